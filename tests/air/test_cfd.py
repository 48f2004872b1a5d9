"""A case of the flow computation: logs, case files, and the logic of a run on a recorded one; one real run."""

from __future__ import annotations

import json
import math
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrowheel_air.cfd import openfoam
from gyrowheel_air.cfd.case import RESULT, Result, finished, mesh_quality, run_case
from gyrowheel_air.cfd.mesh import PolyMesh, read_field, write_field
from gyrowheel_air.cfd.openfoam import average, read_history, read_log, read_moments
from gyrowheel_air.cfd.sweep import sweep
from gyrowheel_air.torque import tilt_axes
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM

from .helpers import RECORDED, Player, levels_of, tiny

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


def test_settled_and_steady_follow_drift_and_scatter():
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


def test_case_files_contain_the_request(tmp_path: Path, player: Player):
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


def test_an_unsettled_run_continues_up_to_the_limit(tmp_path: Path, player: Player):
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


def test_a_run_ends_when_it_has_settled(tmp_path: Path, player: Player):
    # what is played twice over has the same mean in both halves
    result = run_case(tiny(settle=400), tmp_path)
    assert result.torque.settled
    assert result.provenance["iterations"] == 80
    assert player.calls == [result.case.name] * 3


def test_unsettled_case_continues_in_a_later_call(tmp_path: Path, player: Player):
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


def test_a_case_with_too_few_iterations_continues(tmp_path: Path, player: Player):
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


def test_remains_of_a_killed_run_are_not_averaged(tmp_path: Path, player: Player):
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


def test_a_case_without_its_fields_starts_again(tmp_path: Path, player: Player):
    run_case(tiny(), tmp_path)
    shutil.rmtree(tmp_path / tiny().name / "40")
    result = run_case(tiny(settle=60), tmp_path)
    assert result.provenance["iterations"] == 60
    assert player.calls == [tiny().name] * 3


def test_a_history_with_a_hole_is_refused(tmp_path: Path, player: Player):
    case = tiny(settle=60)
    run_case(case, tmp_path)
    logs = tmp_path / case.name / "postProcessing" / "torque"
    assert len(read_history(logs)[0]) == 60
    (logs / "40").rename(logs / "41")
    (logs / "41" / "moment.dat").write_text("42 (1 2 3) (1 2 3) (1 2 3)\n")
    with pytest.raises(InputError, match="iterations are missing"):
        read_history(logs)


def test_a_failed_solver_is_reported_with_its_reason(tmp_path: Path, player: Player):
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
def test_a_solver_that_ends_silently_is_reported_with_a_reason(text: str, code: int, why: str):
    assert openfoam.reason(text, code) == why


def test_a_folder_of_other_content_is_not_changed(tmp_path: Path, player: Player):
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
def test_invalid_cases_are_refused(options: dict[str, Any], words: list[str]):
    with pytest.raises(InputError) as refused:
        tiny(**options)
    assert all(word in str(refused.value) for word in words)


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


@pytest.mark.slow
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
