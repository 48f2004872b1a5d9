"""Instruments with delays, filters, errors, steps and hum show what they must of a motion that is known more finely.

Two plants get the same voltages, one of them in steps ten times as short, with perfect instruments: its samples are
what the readings of the other are compared with.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from gyrowheel_control.loops.closed_loop import simulate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.instruments import Reading, held_response, smooth_response
from gyrowheel_sim.parameter import INSTRUMENTS
from gyrowheel_sim.plant.machine import Plant
from gyrowheel_sim.plant.scenario import Scenario

from .helpers import BENCH, QUIET

FINE = 10
PERIOD = BENCH.sample_period
N = 600
#: A bent rotor with uneven flexures at 3000 rpm: tilts with 1N and 2N, under voltages that change at every sample.
SPIN = 100.0 * math.pi
EFFECTS = {"runout": {"R_x": 1.0e-3, "R_y": 0.0}, "stiffness_anisotropy": {}, "static_imbalance": {}}


@functools.cache
def voltages() -> NDArray[np.float64]:
    rng = np.random.default_rng(7)
    slow = np.sin(2.0 * math.pi * np.arange(N)[:, None] / np.array([37.0, 53.0, 71.0]))
    return slow * [0.3, 0.2, 0.4] + [0.0, 0.0, 9.6] + 0.02 * rng.standard_normal((N, 3))


def driven(values: Mapping[str, float], repeats: int = 1) -> NDArray[np.float64]:
    """Return the readings under the voltages, each held for `repeats` samples."""
    bench = BENCH.with_values({"sample_period": PERIOD / repeats})
    scenario = Scenario(values={**QUIET, **values}, effects=EFFECTS)
    plant = Plant(bench, scenario, initial_spin_rate=SPIN)
    # the first command waits for a sample: let it wait for as long on both
    plant.machine.held[:] = voltages()[0]
    readings = [plant.measure().copy()]
    for k in range(1, N * repeats):
        readings.append(plant.step(*voltages()[min(k // repeats, N - 1)]).copy())
    return np.array(readings)


@functools.cache
def truth() -> NDArray[np.float64]:
    """Return the readings of perfect instruments, `FINE` to a sampling period."""
    return driven({}, FINE)


def compared(
    values: Mapping[str, float], column: Reading, expected: NDArray[np.float64], within: float
) -> None:
    """Check a reading against what is expected of it, without the first samples."""
    error = (driven(values)[:, column] - expected)[30:-2]
    assert np.abs(error).max() < within
    perfect = (driven({})[:, column] - expected)[30:-2]
    assert np.abs(perfect).max() > 20.0 * within, "the instrument shows nothing"


def later(fine: NDArray[np.float64], delay: float) -> NDArray[np.float64]:
    """Return a fine series at the samples, read earlier by `delay`."""
    steps = round(delay / PERIOD * FINE)
    return np.roll(fine, steps)[::FINE]


def low_passed(fine: NDArray[np.float64], time: float, order: int) -> NDArray[np.float64]:
    """Return a fine series through equal poles, its values joined by straight lines."""
    step = PERIOD / FINE
    left = math.exp(-step / time)
    mean = (1.0 - left) * time / step
    for _ in range(order):
        fine = lfilter([1.0 - mean, mean - left], [1.0, -left], fine, zi=[(1.0 - (1.0 - mean)) * fine[0]])[0]
    return np.asarray(fine)


def mean_of_period(fine: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean over the sampling period that ends at each fine sample, of values held before them."""
    return np.convolve(np.concatenate([np.full(FINE - 1, fine[0]), fine]), np.full(FINE, 1.0 / FINE), "valid")


TILTS = (Reading.tilt_x, Reading.tilt_y)
HELD = {"coil_voltage": Reading.coil_voltage_x, "motor_voltage": Reading.motor_voltage}


@pytest.mark.parametrize("delay", [0.2e-3, 0.5e-3, 1.35e-3, -0.15e-3, -0.5e-3])
@pytest.mark.parametrize("column", TILTS, ids=lambda c: c.name)
def test_a_delayed_tilt_is_that_of_the_earlier_instant(column: Reading, delay: float) -> None:
    # what lies ahead is extrapolated, and the runout turns by 9 degrees in one sample
    compared({"tilt_delay": delay}, column, later(truth()[:, column], delay), 5e-7 if delay > 0.0 else 2e-6)


@pytest.mark.parametrize("delay", [0.25e-3, 2.0e-3, -0.1e-3])
def test_a_delayed_angle_is_that_of_the_earlier_instant(delay: float) -> None:
    late = driven({"spin_angle_delay": delay})[:, Reading.spin_angle]
    error = np.angle(np.exp(1j * (late - later(truth()[:, Reading.spin_angle], delay))))[30:-2]
    assert np.abs(error).max() < 1e-6


@pytest.mark.parametrize("delay", [0.5e-3, 1.0e-3, -0.5e-3, 0.15e-3, -0.3e-3])
@pytest.mark.parametrize("channel", HELD)
def test_a_delayed_voltage_is_the_mean_of_the_earlier_period(channel: str, delay: float) -> None:
    column = HELD[channel]
    expected = later(mean_of_period(truth()[:, column]), delay)
    compared({f"{channel}_delay": delay}, column, expected, 1e-9)


def test_a_voltage_read_just_after_the_latch_is_that_of_the_next_interval() -> None:
    now, after = driven({}), driven({"coil_voltage_delay": -PERIOD, "motor_voltage_delay": -PERIOD})
    for column in (Reading.coil_voltage_x, Reading.coil_voltage_y, Reading.motor_voltage):
        np.testing.assert_allclose(after[:-1, column], now[1:, column], rtol=0.0, atol=1e-12)


def test_a_delayed_current_shows_earlier_voltage_and_speed() -> None:
    late, now = driven({"motor_current_delay": PERIOD}), driven({})
    np.testing.assert_allclose(late[1:, Reading.motor_current], now[:-1, Reading.motor_current], atol=1e-12)


@pytest.mark.parametrize(("time", "order"), [(0.1e-3, 1), (0.4e-3, 1), (0.2e-3, 3)])
@pytest.mark.parametrize("channel", ["tilt", *HELD])
def test_a_filter_has_equal_poles(channel: str, time: float, order: int) -> None:
    column = HELD.get(channel, Reading.tilt_x)
    fine = truth()[:, column]
    fine = fine if channel == "tilt" else mean_of_period(fine)
    expected = low_passed(fine, time, order)[::FINE]
    values = {f"{channel}_filter_time": time, f"{channel}_filter_order": float(order)}
    compared(values, column, expected, 1.5e-6 if channel == "tilt" else 2e-4)


def test_encoder_non_linearity_cross_talk_and_steps_are_as_written() -> None:
    now = driven({})
    angle, x, y = (now[:, c] for c in (Reading.spin_angle, *TILTS))
    turn = {"encoder_zero": 0.02, "encoder_once_x": 3e-3, "encoder_once_y": -2e-3, "encoder_twice_y": 1e-3}
    read = driven({**turn, "tilt_cubic": 5.0, "tilt_cross_talk": 0.02, "motor_current_resolution": 0.1})
    error = 0.02 + 3e-3 * np.cos(angle) - 2e-3 * np.sin(angle) + 1e-3 * np.sin(2.0 * angle)
    np.testing.assert_allclose(
        np.exp(1j * read[:, Reading.spin_angle]), np.exp(1j * (angle + error)), atol=1e-12
    )
    true = x - 1e-3 * np.cos(angle), y - 1e-3 * np.sin(angle)  # without the runout, which is no tilt
    for column, own, other in ((Reading.tilt_x, *true), (Reading.tilt_y, *true[::-1])):
        np.testing.assert_allclose(read[:, column] - now[:, column], 5.0 * own**3 + 0.02 * other, atol=1e-12)
    steps = read[:, Reading.motor_current] / 0.1
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert np.abs(read[:, Reading.motor_current] - now[:, Reading.motor_current]).max() <= 0.05 + 1e-9


def test_hum_is_a_sine_of_the_mains() -> None:
    hum = driven({"coil_voltage_hum": 0.02, "mains_frequency": 60.0}) - driven({})
    t = np.arange(N) * PERIOD
    np.testing.assert_allclose(
        hum[:, Reading.coil_voltage_x], 0.02 * np.sin(2.0 * math.pi * 60.0 * t), atol=1e-12
    )
    assert not hum[:, Reading.motor_voltage].any()


PLAN = Plan.load("schema: 1\nname: hold\nhold_s: 0.5\nsegments:\n  - {spin_rpm: 2000, tilt_deg: [[1, 0]]}\n")


def test_instruments_default_to_perfect() -> None:
    """And its machine gives, to the last bit, what one gives of which they are stated as perfect."""
    parameters = {n: p for n, p in BENCH.parameters.items() if n not in INSTRUMENTS}
    entries = "\n".join(
        f"  {p.name}: {{value: {p.value!r}, unit: '{p.unit}', uncertainty: {p.uncertainty!r}, source: own}}"
        for p in parameters.values()
    )
    old = Bench.from_text(f"schema: 1\nname: old\nparameters:\n{entries}\n", origin="old.yaml")
    assert {n: old.value(n) for n in INSTRUMENTS} == dict(INSTRUMENTS)
    assert not any(old.parameters[n].uncertainty for n in INSTRUMENTS)
    of_old, of_new = (simulate(bench, Scenario(noise_seed=4), PLAN).measurement for bench in (old, BENCH))
    np.testing.assert_array_equal(of_old, of_new)


def test_clock_errors_affect_only_the_stamps() -> None:
    exact = simulate(BENCH, Scenario(noise_seed=4), PLAN)
    values = {"clock_jitter": 2e-5, "clock_rate_error": 1e-3}
    run = simulate(BENCH, Scenario(values=values, noise_seed=4), PLAN)
    np.testing.assert_array_equal(run.measurement, exact.measurement)
    true = np.arange(len(exact.stamps)) * PERIOD
    np.testing.assert_allclose(exact.stamps * 1e-9, true, rtol=0.0, atol=1e-12)
    error = run.stamps * 1e-9 - true * (1.0 + 1e-3)
    assert np.std(error) == pytest.approx(2e-5, rel=0.05)
    assert abs(np.mean(error)) < 2e-6
    plant = Plant(BENCH, Scenario(values=values, noise_seed=4), initial_spin_rate=SPIN)
    plant.measure()
    stamps = [plant.stamp_ns]
    for _ in range(20):
        plant.step(0.0, 0.0, 9.0)
        stamps.append(plant.stamp_ns)
    np.testing.assert_array_equal(stamps, run.stamps[:21])


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("tilt_delay", 0.01, "-0.002 .. 0.002"),
        ("coil_voltage_filter_time", -1e-4, ">= 0"),
        ("tilt_filter_order", 2.5, "1, 2, 3 or 4"),
        ("tilt_filter_order", 5.0, "1 .. 4"),
        ("tilt_resolution", -1e-6, ">= 0"),
        ("mains_frequency", 0.0, "> 0"),
    ],
)
def test_impossible_instrument_parameters_are_refused(name: str, value: float, allowed: str) -> None:
    with pytest.raises(InputError, match=rf"overrides.{name}: {value:g} is out of range; allowed: {allowed}"):
        BENCH.with_values({name: value})


def test_a_delay_beyond_the_memory_of_the_plant_is_refused() -> None:
    with pytest.raises(InputError, match=r"tilt_delay: -0.6 ms is out of range; allowed: -0.5 .. 5 ms"):
        simulate(BENCH, Scenario(effects={"tilt_delay": {"d": -0.6e-3}}), PLAN)


@pytest.mark.parametrize(("delay", "time", "order"), [(0.2e-3, 0.0, 1), (0.0, 0.3e-3, 2), (-0.5e-3, 0.0, 1)])
def test_responses_are_those_of_the_readings(delay: float, time: float, order: int) -> None:
    """Of a voltage that is held between samples, and of something that turns smoothly."""
    omega = 2.0 * math.pi / (20.0 * PERIOD)
    held = np.exp(
        1j * omega * PERIOD * np.ceil(np.arange(N * FINE) / FINE)
    )  # of the interval that ends there
    line = mean_of_period(held)
    line = low_passed(line, time, order) if time else line
    ratio = (later(line, delay) / held[::FINE])[400:-20]
    expected = held_response(omega, delay, time, order, period=PERIOD)
    np.testing.assert_allclose(ratio, expected, atol=2e-4)
    turning = np.exp(1j * omega * PERIOD / FINE * np.arange(N * FINE))
    smooth = low_passed(turning, time, order) if time else turning
    ratio = (later(smooth, delay) / turning[::FINE])[400:-20]
    np.testing.assert_allclose(ratio, smooth_response(omega, delay, time, order), atol=2e-4)
    assert abs(expected - smooth_response(omega, delay, time, order)) < (omega * PERIOD) ** 2 / 8.0
