"""The momentum that a wheel can take: eqs (1) and (2) of Huo et al. 2016 over speeds, tilts and azimuths.

The exact momentum of the rotor stands beside the approximations of the paper.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

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
    """The momentum of the rotor over speeds, tilts and azimuths, exact and as approximated.

    Attributes
    ----------
    speed, tilt, azimuth : ndarray (s,), (t,), (a,)
        Spin rates [rad/s], tilts and their azimuths in the case [rad].
    approximate : ndarray (s, t, a, 3)
        Last form of eq (1) with eq (2), in case axes [kg m^2/s].
    exact_mean : ndarray (s, t, a, 3)
        Exact momentum in case axes, averaged over a revolution of the shaft [kg m^2/s].
    smallest, largest : ndarray (s, t, a)
        Magnitude of the exact momentum within a revolution [kg m^2/s].
    error_last, error_middle : ndarray (t,)
        Largest error within a revolution of the last form of eq (1) and of its middle expression, over the exact
        momentum, in the motor frame where they are written.
    """

    speed: Array
    tilt: Array
    azimuth: Array
    approximate: Array
    exact_mean: Array
    smallest: Array
    largest: Array
    error_last: Array
    error_middle: Array

    def to_json(self) -> dict[str, Any]:
        """Return what the pictures show as a JSON object, to five digits, for the first azimuth: all are alike."""

        def numbers(values: Any) -> Any:
            if np.ndim(values):
                return [numbers(value) for value in values]
            return 0.0 if abs(values) < 1e-12 else float(f"{values:.5g}")

        return {
            "speed_rad_s": numbers(self.speed),
            "tilt_rad": numbers(self.tilt),
            "along_axis": numbers(self.approximate[:, :, 0, 2]),
            "across_axis": numbers(np.hypot(self.approximate[:, :, 0, 0], self.approximate[:, :, 0, 1])),
            "smallest": numbers(self.smallest[:, :, 0]),
            "largest": numbers(self.largest[:, :, 0]),
            "error_last": numbers(self.error_last),
            "error_middle": numbers(self.error_middle),
        }

    def to_csv(self) -> str:
        """Return all of it as a table, one state a line, SI units."""
        head = "spin_rate,tilt,azimuth,h_x,h_y,h_z,exact_mean_x,exact_mean_y,exact_mean_z,exact_smallest,exact_largest"
        lines = [head]
        shape = self.smallest.shape
        for s, t, a in itertools.product(*map(range, shape)):
            if self.tilt[t] == 0.0 and a:
                continue  # all azimuths are one
            values = (
                self.speed[s], self.tilt[t], self.azimuth[a], *self.approximate[s, t, a], *self.exact_mean[s, t, a],
                self.smallest[s, t, a], self.largest[s, t, a],
            )  # fmt: skip
            lines.append(",".join(f"{0.0 if abs(v) < 1e-12 else v:.6g}" for v in values))
        return "\n".join(lines) + "\n"


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
