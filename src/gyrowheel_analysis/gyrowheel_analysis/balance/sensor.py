"""What effects add to the tilt readings along the measured motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gyrowheel_analysis.balance.laws import AT_REST, NO_JOINT, READING, ActiveEffect, laws_on
from gyrowheel_analysis.balance.motion import Motion
from gyrowheel_sim.effects.law_code import array_law
from gyrowheel_sim.effects.quantities import Omega, t, theta_z, z, z_rate

#: Step of the derivatives of a reading's error [rad of the spin angle], and the five-point formulas for them.
_STENCIL = 0.05
_FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
_SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0
_REPETITIONS = 3
#: Quantities that change within a revolution.
_MOVING = frozenset((z, z_rate, theta_z, Omega, t))


def tilt_reading_error(
    effects: Sequence[ActiveEffect],
    q: Mapping[str, Any],
    phi: Any,
    tilt_rate: Any,
    tilt_acc: Any,
    acceleration: Any,
    motion: Motion,
) -> tuple[Any, Any, Any]:
    """Return what the effects add to the tilt readings, and its first and second derivative.

    The laws see the true tilt, which is the reading less what they add: found by repetition. The derivatives are
    taken along the motion, with what changes slowly held.

    Parameters
    ----------
    effects : sequence of ActiveEffect
        The effects.
    q : mapping
        What the laws know but for the tilt.
    phi : complex ndarray
        Tilt angles of the readings with the bench's own zero and scale taken out [rad].
    tilt_rate, tilt_acc, acceleration : ndarray
        Derivatives of the readings [rad/s], [rad/s²]; spin acceleration [rad/s²].
    motion : Motion
        The measured motion.
    """
    error: Any = 0.0j
    first: Any = 0.0j
    second: Any = 0.0j
    for active, index, law in laws_on(effects, READING):
        function = array_law(active.effect, index)
        fixed = {**q, **active.values, **NO_JOINT}
        moving = law.expression.free_symbols & _MOVING
        if not moving:
            error = error + function({**fixed, **AT_REST})
            continue
        step = _STENCIL / q["Omega"]
        own: Any = 0.0j
        rate: Any = 0.0j
        acc: Any = 0.0j
        for _ in range(_REPETITIONS if {z, z_rate} & moving else 1):
            samples = []
            for k in (-2, -1, 0, 1, 2):
                h = k * step
                at = phi - own + h * (tilt_rate - rate) + 0.5 * h**2 * (tilt_acc - acc)
                there = {
                    **fixed,
                    "z": np.tan(at.real) + 1j * np.tan(at.imag),
                    "z_rate": tilt_rate - rate + h * (tilt_acc - acc),
                    "theta_z": motion.angle + k * _STENCIL + 0.5 * h**2 * acceleration,
                    "t": fixed["t"] + h,
                }
                samples.append(np.broadcast_to(function(there), motion.shape))
            stack = np.array(samples)
            own = stack[2]
            rate = np.tensordot(_FIRST, stack, 1) / step
            acc = np.tensordot(_SECOND, stack, 1) / step**2
        error, first, second = error + own, first + rate, second + acc
    return error, first, second
