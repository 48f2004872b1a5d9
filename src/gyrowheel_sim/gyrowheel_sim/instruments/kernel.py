"""The instruments as compiled code: from the true state to one sample of readings, with delays and filters.

As of `gyrowheel_sim.plant.kernel`, the text below the kernel line is compiled together with the plant. An instant is
given by its age: the number of sampling periods before the present sample, negative after it.
"""

from __future__ import annotations

import math
from typing import Any

from gyrowheel_sim.instruments import FILTERS, N_FILTER, N_ROWS, ROWS, WIDTH, Drift, Past, Reading
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
    """Return the output of the tilt sensors before their converters; laws of effects add `error`."""
    x, y = math.atan(zx), math.atan(zy)
    tilt_x = p.tilt_scale * x + p.tilt_bias_x + error_x
    tilt_y = p.tilt_scale * y + p.tilt_bias_y + error_y
    if p.tilt_cubic != 0.0 or p.tilt_cross_talk != 0.0:
        tilt_x += p.tilt_cubic * x * x * x + p.tilt_cross_talk * y
        tilt_y += p.tilt_cubic * y * y * y + p.tilt_cross_talk * x
    return tilt_x, tilt_y


@njit(cache=True, error_model="numpy", forceinline=True)
def encoded(p: Any, angle: float) -> float:
    """Return the encoder's reading of an angle: with its zero error and its errors once and twice a turn."""
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
    """Return the output of a converter: the value with mains hum of phase `mains`, in steps."""
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


SUB_STEPS = 8  # of a filter in one sampling period: the smooth input is a straight line in each
SHORTEST_FILTER = 1.0e-7  # s; a shorter time constant does nothing


@njit(cache=True, error_model="numpy", forceinline=True)
def has_chain(q: Any) -> bool:
    """Return whether any instrument has a delay or a filter."""
    return (
        q.tilt_delay != 0.0 or q.spin_angle_delay != 0.0 or q.coil_voltage_delay != 0.0
        or q.motor_voltage_delay != 0.0 or q.motor_current_delay != 0.0
        or q.tilt_filter_time > SHORTEST_FILTER or q.coil_voltage_filter_time > SHORTEST_FILTER
        or q.motor_voltage_filter_time > SHORTEST_FILTER or q.motor_current_filter_time > SHORTEST_FILTER
    )  # fmt: skip


@njit(cache=True, error_model="numpy", forceinline=True)
def remember(
    m: Any, start: int, h: float, nx: float, ny: float, ux: float, uy: float, angle: float, Omega: float,
    vx: float, vy: float, vm: float, current: float,
) -> bool:  # fmt: skip
    """Put a sample into the memory, which begins in `m` at `start`; return whether it is the first one.

    Before the first sample everything moved as it moves at it, under the same voltages.
    """
    first = m[start] == 0.0
    m[start] = 1.0
    rows = start + ROWS
    for i in range(rows + N_ROWS * WIDTH - 1, rows + 2 * WIDTH - 1, -1):
        m[i] = m[i - WIDTH]
    for row in range(1, N_ROWS if first else 2):
        age = (row - 1) * h
        at = rows + row * WIDTH
        m[at + Past.n_x] = nx - age * ux
        m[at + Past.n_y] = ny - age * uy
        m[at + Past.n_x_rate] = ux
        m[at + Past.n_y_rate] = uy
        m[at + Past.spin_angle] = angle - age * Omega
        m[at + Past.spin_rate] = Omega
        m[at + Past.coil_voltage_x] = vx
        m[at + Past.coil_voltage_y] = vy
        m[at + Past.motor_voltage] = vm
        m[at + Past.motor_current] = current
    return first


@njit(cache=True, error_model="numpy", forceinline=True)
def remember_next(m: Any, start: int, vx: float, vy: float, vm: float, current: float) -> None:
    """Put the voltages of the next interval into the memory, and the current that they will give."""
    at = start + ROWS
    m[at + Past.coil_voltage_x] = vx
    m[at + Past.coil_voltage_y] = vy
    m[at + Past.motor_voltage] = vm
    m[at + Past.motor_current] = current


@njit(cache=True, error_model="numpy", forceinline=True)
def mean_at(m: Any, start: int, column: int, age: float) -> float:
    """Return the mean of a held quantity over the sampling period that ends at an instant.

    From one sample to the next it is a straight line, for the quantity is held between them.
    """
    row = min(max(math.floor(age), -1), N_ROWS - 3)
    part = age - row
    at = start + ROWS + (row + 1) * WIDTH + column
    return (1.0 - part) * m[at] + part * m[at + WIDTH]


@njit(cache=True, error_model="numpy", forceinline=True)
def moved_to(m: Any, start: int, h: float, column: int, rate: int, age: float, turn: float) -> Any:
    """Return a quantity of the motion and its rate at an instant.

    It is the cubic that has its values and rates at two samples; an instant after the present sample is reached by that
    of the last two. `turn` is what the quantity jumps by, zero if it does not.
    """
    row = min(max(math.floor(age), 0), N_ROWS - 3)
    at = start + ROWS + (row + 1) * WIDTH
    new, old = m[at + column], m[at + WIDTH + column]
    if turn != 0.0:
        old += turn * round((new - old) / turn)
    new_rate, old_rate = m[at + rate] * h, m[at + WIDTH + rate] * h
    s = 1.0 - (age - row)  # 0 at the older sample, 1 at the newer one
    step = new - old
    c = 3.0 * step - 2.0 * old_rate - new_rate
    d = old_rate + new_rate - 2.0 * step
    return old + s * (old_rate + s * (c + s * d)), (old_rate + s * (2.0 * c + s * 3.0 * d)) / h


@njit(cache=True, error_model="numpy", forceinline=True)
def filter_started(m: Any, start: int, which: int, value: float) -> None:
    """Let a filter begin settled at a value."""
    at = start + FILTERS + which * N_FILTER
    for i in range(N_FILTER):
        m[at + i] = value


@njit(cache=True, error_model="numpy", forceinline=True)
def filtered(m: Any, start: int, which: int, order: int, left: float, mean: float, value: float) -> float:
    """Advance a filter by one sub-step, in which its input goes straight from the last one to `value`.

    `left` is what a pole keeps of its output, `mean` that averaged over the sub-step.
    """
    at = start + FILTERS + which * N_FILTER
    before, now = m[at], value
    m[at] = value
    for pole in range(1, order + 1):
        old = m[at + pole]
        new = left * old + (mean - left) * before + (1.0 - mean) * now
        m[at + pole] = new
        before, now = old, new
    return now


@njit(cache=True, error_model="numpy", forceinline=True)
def read_held(
    m: Any, start: int, h: float, first: bool, column: int, which: int, delay: float, time: float, order: float,
) -> float:  # fmt: skip
    """Return the reading, with delay and filter, of a quantity that is held between samples."""
    age = delay / h
    if time <= SHORTEST_FILTER:
        return mean_at(m, start, column, age)
    if first:
        filter_started(m, start, which, mean_at(m, start, column, age + 1.0))
    step = h / SUB_STEPS
    left = math.exp(-step / time)
    mean = (1.0 - left) * time / step
    value = 0.0
    for i in range(SUB_STEPS):
        value = mean_at(m, start, column, age + 1.0 - (i + 1) / SUB_STEPS)
        value = filtered(m, start, which, int(order), left, mean, value)
    return value
