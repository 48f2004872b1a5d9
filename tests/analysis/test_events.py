"""Events in the middle of a recording: found, dated, told with their size; none where none happened."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from scipy.signal import lfilter

from gyrowheel.show.sentences.diagnosis import verdict_sentence
from gyrowheel_analysis.criteria import FORM_GAIN
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.diagnosis.event_scan import places, scan
from gyrowheel_analysis.diagnosis.event_search import find, search_events
from gyrowheel_analysis.diagnosis.evidence import Evidence
from gyrowheel_analysis.fitting.preparation import prepare
from gyrowheel_analysis.model import Model
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.units import RPM
from gyrowheel_sim import blind
from gyrowheel_sim.effects.declaration import Coefficient, Effect, Law
from gyrowheel_sim.effects.quantities import t as time_symbol
from gyrowheel_sim.plant.scenario import Scenario

from .machines import BENCH, hidden_machine, record

STUDY = pytest.mark.study
MODEL = Model(BENCH)
TORQUE = 0.5e-3
VOLTS = TORQUE / BENCH.value("coil_constant")


def step(at):
    return lambda time: (time > at) * 1.0


def trend(begin, end):
    return lambda time: np.clip((time - begin) / (end - begin), 0.0, 1.0)


def burst(begin, end):
    return lambda time: ((time > begin) & (time < end)) * 1.0


def changed(recording, column, course, size):
    """Return a recording in which a reading has changed by `size` times a course in time."""
    measurement = recording.measurement.copy()
    measurement[column] += size * course(recording.time)
    return replace(recording, measurement=measurement)


def found_in(recording):
    with one_thread():
        problem = prepare([recording], MODEL).problem
        return find(problem, problem.fit(()), [recording])


def pushed(seed, at, **sizes):
    """Return a machine on which something begins to act at a time.

    A torque `across` about case x or on the `spin` [N m], or a shift of the tilt sensors by `shift_x`, `shift_y` [rad].
    """
    begun = (1 + sp.sign(time_symbol - at)) / 2
    names = {"across": "N*m", "spin": "N*m", "shift_x": "rad", "shift_y": "rad"}
    across, spin, x, y = (sp.Symbol(name, real=True) for name in names)
    effect = Effect(
        name="push",
        title="something that begins",
        category="other",
        sentence="Something leans on the rotor.",
        laws=(
            Law("rotor_torque", across * begun),
            Law("shaft_torque", spin * begun),
            Law("tilt_reading", (x + sp.I * y) * begun),
        ),
        coefficients=tuple(
            Coefficient(name, unit, "size", (1e-4, 1e-3), (-1.0, 1.0), "assumed", signed=True)
            for name, unit in names.items()
        ),
        validity="this test",
        source="assumed",
    )
    machine = hidden_machine(seed, {"push": dict.fromkeys(names, 0.0) | sizes})
    return Scenario(machine.values, machine.effects, machine.noise_seed, {"push": effect})


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return record(tmp_path_factory.mktemp("events"), "survey", hidden_machine(31, {}), "survey")


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    return record(tmp_path_factory.mktemp("events"), "quick", hidden_machine(32, {}), "quick")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("column", "course", "size", "kind", "channel", "edges"),
    [
        ("coil_voltage_x", step(110.0), VOLTS, "step", "coil_voltage_x", (110.0,)),
        pytest.param("coil_voltage_y", step(20.0), -VOLTS, "step", "coil_voltage_y", (20.0,), marks=STUDY),
        # between two holds, while the tilt moves
        pytest.param("coil_voltage_y", step(29.5), VOLTS, "step", "coil_voltage_y", (29.5,), marks=STUDY),
        pytest.param(
            "coil_voltage_x", trend(60.0, 120.0), VOLTS, "trend", "coil_voltage_x", (60.0, 120.0), marks=STUDY
        ),
        ("coil_voltage_x", burst(70.0, 85.0), VOLTS, "burst", "coil_voltage_x", (70.0, 85.0)),
        pytest.param("motor_current", step(110.0), 0.012, "step", "motor_current", (110.0,), marks=STUDY),
        pytest.param("motor_voltage", step(61.0), 0.02, "step", "motor_voltage", (61.0,), marks=STUDY),
    ],
)
def test_event_is_found_dated_and_named(survey, column, course, size, kind, channel, edges):
    (found,) = found_in(changed(survey, column, course, size))
    assert found.event.kind == kind
    # a shift of a coil's voltage that is read and a torque differ only in what the torque does to the spin
    assert channel in (found.event.quantity, *found.ties)
    # a trend has no instant: its ends are known from windows alone
    within = 6.0 if kind == "trend" else 0.3
    np.testing.assert_allclose(found.event.edges, edges, rtol=0.0, atol=within)


@pytest.mark.slow
def test_gain_of_one_coil_that_changes_is_found(survey):
    measurement = survey.measurement.copy()
    measurement["coil_voltage_y"] *= np.where(survey.time > 70.0, 1.04, 1.0)
    (found,) = found_in(replace(survey, measurement=measurement))
    assert [event.quantity for event in found.events] == ["coil_gain_y"]
    assert (found.event.kind, found.event.time) == ("step", pytest.approx(70.0, abs=0.3))


@pytest.mark.slow
def test_torque_near_one_speed_is_a_law_and_no_event(survey):
    """A mode of the case that answers near one speed: it begins and ends with the commands."""
    speed = survey.measurement["spin_rate"] / RPM
    with one_thread():
        recording = changed(
            survey, "coil_voltage_x", lambda _: np.exp(-(((speed - 2000.0) / 150.0) ** 2)), VOLTS
        )
        problem = prepare([recording], MODEL).problem
        found, laws = search_events(problem, problem.fit(()), [recording])
    assert found == []
    assert [law.variable for law in laws] == ["speed"]


@pytest.mark.slow
def test_encoder_that_slips_is_found(survey):
    measurement = survey.measurement.copy()
    late = survey.time > 88.0
    measurement["spin_angle"] = (measurement["spin_angle"] + 0.02 * late) % (2.0 * np.pi)
    (found,) = found_in(replace(survey, measurement=measurement))
    assert [event.quantity for event in found.events] == ["encoder_zero"]
    assert (found.event.kind, found.event.time) == ("step", pytest.approx(88.0, abs=0.05))


@pytest.mark.slow
def test_motor_whose_constant_changes_by_a_percent_is_found(survey):
    constant = BENCH.value("motor_constant")
    measurement, late = survey.measurement.copy(), survey.time > 75.0
    # the same torque from less current, and more voltage at the same speed
    measurement["motor_voltage"] += late * 0.01 * constant * measurement["spin_rate"]
    measurement["motor_voltage"] -= (
        late * 0.01 * BENCH.value("motor_resistance") * measurement["motor_current"]
    )
    measurement["motor_current"] -= late * 0.01 * measurement["motor_current"]
    (found,) = found_in(replace(survey, measurement=measurement))
    assert [event.quantity for event in found.events] == ["motor_constant"]
    assert (found.event.kind, found.event.time) == ("step", pytest.approx(75.0, abs=1.0))


@pytest.mark.slow
@pytest.mark.parametrize("at", [20.3, 33.1])
def test_event_of_a_short_recording_is_dated(quick, at):
    (found,) = found_in(changed(quick, "coil_voltage_x", step(at), 2.0 * VOLTS))
    assert "coil_voltage_x" in (found.event.quantity, *found.ties)
    assert found.event.time == pytest.approx(at, abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sizes", "channels", "within"),
    [
        pytest.param({"across": TORQUE}, ["torque_x"], 0.3, marks=pytest.mark.study),
        ({"spin": TORQUE}, ["spin_torque"], 1.0),
        # the loop makes up for a shift: it is the coils that show it
        pytest.param(
            {"shift_x": -1.1e-3, "shift_y": -0.5e-3}, ["tilt_reading_x", "tilt_reading_y"], 0.1, marks=STUDY
        ),
    ],
    ids=("across", "spin", "shift"),
)
def test_an_effect_that_begins_during_the_recording_is_found(tmp_path, sizes, channels, within):
    recording = record(tmp_path, "pushed", pushed(33, 84.0, **sizes), "survey")
    (found,) = found_in(recording)
    assert [event.quantity for event in found.events] == channels
    assert (found.event.kind, found.event.time) == ("step", pytest.approx(84.0, abs=within))


@pytest.mark.slow
def test_a_torque_that_begins_shows_in_the_spin_of_a_tilted_rotor_and_is_no_shift_of_a_reading(tmp_path):
    """The coils push in case axes, so that a part of their torque turns or brakes a rotor that is tilted."""
    recording = record(tmp_path, "pushed", pushed(36, 84.0, across=1.5e-3), "survey")
    with one_thread():
        problem = prepare([recording], MODEL).problem
        (found,), laws = search_events(problem, problem.fit(()), [recording])
        cleared = problem.with_events(found.events)
        noise = cleared.with_drift_estimated(cleared.fit(())).noise
    assert not laws
    assert found.event.quantity == "torque_x"
    assert found.event.time == pytest.approx(84.0, abs=0.3)
    assert "coil_voltage_x" not in found.ties
    assert max(noise.scales.values()) < 1.3


@pytest.mark.slow
def test_two_events_are_reported_with_their_sizes_and_nothing_else(survey):
    once = changed(survey, "coil_voltage_x", step(50.0), VOLTS)
    result = diagnose([changed(once, "coil_voltage_y", step(140.0), -VOLTS)], MODEL)
    assert result.verdict == "nothing_missing"
    first, second = result.events
    assert (first.channel, second.channel) == ("coil_voltage_x", "coil_voltage_y")
    assert first.time == pytest.approx(50.0, abs=0.3)
    assert second.time == pytest.approx(140.0, abs=0.3)
    for event, size in ((first, VOLTS), (second, -VOLTS)):
        assert abs(event.size - size) < 4.0 * event.standard_error
        assert event.standard_error < 0.1 * VOLTS
    # what the drifts are said to be does not cover the events
    assert max(result.drift_scales.values()) < 1.5
    assert result.error is not None
    assert result.error.after.chi2_per_n < 1.1


@pytest.mark.study
def test_effect_with_an_event_has_the_same_coefficient_as_without(tmp_path):
    machine = hidden_machine(34, {"aero_cross": {"c": 5.0e-3, "n": 2.0}})
    plain = record(tmp_path, "plain", machine, "survey")
    (alone,) = diagnose([plain], MODEL).effects
    result = diagnose([changed(plain, "coil_voltage_x", step(95.0), VOLTS)], MODEL)
    (beside,) = result.effects
    assert (alone.name, beside.name) == ("aero_cross", "aero_cross")
    a, b = alone.coefficients["c"], beside.coefficients["c"]
    assert abs(a.value - b.value) < 2.0 * a.standard_error
    (event,) = result.events
    assert event.time == pytest.approx(95.0, abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "scale"),
    [
        (41, 3.0),
        *(
            pytest.param(seed, scale, marks=pytest.mark.study)
            for seed, scale in ((41, 0.5), (41, 1.0), (42, 0.5), (42, 1.0), (42, 3.0))
        ),
    ],
)
def test_enlarged_drift_is_not_taken_for_an_event(tmp_path, seed, scale):
    machine = hidden_machine(seed, {})
    drifts = ("coil_voltage_drift", "motor_current_drift", "motor_voltage_drift")
    values = {**machine.values, **{name: scale * BENCH.value(name) for name in drifts}}
    recording = record(tmp_path, "drifting", replace(machine, values=values), "quick")
    assert found_in(recording) == []


@pytest.mark.study
def test_undeclared_form_is_not_taken_for_an_event(tmp_path):
    # a contact, a torque of three lobes, a bump at one speed
    recording = record(tmp_path, "outside", blind.draw(BENCH, 7, kinds=("outside",)), "quick")
    result = diagnose([recording], MODEL)
    assert result.verdict == "unknown"
    assert not result.events


def shape_in(recording, column, course):
    """Return the only shape that is found in a recording whose reading drifts so."""
    measurement = recording.measurement.copy()
    measurement[column] += course
    (found,) = found_in(replace(recording, measurement=measurement))
    return found


@pytest.mark.slow
def test_drift_that_swings_is_reported_with_its_period(survey):
    swing = 0.6 * VOLTS * np.cos(2.0 * np.pi * (survey.time - 12.0) / 47.0)
    found = shape_in(survey, "coil_voltage_y", swing)
    assert (found.event.kind, [e.quantity for e in found.events]) == ("swing", ["torque_y"])
    assert found.event.end == pytest.approx(47.0, rel=0.03)


@pytest.mark.slow
def test_drift_that_follows_a_temperature_is_reported_as_such(survey):
    # the coils warm themselves, and a fan cools them twice
    measurement, time = survey.measurement.copy(), survey.time
    cooled = np.exp(-(((time - 50.0) / 12.0) ** 2)) + np.exp(-(((time - 120.0) / 12.0) ** 2))
    measurement["coil_temperature"] -= 5.0 * cooled
    warmer = measurement["coil_temperature"] - 293.0
    found = shape_in(replace(survey, measurement=measurement), "motor_voltage", 4.0e-3 * warmer)
    assert (found.event.kind, found.event.quantity) == ("coil_temperature", "motor_voltage")


@pytest.mark.slow
def test_drift_that_follows_a_temperature_does_so_in_recordings_for_validation(quick, tmp_path):
    def warmed(recording, *cooled):
        # a fan cools the coils at times
        time, measurement = recording.time, recording.measurement.copy()
        for at in cooled:
            measurement["coil_temperature"] -= 5.0 * np.exp(-(((time - at) / 6.0) ** 2))
        measurement["coil_voltage_x"] += 4.0e-3 * (measurement["coil_temperature"] - 293.0)
        return replace(recording, measurement=measurement)

    check = record(tmp_path, "check", hidden_machine(32, {}), "check", noise_seed=9001)
    found = diagnose([warmed(quick, 12.0, 33.0)], MODEL, validate=[warmed(check, 15.0)])
    (shape,) = found.drift_shapes
    assert shape.kind == "coil_temperature"
    assert shape.channel in ("coil_voltage_x", "torque_x")
    assert found.proof is not None
    assert found.proof.proven


@pytest.mark.slow
def test_a_shape_that_is_a_law_must_gain_as_much_more_as_a_free_form(survey):
    with one_thread():
        problem = prepare([survey], MODEL).problem
        found = scan(Evidence(problem, problem.fit(())), places(problem))
    by_chance = {(c.first.kind, c.first.quantity): c.gain - c.score for c in found}
    drift = by_chance["coil_temperature", "motor_voltage"]
    assert by_chance["coil_temperature", "coil_gain"] == pytest.approx(drift + FORM_GAIN)
    assert by_chance["after_tilt", "torque_after_tilt"] > FORM_GAIN


@pytest.mark.slow
def test_torque_that_relaxes_after_every_move_of_the_tilt_is_a_law_and_no_drift(survey):
    # a branch of the flexure that yields: it holds against a move, and lets go within ten seconds
    tilt, rate = survey.measurement["tilt_x"] + 1j * survey.measurement["tilt_y"], 5e-4 / 10.0
    behind = lfilter([rate], [1.0, rate - 1.0], tilt)
    volts = 0.8 * VOLTS * (tilt - behind) / BENCH.value("tilt_reference")
    measurement = survey.measurement.copy()
    measurement["coil_voltage_x"] += volts.real
    measurement["coil_voltage_y"] += volts.imag
    with one_thread():
        problem = prepare([replace(survey, measurement=measurement)], MODEL).problem
        found, laws = search_events(problem, problem.fit(()), [survey])
    assert not found
    assert [(law.variable, law.lag) for law in laws] == [("history", 10.0)]


@pytest.mark.slow
@pytest.mark.study
def test_verdict_names_the_shape_of_a_drift_instead_of_its_size(survey):
    swing = 0.6 * VOLTS * np.cos(2.0 * np.pi * (survey.time - 12.0) / 47.0)
    measurement = survey.measurement.copy()
    measurement["coil_voltage_x"] += swing
    result = diagnose([replace(survey, measurement=measurement)], MODEL)
    assert not result.events
    (shape,) = result.drift_shapes
    assert shape.time == pytest.approx(47.0, abs=4.0 * shape.time_error)
    assert shape.channel == "coil_voltage_x"
    assert abs(abs(shape.size) - 0.6 * VOLTS) < 4.0 * shape.standard_error
    said = verdict_sentence(result)
    assert "swings to and fro with a period of 4" in said
    assert "larger than stated" not in said
