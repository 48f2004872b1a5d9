"""The flow computation without OpenFOAM: mesh, case files, logs, and the logic of runs and sweeps on a recorded run."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import tarfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrowheel_sim.air.cfd import openfoam
from gyrowheel_sim.air.cfd.case import RESULT, Case, Result, finished, mesh_quality, run_case
from gyrowheel_sim.air.cfd.history import average, read_history, read_log, read_moments
from gyrowheel_sim.air.cfd.mesh import MESHES, block_mesh_dict, both_sides, morph
from gyrowheel_sim.air.cfd.polymesh import PolyMesh, read_field, read_points, write_field, write_points
from gyrowheel_sim.air.cfd.sweep import companions, plan, sweep
from gyrowheel_sim.air.table import collect_results
from gyrowheel_sim.air.torque import tilt_axes
from gyrowheel_sim.errors import InputError
from gyrowheel_sim.units import DEG, RPM

from .helpers import AIR, GEOMETRY, RECORDED, Player

tilts = st.floats(-5.0, 5.0)
directions = st.floats(-180.0, 180.0)


def tiny(tilt: float = 5.0, rpm: float = 3500.0, **options: object) -> Case:
    settings = {"mesh": "tiny", "iterations": 40, "window": 20} | options
    return Case.of(GEOMETRY, AIR, tilt * DEG, rpm * RPM, **settings)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def upright(tmp_path_factory: pytest.TempPathFactory) -> PolyMesh:
    """Return the recorded mesh of the resolution `tiny` without tilt."""
    folder = tmp_path_factory.mktemp("mesh")
    with tarfile.open(RECORDED / "polyMesh.tar.gz") as archive:
        archive.extractall(folder / "constant")
    return PolyMesh.read(folder)


def moved(mesh: PolyMesh, tilt: float, direction: float = 0.0) -> PolyMesh:
    points = morph(mesh.points, GEOMETRY, tilt * DEG, direction * DEG)
    return PolyMesh(points, mesh.faces, mesh.owner, mesh.neighbour, mesh.patches)


# ---- mesh


@pytest.mark.parametrize("name", MESHES)
def test_blocks_have_the_stated_number_of_cells(name: str):
    text = block_mesh_dict(GEOMETRY, MESHES[name])
    blocks = re.findall(r"hex \([\d ]+\) \((\d+) (\d+) (\d+)\)", text)
    assert len(blocks) == 22
    assert sum(math.prod(map(int, block)) for block in blocks) == MESHES[name].cells


def test_low_re_meshes_have_the_published_order_of_cells():
    assert MESHES["coarse"].cells == 43_200
    assert 90_000 <= MESHES["low_re"].cells <= 110_000
    assert MESHES["low_re_fine"].cells > 2 * MESHES["low_re"].cells


def test_grading_is_fine_at_both_walls():
    assert both_sides(10.0) == "((0.5 0.5 10)(0.5 0.5 0.1))"
    assert both_sides(1.0) == "1"


def test_the_mesh_fills_the_gap(upright: PolyMesh):
    exact = math.pi * (
        GEOMETRY.case_radius**2 * GEOMETRY.case_height - GEOMETRY.rotor_radius**2 * GEOMETRY.rotor_height
    )
    # 16 straight sides in place of a circle
    polygon = math.sin(2 * math.pi / 16) / (2 * math.pi / 16)
    assert upright.cells == MESHES["tiny"].cells
    assert upright.volumes.sum() == pytest.approx(polygon * exact, rel=1e-6)


@given(tilt=tilts, direction=directions)
def test_no_cell_folds_when_the_rotor_tilts(upright: PolyMesh, tilt: float, direction: float):
    mesh = moved(upright, tilt, direction)
    assert mesh.volumes.min() > 0.2 * upright.volumes.min()
    for patch in ("rotor", "case"):
        assert mesh.wall_distance(patch).min() > 0.0
        # a closed surface
        assert mesh.face_areas[mesh.patches[patch]].sum(axis=0) == pytest.approx(0.0, abs=1e-15)


@given(tilt=tilts, direction=directions)
def test_the_rotor_turns_as_a_whole_and_the_case_stays(upright: PolyMesh, tilt: float, direction: float):
    mesh = moved(upright, tilt, direction)
    axes, still = tilt_axes(tilt * DEG, direction * DEG), tilt_axes(0.0, direction * DEG)
    rotor = np.unique(mesh.faces[mesh.patches["rotor"]])
    assert mesh.points[rotor] @ axes.T == pytest.approx(upright.points[rotor] @ still.T, abs=1e-9)
    case = np.unique(mesh.faces[mesh.patches["case"]])
    x, y, z = mesh.points[case].T
    on_end = np.isclose(np.abs(z), GEOMETRY.case_height / 2, atol=1e-9)
    on_rim = np.isclose(np.hypot(x, y), GEOMETRY.case_radius, atol=1e-9)
    assert np.all(on_end | on_rim)
    assert np.hypot(x, y).max() <= GEOMETRY.case_radius + 1e-9


@pytest.mark.parametrize(
    ("tilt", "geometry", "words"),
    [
        (5.5, GEOMETRY, ["5.5 deg", "-5 to 5 deg"]),
        (
            5.0,
            GEOMETRY.with_value("case_radius", 0.0545),
            ["5 deg", "mm of the case", "a tenth of the rim gap"],
        ),
        (float("nan"), GEOMETRY, ["nan"]),
    ],
)
def test_a_tilt_without_a_mesh_is_refused(upright: PolyMesh, tilt: float, geometry, words: list[str]):
    with pytest.raises(InputError) as refused:
        morph(upright.points, geometry, tilt * DEG)
    assert all(word in str(refused.value) for word in words)


def test_wall_distance_of_a_mesh_by_hand(upright: PolyMesh):
    # end gap of 12 mm in 5 equal cells: the first centre is at 1.2 mm
    faces = upright.patches["rotor"]
    flat = np.abs(upright.face_areas[faces][:, 2]) > 1e-12
    assert upright.wall_distance("rotor")[flat] == pytest.approx(1.2e-3, rel=1e-6)


def test_points_and_fields_survive_their_files(tmp_path: Path, upright: PolyMesh):
    write_points(tmp_path / "points", upright.points)
    assert read_points(tmp_path / "points") == pytest.approx(upright.points, abs=1e-10)
    for values in (upright.cell_centres, upright.volumes):
        write_field(tmp_path / "field", "field", "0 0 0 0 0 0 0", values, {"rotor": "type zeroGradient;"})
        assert read_field(tmp_path / "field", upright.cells) == pytest.approx(values, rel=1e-7, abs=1e-12)


def test_a_field_of_another_mesh_is_refused(tmp_path: Path, upright: PolyMesh):
    write_field(tmp_path / "field", "field", "0 0 0 0 0 0 0", upright.volumes, {})
    with pytest.raises(InputError, match="1824 values, 7 are expected"):
        read_field(tmp_path / "field", 7)


# ---- logs


def test_log_of_a_real_run():
    log = read_log((RECORDED / "log.simpleFoam").read_text())
    assert log.version == "1912 (patch=200626)"
    assert log.iterations == 40
    assert log.finished
    assert set(log.residuals) == {"Ux", "Uy", "Uz", "p", "k", "epsilon"}
    assert all(0.0 < value < 0.1 for value in log.residuals.values())


def test_a_log_that_is_cut_off_is_read_as_far_as_it_goes():
    text = (RECORDED / "log.simpleFoam").read_text()
    log = read_log(text[: len(text) // 2])
    assert not log.finished
    assert 10 < log.iterations < 30
    assert read_log("").iterations == 0


def test_checkmesh_of_a_real_mesh():
    quality = mesh_quality((RECORDED / "log.checkMesh").read_text())
    assert quality["ok"]
    assert quality["cells"] == 1824
    assert 20.0 < quality["non_orthogonality"] < 30.0
    assert not mesh_quality("Failed 2 mesh checks.")["ok"]


def test_torque_of_a_real_run():
    iteration, total, pressure = read_moments(RECORDED / "moment.dat")
    assert iteration.tolist() == list(range(1, 41))
    torque = average(total, pressure, tilt_axes(5 * DEG), 20)
    assert torque.mean[0] < 0.0 < torque.mean[1]
    assert torque.mean[2] < 0.0
    # pressure turns the rotor back and does not brake its spin
    assert torque.pressure[0] == pytest.approx(torque.mean[0], rel=0.05)
    assert torque.pressure[2] == pytest.approx(0.0, abs=1e-9)
    # forty iterations are not enough, and it says so
    assert not torque.settled


def test_settled_and_steady_mean_what_they_say():
    def judged(history: np.ndarray) -> tuple[bool, bool]:
        total = np.column_stack([np.zeros_like(history), np.zeros_like(history), history])
        found = average(total, total, np.eye(3), len(history))
        return found.settled, found.steady

    n = np.arange(200)
    assert judged(np.full(200, -1.0)) == (True, True)
    assert judged(-1.0 + 0.05 * np.sin(2 * np.pi * n / 20)) == (True, False)
    assert judged(-1.0 + 0.04 * n / 200) == (False, True)
    assert judged(-1.0 + 0.2 * n / 200) == (False, False)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("# Time\n", ["empty"]),
        ("1 (1 2 3) (1 2 3) (1 2", ["line 1", "9 numbers, 10"]),
        ("1 (1 2 3) (1 2 3) (1 2 x)\n", ["line 1", "not a row of numbers"]),
    ],
)
def test_broken_torque_logs_are_refused(tmp_path: Path, text: str, words: list[str]):
    (tmp_path / "moment.dat").write_text(text)
    with pytest.raises(InputError) as refused:
        read_moments(tmp_path / "moment.dat")
    assert all(word in str(refused.value) for word in words)


def test_a_torque_that_is_not_finite_is_refused():
    total = np.full((10, 3), np.nan)
    with pytest.raises(InputError, match="diverged"):
        average(total, total, np.eye(3), 5)


# ---- one case


def test_a_run_gives_torque_and_provenance(tmp_path: Path, player: Player):
    parts: list[float] = []
    result = run_case(tiny(), tmp_path / "study", advance=parts.append)
    assert result.torque.mean[0] == pytest.approx(-0.944e-3, rel=0.01)
    assert result.provenance["version"] == "1912 (patch=200626)"
    assert result.provenance["first_guess"] == "solid-body rotation at 0.42 of the spin rate"
    assert 20.0 < result.y_plus["rotor"][0] < 60.0
    assert Result.from_json(json.loads(json.dumps(result.to_json()))).case == result.case
    assert finished(tmp_path / "study" / result.case.name, tiny()) is not None
    # another question is not answered by it
    assert finished(tmp_path / "study" / result.case.name, tiny(iterations=50)) is None


def test_case_files_say_what_was_asked(tmp_path: Path, player: Player):
    case = tiny(3.0, 2000.0, model="sst", start_iterations=0)
    run_case(case, tmp_path)
    folder = tmp_path / case.name

    def entry(file: str, pattern: str) -> str:
        found = re.search(pattern, (folder / file).read_text())
        assert found, (file, pattern)
        return found.group(1)

    assert float(entry("constant/transportProperties", r"nu (\S+);")) == pytest.approx(1.81e-5 / 1.205)
    assert entry("constant/turbulenceProperties", r"RASModel (\w+);") == "kOmegaSST"
    assert float(entry("0/U", r"omega (\S+);")) == pytest.approx(2000 * RPM)
    axis = [float(word) for word in entry("0/U", r"axis \(([^)]*)\)").split()]
    assert axis == pytest.approx([0.0, -math.sin(3 * DEG), math.cos(3 * DEG)])
    assert "nutkWallFunction" in (folder / "0/nut").read_text()
    # the first guess turns about the tilted axis with 0.42 of the spin rate
    mesh = PolyMesh.read(folder)
    expected = np.cross(0.42 * 2000 * RPM * np.array(axis), mesh.cell_centres)
    assert read_field(folder / "0/U", mesh.cells) == pytest.approx(expected, rel=1e-5, abs=1e-6)


def test_a_first_guess_is_scaled_to_the_speed(tmp_path: Path, player: Player):
    slow, fast = tiny(5.0, 1000.0), tiny(5.0, 3000.0, model="sst", start_iterations=0)
    run_case(slow, tmp_path)
    # the player writes 1 in every field
    write_field(tmp_path / slow.name / "40" / "U", "U", "0 1 -1 0 0 0 0", np.ones((1824, 3)), {})
    run_case(fast, tmp_path, first=tmp_path / slow.name)
    start = {name: read_field(tmp_path / fast.name / "0" / name, 1824) for name in ("U", "p", "k", "omega")}
    assert start["U"] == pytest.approx(3.0)
    assert start["p"] == pytest.approx(9.0)
    assert start["k"] == pytest.approx(9.0)
    # epsilon 27 over 0.09 k
    assert start["omega"] == pytest.approx(27.0 / (0.09 * 9.0))


def test_sst_starts_from_k_epsilon_at_the_same_tilt(tmp_path: Path, player: Player):
    case = tiny(model="sst", start_iterations=10)
    result = run_case(case, tmp_path)
    assert player.calls == ["start", case.name]
    assert result.provenance["first_guess"].startswith("k-epsilon on the same mesh, 10 iterations")


def test_a_run_that_has_not_settled_goes_on_for_so_long(tmp_path: Path, player: Player):
    result = run_case(tiny(settle=75), tmp_path)
    # what is played begins anew each time
    assert not result.torque.settled
    assert player.calls == [result.case.name] * 3
    assert result.provenance["iterations"] == 75
    assert result.torque.window == 37
    folder = tmp_path / result.case.name
    assert [p.name for p in folder.iterdir() if p.name.isdigit() and p.name != "0"] == ["75"]
    assert finished(folder, tiny(settle=75)) is not None
    # it answers those who ask for less, too
    assert finished(folder, tiny()) is not None
    assert finished(folder, tiny(settle=76)) is None


def test_a_run_goes_on_no_longer_than_until_it_has_settled(tmp_path: Path, player: Player):
    # what is played twice over has the same mean in both halves
    result = run_case(tiny(settle=400), tmp_path)
    assert result.torque.settled
    assert result.provenance["iterations"] == 80
    assert player.calls == [result.case.name] * 3


def test_what_has_not_settled_goes_on_later(tmp_path: Path, player: Player):
    at_once = run_case(tiny(settle=75), tmp_path / "one")
    study = tmp_path / "two"
    begun = run_case(tiny(), study)
    # not so far as one window
    assert run_case(tiny(settle=55), study).provenance["iterations"] == 55
    calls = len(player.calls)
    later = run_case(tiny(settle=75), study)
    assert len(player.calls) == calls + 1
    assert later.provenance["iterations"] == 75
    assert later.provenance["first_guess"] == begun.provenance["first_guess"]
    assert later.provenance["cpu_seconds"] > begun.provenance["cpu_seconds"]
    assert later.case == at_once.case
    assert later.torque.window == at_once.torque.window
    assert finished(study / later.case.name, tiny(settle=75)) is not None


def test_a_case_with_too_few_iterations_goes_on_to_more(tmp_path: Path, player: Player):
    begun = run_case(tiny(), tmp_path)
    more = tiny(iterations=75, window=37)
    assert finished(tmp_path / more.name, more) is None
    result = run_case(more, tmp_path)
    assert player.calls == [more.name] * 2
    assert (result.provenance["iterations"], result.torque.window) == (75, 37)
    assert result.provenance["first_guess"] == begun.provenance["first_guess"]
    # and answers who asks for fewer, from whatever first guess: a study loses nothing
    assert run_case(tiny(start_iterations=0), tmp_path).provenance["iterations"] == 75
    assert len(player.calls) == 2


def test_another_window_is_another_average_of_the_same_iterations(tmp_path: Path, player: Player):
    first = run_case(tiny(), tmp_path)
    other = run_case(tiny(window=11), tmp_path)
    assert len(player.calls) == 1
    total, _ = read_history(tmp_path / first.case.name / "postProcessing" / "torque")
    np.testing.assert_allclose(other.torque.mean, total[-11:].mean(axis=0) @ other.case.axes.T)
    kept = finished(tmp_path / first.case.name, first.case)
    assert kept is not None
    assert kept.torque.window == 11
    assert run_case(tiny(), tmp_path).torque.mean == pytest.approx(first.torque.mean)


def test_what_a_kill_left_does_not_get_into_the_average(tmp_path: Path, player: Player):
    case = tiny(settle=75)
    expected = run_case(case, tmp_path / "one")
    run_case(tiny(), tmp_path / "two")
    folder = tmp_path / "two" / case.name
    # it had gone on, and was killed in the middle of writing; or after the fields, before the result
    for time_, log in (("60", "41 (9 9 9) (9 9 9) (9 9 9)\n42 (9 9"), ("75", "41 (9 9 9) (9 9 9) (9 9 9)\n")):
        (folder / time_).mkdir()
        (folder / time_ / "U").write_text("internalField nonuniform")
        (folder / "postProcessing" / "torque" / "40").mkdir(exist_ok=True)
        (folder / "postProcessing" / "torque" / "40" / "moment.dat").write_text(log)
    result = run_case(case, tmp_path / "two")
    assert result.torque.mean == pytest.approx(expected.torque.mean)
    assert result.torque.scatter == pytest.approx(expected.torque.scatter)
    assert sorted(p.name for p in folder.iterdir() if p.name.isdigit()) == ["0", "75"]


def test_without_its_fields_a_case_begins_anew(tmp_path: Path, player: Player):
    run_case(tiny(), tmp_path)
    shutil.rmtree(tmp_path / tiny().name / "40")
    result = run_case(tiny(settle=60), tmp_path)
    assert result.provenance["iterations"] == 60
    assert player.calls == [tiny().name] * 3


def test_a_sweep_goes_on_with_what_has_not_settled(tmp_path: Path, player: Player):
    levels = levels_of([0, 5], [2000, 3500])
    sweep(levels, tmp_path, tell=lambda *_: None)
    further = [[replace(step, case=replace(step.case, settle=60)) for step in level] for level in levels]
    outcome = sweep(further, tmp_path, tell=lambda *_: None)
    assert outcome.reused == 0
    assert [result.provenance["iterations"] for result in outcome.results] == [60] * 4
    # 40 + 20; those that start from a neighbour 24 + 20 + 16
    assert len(player.calls) == 4 + 2 * 1 + 2 * 2
    # a look at the same study without it computes nothing
    assert sweep(levels, tmp_path, tell=lambda *_: None).reused == 4


def test_a_history_with_a_hole_is_refused(tmp_path: Path, player: Player):
    case = tiny(settle=60)
    run_case(case, tmp_path)
    logs = tmp_path / case.name / "postProcessing" / "torque"
    assert len(read_history(logs)[0]) == 60
    (logs / "40").rename(logs / "41")
    (logs / "41" / "moment.dat").write_text("42 (1 2 3) (1 2 3) (1 2 3)\n")
    with pytest.raises(InputError, match="iterations are missing"):
        read_history(logs)


def test_a_solver_that_fails_says_why(tmp_path: Path, player: Player):
    player.fail_in(tiny().name)
    with pytest.raises(
        InputError, match=r"simpleFoam failed: Maximum number of iterations exceeded; log: .*log\.simpleFoam"
    ):
        run_case(tiny(), tmp_path)
    assert not (tmp_path / tiny().name / RESULT).exists()


@pytest.mark.parametrize(
    ("text", "code", "why"),
    [
        ("Time = 7\n\nSolving for Ux, Initial residual = 0.1\n", -15, "ended by signal 15 (Terminated)"),
        ("#1 Foam::sigFpe::sigHandler\n", -8, "the solution diverged (floating-point exception)"),
        ("some words\nlast words\n", 3, "last words"),
        ("", 3, "exit status 3"),
    ],
)
def test_a_solver_that_ends_without_a_word_is_explained(text: str, code: int, why: str):
    assert openfoam.reason(text, code) == why


def test_a_folder_of_somebody_else_is_left_alone(tmp_path: Path, player: Player):
    (tmp_path / tiny().name).mkdir()
    (tmp_path / tiny().name / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="is no case"):
        run_case(tiny(), tmp_path)
    assert (tmp_path / tiny().name / "thesis.tex").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"mesh": "huge"}, ["mesh", "'huge'", "coarse"]),
        ({"model": "magic"}, ["model", "'magic'", "sst, paper, laminar"]),
        ({"rpm": 0.0}, ["speed", "10 .. 20000"]),
        ({"tilt": 9.0}, ["tilt", "9 deg"]),
        ({"window": 41}, ["window", "41", "2 .. 40"]),
    ],
)
def test_cases_that_make_no_sense_are_refused(options: dict[str, Any], words: list[str]):
    with pytest.raises(InputError) as refused:
        tiny(**options)
    assert all(word in str(refused.value) for word in words)


# ---- sweeps


def levels_of(tilts: list[float], rpms: list[float]):
    template = tiny()
    return plan(template, [t * DEG for t in tilts], [w * RPM for w in rpms], 3500 * RPM)


def test_a_plan_starts_each_tilt_at_one_speed_and_the_others_from_there():
    first, rest = levels_of([0, 5], [1000, 3400, 4000])
    assert [(s.case.tilt / DEG, round(s.case.spin_rate / RPM), s.first) for s in first] == [
        (0.0, 3400, None),
        (5.0, 3400, None),
    ]
    assert {(round(s.case.tilt / DEG), round(s.case.spin_rate / RPM)) for s in rest} == {
        (t, w) for t in (0, 5) for w in (1000, 4000)
    }
    for step in rest:
        assert step.first is not None
        assert step.first.tilt == step.case.tilt


@pytest.mark.parametrize(
    ("mesh", "other", "laminar"),
    [
        ("low_re", "low_re_fine", "low_re"),
        ("low_re_fine", "low_re", "low_re_fine"),
        ("tiny", "low_re_fine", "low_re"),
    ],
)
def test_companions_vary_one_thing_each(mesh: str, other: str, laminar: str):
    steps = companions(tiny(mesh=mesh), 5 * DEG, 3500 * RPM)
    cases = [step.case for step in steps]
    assert len({case.name for case in cases}) == len(cases)
    assert any(case.tilt == -5 * DEG for case in cases)
    assert any(case.direction == pytest.approx(math.pi / 4) for case in cases)
    assert {(c.mesh, c.model) for c in cases} >= {
        (other, "sst"),
        ("coarse", "paper"),
        (laminar, "laminar"),
    }


def test_a_sweep_computes_nothing_twice(tmp_path: Path, player: Player):
    seen: list[tuple[str, int, int]] = []
    levels = levels_of([0, 5], [2000, 3500])
    first = sweep(levels, tmp_path, tell=lambda case, _, done, total: seen.append((case.name, done, total)))
    assert [item[1:] for item in seen] == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert len(player.calls) == 4
    again = sweep(levels, tmp_path, tell=lambda *_: None)
    assert len(player.calls) == 4
    assert (first.reused, again.reused) == (0, 4)
    assert [r.to_json() for r in again.results] == [r.to_json() for r in first.results]
    wider = sweep(levels_of([0, 5], [2000, 3500, 4000]), tmp_path, tell=lambda *_: None)
    assert len(player.calls) == 6
    assert wider.reused == 4
    assert len(collect_results(tmp_path)) == 6


def test_a_case_that_fails_holds_up_only_those_that_start_from_it(tmp_path: Path, player: Player):
    levels = levels_of([0, 5], [2000, 3500])
    player.fail_in(levels[0][1].case.name)
    outcome = sweep(levels, tmp_path, tell=lambda *_: None)
    assert len(outcome.results) == 2
    assert len(outcome.failed) == 2
    assert any("Maximum number of iterations" in why for why in outcome.failed.values())
    assert any("first guess" in why for why in outcome.failed.values())


def test_half_written_results_are_computed_again(tmp_path: Path, player: Player):
    levels = levels_of([5], [3500])
    sweep(levels, tmp_path, tell=lambda *_: None)
    path = tmp_path / levels[0][0].case.name / RESULT
    path.write_text(path.read_text()[:100])
    assert sweep(levels, tmp_path, tell=lambda *_: None).reused == 0
    assert len(player.calls) == 2


SWEEP = ["cfd", "sweep", "--mesh", "tiny", "--iterations", "40", "--tilts", "0,2,5", "--speeds", "3000,3500"]


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_sweep_that_is_killed_goes_on_where_it_was(tmp_path: Path, player: Player, jobs: int):
    study = tmp_path / "study"
    command = [
        sys.executable,
        "-c",
        "from gyrowheel_bringup.cli import main; main()",
        *SWEEP,
        "--jobs",
        str(jobs),
    ]
    player.hang_at(3)
    process = subprocess.Popen([*command, "-o", str(study)], stderr=subprocess.PIPE, text=True)
    try:
        done = _wait(lambda: len(player.calls) >= 3 and len(list(study.glob(f"*/{RESULT}"))) >= 2)
        assert done, process.poll()
        hanging = player.calls[2]
        assert _wait(lambda: bool(_running(player)))
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
    # no solver outlives its sweep
    assert _wait(lambda: not _running(player))
    before = {path.parent.name for path in study.glob(f"*/{RESULT}")}
    assert hanging not in before
    player.hang_at(None)
    calls = len(player.calls)
    finish = subprocess.run([*command, "-o", str(study)], capture_output=True, text=True, check=False)
    assert finish.returncode == 0, finish.stderr
    assert f"6 cases finished, {len(before)} of them before; 0 failed" in finish.stdout
    assert sorted(player.calls[calls:]) == sorted({r.case.name for r in collect_results(study)} - before)


def test_two_sweeps_in_one_folder_are_refused(tmp_path: Path, player: Player):
    import fcntl

    with (tmp_path / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="another sweep works in this folder"):
            sweep(levels_of([5], [3500]), tmp_path, tell=lambda *_: None)


def test_a_sweep_runs_on_a_dask_cluster(tmp_path: Path, player: Player):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        seen: list[int] = []
        outcome = sweep(
            levels_of([0, 5], [2000, 3500]),
            tmp_path / "study",
            dask=cluster.scheduler_address,
            tell=lambda case, result, done, total: seen.append(done),
        )
    assert seen == [1, 2, 3, 4]
    assert len(outcome.results) == len(player.calls) == 4
    assert sweep(levels_of([0, 5], [2000, 3500]), tmp_path / "study", tell=lambda *_: None).reused == 4


def test_dask_that_is_missing_is_named(tmp_path: Path, player: Player, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "dask.distributed", None)
    with pytest.raises(
        InputError, match=r"--dask needs the package distributed.*pip install 'gyrowheel-sim\[dask\]'"
    ):
        sweep(levels_of([5], [3500]), tmp_path, dask="tcp://127.0.0.1:1", tell=lambda *_: None)


# ---- without OpenFOAM


def test_without_openfoam_one_line_says_how_to_install_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    for call in (
        lambda: run_case(tiny(), tmp_path / "study"),
        lambda: sweep(levels_of([5], [3500]), tmp_path / "study", tell=lambda *_: None),
    ):
        with pytest.raises(InputError, match="apt-get install openfoam"):
            call()
    assert not (tmp_path / "study").exists()


# ---- with OpenFOAM


@pytest.mark.openfoam
@pytest.mark.skipif(not openfoam.available(), reason="OpenFOAM is not installed")
def test_a_tiny_case_really_runs(tmp_path: Path):
    result = run_case(tiny(), tmp_path)
    back = run_case(tiny(-5.0), tmp_path)
    recorded = average(*read_moments(RECORDED / "moment.dat")[1:], result.case.axes, 20)
    # another version of OpenFOAM may differ a little; a wrong sign, unit or axis would not be little
    assert result.torque.mean == pytest.approx(recorded.mean, rel=0.2, abs=5e-5)
    assert back.torque.mean == pytest.approx(result.torque.mean * [-1, -1, 1], rel=0.2, abs=5e-5)
    assert result.provenance["cells"] == 1824
    assert result.provenance["version"] is not None
    # one that goes on ends settled, or at its limit
    longer = run_case(tiny(settle=400), tmp_path)
    assert longer.torque.settled or longer.provenance["iterations"] == 400
    assert longer.provenance["iterations"] > 40
    # and SST from k-epsilon, at another speed
    other = run_case(tiny(5.0, 2000.0, model="sst", start_iterations=20), tmp_path)
    assert other.torque.mean[0] < 0.0
    assert other.torque.mean[2] < 0.0


def _wait(condition, seconds: float = 60.0) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.05)
    return False


def _running(player: Player) -> list[int]:
    """Return the processes that hang in place of a solver of this player."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0")
                here = (entry / "cwd").resolve()
            except OSError:
                continue
            if words[:2] == [b"sleep", b"1000"] and here.is_relative_to(player.path.parent):
                found.append(int(entry.name))
    return found
