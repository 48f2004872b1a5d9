"""Events in the middle of a recording: found, dated, told with their size; none where none happened."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.diagnosis.events import find
from gyrowheel_analysis.fitting.preparation import one_thread, prepare
from gyrowheel_analysis.model import Model
from gyrowheel_sim.blind import draw as blind
from gyrowheel_sim.effects.declaration import Coefficient, Effect, Law
from gyrowheel_sim.effects.quantities import t as time_symbol
from gyrowheel_sim.plant.scenario import Scenario

from .machines import BENCH, hidden_machine, record

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


def pushed(seed, at, **torques):
    """Return a machine on which torques [N m] begin to act: `across` about case x, `spin` on the shaft."""
    rises = (1 + sp.tanh((time_symbol - at) / sp.Float(0.01))) / 2
    across, spin = sp.symbols("across spin", real=True)
    effect = Effect(
        name="push",
        title="torque that begins",
        category="other",
        sentence="Something leans on the rotor.",
        laws=(Law("rotor_torque", across * rises), Law("shaft_torque", spin * rises)),
        coefficients=tuple(
            Coefficient(name, "N*m", "size", (1e-4, 1e-3), (-1.0, 1.0), "assumed", signed=True)
            for name in ("across", "spin")
        ),
        validity="this test",
        source="assumed",
    )
    machine = hidden_machine(seed, {"push": {"across": 0.0, "spin": 0.0, **torques}})
    return Scenario(machine.values, machine.effects, machine.noise_seed, {"push": effect})


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return record(tmp_path_factory.mktemp("events"), "survey", hidden_machine(31, {}), "survey")


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    return record(tmp_path_factory.mktemp("events"), "quick", hidden_machine(32, {}), "quick")


@pytest.mark.parametrize(
    ("column", "course", "size", "kind", "channel", "edges"),
    [
        ("coil_voltage_x", step(110.0), VOLTS, "step", "torque_x", (110.0,)),
        ("coil_voltage_y", step(20.0), -VOLTS, "step", "torque_y", (20.0,)),
        # between two holds, while the tilt moves
        ("coil_voltage_y", step(29.5), VOLTS, "step", "torque_y", (29.5,)),
        ("coil_voltage_x", trend(60.0, 120.0), VOLTS, "trend", "torque_x", (60.0, 120.0)),
        ("coil_voltage_x", burst(70.0, 85.0), VOLTS, "burst", "torque_x", (70.0, 85.0)),
        ("motor_current", step(110.0), 0.012, "step", "motor_current", (110.0,)),
        ("motor_voltage", step(61.0), 0.02, "step", "motor_voltage", (61.0,)),
    ],
)
def test_event_is_found_dated_and_named(survey, column, course, size, kind, channel, edges):
    (found,) = found_in(changed(survey, column, course, size))
    assert (found.event.kind, found.event.quantity) == (kind, channel)
    # a trend has no instant: its ends are known from windows alone
    within = 6.0 if kind == "trend" else 0.3
    np.testing.assert_allclose(found.event.edges, edges, rtol=0.0, atol=within)


@pytest.mark.parametrize("at", [20.3, 33.1])
def test_event_of_a_short_recording_is_dated(quick, at):
    (found,) = found_in(changed(quick, "coil_voltage_x", step(at), 2.0 * VOLTS))
    assert found.event.quantity == "torque_x"
    assert found.event.time == pytest.approx(at, abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(("torque", "channel"), [("across", "torque_x"), ("spin", "spin_torque")])
def test_torque_that_begins_to_act_on_the_machine_is_found(tmp_path, torque, channel):
    recording = record(tmp_path, "pushed", pushed(33, 84.0, **{torque: TORQUE}), "survey")
    (found,) = found_in(recording)
    assert (found.event.kind, found.event.quantity) == ("step", channel)
    assert found.event.time == pytest.approx(84.0, abs=1.0)


@pytest.mark.slow
def test_two_events_are_told_with_their_sizes_and_nothing_else(survey):
    once = changed(survey, "coil_voltage_x", step(50.0), VOLTS)
    result = diagnose([changed(once, "coil_voltage_y", step(140.0), -VOLTS)], MODEL)
    assert result.verdict == "nothing_missing"
    first, second = result.events
    assert (first.channel, second.channel) == ("torque_x", "torque_y")
    assert first.time == pytest.approx(50.0, abs=0.3)
    assert second.time == pytest.approx(140.0, abs=0.3)
    # a voltage that reads more is a torque the other way
    for event, size in ((first, -TORQUE), (second, TORQUE)):
        assert abs(event.size - size) < 4.0 * event.standard_error
        assert event.standard_error < 0.1 * TORQUE
    # what the drifts are said to be does not cover the events
    assert max(result.drift_scales.values()) < 1.5
    assert result.error is not None
    assert result.error.after.chi2_per_n < 1.1


@pytest.mark.slow
def test_effect_beside_an_event_has_the_coefficient_that_it_has_without(tmp_path):
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


@pytest.mark.parametrize("scale", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("seed", [41, 42])
def test_drift_of_any_size_is_no_event(tmp_path, seed, scale):
    machine = hidden_machine(seed, {})
    drifts = ("coil_voltage_drift", "motor_current_drift", "motor_voltage_drift")
    values = {**machine.values, **{name: scale * BENCH.value(name) for name in drifts}}
    recording = record(tmp_path, "drifting", replace(machine, values=values), "quick")
    assert found_in(recording) == []


def test_form_that_nobody_declared_is_no_event(tmp_path):
    # a contact, a torque of three lobes, a bump at one speed
    recording = record(tmp_path, "outside", blind.draw(BENCH, 7, kinds=("outside",)), "quick")
    result = diagnose([recording], MODEL)
    assert result.verdict == "unknown"
    assert result.events == []
