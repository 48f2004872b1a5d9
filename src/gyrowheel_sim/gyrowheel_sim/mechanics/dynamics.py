"""Equations of motion of the flex-gimbal rotor, in joint angles and in the case frame.

Joint angles are (theta_x, theta_y, theta_z): case -> motor by Rz(theta_z), motor -> gimbal by Rx(theta_x),
gimbal -> rotor by Ry(theta_y). `inertia_terms` is eq (6) of Huo et al. 2016 with Appendices A and B (every inertial
term of which agrees with the Lagrange derivation; its potential energy lacks the factor 1/2, which is corrected here).

The bench is integrated and analysed in the case frame: at a constant tilt the joint angles swing at the spin rate,
while the components (n_x, n_y) of the spin axis along the case axes are constant, so one step per sample suffices.
All functions take scalars inside compiled code and arrays of any equal shape outside it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from gyrowheel_sim.jit import register_jitable

# --- kernel ---


@register_jitable
def case_to_joint(nx: Any, ny: Any, nx_rate: Any, ny_rate: Any, sz: Any, cz: Any, Omega: Any) -> Any:
    """Return (sx, cx, sy, cy, theta_x_rate, theta_y_rate) from the spin axis in the case frame.

    `sz`, `cz` are sine and cosine of theta_z. With m the spin axis in motor axes, m = (Sy, -Sx Cy, Cx Cy).
    """
    mx = cz * nx + sz * ny
    my = -sz * nx + cz * ny
    mx_rate = cz * nx_rate + sz * ny_rate + Omega * my
    my_rate = -sz * nx_rate + cz * ny_rate - Omega * mx
    sy = mx
    cy = (1.0 - mx * mx) ** 0.5
    sx = -my / cy
    cx = (1.0 - sx * sx) ** 0.5
    theta_y_rate = mx_rate / cy
    theta_x_rate = (sx * sy * theta_y_rate - my_rate) / (cx * cy)
    return sx, cx, sy, cy, theta_x_rate, theta_y_rate


@register_jitable
def case_accelerations(
    sx: Any, cx: Any, sy: Any, cy: Any, wx: Any, wy: Any, sz: Any, cz: Any, Omega: Any, ax: Any, ay: Any, az: Any,
) -> Any:  # fmt: skip
    """Return (n_x'', n_y'') in the case frame from joint rates (wx, wy, Omega) and accelerations (ax, ay, az)."""
    mx = sy
    my = -sx * cy
    mx_rate = cy * wy
    my_rate = -cx * cy * wx + sx * sy * wy
    mx_acc = cy * ay - sy * wy * wy
    my_acc = -cx * cy * ax + sx * cy * wx * wx + 2.0 * cx * sy * wx * wy + sx * sy * ay + sx * cy * wy * wy
    # acceleration of a vector seen from the turning motor frame, in motor axes
    bx = mx_acc - 2.0 * Omega * my_rate - az * my - Omega * Omega * mx
    by = my_acc + 2.0 * Omega * mx_rate + az * mx - Omega * Omega * my
    return cz * bx - sz * by, sz * bx + cz * by


@register_jitable
def inertia_terms(
    sx: Any, cx: Any, sy: Any, cy: Any, wx: Any, wy: Any, wz: Any,
    Irx: Any, Iry: Any, Irz: Any, Igx: Any, Igy: Any, Igz: Any, Imz: Any,
) -> Any:  # fmt: skip
    """Return the mass matrix (m11, m13, m22, m23, m33) and the velocity terms (f1, f2, f3) of eq (6).

    The equations of motion are M q'' = Q + f, with Q every generalised force. Source: Huo et al. 2016, eq (6),
    Appendix A (I_m1..I_m3) and Appendix B (F_nl).
    """
    d = Irz - Irx
    s2y = 2.0 * sy * cy
    c2y = cy * cy - sy * sy
    s2x = 2.0 * sx * cx
    m11 = Igx + Irx * cy * cy + Irz * sy * sy
    m13 = 0.5 * d * cx * s2y
    m22 = Iry
    m23 = Iry * sx
    m33 = Imz + (Irx * sy * sy + Irz * cy * cy + Igz) * cx * cx + (Iry + Igy) * sx * sx
    e = Igz - Igy - Iry + Irx * sy * sy + Irz * cy * cy
    f1 = -(d * c2y - Iry) * cx * wz * wy - e * 0.5 * s2x * wz * wz - d * s2y * wx * wy
    f2 = d * 0.5 * s2y * wx * wx + (d * c2y - Iry) * cx * wz * wx - d * cx * cx * 0.5 * s2y * wz * wz
    f3 = (
        e * s2x * wx * wz
        - (d * c2y + Iry) * cx * wx * wy
        + d * sx * sy * cy * wx * wx
        + d * cx * cx * s2y * wy * wz
    )
    return m11, m13, m22, m23, m33, f1, f2, f3


@register_jitable
def joint_accelerations(m11: Any, m13: Any, m22: Any, m23: Any, m33: Any, b1: Any, b2: Any, b3: Any) -> Any:
    """Solve M a = b for the mass matrix of eq (6) (its element 12 is zero)."""
    # eliminate the first two unknowns: a1 = (b1 - m13 a3) / m11, a2 = (b2 - m23 a3) / m22
    a3 = (b3 - m13 * b1 / m11 - m23 * b2 / m22) / (m33 - m13 * m13 / m11 - m23 * m23 / m22)
    return (b1 - m13 * a3) / m11, (b2 - m23 * a3) / m22, a3


@register_jitable
def generalised_forces(sx: Any, cx: Any, sz: Any, cz: Any, Tx: Any, Ty: Any, Tz: Any) -> Any:
    """Return (Q_x, Q_y, Q_z) of a torque on the rotor given in CASE axes, by virtual work (eq (8) with a z part)."""
    tx = cz * Tx + sz * Ty
    ty = -sz * Tx + cz * Ty
    return tx, cx * ty + sx * Tz, Tz


@register_jitable
def moving_case_forces(
    sx: Any, cx: Any, sy: Any, cy: Any, sz: Any, cz: Any, wx: Any, wy: Any, wz: Any,
    Irx: Any, Iry: Any, Irz: Any, Igx: Any, Igy: Any, Igz: Any, Imz: Any,
    bx: Any, by: Any, bz: Any, bx_rate: Any, by_rate: Any, bz_rate: Any,
) -> Any:  # fmt: skip
    """Return the generalised forces that the motion needs beyond eq (6) because the case itself turns.

    M q'' + e = Q + f, with e what is returned. (bx, by, bz) is the rate of the case in inertial space along the case's
    axes, (bx_rate, ..) its derivative. Exact: for gimbal and rotor, with b the rate of the case in the body's axes and
    w the body's rate relative to the case, e = J^T [I (b' - w x b) + b x I w + w x I b + b x I b]; of the round shaft
    only the acceleration about its axis remains. Source: Newton-Euler; agrees with `derivation.derive`.
    """
    # rate and acceleration of the case in motor axes, then gimbal axes, then rotor axes
    mx = cz * bx + sz * by
    my = -sz * bx + cz * by
    mx_rate = cz * bx_rate + sz * by_rate
    my_rate = -sz * bx_rate + cz * by_rate
    gy = cx * my + sx * bz
    gz = -sx * my + cx * bz
    gy_rate = cx * my_rate + sx * bz_rate
    gz_rate = -sx * my_rate + cx * bz_rate
    rx = cy * mx - sy * gz
    rz = sy * mx + cy * gz
    rx_rate = cy * mx_rate - sy * gz_rate
    rz_rate = sy * mx_rate + cy * gz_rate
    # gimbal
    ux = wx
    uy = sx * wz
    uz = cx * wz
    px = Igx * ux
    py = Igy * uy
    pz = Igz * uz
    qx = Igx * mx
    qy = Igy * gy
    qz = Igz * gz
    nx = Igx * (mx_rate - (uy * gz - uz * gy)) + gy * (pz + qz) - gz * (py + qy) + uy * qz - uz * qy
    ny = Igy * (gy_rate - (uz * mx - ux * gz)) + gz * (px + qx) - mx * (pz + qz) + uz * qx - ux * qz
    nz = Igz * (gz_rate - (ux * gy - uy * mx)) + mx * (py + qy) - gy * (px + qx) + ux * qy - uy * qx
    e1 = nx
    e3 = sx * ny + cx * nz + Imz * bz_rate
    # rotor
    ux = cy * wx - cx * sy * wz
    uy = wy + sx * wz
    uz = sy * wx + cx * cy * wz
    px = Irx * ux
    py = Iry * uy
    pz = Irz * uz
    qx = Irx * rx
    qy = Iry * gy
    qz = Irz * rz
    nx = Irx * (rx_rate - (uy * rz - uz * gy)) + gy * (pz + qz) - rz * (py + qy) + uy * qz - uz * qy
    ny = Iry * (gy_rate - (uz * rx - ux * rz)) + rz * (px + qx) - rx * (pz + qz) + uz * qx - ux * qz
    nz = Irz * (rz_rate - (ux * gy - uy * rx)) + rx * (py + qy) - gy * (px + qx) + ux * qy - uy * qx
    return e1 + cy * nx + sy * nz, ny, e3 - cx * sy * nx + sx * ny + cx * cy * nz


# --- end of kernel ---


class Spin(NamedTuple):
    """Motion of the rotor at an instant (arrays of one shape).

    Attributes
    ----------
    z, z_rate, z_acc : complex ndarray
        Complex tilt tan(phi_x) + i tan(phi_y) [1] and its derivatives [1/s, 1/s^2].
    angle, rate, acceleration : ndarray
        Shaft angle theta_z [rad], spin rate [rad/s] and its derivative [rad/s^2].
    """

    z: Any
    z_rate: Any
    z_acc: Any
    angle: Any
    rate: Any
    acceleration: Any


class Joint(NamedTuple):
    """Joint angles and rates that belong to a `Spin`, and the inertial generalised forces that its motion needs."""

    sx: Any
    cx: Any
    sz: Any
    cz: Any
    theta_x: Any
    theta_y: Any
    theta_x_rate: Any
    theta_y_rate: Any
    inertial: tuple[Any, Any, Any]


def spin_axis(z: Any, z_rate: Any, z_acc: Any) -> tuple[Any, Any, Any, Any]:
    """Return the transverse part n_x + i n_y of the spin axis with its two derivatives, and n_z.

    n = (tan phi_y, -tan phi_x, 1) n_z, n_z = 1/sqrt(1 + |z|^2), hence n_x + i n_y = -i z n_z.
    """
    nz = 1.0 / np.sqrt(1.0 + np.abs(z) ** 2)
    radial = (np.conj(z) * z_rate).real
    nz_rate = -(nz**3) * radial
    nz_acc = -(nz**3) * (np.abs(z_rate) ** 2 + (np.conj(z) * z_acc).real) + 3.0 * nz**5 * radial**2
    n = -1j * z * nz
    n_rate = -1j * (z_rate * nz + z * nz_rate)
    n_acc = -1j * (z_acc * nz + 2.0 * z_rate * nz_rate + z * nz_acc)
    return n, n_rate, n_acc, nz


def inverse(
    motion: Spin,
    inertias: tuple[Any, Any, Any, Any, Any, Any, Any],
    case_rate: tuple[Any, Any, Any] | None = None,
) -> Joint:
    """Return joint angles, rates and the generalised forces M q'' - f that a given motion needs.

    Parameters
    ----------
    motion : Spin
        The motion, arrays of one shape.
    inertias : tuple
        (Irx, Iry, Irz, Igx, Igy, Igz, Imz) [kg m^2].
    case_rate : tuple, optional
        Steady rate of the case in inertial space along the case's axes [rad/s]; zero if not given.
    """
    n, n_rate, n_acc, _ = spin_axis(motion.z, motion.z_rate, motion.z_acc)
    sz, cz = np.sin(motion.angle), np.cos(motion.angle)
    sx, cx, sy, cy, wx, wy = case_to_joint(n.real, n.imag, n_rate.real, n_rate.imag, sz, cz, motion.rate)
    # acceleration of the spin axis in the motor frame, in motor axes
    turn = np.exp(-1j * motion.angle)
    m, m_rate = turn * n, turn * (n_rate - 1j * motion.rate * n)
    m_acc = turn * n_acc - 2j * motion.rate * m_rate - 1j * motion.acceleration * m + motion.rate**2 * m
    ay = (m_acc.real + sy * wy * wy) / cy
    ax = (sx * cy * wx * wx + 2.0 * cx * sy * wx * wy + sx * sy * ay + sx * cy * wy * wy - m_acc.imag) / (
        cx * cy
    )
    az = motion.acceleration
    m11, m13, m22, m23, m33, f1, f2, f3 = inertia_terms(sx, cx, sy, cy, wx, wy, motion.rate, *inertias)
    inertial = (m11 * ax + m13 * az - f1, m22 * ay + m23 * az - f2, m13 * ax + m23 * ay + m33 * az - f3)
    if case_rate is not None:
        more = moving_case_forces(
            sx, cx, sy, cy, sz, cz, wx, wy, motion.rate, *inertias, *case_rate, 0.0, 0.0, 0.0
        )
        inertial = (inertial[0] + more[0], inertial[1] + more[1], inertial[2] + more[2])
    return Joint(sx, cx, sz, cz, np.arctan2(sx, cx), np.arctan2(sy, cy), wx, wy, inertial)
