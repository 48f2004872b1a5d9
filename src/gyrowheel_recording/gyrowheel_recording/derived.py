"""Readings that no instrument took: where they come from, and how they are derived from others."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.readings import Readings
from gyrowheel_core.units import DEG
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import Environment

#: Units of the readings for which a value may be assumed.
_ASSUMED_UNITS: Final = {"air_pressure": "Pa", "air_temperature": "K", "coil_temperature": "K"}


@dataclass(frozen=True)
class Origin:
    """Where a reading comes from."""

    uncertainty: float  # how far off it may be throughout [SI, 1 sigma]
    #: Pulses a turn by which an angle is known; 0 for a value that was assumed for all samples.
    pulses: int = 0


def described(bench: str, origins: Mapping[str, Origin]) -> str:
    """Return the description of a bench with the origins of the readings of a recording."""
    if not origins:
        return bench
    content = json.loads(bench)
    content["readings"] = {
        name: ({"pulses": own.pulses} if own.pulses else {"assumed": True}) | {"uncertainty": own.uncertainty}
        for name, own in origins.items()
    }
    return json.dumps(content, separators=(",", ":"))


def origins_in(bench: str) -> dict[str, Origin]:
    """Return the origins of readings in the description of a bench, by reading; empty where it is not valid."""
    try:
        entries = json.loads(bench)["readings"].items()
        found = {
            str(name): Origin(float(own["uncertainty"]), int(own.get("pulses", 0))) for name, own in entries
        }
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
        return {}
    return {
        name: own
        for name, own in found.items()
        if math.isfinite(own.uncertainty) and own.uncertainty >= 0.0 and own.pulses >= 0
    }


def origins_in_words(origins: Mapping[str, Origin]) -> tuple[str, ...]:
    """Return, in words, the substitutes of readings that no instrument took, and their uncertainty."""
    found = []
    for name, own in origins.items():
        if own.pulses:
            found.append(
                f"{name} (from {own.pulses} pulse{'s' * (own.pulses > 1)} a turn and the speed, "
                f"± {own.uncertainty / DEG:.2g} deg)"
            )
        else:
            found.append(f"{name} (a value is given, ± {own.uncertainty:g} {_ASSUMED_UNITS.get(name, '')})")
    return tuple(found)


Array = NDArray[np.float64]

#: What stands for a reading that was never taken, in words.
_WORDS: Final = {
    "spin_angle": "spin_angle (summed up from the speed; where in its turn the rotor is, is not known: averages alone)",
    "spin_rate": "spin_rate (the rate of the angle is taken)",
    "motor_current": "motor_current (from voltage and speed by the bench's constants)",
    "motor_voltage": "motor_voltage (from current and speed by the bench's constants)",
    "coil_voltage_x": "coil_voltage_x (the torque about x is not analysed)",
    "coil_voltage_y": "coil_voltage_y (the torque about y is not analysed)",
}
_SPAN: Final = 0.01  # s over which the rate of an angle is taken
#: Slow readings for which a value is assumed where they were never taken, by the parameter of the bench that is their
#: error; and how far what is assumed may be off (1 sigma): weather and the height of a lab [Pa], a room and what heats
#: in it [K].
ASSUMED: Final = {
    "air_pressure": ("pressure_bias", 3.0e3),
    "air_temperature": ("temperature_bias", 3.0),
    "coil_temperature": ("temperature_bias", 3.0),
}


def assumed_rig(environment: Sequence[Environment]) -> tuple[str, ...]:
    """Return, in words, what is taken for the rig where a recording does not state how it stood."""
    return () if environment else ("how the rig stood (upright is taken, in air of the usual density)",)


def unmeasured(readings: Readings) -> frozenset[str]:
    """Return the readings of which none is a number."""
    return frozenset(name for name in _WORDS if not np.isfinite(readings[name]).any())


def assumed_errors(readings: Readings, stated: Mapping[str, float]) -> dict[str, float]:
    """Return how far off the values assumed for readings without any number may be [SI, 1 sigma], by reading.

    `stated` has the same of readings that are a given value.
    """
    never = {name: size for name, (_, size) in ASSUMED.items() if not np.isfinite(readings[name]).any()}
    return never | {name: size for name, size in stated.items() if name in ASSUMED and size > 0.0}


def largest_errors(recordings: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Return the largest of what `assumed_errors` returns for recordings, by parameter of the bench [SI]."""
    result: dict[str, float] = {}
    for sizes in recordings:
        for name, size in sizes.items():
            parameter = ASSUMED[name][0]
            result[parameter] = max(size, result.get(parameter, 0.0))
    return result


def shares(sizes: Mapping[str, float], largest: Mapping[str, float]) -> dict[str, float]:
    """Return the share of each reading in the error of a parameter (`largest_errors`)."""
    return {name: size / largest[ASSUMED[name][0]] for name, size in sizes.items()}


def lacking(readings: Readings) -> list[str]:
    """Return what is missing for any analysis: readings for which nothing can stand."""
    absent = unmeasured(readings)
    needed = [name for name in ("tilt_x", "tilt_y") if not np.isfinite(readings[name]).any()]
    if {"spin_angle", "spin_rate"} <= absent:
        needed.append("spin_angle or spin_rate")
    if {"coil_voltage_x", "coil_voltage_y", "motor_current", "motor_voltage"} <= absent:
        needed.append("a voltage or the motor's current")
    return needed


def completed(time: Array, readings: Readings, absent: Set[str], bench: Bench) -> Readings:
    """Return readings in which those `absent` are derived from others where that is possible, else as they are.

    Parameters
    ----------
    time : ndarray (n,)
        Stamps [s].
    readings : Readings
        The readings [SI].
    absent : set of str
        What `unmeasured` returns.
    bench : Bench
        Gives constant and resistance of the motor.
    """
    if not absent or len(time) < 2:
        return readings
    result = readings.copy()
    if "spin_rate" in absent and "spin_angle" not in absent:
        result["spin_rate"][:] = _rate(time, readings.spin_angle)
    if "spin_angle" in absent and "spin_rate" not in absent:
        result["spin_angle"][:] = angle_of(time, readings.spin_rate)
    resistance, constant = bench.value("motor_resistance"), bench.value("motor_constant")
    if "motor_current" in absent and "motor_voltage" not in absent:
        result["motor_current"][:] = (readings.motor_voltage - constant * result.spin_rate) / resistance
    if "motor_voltage" in absent and "motor_current" not in absent:
        result["motor_voltage"][:] = resistance * readings.motor_current + constant * result.spin_rate
    return result


def in_words(absent: Set[str]) -> tuple[str, ...]:
    """Return what stands for the readings that were never taken."""
    motor = ("motor_current", "motor_voltage")
    if absent >= set(motor):
        rest = tuple(text for name, text in _WORDS.items() if name in absent and name not in motor)
        return (*rest, f"{' and '.join(motor)} (the torque about the spin axis is not analysed)")
    return tuple(text for name, text in _WORDS.items() if name in absent)


def angle_of(time: Array, rate: Array) -> Array:
    """Return an angle that turns at a rate [rad]; its beginning is arbitrary."""
    known = np.isfinite(rate)
    filled = np.interp(time, time[known], rate[known])
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (filled[1:] + filled[:-1]) * np.diff(time))])
    return np.where(known, np.mod(turned, 2.0 * math.pi), np.nan)


def _rate(time: Array, angle: Array) -> Array:
    """Return the rate of an angle [rad/s], over some samples so that its noise stays small."""
    known = np.flatnonzero(np.isfinite(angle))
    result = np.full(len(time), np.nan)
    if len(known) < 3:
        return result
    when, turned = time[known], np.unwrap(angle[known])
    half = max(round(0.5 * _SPAN / max(float(np.median(np.diff(when))), 1e-9)), 1)
    ahead = np.minimum(np.arange(len(known)) + half, len(known) - 1)
    behind = np.maximum(np.arange(len(known)) - half, 0)
    result[known] = (turned[ahead] - turned[behind]) / (when[ahead] - when[behind])
    return result
