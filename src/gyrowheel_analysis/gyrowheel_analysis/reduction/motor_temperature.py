"""Temperatures of the motor, which no sensor measures: computed from the recorded current."""

from __future__ import annotations

import functools
import itertools
import math

import numpy as np

from gyrowheel_analysis.reduction.samples import Array, Samples
from gyrowheel_sim.bench import Bench

#: Bench parameters on which the computed motor temperatures depend.
MOTOR_THERMAL = (
    "winding_heat_capacity",
    "winding_thermal_resistance",
    "motor_heat_capacity",
    "motor_thermal_resistance",
)
_THERMAL_STEP = 0.1  # s


def motor_temperatures(data: Samples, bench: Bench) -> tuple[Array, Array, Array]:
    """Compute the temperatures of the motor's winding and magnets from the recorded current.

    Parameters
    ----------
    data : Samples
        The recording; at its start the motor is assumed to have the air temperature.
    bench : Bench
        Gives the heat capacities and thermal resistances (`MOTOR_THERMAL`).

    Returns
    -------
    time : ndarray (m,)
        Instants [s].
    temperature : ndarray (m, 2)
        Winding and magnets [K].
    sensitivity : ndarray (m, 2, 4)
        Derivatives by the parameters of `MOTOR_THERMAL`.
    """
    stated = np.array([bench.value(name) for name in MOTOR_THERMAL])
    if len(data.time) == 0:
        return np.zeros(1), np.full((1, 2), bench.value("air_temperature")), np.zeros((1, 2, len(stated)))
    block = ((data.time - data.time[0]) / _THERMAL_STEP).astype(np.int64)
    count = int(block[-1]) + 1
    # a block without samples has the heating of the one before
    samples = np.bincount(block, minlength=count)
    sums = np.bincount(block, weights=data.readings.motor_current**2, minlength=count)
    known = np.flatnonzero(samples)
    last = known[np.searchsorted(known, np.arange(count), side="right") - 1]
    power = bench.value("motor_resistance") * (sums[last] / samples[last])
    above = _warming(power, stated)
    sensitivity = np.empty((*above.shape, len(stated)))
    for k, value in enumerate(stated):
        moved = stated.copy()
        moved[k] *= 1.01
        sensitivity[..., k] = (_warming(power, moved) - above) / (0.01 * value)
    air = float(np.mean(data.readings.air_temperature))
    return data.time[0] + _THERMAL_STEP * np.arange(count + 1), air + above, sensitivity


def _warming(power: Array, parameters: Array) -> Array:
    """Return the temperature rise of winding and magnets (m + 1, 2) [K], given the heating of each step (m,) [W]."""
    winding, resistance, magnets, outer = parameters
    inward, outward = 1.0 / resistance, 1.0 / outer
    rates = np.array(
        [[-inward / winding, inward / winding], [inward / magnets, -(inward + outward) / magnets]]
    )
    values, modes = np.linalg.eig(rates)
    drive = np.linalg.solve(modes, np.array([1.0 / winding, 0.0]))
    result = np.zeros((len(power) + 1, 2))
    for value, mode, gain in zip(values, modes.T, drive, strict=True):
        step = math.exp(value * _THERMAL_STEP)
        heating = (gain * (step - 1.0) / value * power).tolist()
        own = list(itertools.accumulate(heating, functools.partial(_fading, step), initial=0.0))
        result += np.array(own)[:, None] * mode[None, :]
    return result


def _fading(step: float, before: float, more: float) -> float:
    return step * before + more


def interpolated(time: Array, values: Array, when: float) -> Array:
    """Interpolate rows of `values`, as `motor_temperatures` returns them at its instants `time`."""
    place = float(np.clip((when - time[0]) / _THERMAL_STEP, 0.0, len(time) - 1.0))
    low = min(int(place), max(len(time) - 2, 0))
    high = min(low + 1, len(time) - 1)
    return np.asarray(values[low] + (place - low) * (values[high] - values[low]))
