"""The states of an effect along the motion of a recording, as compiled code; `balance.history` runs it.

The text below the kernel line is compiled once for all effects. It calls the rates and start values of the states of
one, which are generated and compiled apart, by their addresses.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gyrowheel_sim.effects.law_code import Instant
from gyrowheel_sim.jit import call_laws, njit
from gyrowheel_sim.mechanics.dynamics import case_to_joint

# --- kernel ---

_PLACE = Instant._fields.index
#: Where the columns of a course, its slow quantities and the flexures are among the quantities of a law.
_MOTION = tuple(map(_PLACE, ("zx", "zy", "zx_rate", "zy_rate", "theta_z", "Omega")))
_SLOW = tuple(map(_PLACE, ("T_coil", "T_air", "T_winding", "T_motor", "rho", "i_motor", "Vx", "Vy"))) + tuple(
    map(_PLACE, ("up", "up_x", "up_y", "home_xx", "home_xy", "home_yx", "home_yy"))
)
_FLEXURES = tuple(map(_PLACE, ("theta_x", "theta_y", "theta_x_rate", "theta_y_rate")))
_TIME, _COUNT = _PLACE("t"), len(Instant._fields)


@njit(cache=True, error_model="numpy")
def set_instant(q: Any, course: Any, slow: Any, k: int, per_row: int, time: float, joint: bool) -> None:
    """Write the quantities of the laws at point k of a course into `q`, which has those of two points before."""
    for i in range(6):
        q[_MOTION[i]] = course[k, i]
    q[_TIME] = time
    if k % per_row < 2:
        for i in range(15):
            q[_SLOW[i]] = slow[k // per_row, i]
    if joint:
        zx, zy, zx_rate, zy_rate = q[_MOTION[0]], q[_MOTION[1]], q[_MOTION[2]], q[_MOTION[3]]
        nz = 1.0 / math.sqrt(1.0 + zx * zx + zy * zy)
        nz_rate = -nz * nz * nz * (zx * zx_rate + zy * zy_rate)
        angle, Omega = q[_MOTION[4]], q[_MOTION[5]]
        sx, _, sy, _, wx, wy = case_to_joint(
            zy * nz, -zx * nz, zy_rate * nz + zy * nz_rate, -zx_rate * nz - zx * nz_rate,
            math.sin(angle), math.cos(angle), Omega,
        )  # fmt: skip
        q[_FLEXURES[0]], q[_FLEXURES[1]] = math.asin(sx), math.asin(sy)
        q[_FLEXURES[2]], q[_FLEXURES[3]] = wx, wy


@njit(cache=True, error_model="numpy")
def states_along(
    rates: int, starts: int, coef: Any, active: Any, state: Any, joint: bool,
    course: Any, slow: Any, per_row: int, start: float, h: float, parts: int, out: Any,
) -> None:  # fmt: skip
    """Fill `out` (n, states) with the states at the points of a course, `h` apart, each step in some equal `parts`.

    Each part takes the mean of the rates at its ends (Heun). `rates` and `starts` are the addresses of functions that
    write into `state`; `joint` is whether they need the angles of the flexures.
    """
    step, n = h / parts, out.shape[1]
    at, ahead = np.zeros(_COUNT), np.zeros(_COUNT)
    before = np.zeros(n)
    for k in range(-1, len(course) - 1):
        set_instant(ahead, course, slow, k + 1, per_row, start + (k + 1) * h, joint)
        if k < 0:
            call_laws(starts, coef, active, state, ahead, ())
        else:
            for part in range(parts):
                call_laws(rates, coef, active, state, at if 2 * part < parts else ahead, ())
                for i in range(n):
                    before[i] = state[i] + 0.5 * step * state[i + n]
                    state[i] += step * state[i + n]
                call_laws(rates, coef, active, state, at if 2 * (part + 1) < parts else ahead, ())
                for i in range(n):
                    state[i] = before[i] + 0.5 * step * state[i + n]
        for i in range(n):
            out[k + 1, i] = state[i]
        at, ahead = ahead, at
