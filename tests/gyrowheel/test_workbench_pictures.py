"""The numbers that the workbench draws: signals, windows, residuals, maps, holds and estimates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel.diagnosis.api import Diagnosis
from gyrowheel.simulation.api import record_simulation
from gyrowheel.simulation.scenario import scenario
from gyrowheel.workbench import pictures, residual, windows
from gyrowheel.workbench.coefficients import Estimates
from gyrowheel.workbench.library import ROLES, Envelope, Library, Opened, envelopes
from gyrowheel.workbench.session import Session, Step
from gyrowheel_analysis.reduction.windows import HARMONICS
from gyrowheel_control.plans.plan import Plan
from gyrowheel_sim.bench import Bench

from .conftest import Wheel
from .findings import MAP, UNKNOWN
from .helpers import write


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


def test_the_map_of_the_missing_torque_has_its_standard_deviation() -> None:
    session = Session(Library([]), gw.Model())
    assert pictures.torque_maps(session) == []
    session.steps = [replace(session.step, diagnosis=Diagnosis.of(replace(UNKNOWN, map=MAP)))]
    rotor, shaft = pictures.torque_maps(session)
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


@pytest.mark.slow
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
