"""The states of an effect along the motion of a recording, as compiled code; `balance.history` runs it.

The text below the kernel line is compiled together with the generated rates of the states, as in the plant.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from gyrowheel_sim.effects.law_code import Instant
from gyrowheel_sim.jit import njit
from gyrowheel_sim.mechanics.dynamics import case_to_joint

if TYPE_CHECKING:
    from gyrowheel_sim.effects.generated import flexures_remember, law_rates, law_starts, law_states

# --- kernel ---

#: The one effect is active. Known when it is compiled: to ask at every point would take three times as long.
_ACTIVE = (True,)


@njit(cache=True, error_model="numpy")
def instant_of_course(course: Any, slow: Any, k: int, row: int, start: float, h: float, joint: bool) -> Any:
    """Return the quantities of the laws at point k of a course, whose slow quantities are in `row` of `slow`."""
    zx, zy = float(course[k, 0]), float(course[k, 1])
    zx_rate, zy_rate = float(course[k, 2]), float(course[k, 3])
    angle, Omega = float(course[k, 4]), float(course[k, 5])
    theta_x = theta_y = wx = wy = 0.0
    if joint:
        nz = 1.0 / math.sqrt(1.0 + zx * zx + zy * zy)
        nz_rate = -nz * nz * nz * (zx * zx_rate + zy * zy_rate)
        sx, _, sy, _, wx, wy = case_to_joint(
            zy * nz, -zx * nz, zy_rate * nz + zy * nz_rate, -zx_rate * nz - zx * nz_rate,
            math.sin(angle), math.cos(angle), Omega,
        )  # fmt: skip
        theta_x, theta_y = math.asin(sx), math.asin(sy)
    v = slow[row]
    return Instant(
        zx=zx, zy=zy, zx_rate=zx_rate, zy_rate=zy_rate, theta_z=angle, Omega=Omega,
        theta_x=theta_x, theta_y=theta_y, theta_x_rate=wx, theta_y_rate=wy,
        T_coil=v[0], T_air=v[1], T_winding=v[2], T_motor=v[3], rho=v[4], i_motor=v[5], Vx=v[6], Vy=v[7],
        t=start + k * h, up=v[8], up_x=v[9], up_y=v[10],
        home_xx=v[11], home_xy=v[12], home_yx=v[13], home_yy=v[14],
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def states_along(
    coef: Any, state: Any, course: Any, slow: Any, per_row: int, start: float, h: float, parts: int, out: Any
) -> None:  # fmt: skip
    """Fill `out` (n, states) with the states at the points of a course, `h` apart, each step in some equal `parts`.

    Each part takes the mean of the rates at its ends (Heun).
    """
    joint = flexures_remember(_ACTIVE)
    step, n = h / parts, law_states(state)
    at = instant_of_course(course, slow, 0, 0, start, h, joint)
    law_starts(coef, _ACTIVE, state, at)
    before = state.copy()
    for k in range(len(course)):
        for i in range(n):
            out[k, i] = state[i]
        if k + 1 == len(course):
            break
        ahead = instant_of_course(course, slow, k + 1, (k + 1) // per_row, start, h, joint)
        for part in range(parts):
            first = at if 2 * part < parts else ahead
            last = at if 2 * (part + 1) < parts else ahead
            law_rates(coef, _ACTIVE, state, first)
            for i in range(n):
                before[i] = state[i] + 0.5 * step * state[i + n]
                state[i] += step * state[i + n]
            law_rates(coef, _ACTIVE, state, last)
            for i in range(n):
                state[i] = before[i] + 0.5 * step * state[i + n]
        at = ahead
