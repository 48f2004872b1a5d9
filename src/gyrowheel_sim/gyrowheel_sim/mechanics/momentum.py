"""Momentum envelope of a wheel: eqs (1) and (2) of Huo et al. 2016 over speeds, tilts and azimuths.

It contains the exact momentum of the rotor and the approximations of the paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrowheel_sim.bench import Bench
from gyrowheel_sim.mechanics import kinematics as k

Array = NDArray[np.float64]

_TILTS = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)  # fifths of the limit
_AZIMUTHS = 12
_PHASES = 72  # of a revolution


@dataclass(frozen=True)
class Envelope:
    """The momentum of the rotor over speeds, tilts and azimuths, exact and as approximated."""

    #: Spin rates [rad/s], tilts and their azimuths in the case [rad].
    speed: Array
    tilt: Array
    azimuth: Array
    approximate: Array  # last form of eq (1) with eq (2), in case axes [kg m^2/s]
    exact_mean: Array  # exact momentum in case axes, averaged over a revolution of the shaft [kg m^2/s]
    #: Magnitude of the exact momentum within a revolution [kg m^2/s].
    smallest: Array
    largest: Array
    #: Largest error within a revolution of the last form of eq (1) and of its middle expression, over the
    #: exact momentum, in the motor frame where they are written.
    error_last: Array
    error_middle: Array
    bench: Bench

    @property
    def along(self) -> tuple[float, float]:
        """Least and most momentum along the case axis [N m s]."""
        along = self.approximate[..., 2]
        return float(along.min()), float(along.max())

    @property
    def across(self) -> float:
        """Most momentum across the case axis [N m s], the same in every direction."""
        return float(np.linalg.norm(self.approximate[..., :2], axis=-1).max())


def speeds_of(bench: Bench) -> Array:
    """Return the speeds of Fig. 3 on a bench [rad/s]: the reference speed, the highest, and one as far below.

    The lowest is never below the lowest speed of the bench.
    """
    reference, high = bench.value("spin_rate_reference"), bench.value("spin_rate_maximum")
    return np.array([max(2.0 * reference - high, bench.value("spin_rate_minimum")), reference, high])


def envelope(bench: Bench, speeds: Sequence[float] | Array | None = None) -> Envelope:
    """Return the momentum envelope of a bench.

    Parameters
    ----------
    bench : Bench
        Gives inertias, speeds and the largest tilt.
    speeds : sequence of float, optional
        Spin rates [rad/s]; those of Fig. 3 if not given, see `speeds_of`.
    """
    speed = np.asarray(speeds_of(bench) if speeds is None else speeds, dtype=float)
    tilt = np.array(_TILTS) / _TILTS[-1] * bench.value("tilt_limit")
    azimuth = np.linspace(0.0, 2.0 * np.pi, _AZIMUTHS, endpoint=False)
    inertia = rotor_inertias(bench)
    s, p, a = np.meshgrid(speed, tilt, azimuth, indexing="ij")
    exact = k.held_momentum(s[..., None], p[..., None], a[..., None], revolution(), inertia)
    size = np.linalg.norm(exact, axis=-1)
    last, middle = largest_errors(tilt, float(speed[0]), inertia)
    return Envelope(
        speed=speed,
        tilt=tilt,
        azimuth=azimuth,
        approximate=k.momentum_envelope(s, p, a, inertia[2]),
        exact_mean=exact.mean(axis=-2),
        smallest=size.min(axis=-1),
        largest=size.max(axis=-1),
        error_last=last,
        error_middle=middle,
        bench=bench,
    )


def rotor_inertias(bench: Bench) -> tuple[float, float, float]:
    """Return the principal moments of inertia of the rotor of a bench [kg m^2]."""
    x, y, z = (bench.value(f"rotor_inertia_{axis}") for axis in "xyz")
    return x, y, z


def revolution() -> Array:
    """Return the angles of the shaft over which a revolution is sampled [rad]."""
    return np.linspace(0.0, 2.0 * np.pi, _PHASES, endpoint=False)


def largest_errors(tilt: Array, speed: float, inertia: tuple[float, float, float]) -> tuple[Array, Array]:
    """Return the largest relative errors of the last form and of the middle expression of eq (1) at each tilt.

    Parameters
    ----------
    tilt : ndarray (t,)
        Tilts [rad].
    speed : float
        Spin rate [rad/s].
    inertia : tuple of float
        See `rotor_inertias`.
    """
    phi, beta = np.broadcast_arrays(tilt[:, None], revolution())
    theta_x, theta_y = k.joint_of_azimuth(phi, beta)
    rates = (*k.joint_rates_of_hold(phi, beta, speed), np.full(phi.shape, speed))
    angles = (theta_x, theta_y, beta)
    exact = k.rotor_momentum(angles, rates, inertia)
    size = np.linalg.norm(exact, axis=-1)

    def error(form: Array) -> Array:
        return np.asarray((np.linalg.norm(form - exact, axis=-1) / size).max(axis=-1))

    return (
        error(k.spin_momentum(theta_x, theta_y, rates[2], inertia[2])),
        error(k.rotor_momentum_by_joint_rates(angles, rates, inertia)),
    )
