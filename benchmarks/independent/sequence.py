"""A test sequence: setpoints of tilt and speed at every sample, and the parts with steady motion."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_DEGREE = math.pi / 180.0
_RPM = math.pi / 30.0
_TILT_SPEED = 6.0 * _DEGREE  # mean rate of a change of tilt [rad/s]
_SPEED_UP = 80.0  # mean rate of a change of speed [rad/s^2]


@dataclass(frozen=True)
class Step:
    """One steady motion: a hold or a cone.

    Attributes
    ----------
    rpm : float
        Speed.
    tilt : complex
        Tilt phi_x + i phi_y at its start [degrees].
    hold : float
        Duration [s].
    turn : float
        Turns of the tilt about the case axis in that time; 0 for a hold.
    """

    rpm: float
    tilt: complex
    hold: float = 2.1
    turn: float = 0.0


@dataclass(frozen=True)
class References:
    """Setpoints at every sample.

    Attributes
    ----------
    tilt, tilt_rate : complex ndarray (n,)
        Tilt [rad] and its rate [rad/s].
    spin, spin_rate : ndarray (n,)
        Speed [rad/s] and its rate [rad/s^2].
    steady : ndarray of bool (n,)
        Whether the setpoint is a steady motion.
    step : ndarray of int (n,)
        Number of the step.
    """

    tilt: NDArray[np.complex128]
    tilt_rate: NDArray[np.complex128]
    spin: Array
    spin_rate: Array
    steady: NDArray[np.bool_]
    step: NDArray[np.int64]


def references(steps: Sequence[Step], period: float) -> References:
    """Return the setpoints of a sequence; changes have the shape of half a cosine wave."""
    parts: list[tuple[NDArray[Any], ...]] = []
    tilt, spin, turning = steps[0].tilt * _DEGREE, steps[0].rpm * _RPM, 0.0
    for number, step in enumerate(steps):
        to, speed = step.tilt * _DEGREE, step.rpm * _RPM
        rate = 2.0 * math.pi * step.turn / step.hold
        length = max(abs(to - tilt) / _TILT_SPEED, abs(speed - spin) / _SPEED_UP, 0.0) + 0.3
        if number == 0:
            length = 2.0  # the loops start
        n = round(length / period)
        x = np.arange(n) / n
        shape, slope = 0.5 - 0.5 * np.cos(np.pi * x), 0.5 * np.pi * np.sin(np.pi * x) / (n * period)
        parts.append(
            (
                tilt + (to - tilt) * shape,
                (to - tilt) * slope,
                spin + (speed - spin) * shape,
                (speed - spin) * slope,
                np.zeros(n),
                np.full(n, number),
            )
        )
        if step.turn:
            # the cone starts within half a second
            n = round(0.5 / period)
            t = np.arange(n) * period
            turned = rate * t * t / (2.0 * n * period)
            parts.append(_turning(to, turned, rate * t / (n * period), speed, 0.0, number))
            turning = rate * 0.5 * n * period
        n = round(step.hold / period)
        t = np.arange(n) * period
        parts.append(_turning(to, turning + rate * t, np.full(n, rate), speed, 1.0, number))
        tilt = to * np.exp(1j * (turning + rate * step.hold))
        spin, turning = speed, 0.0
        if step.turn:
            n = round(0.5 / period)
            t = np.arange(n) * period
            turned = rate * (t - t * t / (2.0 * n * period))
            parts.append(_turning(tilt, turned, rate * (1.0 - t / (n * period)), speed, 0.0, number))
            tilt = tilt * np.exp(1j * rate * 0.5 * n * period)
    z, z_rate, w, w_rate, steady, of = (np.concatenate(column) for column in zip(*parts, strict=True))
    return References(z, z_rate, w.real, w_rate.real, steady > 0.5, of.astype(np.int64))


def _turning(
    start: complex, angle: NDArray[Any], rate: NDArray[Any], speed: float, steady: float, number: int
) -> tuple[NDArray[Any], ...]:
    n = len(angle)
    z = start * np.exp(1j * angle)
    return z, 1j * rate * z, np.full(n, speed), np.zeros(n), np.full(n, steady), np.full(n, number)


def _grid(speeds: Sequence[float], tilts: Sequence[complex], rng: np.random.Generator) -> Iterator[Step]:
    for rpm in speeds:
        for index in rng.permutation(len(tilts)):
            yield Step(rpm, tilts[index])


def long_sequence() -> list[Step]:
    """Return two and a half minutes: five speeds with eight tilts each, three cones."""
    rng = np.random.default_rng(11)
    tilts = [0j, 3.2 + 0j, -3.2 + 0j, 3.2j, -3.2j, 2.4 + 2.4j, -1.7 + 1.7j, 1.8 - 1.2j]
    return [
        Step(3500.0, 0j),
        Step(3500.0, 2.5 + 0j),
        *_grid([3500.0, 2200.0, 1300.0, 3000.0, 4000.0], tilts, rng),
        Step(3500.0, 4.4 + 0j, 5.0, 2.0),
        Step(3500.0, 1.6 + 0j, 4.0, -3.0),
        Step(1700.0, 4.4j, 5.0, 2.0),
        Step(3500.0, 2.5 + 0j),
        Step(3500.0, 0j),
    ]


def short_sequence() -> list[Step]:
    """Return a minute: three speeds with five tilts each, a cone."""
    rng = np.random.default_rng(12)
    tilts = [0j, 3.2 + 0j, -2.6 + 1.5j, -3.2j, 1.6 + 1.6j]
    return [
        Step(3500.0, 0j),
        *_grid([3500.0, 1600.0, 2600.0, 4000.0], tilts, rng),
        Step(3500.0, 4.4 + 0j, 4.0, 1.6),
        Step(3500.0, 2.5j),
    ]
