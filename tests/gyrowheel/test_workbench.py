"""The session of the workbench, and the pages and pictures of it."""

from __future__ import annotations

import http.client
import json
import os
import re
import shutil
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest
import yaml

import gyrowheel as gw
from gyrowheel.diagnosis.api import Diagnosis
from gyrowheel.recordings.api import note_machine
from gyrowheel.simulation.api import record_simulation
from gyrowheel.simulation.scenario import scenario
from gyrowheel.workbench import pictures, residual, tables, views, windows
from gyrowheel.workbench.benches import SimulatedBench
from gyrowheel.workbench.coefficients import Estimates
from gyrowheel.workbench.library import ROLES, Envelope, Library, Opened, envelopes
from gyrowheel.workbench.report import before
from gyrowheel.workbench.server import Server
from gyrowheel.workbench.session import Session, Step
from gyrowheel.workbench.torque_map import torque_maps
from gyrowheel_analysis.diagnosis.findings import TieReport
from gyrowheel_analysis.diagnosis.proof_result import Proof
from gyrowheel_analysis.reduction.instrument_readings import ReadingFinding
from gyrowheel_analysis.reduction.windows import HARMONICS, Coverage
from gyrowheel_control.plans.plan import Plan
from gyrowheel_recording.mislabelled import Fix, WrongSetup
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import effect_to_mapping
from gyrowheel_sim.plant.scenario import Scenario

from .conftest import Wheel
from .findings import MAP, UNKNOWN, diagnosis, finding
from .helpers import SHORT_PLAN, ask, write
from .lab_tables import lab_table


@pytest.fixture(scope="module")
def compared(wheel: Wheel) -> Iterator[Session]:
    """Return a session with a recording compared and its holds predicted, and nothing diagnosed."""
    session = Session(Library([wheel.recording.parent]), gw.Model.load(wheel.model), wheel.model)
    session.open("0/drag", "fitted")
    session.wait(240.0)
    session.compare()
    session.wait(240.0)
    assert session.trouble is None
    yield session
    session.shut()


def test_decimation_keeps_spikes_and_short_signals() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=300_001)
    values[[0, 123_456, 300_000]] = 50.0, -60.0, np.nan
    line = Envelope(values)
    for first, last in ((0, 300_001), (100_000, 130_000), (123_000, 124_000), (120_000, 250_123)):
        places, found = line.cut(first, last, 400)
        assert len(found) <= 400
        assert np.all(np.diff(places) > 0)
        inside = values[first:last]
        assert found.min() == np.nanmin(inside) == -60.0
        assert found.max() >= np.nanmax(inside)
    places, found = line.cut(5, 105, 400)
    assert np.array_equal(found, values[5:105])
    assert np.array_equal(places, np.arange(5, 105))


def test_envelopes_of_all_columns_agree_with_single_ones() -> None:
    """Also of more rows than one block has, and the last block cut."""
    rng = np.random.default_rng(2)
    rows = np.zeros(100_001, [("stamp_ns", "i8"), ("a", "f8"), ("b", "f8"), ("undrawn", "f8")])
    rows["a"], rows["b"] = rng.normal(size=(2, len(rows)))
    rows["b"][70_000:70_600] = np.nan
    found = envelopes(rows, {"a", "b", "c"})
    assert found.keys() == {"a", "b"}
    for name, line in found.items():
        for own, alone in zip(
            line.cut(0, len(rows), 100), Envelope(rows[name]).cut(0, len(rows), 100), strict=True
        ):
            np.testing.assert_array_equal(own, alone)
    drawn = found["b"].cut(0, len(rows), 100)[1]
    assert (drawn.min(), drawn.max()) == (np.nanmin(rows["b"]), np.nanmax(rows["b"]))
    assert envelopes(rows[:0], {"a"})["a"].cut(0, 0, 100)[1].size == 0


def test_times_of_positions_between_samples() -> None:
    times = np.cumsum(np.random.default_rng(3).random(50))
    places = np.array([0.0, 0.5, 7.25, 48.5, 49.0, 49.5])
    np.testing.assert_allclose(
        pictures._between(times, places), np.interp(places, np.arange(50), times), rtol=1e-15
    )


def test_only_recordings_of_the_chosen_folders_can_be_named(wheel: Wheel, tmp_path: Path) -> None:
    folder = tmp_path / "chosen"
    shutil.copytree(wheel.recording, folder / "deep" / "drag")
    (folder / "link").symlink_to(wheel.other)
    library = Library([folder])
    assert [entry.key for entry in library.entries()] == ["0/deep/drag"]
    for key in ("0/../drag", str(wheel.other), "0/link", "0/deep/drag/../drag", "1/deep/drag", ""):
        with pytest.raises(gw.InputError, match="not in the chosen folders"):
            library.find(key)
    with pytest.raises(gw.InputError, match="no such folder"):
        Library([tmp_path / "none"])


def noted(folder: Path, when: float) -> None:
    """Make what looks like a recording of five seconds, changed at a time."""
    folder.mkdir(parents=True)
    text = "rosbag2_bagfile_information:\n  version: 9\n  duration:\n    nanoseconds: 5000000000\n"
    os.utime(write(folder / "metadata.yaml", text), (when, when))


def test_the_latest_recordings_are_listed_and_the_others_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for k in range(4):
        noted(tmp_path / f"day{k}" / "run", 1000.0 + k)
    monkeypatch.setattr(views, "MOST_LISTED", 2)
    part = views.state(Session(Library([tmp_path]), gw.Model()))["parts"]["recordings"]
    places = [part.find(f"in day{k}, ") for k in range(4)]  # folders of one name are told apart
    assert places[:2] == [-1, -1]
    assert -1 < places[3] < places[2]
    assert "5.0 s, " in part
    assert "2 older ones are not listed" in part


def test_a_recording_with_invalid_bytes_in_its_name_opens(wheel: Wheel, tmp_path: Path) -> None:
    shutil.copytree(wheel.recording, os.fsdecode(os.fsencode(tmp_path) + b"/Me\xdf"))
    with Server(Session(Library([tmp_path]), gw.Model()), port=0) as server:
        assert "<b>Me\\xdf</b>" in json.loads(ask(server, "/state")[1])["parts"]["recordings"]
        assert ask(server, "/do/open", {"key": "0/Me\\xdf", "role": "fitted"})[0] == 200
        server.session.wait(240.0)
        assert server.session.trouble is None
        status, body = ask(server, "/state")
        assert status == 200
        assert [own["key"] for own in json.loads(body)["signals"]] == ["0/Me\\xdf"]


def test_long_names_of_tables_are_shortened() -> None:
    name = tables.file_name("測" * 200 + ".csv")
    assert name.startswith("測")
    assert name.endswith(".csv")
    assert len(name.encode()) <= 120


def test_windows_and_sentences_of_a_cell_of_the_map(compared: Session) -> None:
    found = pictures.found(compared)
    comparison = compared.step.comparison
    assert comparison is not None
    data = comparison.data
    for shown in found["maps"]:
        every = [k for cell in shown["cells"] for k in cell["windows"]]
        assert sorted(every) == list(range(len(data.windows)))  # each window once
        for cell, own in zip(shown["cells"], comparison.map(shown["variable"]).cells, strict=True):
            assert len(cell["windows"]) == own.count
            mean = np.mean([found["windows"]["chi2"]["spin"]["values"][k] for k in cell["windows"]])
            assert mean == pytest.approx(own.chi2_per_n["spin"])
    whole = windows.region(compared, range(len(data.windows)))
    assert whole["share"] == pytest.approx(1.0)
    assert [own["share"] for own in whole["said"]] == [r.share_of_chi2 for r in comparison.where]
    with pytest.raises(gw.InputError, match="windows: must be of 0"):
        windows.region(compared, [len(data.windows)])


def test_the_spectrum_by_order_names_its_lines_and_what_is_measured(compared: Session) -> None:
    """The joint gives the motor a torque twice a turn; at the orders of the model the coils have its residual."""
    comparison = compared.step.comparison
    assert comparison is not None
    motor = residual.orders(compared, "spin", [])
    (line,) = motor["lines"]
    assert line["title"] == "motor torque by its current, mN·m: measured"
    assert "clearest first: order 2: " in motor["said"]
    size = max(line["amplitude"])
    assert motor["order"][line["amplitude"].index(size)] == 2.0
    # the amplitude of the reduction at that order, whose windows are the same samples
    w = comparison.data.windows
    known = 2.0 * np.abs(w.current_harmonics[:, HARMONICS.index(2), 0]) * 1e3
    known *= compared.step.model.bench.value("motor_constant")
    assert known.min() < size < known.max()
    coils = residual.orders(compared, "tilt", [0, 1])
    assert [own["title"].partition(": ")[2] for own in coils["lines"]] == [
        "measured; residual at 1, 2",
        "measured",
    ]
    assert "in the 2 chosen windows" in coils["said"]
    for channel, chosen, said in (("tlt", [], "did you mean tilt"), ("tilt", [99], "windows: must be of 0")):
        with pytest.raises(gw.InputError, match=said):
            residual.orders(compared, channel, chosen)


def test_the_first_picture_is_of_the_worst_channel_over_the_variable_that_tells_most(
    compared: Session,
) -> None:
    comparison = compared.step.comparison
    assert comparison is not None
    data = comparison.data
    assert windows.worst_place(data) == ("spin", "speed")  # windage
    for channel, part in data.parts.items():
        for variable in ("speed", "tilt"):
            where = windows.values_of(data.windows, variable)
            wrong = 1.0 + 300.0 * ((where - where.min()) / np.ptp(where)) ** 2
            parts = {**data.parts, channel: replace(part, chi2=len(part.kind.rows) * wrong)}
            assert windows.worst_place(replace(data, parts=parts)) == (channel, variable)


#: Hidden effects of recordings of plan quick: seed, channels that the law acts on, variables that are in it. Two more
#: were tried: gravity_offset is not visible at 0.01, and stiffness_anisotropy is shown in its channel over speed.
HIDDEN = {
    "windage": (11, ("spin", "motor_voltage"), ("speed",)),
    "bearing_viscous": (12, ("spin", "motor_voltage"), ("speed",)),
    "eddy_drag": (13, ("spin", "motor_voltage"), ("speed",)),
    "windage_tilt:w=0.001": (14, ("spin", "motor_voltage"), ("speed", "tilt")),
    "aero_restoring:k=0.05": (15, ("tilt",), ("speed", "tilt")),
    "aero_cross": (16, ("tilt",), ("speed", "tilt")),
    "cubic_stiffness:q=10": (17, ("tilt",), ("tilt",)),
    "coil_tilt:g=0.3": (20, ("tilt",), ("tilt",)),
    "tilt_rotation:a=0.05": (21, ("tilt",), ("tilt",)),
    "inertia_anisotropy:d=2e-5": (22, ("tilt_2n",), ("speed", "tilt")),
}


@pytest.mark.study
@pytest.mark.parametrize("effect", HIDDEN)
def test_the_first_picture_shows_the_channel_and_the_variable_of_a_hidden_effect(
    effect: str, tmp_path: Path
) -> None:
    seed, channels, variables = HIDDEN[effect]
    bench, plan = Bench.load(), Plan.load("quick")
    hidden = scenario(bench, plan.name, effects=[effect], seed=seed)
    record_simulation(tmp_path / "runs", bench, hidden, plan)
    session = Session(Library([tmp_path]), gw.Model())
    session.steps = [Step(gw.Model(), gw.compare(tmp_path / "runs", gw.Model()))]
    session.opened = {"0/runs": Opened("0/runs", gw.Recording.open(tmp_path / "runs"), ROLES[0], {}, {})}
    shown = windows.windows(session)
    assert shown is not None
    assert shown["worst"] in channels
    assert shown["variable"] in variables
    # what is drawn is what was found: the largest colours are in that channel
    chi2 = {name: np.mean(own["values"]) for name, own in shown["chi2"].items()}
    assert max(chi2, key=lambda name: chi2[name]) == shown["worst"]


def test_ranges_are_fitted_predicted_or_left_out(compared: Session, wheel: Wheel) -> None:
    """Results belong to the ranges that they were found with, and come back with them."""
    whole, length = compared.step, gw.Recording.open(wheel.recording).duration
    compared.use("0/drag", 12.0, length + 1.0, "not used to fit")
    compared.use("0/drag", -1.0, 0.5, "left out")
    compared.use("0/drag", 0.8, 1.0, "left out")
    compared.use("0/drag", 0.5, 0.9, "left out")
    compared.use("0/drag", 0.9, 1.0, "fitted")
    path = str(wheel.recording.resolve())
    assert [str(own.path) for own in compared.used("fitted")] == [f"{path}@from=0.9,until=12"]
    assert [str(own.path) for own in compared.used("not used to fit")] == [f"{path}@from=12"]
    state = views.state(compared)
    assert [(own["from"], own["until"], own["use"]) for own in state["signals"][0]["uses"]] == [
        (0.0, 0.9, "left out"), (0.9, 12.0, "fitted"), (12.0, pytest.approx(length), "not used to fit"),
    ]  # fmt: skip
    assert "0 … 0.9 s left out; 0.9 … 12 s fit" in state["parts"]["recordings"]
    assert "not compared" in state["parts"]["verdict"]
    assert pictures.found(compared)["windows"] is None
    compared.compare()
    compared.wait(240.0)
    assert compared.trouble is None
    shown = pictures.found(compared)["windows"]
    assert set(shown["recording"]) == {"0/drag"}
    assert min(shown["start"]) > 0.899  # within a sample
    assert max(shown["start"]) < 12.0
    for begin, end, use, words in (
        (5.0, 4.0, "fitted", "range: 5 to 4 s is not allowed"),
        (length + 1.0, length + 2.0, "fitted", "range"),
        (np.nan, 4.0, "fitted", "range"),
        (1.0, 4.0, "root", "use: 'root' is not allowed"),
    ):
        with pytest.raises(gw.InputError, match=words):
            compared.use("0/drag", begin, end, use)  # type: ignore[arg-type]
    while compared.step.ranges:
        compared.undo()
    assert compared.step is whole
    compared.redo()
    assert compared.step.ranges
    compared.use_all("0/drag")
    assert [own.path for own in compared.used("fitted")] == [wheel.recording.resolve()]
    while compared.step is not whole:
        compared.undo()


def test_residuals_are_what_is_measured_less_what_is_predicted(compared: Session) -> None:
    comparison = compared.step.comparison
    assert comparison is not None
    rows = {row["title"]: row for row in pictures.found(compared)["residuals"]}
    assert len(rows) == sum(len(part.kind.rows) for part in comparison.data.parts.values())
    for row in rows.values():
        part = comparison.data.parts[row["channel"]]
        assert part.measured is not None
        side = np.imag if row["place"] else np.real
        whole = np.abs(row["measured"]).max()
        size = np.abs(side(part.measured)).max() / whole if whole else 1.0
        left = size * np.subtract(row["measured"], row["predicted"])
        np.testing.assert_allclose(left, side(part.values), atol=2e-5 * size * whole)
    spin, part = rows["spin"], comparison.data.parts["spin"]
    assert spin["unit"] == "mN·m"
    np.testing.assert_allclose(spin["residual"], 1e3 * part.values, rtol=1e-4)
    np.testing.assert_allclose(spin["sigma"], 1e3 * part.sigma, rtol=1e-4)
    # windage is no noise: its spectrum and its quantiles are far off
    assert max(spin["noise"]["power"]) > 10.0 * spin["noise"]["level"]
    assert spin["noise"]["white"][-1] > 3.0 * spin["noise"]["high"][-1]
    assert [row["others"] for row in rows.values()] == [{}] * len(rows)
    compared.steps.append(replace(compared.step, model=gw.Model()))
    after = {row["title"]: row for row in pictures.found(compared)["residuals"]}
    alike = {key: spin[key] for key in ("predicted", "residual", "sigma", "chi2")}
    assert after["spin"]["others"] == {"no effects": alike}
    compared.steps.pop()


def test_the_model_of_a_file_is_drawn_over_the_results(compared: Session, wheel: Wheel) -> None:
    text = wheel.model.read_text(encoding="utf-8").replace("effects: {}", "effects: {windage: {w: 0.0013}}")
    kept, shown = compared.step, pictures.found(compared)["residuals"]
    file = write(wheel.model.parent / "colleague.yaml", text)
    noted = write(wheel.model.parent / "notes.yaml", "names: no model\n")
    try:
        assert pictures.found(compared)["models"] == ["colleague.yaml"]
        with pytest.raises(gw.InputError, match="no model file here"):
            compared.other("notes.yaml")
        compared.other("colleague.yaml")
        compared.wait(240.0)
    finally:
        file.unlink()
        noted.unlink()
    assert compared.trouble is None
    assert compared.step is kept
    rows = {row["title"]: row for row in pictures.found(compared)["residuals"]}
    assert rows["spin"]["others"].keys() == {"colleague.yaml"}
    own = gw.compare(wheel.recording, gw.Model.load(write(file.with_name("again.yaml"), text)))
    file.with_name("again.yaml").unlink()
    np.testing.assert_allclose(
        rows["spin"]["others"]["colleague.yaml"]["residual"], 1e3 * own.data.parts["spin"].values, rtol=1e-4
    )
    other = rows["spin"]["others"]["colleague.yaml"]
    assert other["chi2"] < 0.1 * rows["spin"]["chi2"]
    # what each predicts differs as what each leaves does, in the units of both
    size = {"µN·m": 1e-6, "mN·m": 1e-3}
    change = np.subtract(rows["spin"]["residual"], other["residual"]) * size[rows["spin"]["unit"]]
    more = np.subtract(other["predicted"], rows["spin"]["predicted"]) * size[rows["spin"]["measured_unit"]]
    np.testing.assert_allclose(more, change, atol=1e-8)
    # and so do the windows of the tilt plane
    drawn = pictures.found(compared)["windows"]
    part = own.data.parts["spin"]
    np.testing.assert_allclose(drawn["others"]["colleague.yaml"]["chi2"]["spin"]["values"], part.chi2)
    assert [row["residual"] for row in rows.values()] == [row["residual"] for row in shown]


def test_estimates_are_drawn_as_fitted_and_a_profile_rises_at_the_ends_of_its_interval(
    compared: Session, wheel: Wheel
) -> None:
    with pytest.raises(gw.InputError, match="nothing is estimated yet"):
        compared.profile("windage.w")
    model = gw.Model().add("windage", fit=wheel.recording)
    fit = model.fit(wheel.recording, free=["windage", "bearing_viscous"])
    kept = compared.steps
    compared.steps, compared.report = [replace(compared.step, estimates=Estimates(fit))], "written before"
    try:
        with pytest.raises(gw.InputError, match=r"windage\.v: no such parameter"):
            compared.profile("windage.v")
        compared.profile("windage.w")
        compared.wait(240.0)
        assert compared.trouble is None
        assert compared.report == "written before"  # which has no estimates
        shown = pictures.found(compared)["estimates"]
    finally:
        compared.steps, compared.report = kept, None
    rows = {row["name"]: row for row in shown["rows"]}
    assert list(rows) == fit.names == shown["names"]
    for name, row in rows.items():
        own = fit.params[name]
        size = row["both"][0] / own.value
        np.testing.assert_allclose(row["both"][1], size * own.standard_error, rtol=1e-6)
        assert (row["stated"] is None) == (own.prior is None)
        if own.prior is not None:
            np.testing.assert_allclose(row["stated"], size * np.array(own.prior), rtol=1e-6)
    assert (rows["windage.w"]["unit"], rows["windage.n"]["words"]["stated"]) == ("mN·m", "1.480 ± 0.030")
    np.testing.assert_allclose(shown["correlation"], fit.correlation.values, atol=1e-3)
    # the strongest pair is named, with the direction in which both may change
    assert shown["said"][0].startswith(
        "Strongest correlation of an effect: windage.w and bearing_viscous, −0."
    )
    assert "A larger value of one with a smaller value of the other" in shown["said"][0]
    profile = rows["windage.w"]["profile"]
    rise = np.interp(profile["interval"], profile["values"], profile["rise"])
    np.testing.assert_allclose(rise, 3.84, rtol=0.05)


def test_noise_has_no_correlation_and_no_line_and_a_drift_has_both() -> None:
    rng = np.random.default_rng(3)
    time = np.sort(rng.uniform(0.0, 300.0, 120))
    beyond = []
    for _ in range(200):
        white = rng.normal(size=120)
        found = residual.spectrum([(time, white)])
        beyond.append(max(found["power"]) > found["level"])
        band = 1.96 / np.sqrt(120)
    assert 0.01 < np.mean(beyond) < 0.12  # of a level that noise exceeds in 5 of 100 cases
    inside = np.abs(residual.correlation([white])) < band
    assert np.mean(inside) > 0.8
    drift = 2.0 * np.sin(2.0 * np.pi * 0.02 * time) + white
    found = residual.spectrum([(time, drift)])
    assert found["frequency"][int(np.argmax(found["power"]))] == pytest.approx(0.02, abs=2e-3)
    assert max(found["power"]) > 5.0 * found["level"]
    assert residual.correlation([drift])[0] > 3.0 * band


def test_a_residual_that_follows_the_motion_three_windows_later_is_correlated_with_it_there() -> None:
    rng = np.random.default_rng(5)
    motion = rng.normal(size=100)
    white = rng.normal(size=100)
    white[3:] += 2.0 * motion[:-3]
    found = residual.cross_correlation([(white[:60], motion[:60]), (white[60:], motion[60:])])
    assert len(found) == 21
    assert int(np.argmax(np.abs(found))) - 10 == 3
    others = np.abs(np.delete(found, 13))
    assert np.mean(others < 1.96 / np.sqrt(100)) > 0.8
    assert found[13] > 0.5
    assert residual.cross_correlation([(white, np.ones(100))]) == [0.0] * 21


def test_holds_agree_with_the_drag_comparison(compared: Session, wheel: Wheel) -> None:
    own = pictures.holds(compared)["0/drag"]
    (holds,) = gw.drag(wheel.recording, gw.Model.load(wheel.model)).holds
    constant = gw.Model.load(wheel.model).bench.value("coil_constant")
    assert own["hold"] == [e.segment for e in holds]
    for k, e in enumerate(holds):
        x = own["actuators"][0]
        assert x["torque"]["measured"][k] == pytest.approx(1e3 * e.measured_torque[0])
        assert x["torque"]["predicted"][k] == pytest.approx(1e3 * e.simulated_torque[0])
        assert x["voltage"]["predicted"][k] == pytest.approx(1e3 * e.simulated_voltage_increment[0])
        level = own["levels"]["coil_voltage_x"]
        assert constant * (level["measured"][k] - level["predicted"][k]) == pytest.approx(e.residual[0])
        assert 0.0 <= own["start"][k] < own["end"][k] <= compared.opened["0/drag"].recording.duration


def test_states_of_the_rotor_are_means_of_the_samples(compared: Session) -> None:
    samples, time = (getattr(compared.opened["0/drag"].recording, name) for name in ("measurement", "time"))
    states = pictures.motion(compared, "0/drag", 1.0, 2.0)
    assert len(states["time"]) == 30
    span = (time >= 1.0) & (time < 2.0)
    assert np.mean(states["tilt_x"]) == pytest.approx(samples["tilt_x"][span].mean(), rel=1e-2)
    assert all(1.0 <= t <= 2.0 for t in states["time"])


def test_a_test_runs_on_the_machine_of_the_recordings_and_is_opened(
    wheel: Wheel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(wheel.recording, tmp_path / "drag")
    session = Session(Library([tmp_path / "drag"]), gw.Model.load(wheel.model))
    session.open("0/.", "fitted")
    session.wait(240.0)
    plan = "check@hold_s=0.5"
    with pytest.raises(gw.InputError, match="not what the diagnosis asks for"):
        session.test(plan)
    diagnosed: list[int] = []
    monkeypatch.setattr(session, "tests", lambda: [plan])
    monkeypatch.setattr(session, "_diagnose", lambda at: diagnosed.append(len(session.used("fitted"))))
    with pytest.raises(gw.InputError, match="not of a simulated bench"):
        session.test(plan)
    note_machine(session.used("fitted")[0], ["--effect", "windage", "--machine", "3", "--seed", "5"])
    session.test(plan)
    session.wait(240.0)
    assert session.trouble is None
    assert diagnosed == [2]  # after it was joined
    made = session.opened["1/."].recording
    assert made.path == tmp_path / "check-hold-s-0-5-1"
    bench = SimulatedBench.of([made])
    assert bench == SimulatedBench(effect=("windage",), machine=3, seed=5)
    # ended in the middle: nothing is left of it
    ended, record = threading.Event(), SimulatedBench.record

    def later(*arguments: Any) -> Any:
        assert ended.wait(240.0)
        return record(*arguments)

    monkeypatch.setattr(SimulatedBench, "record", later)
    session.test(plan)
    session.end()
    assert session.job is None
    ended.set()
    session.wait(240.0)
    assert not (tmp_path / "check-hold-s-0-5-2").exists()
    assert len(session.opened) == 2


@pytest.mark.slow
def test_a_table_is_mapped_corrected_and_becomes_a_recording(wheel: Wheel, tmp_path: Path) -> None:
    shutil.copytree(wheel.recording, tmp_path / "drag")
    samples = gw.Recording.open(wheel.recording).measurement[:20_000]
    table = lab_table(tmp_path / "lab 3.csv", samples)
    with Server(Session(Library([tmp_path]), gw.Model.load(wheel.model)), port=0) as server:
        session = server.session

        def send(body: bytes, name: str, **headers: str) -> tuple[int, bytes]:
            connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=240.0)
            sent = {"Host": f"127.0.0.1:{server.port}", "Content-Type": "application/octet-stream", **headers}
            connection.request("POST", f"/table?name={quote(name)}", body, sent)
            answer = connection.getresponse()
            return answer.status, answer.read()

        assert send(b"x", "a.csv", Origin="http://bench.example")[0] == 403
        assert send(b"x", "a.csv", **{"Content-Type": "text/plain"})[0] == 415
        assert send(b"x", "..")[0] == 422
        assert ask(server, "/do/map_table", {})[0] == 422  # no table
        assert send(b"no table", "../../a.csv")[0] == 200
        session.wait(240.0)
        assert session.trouble is not None
        assert session.trouble.place == "table"
        assert "gyrowheel-" not in session.trouble.sentence  # where it is kept is nobody's business
        assert send(table.read_bytes(), table.name)[0] == 200
        session.wait(240.0)
        assert session.trouble is None
        part = json.loads(ask(server, "/state")[1])["parts"]["table"]
        assert "tilt_y" in part
        assert "Questions to answer" in part
        # what is no map is said; a corrected one is read, and the laws of the wheel agree
        given = {"tilt_y.column": "Tilt Y [rad]", "tilt_y.unit": "deg", "tilt_y.scale": "one"}
        status, body = ask(server, "/do/map_table", given)
        assert status == 422
        assert "scale: 'one' is no number" in json.loads(body)["error"]
        column = (
            next(row["column"] for row in session.table.rows() if row["field"] == "tilt_y")
            if session.table
            else ""
        )
        given = {"tilt_y.column": column, "tilt_y.unit": "deg", "tilt_y.scale": ""}
        ask(server, "/do/map_table", given)
        session.wait(240.0)
        assert session.trouble is None
        assert session.table is not None
        assert session.table.questions == ()
        assert ask(server, "/preview.png")[1].startswith(b"\x89PNG")
        ask(server, "/do/map_table", given | {"take": "1"})
        session.wait(240.0)
        assert session.trouble is None
        assert session.table is None
        (own,) = session.opened.values()
        assert own.recording.path == tmp_path / "lab-3-1"
        assert own.role == "fitted"
        assert np.allclose(own.recording.measurement["tilt_y"], samples["tilt_y"][::2], atol=1e-6)


def test_a_model_is_saved_again_under_its_new_name_and_over_no_other(wheel: Wheel, tmp_path: Path) -> None:
    file = write(tmp_path / "wheel.yaml", wheel.model.read_text(encoding="utf-8"))
    other = write(tmp_path / "other.yaml", "mine")
    session = Session(Library([wheel.recording.parent]), gw.Model.load(file), file)

    def part() -> str:
        return str(views.state(session)["parts"]["bar"])

    def needed(own: Session) -> list[str]:
        return before(own.step.model, own.kept, own.file)

    assert "not saved yet" not in part()
    assert needed(session) == []
    session.steps.append(replace(session.step, model=gw.Model()))
    assert "not saved yet" in part()
    (line,) = needed(session)  # the commands of a report do not find this model
    assert line.startswith("# first save the model")
    for _ in range(2):
        assert session.save("better.yaml") == tmp_path / "better.yaml"
        session.wait(240.0)
    assert 'value="better.yaml"' in part()
    assert "not saved yet" not in part()
    assert needed(session) == []
    (tmp_path / "outside.yaml").symlink_to(tmp_path / "none")
    for taken in ("other.yaml", "outside.yaml"):
        with pytest.raises(gw.InputError, match="exists"):
            session.save(taken)
    for name in ("-rf.yaml", "_.yaml", ".yaml", "a/b.yaml", "a\x1b.yaml", "a.yml"):
        with pytest.raises(gw.InputError, match="is not allowed; allowed: letters, digits"):
            session.save(name)
    assert other.read_text(encoding="utf-8") == "mine"
    fresh = Session(Library([wheel.recording.parent]), gw.Model())
    assert needed(fresh) == ["gyrowheel model new --model wheel.yaml"]


def test_too_little_steady_motion_is_a_verdict_and_no_error(tmp_path: Path) -> None:
    record_simulation(tmp_path / "short", Bench.load(), Scenario.nominal(), Plan.load(SHORT_PLAN))
    session = Session(Library([tmp_path]), gw.Model())
    session.open("0/short", "fitted")
    session.wait(240.0)
    session.diagnose()
    session.wait(240.0)
    assert session.trouble is None
    part = views.state(session)["parts"]["verdict"]
    assert 'data-verdict="insufficient_data"' in part
    assert "steady motion" in part


def test_undone_steps_return_until_the_model_changes_otherwise(wheel: Wheel) -> None:
    session = Session(Library([wheel.recording.parent]), gw.Model())
    one, two = Step(gw.Model()), Step(gw.Model())
    session.steps += [one, two]
    session.undo()
    session.undo()
    assert len(session.steps) == 1
    session.redo()
    assert session.step is one
    session.redo()
    assert session.step is two
    session.undo()
    session._go([*session.steps, Step(gw.Model())])
    with pytest.raises(gw.InputError, match="nothing to redo"):
        session.redo()


def test_all_findings_are_added_at_once_and_removed_one_by_one(
    compared: Session, wheel: Wheel, tmp_path: Path
) -> None:
    content = yaml.safe_load(wheel.model.read_text(encoding="utf-8"))
    size = {"value": 1e-4, "standard_error": 1e-6}
    content["effects"] = {"windage": {"w": size, "n": size | {"value": 1.5}}, "bearing_viscous": {"b": size}}
    file = write(tmp_path / "wheel.yaml", yaml.safe_dump(content))
    compared.steps = [Step(gw.Model.load(file))]
    assert 'data-do="remove" data-what="windage"' in views.state(compared)["parts"]["model"]
    compared.remove("windage")
    assert list(compared.step.model.effects) == ["bearing_viscous"]
    compared.undo()
    assert set(compared.step.model.effects) == {"windage", "bearing_viscous"}
    added: list[Any] = []
    compared._add = lambda items, place: added.append(items)  # type: ignore[method-assign]
    found = Diagnosis.of(diagnosis("effect", finding("windage"), finding("bearing_viscous")))
    compared.steps = [replace(compared.step, diagnosis=found)]
    parts = views.state(compared)["parts"]
    assert ">Add all 2<" in parts["verdict"]
    assert ">Add all 2<" in parts["missing"]
    compared.add_all()
    assert added == [["windage", "bearing_viscous"]]


def test_the_page_speaks_of_its_own_buttons_and_of_no_options_of_the_shell(compared: Session) -> None:
    for name in ("one", "two"):
        own: Any = SimpleNamespace(name=name, data=SimpleNamespace(machine=name))
        compared.opened[name] = Opened(name, own, ROLES[0], {}, {})
    with pytest.raises(gw.InputError, match=r"one is of machine one.*close those of one machine on the left"):
        compared.diagnose()
    for name in ("one", "two"):
        del compared.opened[name]
    untried = Proof("drag", None, "not_tried", left_out="speed")
    found = Diagnosis.of(replace(diagnosis("effect", finding("windage")), proof=untried))
    compared.steps = [replace(compared.step, diagnosis=found)]
    for part in views.state(compared)["parts"].values():
        assert not re.search(r"(?<=[\s(])--[a-z]", re.sub(r"<pre.*?</pre>", "", part, flags=re.DOTALL))


def test_the_page_shows_every_part_of_a_diagnosis(wheel: Wheel) -> None:
    session = Session(Library([wheel.recording.parent]), gw.Model())

    def part(details: Any) -> str:
        session.steps = [replace(session.step, diagnosis=Diagnosis.of(details))]
        return str(views.state(session)["parts"]["missing"])

    nothing: dict[str, Any] = {"error": None, "nuisance": {}, "limits": (), "where": ()}
    wrong = WrongSetup("sign", ("tilt_y",), Fix(scale={"tilt_y": -1.0}), recording="runs/mine")
    shown = part(diagnosis("insufficient_data", setup=(wrong,), **nothing))
    assert "the sign of tilt_y is turned" in shown
    assert "gyrowheel correct runs/mine" in shown
    clock = ReadingFinding("clock_rate", "clock", "rate_error", 2e-5, 1e-6, 0.0, "1", 400.0, "drag")
    half = Coverage(60.0, 30.0, {"of a kind": 10.0})
    own = replace(finding("windage"), name="stiffness_error", effect_title="", effect_sentence="")
    has = finding("aero_cross")
    has = replace(has, in_model=has.coefficients)
    shown = part(diagnosis("effect", own, has, readings=(clock,), coverage=half))
    assert "ppm fast against the count of the samples" in shown
    assert "30 of 40 s of steady motion take part" in shown
    assert "/help/effect/aero_cross" in shown
    assert "/help/effect/stiffness_error" not in shown  # there is no such page
    assert ">Fit again aero_cross<" in shown
    assert ">Add stiffness_error<" in shown
    (form,) = UNKNOWN.free_form
    shown = part(replace(UNKNOWN, free_form=(replace(form, name="form", simple="rotor_torque = a*z^2"),)))
    assert 'data-text="form: rotor_torque = a*z^2"' in shown
    assert "Add the simple law" in shown
    other = TieReport("lobes", "", 3.0, "cone", 40.0, 0.5, form=replace(form, name="lobes"))
    shown = part(replace(UNKNOWN, free_form=(replace(form, name="form", ties=(other,)),)))
    assert "could also be lobes" in shown
    assert 'data-text="lobes: rotor_torque = a*z^2">Add lobes<' in shown


def test_the_map_of_the_missing_torque_has_its_standard_deviation() -> None:
    session = Session(Library([]), gw.Model())
    assert torque_maps(session) == []
    session.steps = [replace(session.step, diagnosis=Diagnosis.of(replace(UNKNOWN, map=MAP)))]
    rotor, shaft = torque_maps(session)
    assert (rotor["target"], rotor["unit"], shaft["title"]) == ("rotor_torque", "mN·m", "torque on the shaft")
    tilt = np.array(rotor["x"]) + 1j * np.array(rotor["y"])
    assert np.abs(tilt).max() <= np.degrees(MAP.effect.within.tilt)
    share = np.radians(np.abs(tilt)) / MAP.effect.within.tilt
    at = rotor["speeds"][2]
    size = np.hypot(at["value_x"], at["value_y"])
    np.testing.assert_allclose(size, 0.5 * share, atol=1e-3)  # 3 and 4 parts
    np.testing.assert_allclose(at["sigma"], np.hypot(0.01, 0.02) * share, atol=1e-4)
    assert at["shape"] == pytest.approx(0.0, abs=1e-6)  # a slope, which the bench may have as well
    # over the speed the constant and the slope of the shaft add up, and so do their errors, which are one
    low, high = shaft["speeds"][0], shaft["speeds"][-1]
    scale = {"µN·m": 1e-6, "mN·m": 1e-3}[shaft["unit"]]
    assert low["speed"] < high["speed"]
    assert (low["value_x"][0], high["value_x"][0]) == pytest.approx((1.5e-4 / scale, 5e-5 / scale))
    assert (low["sigma"][0], high["sigma"][0]) == pytest.approx((1e-6 / scale, 7e-6 / scale))


def test_script_in_the_titles_of_a_model_is_text(wheel: Wheel, tmp_path: Path) -> None:
    evil = "<img src=x onerror=alert(1)></script><script>alert(2)</script>"
    declaration = effect_to_mapping(gw.own_effect("mine: torque = -k*Omega*z"))
    content = yaml.safe_load(wheel.model.read_text(encoding="utf-8"))
    content["effects"] = {
        "mine": {
            "declaration": declaration | {"title": evil, "sentence": evil, "source": evil},
            "k": {"value": 1e-6, "standard_error": 1e-7},
        }
    }
    file = write(tmp_path / "wheel.yaml", yaml.safe_dump(content))
    with Server(Session(Library([tmp_path]), gw.Model.load(file), file), port=0) as server:
        for text in (
            json.loads(ask(server, "/state")[1])["parts"]["model"],
            ask(server, "/help/effect/mine")[1].decode(),
        ):
            assert "&lt;img src=x" in text
            assert "<img" not in text
            assert "<script" not in text


def test_an_empty_workbench_offers_the_demonstration(tmp_path: Path) -> None:
    with Server(Session(Library([tmp_path]), gw.Model()), port=0) as server:
        parts = json.loads(ask(server, "/state")[1])["parts"]
    assert 'data-do="demonstrate"' in parts["recordings"]
    assert 'data-do="demonstrate"' in parts["verdict"]


def test_signals_appear_before_the_summary_of_a_recording(
    wheel: Wheel, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session(Library([wheel.recording.parent]), gw.Model())
    drawn, ended = threading.Event(), threading.Event()
    describe = Opened.with_description

    def slowly(own: Opened) -> Opened:
        drawn.set()
        assert ended.wait(240.0)
        return describe(own)

    monkeypatch.setattr(Opened, "with_description", slowly)
    session.open("0/drag", "fitted")
    assert drawn.wait(240.0)
    assert [each["key"] for each in views.state(session)["signals"]] == ["0/drag"]
    assert "holds" not in views.state(session)["parts"]["recordings"]
    session.end()
    ended.set()
    session.wait(240.0)
    assert "holds" not in views.state(session)["parts"]["recordings"]
    session.open("0/drag", "not used to fit")  # asked for again, it is summed up
    session.wait(240.0)
    assert "holds" in views.state(session)["parts"]["recordings"]
