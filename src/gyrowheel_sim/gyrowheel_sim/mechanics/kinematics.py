"""Frames, tilt, angular momentum and its envelope: eqs (1) to (5) and (7) of Huo et al. 2016, exact and approximated.

Passive rotations lead from the case to the rotor: case -> motor by Rz(theta_z), the angle of the shaft; motor ->
gimbal by Rx(theta_x), the angle of the inner flexure; gimbal -> rotor by Ry(theta_y), the angle of the outer one. The
tilt sensors are fixed to the case and read phi_x, phi_y. A tilt that is fixed in the case has a magnitude phi and an
azimuth alpha: tan(phi_x) + i tan(phi_y) = tan(phi) exp(i alpha).

All angles in rad and rates in rad/s. Every argument may be an array; the arguments broadcast, and vectors and matrices
lie along the last axes of the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_STILL = (0.0, 0.0, 0.0)


class JointAngles(NamedTuple):
    """Angles of the two flexures [rad]."""

    theta_x: Array
    theta_y: Array


def _matrix(rows: list[list[ArrayLike]]) -> Array:
    flat = np.broadcast_arrays(*(np.asarray(e, dtype=float) for row in rows for e in row))
    return np.stack(flat, axis=-1).reshape(*flat[0].shape, len(rows), len(rows[0]))


def _vector(*components: ArrayLike) -> Array:
    return np.stack(np.broadcast_arrays(*(np.asarray(c, dtype=float) for c in components)), axis=-1)


# --- frames ---


def case_to_motor(theta_z: ArrayLike) -> Array:
    """Return the matrix that turns components in the case frame into the motor frame, shape (..., 3, 3)."""
    s, c = np.sin(theta_z), np.cos(theta_z)
    return _matrix([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def motor_to_gimbal(theta_x: ArrayLike) -> Array:
    """Return the matrix that turns components in the motor frame into the gimbal frame, shape (..., 3, 3)."""
    s, c = np.sin(theta_x), np.cos(theta_x)
    return _matrix([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])


def gimbal_to_rotor(theta_y: ArrayLike) -> Array:
    """Return the matrix that turns components in the gimbal frame into the rotor frame, shape (..., 3, 3)."""
    s, c = np.sin(theta_y), np.cos(theta_y)
    return _matrix([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


# --- tilt ---


def axis_of_joint(theta_x: ArrayLike, theta_y: ArrayLike, theta_z: ArrayLike) -> Array:
    """Return the spin axis of the rotor as a unit vector in the case frame, shape (..., 3)."""
    sx, cx, sy, cy = np.sin(theta_x), np.cos(theta_x), np.sin(theta_y), np.cos(theta_y)
    sz, cz = np.sin(theta_z), np.cos(theta_z)
    return _vector(sx * cy * sz + sy * cz, -sx * cy * cz + sy * sz, cx * cy)


def axis_of_tilt(phi_x: ArrayLike, phi_y: ArrayLike) -> Array:
    """Return the spin axis that belongs to two tilt readings as a unit vector in the case frame, shape (..., 3)."""
    tx, ty = np.tan(phi_x), np.tan(phi_y)
    nz = 1.0 / np.sqrt(1.0 + tx**2 + ty**2)
    return _vector(ty * nz, -tx * nz, nz)


def tilt_of_joint(theta_x: ArrayLike, theta_y: ArrayLike, theta_z: ArrayLike) -> tuple[Array, Array]:
    """Return the tilt readings (phi_x, phi_y) [rad] that belong to joint angles: eq (7), which is exact."""
    n = axis_of_joint(theta_x, theta_y, theta_z)
    return np.arctan2(-n[..., 1], n[..., 2]), np.arctan2(n[..., 0], n[..., 2])


def joint_of_azimuth(phi: ArrayLike, beta: ArrayLike) -> JointAngles:
    """Return the angles of the flexures at a tilt phi in the direction beta of the motor frame: eq (2), exact.

    A tilt that is fixed in the case at azimuth alpha has beta = alpha - theta_z: seen from the shaft it turns
    backwards once a revolution, and both flexures bend to and fro at the spin rate.
    """
    theta_x = np.arctan(np.tan(phi) * np.cos(beta))
    return JointAngles(theta_x, np.arctan(np.tan(phi) * np.sin(beta) * np.cos(theta_x)))


def complex_tilt(phi_x: ArrayLike, phi_y: ArrayLike) -> ComplexArray:
    """Return tan(phi_x) + i tan(phi_y), in which a tilt of any direction is one number."""
    return np.tan(phi_x) + 1j * np.tan(phi_y)


# --- angular velocity ---


def shaft_rate(
    theta_z: ArrayLike, theta_z_rate: ArrayLike, body_rate: tuple[ArrayLike, ArrayLike, ArrayLike] = _STILL
) -> Array:
    """Return the angular velocity of the motor shaft in the motor frame: eq (3), exact; shape (..., 3).

    `body_rate` is the rate of the case in inertial space along the case's axes.
    """
    s, c = np.sin(theta_z), np.cos(theta_z)
    bx, by, bz = (np.asarray(component, dtype=float) for component in body_rate)
    return _vector(bx * c + by * s, -bx * s + by * c, np.asarray(theta_z_rate, dtype=float) + bz)


def gimbal_rate(
    theta_x: ArrayLike,
    theta_z: ArrayLike,
    theta_x_rate: ArrayLike,
    theta_z_rate: ArrayLike,
    body_rate: tuple[ArrayLike, ArrayLike, ArrayLike] = _STILL,
) -> Array:
    """Return the angular velocity of the gimbal in the gimbal frame: eq (4), exact; shape (..., 3)."""
    shaft = shaft_rate(theta_z, theta_z_rate, body_rate)
    return _turn(motor_to_gimbal(theta_x), shaft) + _vector(theta_x_rate, 0.0, 0.0)


def rotor_rate(
    theta_x: ArrayLike,
    theta_y: ArrayLike,
    theta_z: ArrayLike,
    theta_x_rate: ArrayLike,
    theta_y_rate: ArrayLike,
    theta_z_rate: ArrayLike,
    body_rate: tuple[ArrayLike, ArrayLike, ArrayLike] = _STILL,
) -> Array:
    """Return the angular velocity of the rotor in the rotor frame: eq (5), exact; shape (..., 3)."""
    gimbal = gimbal_rate(theta_x, theta_z, theta_x_rate, theta_z_rate, body_rate)
    return _turn(gimbal_to_rotor(theta_y), gimbal) + _vector(0.0, theta_y_rate, 0.0)


def joint_rates_of_hold(phi: ArrayLike, beta: ArrayLike, spin_rate: ArrayLike) -> tuple[Array, Array]:
    """Return the rates of the two flexures [rad/s] while the tilt is fixed in the case: eq (2) differentiated.

    `phi`, `beta`: tilt, and its direction in the motor frame [rad]; `spin_rate`: rate of the shaft [rad/s].
    """
    angles = joint_of_azimuth(phi, beta)
    rate = np.asarray(spin_rate, dtype=float)
    sx, cx = np.sin(angles.theta_x), np.cos(angles.theta_x)
    sy, cy = np.sin(angles.theta_y), np.cos(angles.theta_y)
    # the spin axis (sy, -sx cy, cx cy) in the motor frame turns backwards
    theta_y_rate = -rate * sx
    theta_x_rate = (sx * sy * theta_y_rate + rate * sy) / (cx * cy)
    return theta_x_rate, theta_y_rate


# --- angular momentum ---


def rotor_momentum(
    angles: tuple[ArrayLike, ArrayLike, ArrayLike],
    rates: tuple[ArrayLike, ArrayLike, ArrayLike],
    inertia: tuple[float, float, float],
) -> Array:
    """Return the angular momentum of the rotor in the motor frame [kg m^2/s], exact; shape (..., 3).

    Eq (1) stands for I_r times the rotor's angular velocity, eq (5).

    `angles`, `rates`: (theta_x, theta_y, theta_z) and their rates; `inertia`: (I_rx, I_ry, I_rz) [kg m^2].
    """
    momentum = np.asarray(inertia) * rotor_rate(*angles, *rates)
    return _turn(_motor_of_rotor(angles[0], angles[1]), momentum)


def rotor_momentum_by_joint_rates(
    angles: tuple[ArrayLike, ArrayLike, ArrayLike],
    rates: tuple[ArrayLike, ArrayLike, ArrayLike],
    inertia: tuple[float, float, float],
) -> Array:
    """Return the middle expression of eq (1) [kg m^2/s], which is NOT the momentum of the rotor; shape (..., 3).

    It multiplies the inertias by the rates of the joint angles as if these were the angular velocity of the rotor.
    Takes what `rotor_momentum` takes; it is here so that the two can be compared.
    """
    return _turn(_motor_of_rotor(angles[0], angles[1]), np.asarray(inertia) * _vector(*rates))


def spin_momentum(
    theta_x: ArrayLike, theta_y: ArrayLike, theta_z_rate: ArrayLike, spin_inertia: float
) -> Array:
    """Return the last form of eq (1), I_rz theta_z' along the spin axis, in the motor frame [kg m^2/s]; (..., 3).

    While a tilt is held this is right to 1/cos(phi) - 1 at every instant and exact on average over a revolution.
    """
    sx, cx, sy, cy = np.sin(theta_x), np.cos(theta_x), np.sin(theta_y), np.cos(theta_y)
    axis = _vector(sy, -sx * cy, cx * cy)
    return spin_inertia * np.asarray(theta_z_rate, dtype=float)[..., None] * axis


def held_momentum(
    spin_rate: ArrayLike, phi: ArrayLike, alpha: ArrayLike, theta_z: ArrayLike, inertia: tuple[float, float, float]
) -> Array:  # fmt: skip
    """Return the angular momentum of the rotor in the CASE frame while a tilt is held [kg m^2/s], exact; (..., 3).

    Eqs (1) and (2) without approximation. It keeps the direction of the spin axis; its size ripples twice a revolution,
    because a universal joint passes on a constant speed unevenly.

    Parameters
    ----------
    spin_rate : array_like
        Rate of the shaft, constant [rad/s].
    phi, alpha : array_like
        Tilt and its azimuth in the case [rad].
    theta_z : array_like
        Angle of the shaft [rad].
    inertia : tuple of float
        (I_rx, I_ry, I_rz) [kg m^2].
    """
    beta = np.asarray(alpha, dtype=float) - theta_z
    theta_x, theta_y = joint_of_azimuth(phi, beta)
    rates = (*joint_rates_of_hold(phi, beta, spin_rate), spin_rate)
    return _turn(
        np.swapaxes(case_to_motor(theta_z), -1, -2),
        rotor_momentum((theta_x, theta_y, theta_z), rates, inertia),
    )


def momentum_envelope(spin_rate: ArrayLike, phi: ArrayLike, alpha: ArrayLike, spin_inertia: float) -> Array:
    """Return the angular momentum that the wheel can take in the case frame [kg m^2/s]; shape (..., 3).

    The last form of eq (1) with eq (2), and the mean of `held_momentum` over a revolution: I_rz Omega along the spin
    axis. At one speed and all tilts up to the limit it is a cap of a sphere; over a range of speeds, the body between
    two caps.

    Parameters
    ----------
    spin_rate : array_like
        Rate of the shaft [rad/s].
    phi, alpha : array_like
        Tilt and its azimuth in the case [rad].
    spin_inertia : float
        I_rz [kg m^2].
    """
    z = np.tan(phi) * np.exp(1j * np.asarray(alpha, dtype=float))
    axis = axis_of_tilt(np.arctan(z.real), np.arctan(z.imag))
    return spin_inertia * np.asarray(spin_rate, dtype=float)[..., None] * axis


def _motor_of_rotor(theta_x: ArrayLike, theta_y: ArrayLike) -> Array:
    return np.swapaxes(gimbal_to_rotor(theta_y) @ motor_to_gimbal(theta_x), -1, -2)


def _turn(matrix: Array, vector: Array) -> Array:
    return (matrix @ vector[..., None])[..., 0]


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
    exact = held_momentum(s[..., None], p[..., None], a[..., None], revolution(), inertia)
    size = np.linalg.norm(exact, axis=-1)
    last, middle = largest_errors(tilt, float(speed[0]), inertia)
    return Envelope(
        speed=speed,
        tilt=tilt,
        azimuth=azimuth,
        approximate=momentum_envelope(s, p, a, inertia[2]),
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
    theta_x, theta_y = joint_of_azimuth(phi, beta)
    rates = (*joint_rates_of_hold(phi, beta, speed), np.full(phi.shape, speed))
    angles = (theta_x, theta_y, beta)
    exact = rotor_momentum(angles, rates, inertia)
    size = np.linalg.norm(exact, axis=-1)

    def error(form: Array) -> Array:
        return np.asarray((np.linalg.norm(form - exact, axis=-1) / size).max(axis=-1))

    return (
        error(spin_momentum(theta_x, theta_y, rates[2], inertia[2])),
        error(rotor_momentum_by_joint_rates(angles, rates, inertia)),
    )
