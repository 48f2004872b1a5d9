"""The spectrum over the order of the rotation: lines at any speed, the residual where the model predicts, and noise."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gyrowheel_analysis.channels import CHANNELS
from gyrowheel_analysis.reduction.windows import Windows, still_row
from gyrowheel_analysis.residuals.error_table import Part, WindowResiduals
from gyrowheel_analysis.residuals.orders import TURNS, OrderSpectrum, order_spectrum
from gyrowheel_core.readings import READINGS, Readings
from gyrowheel_core.units import RPM
from gyrowheel_sim.bench import Bench

PERIOD, SAMPLES = 5e-4, 1600
BENCH = Bench.load()


def spectrum(
    waves: dict[int, complex],
    speeds: list[float],
    *,
    noise: float = 0.0,
    residual: complex = 0.0,
    seed: int = 0,
    lost: int = 0,
    quantity: Any = "coil_torque",
) -> OrderSpectrum:
    """Return the spectrum of windows, one a speed [rpm], with coil torques of some orders [N m]."""
    rng = np.random.default_rng(seed)
    values = np.zeros((len(speeds) * SAMPLES, len(READINGS)))
    readings, rows = Readings(values), []
    time = PERIOD * np.arange(1, len(values) + 1)
    for k, speed in enumerate(speeds):
        own = slice(k * SAMPLES, (k + 1) * SAMPLES)
        angle = speed * RPM * time[own] + rng.uniform(0.0, 6.0)
        torque = sum(size * np.exp(1j * order * angle) for order, size in waves.items()) + 3e-3
        volts = torque / BENCH.value("coil_constant")
        volts = volts + noise * (rng.normal(size=SAMPLES) + 1j * rng.normal(size=SAMPLES))
        readings.array[own, Readings.columns(["spin_angle"])[0]] = np.mod(angle, 2.0 * np.pi)
        for name, part in (
            ("coil_voltage_x", volts.real),
            ("coil_voltage_y", volts.imag),
            ("motor_current", volts.real),
        ):
            readings.array[own, Readings.columns([name])[0]] = part
        spin = np.zeros(5)
        spin[0] = speed * RPM
        rows.append(
            still_row()
            | {"start": time[own][0] - PERIOD, "duration": SAMPLES * PERIOD, "samples": SAMPLES, "spin": spin}
        )
    kept = np.arange(len(values)) != lost if lost else np.ones(len(values), dtype=bool)
    recording = SimpleNamespace(time=time[kept], readings=readings[kept])
    n = len(speeds)
    part = Part(CHANNELS["tilt_1n"], np.full(n, residual), np.ones(n), np.zeros(n))
    data = WindowResiduals(Windows.of(rows), np.zeros(n, dtype=np.int64), {"tilt_1n": part})
    return order_spectrum([recording], data, quantity, BENCH)  # type: ignore[list-item]


def test_what_turns_with_the_rotor_is_a_line_at_every_speed() -> None:
    found = spectrum({3: 2e-4, -2: 1e-4}, [3500.0, 1400.0, 2222.0])
    forward, backward = (dict(zip(found.order, own, strict=True)) for own in (found.forward, found.backward))
    assert forward[3.0] == pytest.approx(2e-4, rel=1e-3)
    assert backward[2.0] == pytest.approx(1e-4, rel=1e-3)
    assert forward[5.0] < 1e-8  # the line leaks nowhere
    assert found.order[-1] == 10.0
    assert found.blocks == sum(int(SAMPLES * PERIOD * rpm / 60.0 / TURNS) for rpm in (3500, 1400, 2222))


def test_at_the_orders_of_the_model_its_residual_takes_the_place_of_what_is_measured() -> None:
    found = spectrum({1: 5e-3j, 3: 2e-4}, [3500.0], residual=4e-5)
    forward = dict(zip(found.order, found.forward, strict=True))
    assert found.predicted == (1,)
    assert forward[1.0] == pytest.approx(4e-5, rel=1e-2)
    assert forward[3.0] == pytest.approx(2e-4, rel=1e-3)
    # of the motor nothing is predicted within a revolution, and a real signal has one side
    motor = spectrum({3: 2e-4}, [3500.0], quantity="motor_torque")
    size = 2e-4 * BENCH.value("motor_constant") / BENCH.value("coil_constant")
    assert (motor.predicted, len(motor.backward)) == ((), 0)
    assert motor.forward[motor.order == 3.0] == pytest.approx(size, rel=1e-3)


def test_orders_end_at_half_the_sampling_rate_over_the_highest_speed() -> None:
    found = spectrum({}, [9000.0, 3000.0], noise=1e-3)  # 150 turns a second, 2 kHz
    assert found.order[-1] == pytest.approx(1000.0 / 150.0, abs=1.0 / TURNS)
    # windows that are too short, or lack samples, have no part
    short = spectrum({}, [3000.0, 300.0], noise=1e-3)
    assert (short.blocks, short.left_out) == (5, 1)
    assert spectrum({}, [3000.0, 3000.0], noise=1e-3, lost=300).left_out == 1
    none = spectrum({}, [300.0])
    assert (len(none.order), none.blocks, none.left_out) == (0, 0, 1)


@pytest.mark.slow
def test_noise_alone_exceeds_its_level_in_five_of_a_hundred_spectra() -> None:
    """Also where windows differ in their noise, and of a single block."""
    for speeds in ([600.0], [3500.0, 1400.0]):
        hits = 0
        for seed in range(200):
            found = spectrum({}, speeds, noise=1e-3, seed=seed)
            hits += bool(np.any(found.backward > found.backward_level))
        assert 1 <= hits <= 22  # of 200; 10 are expected
    clear = spectrum({4: 2e-6}, [3500.0] * 5, noise=1e-4)
    above = clear.order[clear.forward > clear.forward_level]
    assert 4.0 in above
    assert np.all(np.abs(above - 4.0) <= 1.0 / TURNS)
