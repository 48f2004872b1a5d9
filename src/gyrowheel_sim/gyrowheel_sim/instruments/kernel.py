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
def sensed_tilt(p: Any, zx: float, zy: float, error_x: float, error_y: float) -> Any:
    """Return what the tilt sensors show of a tilt, before their converters; laws of effects add `error`."""
    x, y = math.atan(zx), math.atan(zy)
    tilt_x = p.tilt_scale * x + p.tilt_bias_x + error_x
    tilt_y = p.tilt_scale * y + p.tilt_bias_y + error_y
    if p.tilt_cubic != 0.0 or p.tilt_cross_talk != 0.0:
        tilt_x += p.tilt_cubic * x * x * x + p.tilt_cross_talk * y
        tilt_y += p.tilt_cubic * y * y * y + p.tilt_cross_talk * x
    return tilt_x, tilt_y


@njit(cache=True, error_model="numpy", forceinline=True)
def encoded(p: Any, angle: float) -> float:
    """Return what the encoder shows of an angle: its zero, and its errors once and twice a turn."""
    angle_read = angle + p.encoder_zero
    if p.encoder_once_x != 0.0 or p.encoder_once_y != 0.0:
        angle_read += p.encoder_once_x * math.cos(angle) + p.encoder_once_y * math.sin(angle)
    if p.encoder_twice_x != 0.0 or p.encoder_twice_y != 0.0:
        angle_read += p.encoder_twice_x * math.cos(2.0 * angle) + p.encoder_twice_y * math.sin(2.0 * angle)
    return angle_read


@njit(cache=True, error_model="numpy", forceinline=True)
def stepped(value: float, resolution: float) -> float:
    """Return the nearest step of a converter, the upper one half-way; without resolution the value itself."""
    if resolution > 0.0:
        return resolution * math.floor(value / resolution + 0.5)
    return value


@njit(cache=True, error_model="numpy", forceinline=True)
def converted(value: float, hum: float, mains: float, resolution: float) -> float:
    """Return what a converter gives: the value with the hum of the mains, whose phase is `mains`, in steps."""
    if hum > 0.0:
        value += hum * math.sin(mains)
    return stepped(value, resolution)


@njit(cache=True, error_model="numpy", forceinline=True)
def read_instruments(
    p: Any, error: Any, drift: Any, start: int, noise: Any, t: float, tilt_x: float, tilt_y: float, angle: float,
    Omega: float, vx: float, vy: float, vm: float, current: float, T_coil: float, T_air: float, pressure: float,
    out: Any,
) -> None:  # fmt: skip
    """Write one sample of every reading into `out`.

    The tilts are those that the sensors show, the angle the encoder's. `error` has what the laws of the effects add to
    the other readings; the drifts lie in `drift` from `start` on.
    """
    mains = 2.0 * math.pi * p.mains_frequency * t
    value = tilt_x + p.tilt_noise * noise[Reading.tilt_x]
    out[Reading.tilt_x] = converted(value, p.tilt_hum, mains, p.tilt_resolution)
    value = tilt_y + p.tilt_noise * noise[Reading.tilt_y]
    out[Reading.tilt_y] = converted(value, p.tilt_hum, mains, p.tilt_resolution)
    angle = stepped(
        angle + error.spin_angle + p.spin_angle_noise * noise[Reading.spin_angle], p.spin_angle_resolution
    )
    out[Reading.spin_angle] = angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi))
    value = Omega + error.spin_rate + p.spin_rate_noise * noise[Reading.spin_rate]
    out[Reading.spin_rate] = stepped(value, p.spin_rate_resolution)
    value = (
        vx + drift[start + Drift.coil_voltage_x] + error.coil_voltage_x
        + p.coil_voltage_noise * noise[Reading.coil_voltage_x]
    )  # fmt: skip
    out[Reading.coil_voltage_x] = converted(value, p.coil_voltage_hum, mains, p.coil_voltage_resolution)
    value = (
        vy + drift[start + Drift.coil_voltage_y] + error.coil_voltage_y
        + p.coil_voltage_noise * noise[Reading.coil_voltage_y]
    )  # fmt: skip
    out[Reading.coil_voltage_y] = converted(value, p.coil_voltage_hum, mains, p.coil_voltage_resolution)
    value = (
        vm + drift[start + Drift.motor_voltage] + error.motor_voltage
        + p.motor_voltage_noise * noise[Reading.motor_voltage]
    )  # fmt: skip
    out[Reading.motor_voltage] = converted(value, p.motor_voltage_hum, mains, p.motor_voltage_resolution)
    value = (
        current + drift[start + Drift.motor_current] + error.motor_current
        + p.motor_current_noise * noise[Reading.motor_current]
    )  # fmt: skip
    out[Reading.motor_current] = converted(value, p.motor_current_hum, mains, p.motor_current_resolution)
    value = (
        T_coil + p.temperature_bias + error.coil_temperature
        + p.temperature_noise * noise[Reading.coil_temperature]
    )  # fmt: skip
    out[Reading.coil_temperature] = stepped(value, p.temperature_resolution)
    value = T_air + error.air_temperature + p.temperature_noise * noise[Reading.air_temperature]
    out[Reading.air_temperature] = stepped(value, p.temperature_resolution)
    value = pressure + p.pressure_bias + error.air_pressure + p.pressure_noise * noise[Reading.air_pressure]
    out[Reading.air_pressure] = stepped(value, p.pressure_resolution)
