"""The instruments as part of the compiled plant: from the true state to one sample of readings.

As `gyrowheel_sim.plant.kernel`, the text below the kernel line is compiled together with the plant.
"""

from __future__ import annotations

import math
from typing import Any

from gyrowheel_sim.instruments.readings import Drift, Reading
from gyrowheel_sim.jit import njit

# --- kernel ---

DRIFT_NOISE = len(Reading)  # the numbers of the drifts follow those of the readings


@njit(cache=True, error_model="numpy", forceinline=True)
def advance_drifts(p: Any, drift: Any, start: int, noise: Any) -> None:
    """Advance the drifts, which lie in `drift` from `start` on, by one sample (first-order Gauss-Markov processes)."""
    a = math.exp(-p.sample_period / p.drift_time)
    b = math.sqrt(1.0 - a * a)
    i = start + Drift.coil_voltage_x
    drift[i] = a * drift[i] + b * p.coil_voltage_drift * noise[DRIFT_NOISE + Drift.coil_voltage_x]
    i = start + Drift.coil_voltage_y
    drift[i] = a * drift[i] + b * p.coil_voltage_drift * noise[DRIFT_NOISE + Drift.coil_voltage_y]
    i = start + Drift.motor_voltage
    drift[i] = a * drift[i] + b * p.motor_voltage_drift * noise[DRIFT_NOISE + Drift.motor_voltage]
    i = start + Drift.motor_current
    drift[i] = a * drift[i] + b * p.motor_current_drift * noise[DRIFT_NOISE + Drift.motor_current]


@njit(cache=True, error_model="numpy", forceinline=True)
def read_instruments(
    p: Any, error: Any, drift: Any, start: int, noise: Any, zx: float, zy: float, angle: float, Omega: float,
    vx: float, vy: float, vm: float, current: float, T_coil: float, T_air: float, pressure: float, out: Any,
) -> None:  # fmt: skip
    """Write one sample of every reading into `out`.

    `error` has what the laws of the effects add to the readings; the drifts lie in `drift` from `start` on.
    """
    out[Reading.tilt_x] = (
        p.tilt_scale * math.atan(zx) + p.tilt_bias_x + error.tilt_x + p.tilt_noise * noise[Reading.tilt_x]
    )
    out[Reading.tilt_y] = (
        p.tilt_scale * math.atan(zy) + p.tilt_bias_y + error.tilt_y + p.tilt_noise * noise[Reading.tilt_y]
    )
    angle = angle + error.spin_angle + p.spin_angle_noise * noise[Reading.spin_angle]
    out[Reading.spin_angle] = angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi))
    out[Reading.spin_rate] = Omega + error.spin_rate + p.spin_rate_noise * noise[Reading.spin_rate]
    out[Reading.coil_voltage_x] = (
        vx + drift[start + Drift.coil_voltage_x] + error.coil_voltage_x
        + p.coil_voltage_noise * noise[Reading.coil_voltage_x]
    )  # fmt: skip
    out[Reading.coil_voltage_y] = (
        vy + drift[start + Drift.coil_voltage_y] + error.coil_voltage_y
        + p.coil_voltage_noise * noise[Reading.coil_voltage_y]
    )  # fmt: skip
    out[Reading.motor_voltage] = (
        vm + drift[start + Drift.motor_voltage] + error.motor_voltage
        + p.motor_voltage_noise * noise[Reading.motor_voltage]
    )  # fmt: skip
    out[Reading.motor_current] = (
        current + drift[start + Drift.motor_current] + error.motor_current
        + p.motor_current_noise * noise[Reading.motor_current]
    )  # fmt: skip
    out[Reading.coil_temperature] = (
        T_coil + p.temperature_bias + error.coil_temperature
        + p.temperature_noise * noise[Reading.coil_temperature]
    )  # fmt: skip
    out[Reading.air_temperature] = (
        T_air + error.air_temperature + p.temperature_noise * noise[Reading.air_temperature]
    )
    out[Reading.air_pressure] = (
        pressure + p.pressure_bias + error.air_pressure + p.pressure_noise * noise[Reading.air_pressure]
    )
