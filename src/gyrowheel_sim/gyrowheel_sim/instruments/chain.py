"""Delays and filters of the instruments as part of the compiled plant: what a reading shows of another instant.

As `gyrowheel_sim.plant.kernel`, the text below the kernel line is compiled together with the plant. An instant is
given by its age: how many sampling periods before the present sample it lies, below zero for one after it.
"""

from __future__ import annotations

import math
from typing import Any

from gyrowheel_sim.instruments.memory import FILTERS, N_FILTER, N_ROWS, ROWS, WIDTH, Past
from gyrowheel_sim.jit import njit

# --- kernel ---

SUB_STEPS = 8  # of a filter in one sampling period: the smooth input is a straight line in each
SHORTEST_FILTER = 1.0e-7  # s; a shorter time constant does nothing


@njit(cache=True, error_model="numpy", forceinline=True)
def has_chain(q: Any) -> bool:
    """Whether any instrument shows another instant than its stamp, or a filtered quantity."""
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
    m: Any,
    start: int,
    h: float,
    first: bool,
    column: int,
    which: int,
    delay: float,
    time: float,
    order: float,
) -> float:
    """Return what an instrument with delay and filter shows of a quantity that is held between samples."""
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
