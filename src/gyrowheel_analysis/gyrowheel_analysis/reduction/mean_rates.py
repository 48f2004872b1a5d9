"""Mean rates of a window by modulating functions: of the tilt, and of the spin rate.

A polynomial does not follow how a loop answers the noise of its readings, least of all at the ends of a window, where a
mean rate comes from. Weighted by a function that is zero there, a mean rate follows from the readings inside the window
(Shinbrot, NACA TN 3288, 1954); the torques that the readings show give what it differs by from the plain mean.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, Literal

import numpy as np

from gyrowheel_analysis.reduction.samples import Array
from gyrowheel_analysis.reduction.windows import DEGREE, MODULATION, waves_of
from gyrowheel_sim.bench import Bench

_SAMPLES_OF_TURN = 32  # of a planned window: its noise hardly depends on them
#: The modulating function of the tilt rate, by powers of x. Zero at the ends of a window, it gives any motion that is a
#: cubic in time the mean of a constant weight; of these functions its slope is the least, and with it the noise.
_BUMP = np.array([0.625, 0.0, 3.75, 0.0, -4.375])
_BUMP_SLOPE = np.polynomial.polynomial.polyder(_BUMP)
_BUMP_EXCESS = np.polynomial.polynomial.polysub(_BUMP, [1.0])
#: What a change acts on: a reading, or as a torque on the tilt or on the spin.
Acts = Literal["reading", "tilt", "spin"]
#: Share of the lowest spin rate of a test: a torque moves a rotor that turns more slowly, or backwards, as at this one.
_SLOWEST = 0.01

#: Nodes of a mean over a window, and their weights.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
_WEIGHTS = 0.5 * _WEIGHTS


def tilt_rate_weights(
    x: Array, design: Array, gram: Array, duration: float, late: float, bench: Bench, spin: float
) -> tuple[Any, Any, Array, Array]:
    """Return the weights (n,) of the readings of tilt and coil voltages in the mean tilt rate of a window [rad/s].

    They are followed by those in the swings of both: by what they differ from their plain means, weighted like the
    rate.

    The modulating function is `_BUMP`. The torques of coils and flexures cause what the plain mean differs by; of other
    torques the row of the window has the weighted mean, which equals the plain one for what is a cubic in time.

    Parameters
    ----------
    x : ndarray (n,)
        Times of the samples, -1 .. 1 in the window.
    design : ndarray (n, terms)
        Powers of x and waves that describe the readings; the waves are left out of both means.
    gram : ndarray (terms, terms)
        Inverse of the products of its columns.
    duration : float
        Length of the window [s].
    late : float
        By what the time of a voltage is late, in x.
    bench : Bench
        The bench.
    spin : float
        Mean spin rate [rad/s].
    """
    per_torque = 1j / (bench.precession_inertia * max(spin, _SLOWEST * bench.value("spin_rate_minimum")))
    slope, excess = (_bump_mean(of, x, design, gram) for of in (_BUMP_SLOPE, _BUMP_EXCESS))
    tilt = per_torque * bench.flexure_stiffness * excess - 2.0 / duration * slope
    volts = _bump_mean(_BUMP_EXCESS, x, design, gram, late)
    return tilt, -per_torque * bench.value("coil_constant") * volts, excess, volts


def _bump_mean(weight: Array, x: Array, design: Array, gram: Array, late: float = 0.0) -> Array:
    """Return the weights (n,) of readings in their mean times a polynomial `weight`, without waves."""
    polyval = np.polynomial.polynomial.polyval
    exact = np.zeros(design.shape[1])
    powers = np.vander(_NODES + late, DEGREE + 1, increasing=True)
    exact[: DEGREE + 1] = (_WEIGHTS * polyval(_NODES, weight)) @ powers
    direct = polyval(x - late, weight) / len(x)
    return np.asarray(direct + design @ (gram @ (exact - design.T @ direct)))


def share_of_swing(angle: Array, acts: Acts) -> Array:
    """Return the part of the amplitude of a sine that the averages of a window have.

    `angle` is half of that through which it turns in a window [rad]. Averages of readings are plain means; a torque
    acts in the mean rates.
    """
    weights = _WEIGHTS
    if acts == "tilt":
        weights = weights * np.polynomial.polynomial.polyval(_NODES, _BUMP)
    elif acts == "spin":
        weights = weights * (1.0 + np.cos(math.pi * _NODES))
    return np.asarray(np.cos(np.multiply.outer(angle, _NODES)) @ weights)


@cache
def _bump_noise(turns: int) -> tuple[float, float]:
    """Return the mean squares of the weights of slope and excess (`_bump_mean`) in a window of some revolutions."""
    x = np.linspace(-1.0, 1.0, 2 * _SAMPLES_OF_TURN * turns + 1)[1::2]
    powers = np.vander(x, DEGREE + 1, increasing=True)
    design = np.hstack([powers, waves_of(math.pi * turns * x, powers[:, :MODULATION])])
    gram = np.linalg.inv(design.T @ design)
    rows = (_bump_mean(of, x, design, gram) for of in (_BUMP_SLOPE, _BUMP_EXCESS))
    slope, excess = (float(row @ row) * len(x) for row in rows)
    return slope, excess


def planned_rate_variance(duration: float, samples: float, spin: float, bench: Bench) -> float:
    """Return the variance of the mean tilt rate of a window of a plan, one axis [rad²/s²] (`tilt_rate_weights`).

    `duration` [s] and `samples` are those of the window, `spin` is its spin rate [rad/s].
    """
    slope, excess = _bump_noise(round(duration * spin / (2.0 * math.pi)))
    drive = (
        bench.value("coil_constant") * bench.value("coil_voltage_noise") / (bench.precession_inertia * spin)
    )
    tilt = 2.0 / duration * bench.value("tilt_noise")
    return (slope * tilt**2 + excess * drive**2) / samples


def mean_acceleration(
    series: Array, left: Array, drive: Array, x: Array, duration: float, *, of_speed: bool
) -> tuple[float, float]:
    """Return the mean spin acceleration of a window, and the swing of the motor's part of it [rad/s²].

    The modulating function is 1 + cos(pi x): it begins and ends with zero and without a slope, so that no slope of the
    angle is needed at the ends. The motor causes what the plain mean differs by, its swing: the other torques hardly
    change in a window.

    Parameters
    ----------
    series : ndarray (terms,)
        Legendre series of the speed [rad/s].
    left : ndarray (n,)
        What it leaves at the samples: of the angle [rad], or with `of_speed` of the speed [rad/s].
    drive : ndarray (n,)
        Acceleration that the motor causes at the samples [rad/s²].
    x : ndarray (n,)
        Times of the samples, -1 .. 1 in the window.
    duration : float
        Length of the window [s].
    """
    turn = 2.0 * math.pi / duration
    wave = np.cos(math.pi * x)
    slope = np.sin(math.pi * _NODES) * np.polynomial.legendre.legval(_NODES, series)
    weighted = turn * float(_WEIGHTS @ slope)
    if of_speed:
        weighted += turn * float(np.mean(np.sin(math.pi * x) * left))
    else:
        weighted -= turn**2 * float(np.mean(wave * left))
    swing = float(np.mean(wave * (drive - drive.mean())))
    return weighted - swing, swing


def acceleration_variance(duration: float, samples: float, angle: float, drive: float) -> float:
    """Return the variance of the mean spin acceleration of a window [rad²/s⁴] (`mean_acceleration`).

    `angle` and `drive` are the deviations of white noise in a sample of the angle [rad], and of the acceleration that
    the motor causes [rad/s²]; the `duration` of the window is in s.
    """
    return ((2.0 * math.pi / duration) ** 4 * angle**2 + drive**2) / (2.0 * samples)
