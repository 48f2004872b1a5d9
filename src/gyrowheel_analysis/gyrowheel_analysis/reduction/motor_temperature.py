"""Temperatures of the motor, which no sensor measures: computed from the recorded current."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.reduction.samples import Array, Samples
from gyrowheel_recording.bags.reader import PAUSE
from gyrowheel_sim.bench import Bench

#: Bench parameters on which the computed motor temperatures depend.
MOTOR_THERMAL = (
    "winding_heat_capacity",
    "winding_thermal_resistance",
    "motor_heat_capacity",
    "motor_thermal_resistance",
)
_THERMAL_STEP = 0.1  # s
_PAUSE = round(PAUSE / _THERMAL_STEP)  # steps without a sample, after which the rest of a pause is one


def motor_temperatures(data: Samples, bench: Bench) -> tuple[Array, Array, Array]:
    """Compute the temperatures of the motor's winding and magnets from the recorded current.

    At the start of the recording the motor is assumed to have the air temperature. Returns instants (m,) [s], the
    temperatures (m, 2) [K], and their derivatives (m, 2, 4) by the parameters of `MOTOR_THERMAL`.
    """
    stated = np.array([bench.value(name) for name in MOTOR_THERMAL])
    if len(data.time) == 0:
        return np.zeros(1), np.full((1, 2), bench.value("air_temperature")), np.zeros((1, 2, len(stated)))
    numbers = ((data.time - data.time[0]) / _THERMAL_STEP).astype(np.int64)
    steps, block = _steps(numbers)
    # a block without samples has the heating of the previous one
    samples = np.bincount(block, minlength=len(steps))
    sums = np.bincount(block, weights=data.readings.motor_current**2, minlength=len(steps))
    known = np.flatnonzero(samples)
    last = known[np.searchsorted(known, np.arange(len(steps)), side="right") - 1]
    power = bench.value("motor_resistance") * (sums[last] / samples[last])
    above = _warming(power, steps, stated)
    sensitivity = np.empty((*above.shape, len(stated)))
    for k, value in enumerate(stated):
        moved = stated.copy()
        moved[k] *= 1.01
        sensitivity[..., k] = (_warming(power, steps, moved) - above) / (0.01 * value)
    air = float(np.mean(data.readings.air_temperature))
    ends = np.concatenate([[0], np.cumsum(steps)])
    return data.time[0] + _THERMAL_STEP * ends, air + above, sensitivity


def _steps(numbers: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the lengths of blocks [`_THERMAL_STEP`], and the block of each sample.

    `numbers` (n,) are the steps of the samples, ascending. A step is one block; the part of a long pause after its
    first `_PAUSE` steps is a single block.
    """
    count = int(numbers[-1]) + 1
    if count <= _PAUSE:
        return np.ones(count, dtype=np.int64), numbers
    ahead = np.diff(numbers)
    at = np.flatnonzero(ahead > _PAUSE + 1)
    if not len(at):
        return np.ones(count, dtype=np.int64), numbers
    joined = ahead[at] - _PAUSE - 1  # steps that form one block
    fewer = np.zeros_like(numbers)
    fewer[at + 1] = joined - 1
    block = numbers - np.cumsum(fewer)
    steps = np.ones(int(block[-1]) + 1, dtype=np.int64)
    steps[block[at] + _PAUSE + 1] = joined
    return steps, block


def _warming(power: Array, steps: NDArray[np.int64], parameters: Array) -> Array:
    """Return the temperature rise of winding and magnets (m + 1, 2) [K].

    `power` (m,) is the heating in each block [W], `steps` (m,) the length of the blocks [`_THERMAL_STEP`];
    `parameters` are the values of `MOTOR_THERMAL`.
    """
    winding, resistance, magnets, outer = parameters
    inward, outward = 1.0 / resistance, 1.0 / outer
    rates = np.array(
        [[-inward / winding, inward / winding], [inward / magnets, -(inward + outward) / magnets]]
    )
    # heat flows both ways between two bodies: the values are real, whatever type this version of NumPy gives them
    values, modes = (found.real for found in np.linalg.eig(rates))
    drive = np.linalg.solve(modes, np.array([1.0 / winding, 0.0]))
    result = np.zeros((len(power) + 1, 2))
    for value, mode, gain in zip(values, modes.T, drive, strict=True):
        fading = np.where(steps == 1, math.exp(value * _THERMAL_STEP), np.exp(value * _THERMAL_STEP * steps))
        heating = gain * (fading - 1.0) / value * power
        pairs = zip(fading.tolist(), heating.tolist(), strict=True)
        course = list(
            itertools.accumulate(pairs, lambda rise, block: block[0] * rise + block[1], initial=0.0)
        )
        result += np.array(course)[:, None] * mode[None, :]
    return result


def interpolated(time: Array, values: Array, when: float) -> Array:
    """Interpolate rows of `values`, as `motor_temperatures` returns them at its instants `time`."""
    if len(time) < 2:
        return np.asarray(values[0])
    low = min(max(int(np.searchsorted(time, when, side="right")) - 1, 0), len(time) - 2)
    part = min(max((when - time[low]) / (time[low + 1] - time[low]), 0.0), 1.0)
    return np.asarray(values[low] + part * (values[low + 1] - values[low]))
