"""Inverse dynamics point by point as compiled code: from readings of the tilt to the forces that the motion needs.

As `dynamics.inverse`, for many points at once; compiled and cached by `compiled.compile_kernels`.
"""

from __future__ import annotations

import math
from typing import Any

from gyrowheel_sim.jit import njit
from gyrowheel_sim.mechanics.dynamics import case_to_joint, inertia_terms, moving_case_forces

# --- kernel ---

N_POINT = 14


@njit(cache=True, error_model="numpy")
def inverse_points(
    z: Any, phi_rate: Any, phi_acc: Any, sines: Any, cosines: Any, rate: Any, acceleration: Any,
    turn_x: Any, turn_y: Any, turn_z: Any, turning: bool,
    Irx: float, Iry: float, Irz: float, Igx: float, Igy: float, Igz: float, Imz: float, out: Any,
) -> None:  # fmt: skip
    """Fill `out` (14, n) for complex tilts z and the derivatives of their angles phi_x + i phi_y at n points.

    Rows of `out`: the rate of z (2); spin axis n (3); sine and cosine of theta_x, then of theta_y (4); rates of the two
    joints (2); the generalised forces M q'' - f, with those of a case that turns at (turn_x, turn_y, turn_z) where
    `turning` (3). The loop calls no function of the C library, which compilers cannot run on several points at once.
    """
    for i in range(len(rate)):
        px_rate = phi_rate[i].real
        py_rate = phi_rate[i].imag
        zx = z[i].real
        zy = z[i].imag
        gx = 1.0 + zx * zx
        gy = 1.0 + zy * zy
        zx_rate = gx * px_rate
        zy_rate = gy * py_rate
        zx_acc = gx * (phi_acc[i].real + 2.0 * zx * px_rate * px_rate)
        zy_acc = gy * (phi_acc[i].imag + 2.0 * zy * py_rate * py_rate)
        # spin axis n = (z_y, -z_x, 1) n_z and its derivatives
        nz = 1.0 / math.sqrt(1.0 + zx * zx + zy * zy)
        radial = zx * zx_rate + zy * zy_rate
        nz3 = nz * nz * nz
        nz_rate = -nz3 * radial
        nz_acc = (
            -nz3 * (zx_rate * zx_rate + zy_rate * zy_rate + zx * zx_acc + zy * zy_acc)
            + 3.0 * nz3 * nz * nz * radial * radial
        )
        nx = zy * nz
        ny = -zx * nz
        nx_rate = zy_rate * nz + zy * nz_rate
        ny_rate = -zx_rate * nz - zx * nz_rate
        nx_acc = zy_acc * nz + 2.0 * zy_rate * nz_rate + zy * nz_acc
        ny_acc = -zx_acc * nz - 2.0 * zx_rate * nz_rate - zx * nz_acc
        sz = sines[i]
        cz = cosines[i]
        w = rate[i]
        aw = acceleration[i]
        sx, cx, sy, cy, wx, wy = case_to_joint(nx, ny, nx_rate, ny_rate, sz, cz, w)
        # acceleration of the spin axis in motor axes
        mx = cz * nx + sz * ny
        my = -sz * nx + cz * ny
        ux = nx_rate + w * ny
        uy = ny_rate - w * nx
        mx_rate = cz * ux + sz * uy
        my_rate = -sz * ux + cz * uy
        mx_acc = cz * nx_acc + sz * ny_acc + 2.0 * w * my_rate + aw * my + w * w * mx
        my_acc = -sz * nx_acc + cz * ny_acc - 2.0 * w * mx_rate - aw * mx + w * w * my
        ay = (mx_acc + sy * wy * wy) / cy
        ax = (sx * cy * wx * wx + 2.0 * cx * sy * wx * wy + sx * sy * ay + sx * cy * wy * wy - my_acc) / (
            cx * cy
        )
        m11, m13, m22, m23, m33, f1, f2, f3 = inertia_terms(
            sx, cx, sy, cy, wx, wy, w, Irx, Iry, Irz, Igx, Igy, Igz, Imz
        )
        b1 = m11 * ax + m13 * aw - f1
        b2 = m22 * ay + m23 * aw - f2
        b3 = m13 * ax + m23 * ay + m33 * aw - f3
        if turning:
            e1, e2, e3 = moving_case_forces(
                sx, cx, sy, cy, sz, cz, wx, wy, w, Irx, Iry, Irz, Igx, Igy, Igz, Imz,
                turn_x[i], turn_y[i], turn_z[i], 0.0, 0.0, 0.0,
            )  # fmt: skip
            b1 += e1
            b2 += e2
            b3 += e3
        out[0, i] = zx_rate
        out[1, i] = zy_rate
        out[2, i] = nx
        out[3, i] = ny
        out[4, i] = nz
        out[5, i] = sx
        out[6, i] = cx
        out[7, i] = sy
        out[8, i] = cy
        out[9, i] = wx
        out[10, i] = wy
        out[11, i] = b1
        out[12, i] = b2
        out[13, i] = b3
