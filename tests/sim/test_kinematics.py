"""Frames, tilt and angular momentum; how good the approximations of eqs (1) and (2) of Huo et al. 2016 are."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.mechanics import derivation as d
from gyrowheel_sim.mechanics import kinematics as k
from gyrowheel_sim.mechanics.dynamics import spin_axis

from .helpers import INERTIAS

ROTOR = INERTIAS[:3]
REVOLUTION = np.arange(720) * (0.5 * DEG)
SPIN = 3500.0 * RPM

ANGLE = st.floats(-1.2, 1.2)
TURN = st.floats(-np.pi, np.pi)
RATE = st.floats(-400.0, 400.0)
close = functools.partial(np.testing.assert_allclose, rtol=0.0)
unhurried = settings(deadline=None)


@unhurried
@given(st.tuples(ANGLE, ANGLE, TURN), st.tuples(RATE, RATE, RATE), st.tuples(RATE, RATE, RATE))
def test_frames_and_rates_are_those_of_the_derivation(angles, rates, body):
    """Eqs (3), (4), (5) and the matrices between the frames, with a case that turns."""
    (x, y, z), (ux, uy, uz) = angles, rates
    derived = derived_kinematics()(angles, rates, body)
    ours = (
        k.case_to_motor(z), k.motor_to_gimbal(x), k.gimbal_to_rotor(y), k.shaft_rate(z, uz, body),
        k.gimbal_rate(x, z, ux, uz, body), k.rotor_rate(x, y, z, ux, uy, uz, body),
    )  # fmt: skip
    for mine, other in zip(ours, derived, strict=True):
        close(mine, np.squeeze(other), atol=1e-12)


@functools.cache
def derived_kinematics() -> Any:
    names = ("case_to_motor", "motor_to_gimbal", "gimbal_to_rotor", "shaft_rate", "gimbal_rate", "rotor_rate")
    equations = d.derive(body_rate=True)
    return sp.lambdify([d.ANGLES, d.RATES, d.BODY_RATE], [getattr(equations, name) for name in names])


#: Angular velocity of the rotor as eq (5) prints it.
PRINTED_ROTOR_RATE = [
    "ux*Cy - uz*Cx*Sy - bz*Cx*Sy + (Cy*Cz - Sx*Sy*Sz)*bx + (Cy*Sz + Sx*Sy*Cz)*by",
    "uz*Sx + uy + bz*Sx - bx*Cx*Sz + by*Cx*Cz",
    "ux*Sy + uz*Cx*Cy + bz*Cx*Cy + (Sy*Cz + Sx*Cy*Sz)*bx + (Sy*Sz - Sx*Cy*Cz)*by",
]


@pytest.mark.parametrize("row", range(3))
def test_printed_rate_of_the_rotor_is_right(row):
    names = dict(zip(("ux", "uy", "uz", "bx", "by", "bz"), (*d.RATES, *d.BODY_RATE), strict=True))
    for letter, angle in zip("xyz", d.ANGLES, strict=True):
        names |= {f"S{letter}": sp.sin(angle), f"C{letter}": sp.cos(angle)}
    printed = sp.sympify(PRINTED_ROTOR_RATE[row], locals=names)
    assert sp.expand(printed - d.derive(body_rate=True).rotor_rate[row]) == 0


@unhurried
@given(st.tuples(ANGLE, ANGLE, TURN), st.tuples(RATE, RATE, RATE))
def test_rate_of_the_rotor_is_the_turning_of_its_frame(angles, rates):
    """The matrix to the rotor frame changes by -[omega x] times itself; differentiated by a complex step."""
    step = 1e-30

    def to_rotor(*at: Any) -> Any:
        (sx, sy, sz), (cx, cy, cz) = np.sin(at), np.cos(at)
        about_z = np.array([[cz, sz, 0], [-sz, cz, 0], [0, 0, 1]])
        about_x = np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
        return np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]]) @ about_x @ about_z

    moved = to_rotor(*(a + 1j * step * u for a, u in zip(angles, rates, strict=True)))
    cross = -(moved.imag / step) @ moved.real.T
    close(k.rotor_rate(*angles, *rates), [cross[2, 1], cross[0, 2], cross[1, 0]], atol=1e-11)


def test_each_angle_turns_about_the_axis_of_its_name():
    """The order in which the paper's text names the axes of theta_x, theta_y, theta_z is another."""
    for matrix, axis in ((k.motor_to_gimbal, 0), (k.gimbal_to_rotor, 1), (k.case_to_motor, 2)):
        turned = matrix(0.3) @ np.eye(3)[axis]
        close(turned, np.eye(3)[axis], atol=1e-16)
        assert abs(matrix(0.3)[axis - 2, axis - 1]) == pytest.approx(np.sin(0.3))


@unhurried
@given(ANGLE, ANGLE, TURN)
def test_tilt_and_joint_angles(theta_x, theta_y, theta_z):
    """Eq (7) as printed is exact, and is inverted; the spin axis is the z axis of the rotor frame."""
    n = k.axis_of_joint(theta_x, theta_y, theta_z)
    to_rotor = k.gimbal_to_rotor(theta_y) @ k.motor_to_gimbal(theta_x) @ k.case_to_motor(theta_z)
    close(n, to_rotor[2], atol=1e-15)
    phi_x, phi_y = k.tilt_of_joint(theta_x, theta_y, theta_z)
    sx, cx, sy, cy = np.sin(theta_x), np.cos(theta_x), np.sin(theta_y), np.cos(theta_y)
    sz, cz = np.sin(theta_z), np.cos(theta_z)
    assert np.tan(phi_x) == pytest.approx((sx * cy * cz - sy * sz) / (cx * cy), rel=1e-12, abs=1e-14)
    assert np.tan(phi_y) == pytest.approx((sx * cy * sz + sy * cz) / (cx * cy), rel=1e-12, abs=1e-14)
    close(k.axis_of_tilt(phi_x, phi_y), n, atol=1e-14)
    z = k.complex_tilt(phi_x, phi_y)
    phi = np.arctan(np.abs(z))
    assert np.cos(phi) == pytest.approx(n[2], abs=1e-14)
    close(k.joint_of_azimuth(phi, np.angle(z) - theta_z), (theta_x, theta_y), atol=1e-13)
    transverse = spin_axis(z, 0j, 0j)[0]
    close([transverse.real, transverse.imag], n[:2], atol=1e-14)


@unhurried
@given(st.floats(0.0, 0.3), TURN)
def test_eq_2_is_exact_for_a_tilt_fixed_in_the_case(phi, alpha):
    """tan(theta_x) = tan(phi) cos(beta), tan(theta_y) = tan(phi) sin(beta) cos(theta_x) with beta = alpha - theta_z."""
    theta_x, theta_y = k.joint_of_azimuth(phi, alpha - REVOLUTION)
    phi_x, phi_y = k.tilt_of_joint(theta_x, theta_y, REVOLUTION)
    close(k.complex_tilt(phi_x, phi_y), np.full(720, np.tan(phi) * np.exp(1j * alpha)), atol=1e-15)


@unhurried
@given(st.floats(0.0, 0.3), TURN)
def test_rates_of_the_flexures_in_a_hold(phi, beta):
    """They are the derivative of eq (2) with beta' = -Omega; the rotor then turns about its own axis alone."""
    step = 1e-6
    after, before = (k.joint_of_azimuth(phi, beta - sign * step) for sign in (1.0, -1.0))
    rates = k.joint_rates_of_hold(phi, beta, SPIN)
    for rate, later, earlier in zip(rates, after, before, strict=True):
        assert rate == pytest.approx((later - earlier) / (2.0 * step) * SPIN, abs=1e-7 * SPIN)
    theta_x, theta_y = k.joint_of_azimuth(phi, beta)
    omega = k.rotor_rate(theta_x, theta_y, 0.0, rates[0], rates[1], SPIN)
    close(omega[:2], 0.0, atol=1e-12 * SPIN)


def largest_error(momentum: Any, reference: Any) -> float:
    """Return the largest error of a momentum over its size."""
    size = np.linalg.norm(reference, axis=-1)
    return float((np.linalg.norm(momentum - reference, axis=-1) / size).max())


def held_revolution(tilt_deg: float) -> tuple[Any, Any]:
    """Return joint angles and rates over a revolution at a held tilt."""
    phi, beta = tilt_deg * DEG, -REVOLUTION
    rates = (*k.joint_rates_of_hold(phi, beta, SPIN), np.full(720, SPIN))
    return (*k.joint_of_azimuth(phi, beta), REVOLUTION), rates


@pytest.mark.parametrize(("tilt_deg", "error"), [(1.0, 1.5e-4), (3.0, 1.4e-3), (5.0, 3.8e-3)])
def test_last_form_of_eq_1(tilt_deg, error):
    """I_rz Omega along the spin axis is right to 1/cos(phi) - 1 in the motor frame, and exact on average."""
    angles, rates = held_revolution(tilt_deg)
    exact = k.rotor_momentum(angles, rates, ROTOR)
    last = k.spin_momentum(angles[0], angles[1], rates[2], ROTOR[2])
    assert largest_error(last, exact) == pytest.approx(error, rel=0.03)
    assert np.abs(np.linalg.norm(exact, axis=-1) / (ROTOR[2] * SPIN) - 1.0).max() == pytest.approx(
        1.0 / np.cos(tilt_deg * DEG) - 1.0, rel=1e-3
    )


@pytest.mark.parametrize(("tilt_deg", "error"), [(1.0, 0.0104), (3.0, 0.0313), (5.0, 0.0524)])
def test_middle_expression_of_eq_1_is_not_the_momentum(tilt_deg, error):
    """The rates of the joint angles are not the angular velocity of the rotor: wrong by I_rx/I_rz tan(phi)."""
    angles, rates = held_revolution(tilt_deg)
    exact = k.rotor_momentum(angles, rates, ROTOR)
    middle = largest_error(k.rotor_momentum_by_joint_rates(angles, rates, ROTOR), exact)
    assert middle == pytest.approx(error, abs=0.5e-4)
    assert middle == pytest.approx(ROTOR[0] / ROTOR[2] * np.tan(tilt_deg * DEG), rel=1e-2)


def test_eq_1_is_written_in_the_motor_frame():
    """Turned into the case frame, the momentum of a held tilt stands still; as printed it turns with the shaft."""
    angles, rates = held_revolution(3.0)
    last = k.spin_momentum(angles[0], angles[1], rates[2], ROTOR[2])
    in_case = np.einsum("nji,nj->ni", k.case_to_motor(REVOLUTION), last)
    close(in_case, np.broadcast_to(in_case[0], in_case.shape), atol=1e-12)
    assert np.ptp(last[:, 0]) == pytest.approx(2.0 * ROTOR[2] * SPIN * np.sin(3.0 * DEG), rel=1e-3)


def test_envelope():
    """A cap of a sphere for each speed, the exact momentum on average over a revolution."""
    speeds, tilts = np.array([3000.0, 3500.0, 4000.0]) * RPM, np.array([0.0, 1.0, 3.0, 5.0]) * DEG
    azimuths = np.arange(8) * 45.0 * DEG
    grid = np.meshgrid(speeds, tilts, azimuths, indexing="ij")
    spin, phi, alpha = grid
    envelope = k.momentum_envelope(spin, phi, alpha, ROTOR[2])
    assert envelope.shape == (3, 4, 8, 3)
    sizes = np.linalg.norm(envelope, axis=-1)
    close(sizes, ROTOR[2] * spin, atol=1e-15)
    close(np.arccos(envelope[..., 2] / sizes), phi, atol=1e-7)
    exact = k.held_momentum(spin[..., None], phi[..., None], alpha[..., None], REVOLUTION, ROTOR)
    assert exact.shape == (3, 4, 8, 720, 3)
    close(exact.mean(axis=-2), envelope, atol=1e-12)
    # at every instant along the spin axis, and as large as the uneven speed behind a universal joint
    along = (exact * envelope[..., None, :]).sum(axis=-1) / sizes[..., None]
    close(along, np.linalg.norm(exact, axis=-1), atol=1e-12)
    ripple = (along.max(axis=-1) / along.min(axis=-1))[..., 0]
    close(ripple, np.broadcast_to(1.0 / np.cos(tilts) ** 2, ripple.shape), atol=1e-5)
    assert sizes.max() == pytest.approx(0.745, abs=0.001)


def test_tilt_along_an_axis_of_the_case():
    """A reading phi_x is a rotation about case x: the axis leans towards -y."""
    close(k.axis_of_tilt(3.0 * DEG, 0.0), [0.0, -np.sin(3.0 * DEG), np.cos(3.0 * DEG)], atol=1e-15)
    close(k.axis_of_tilt(0.0, 3.0 * DEG), [np.sin(3.0 * DEG), 0.0, np.cos(3.0 * DEG)], atol=1e-15)
