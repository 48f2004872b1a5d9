"""The laws of the effects, evaluated at the instants of the windows and summed target by target.

The action of each target on the equations is declared once, in `gyrowheel_sim.effects.targets`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gyrowheel_sim.effects.declaration import Effect, Law
from gyrowheel_sim.effects.law_code import array_law
from gyrowheel_sim.effects.quantities import T_motor, T_winding
from gyrowheel_sim.effects.targets import (
    INERTIAS,
    INSTRUMENT_PARAMETERS,
    TARGETS,
    TORQUE_PARAMETERS,
    TORQUE_PLACES,
)
from gyrowheel_sim.mechanics.dynamics import Joint

#: Sum of the laws of every target that has one; of a target with a law for each flexure, a pair.
Laws = Mapping[str, Any]

#: Angles of a flexure for laws that do not act on one.
NO_JOINT = {"theta": 0.0, "theta_rate": 0.0, "axis": 1.0}
#: Substitutes of the motion in laws that must not depend on it.
AT_REST = {"z": 0.0j, "z_rate": 0.0j}

#: Targets that change the tilt readings, and those that the inverse dynamics needs; all others are evaluated after it,
#: with the motion known.
READING = frozenset(
    t.name for t in TARGETS.values() for e in t.enters if (e.place, e.of) == ("reading", "tilt")
)
AHEAD = frozenset(
    t.name for t in TARGETS.values() for e in t.enters if e.place == "case_rate" or e.of in INERTIAS
)
#: Targets that change an instrument; their laws are constant, and evaluated before everything else.
INSTRUMENT = frozenset(t.name for t in TARGETS.values() for e in t.enters if e.of in INSTRUMENT_PARAMETERS)
AFTER = frozenset(TARGETS) - READING - AHEAD - INSTRUMENT
TORQUES = frozenset(t.name for t in TARGETS.values() for e in t.enters if e.place in TORQUE_PLACES)
#: Targets of laws whose change makes the state of the balance another one.
ANEW = READING | AHEAD | {t.name for t in TARGETS.values() for e in t.enters if e.of in TORQUE_PARAMETERS}
_WARM = frozenset((T_winding, T_motor))


@dataclass(frozen=True)
class ActiveEffect:
    """An effect with the values of its coefficients."""

    effect: Effect
    values: Mapping[str, float]


def laws_on(
    effects: Iterable[ActiveEffect], targets: frozenset[str]
) -> Iterator[tuple[ActiveEffect, int, Law]]:
    """Return the laws of effects that act on some targets, each with its number."""
    for active in effects:
        for index, law in enumerate(active.effect.laws):
            if law.target in targets:
                yield active, index, law


def evaluated(
    effects: Sequence[ActiveEffect],
    quantities: Mapping[str, Any],
    targets: frozenset[str],
    joint: Joint | None = None,
) -> Laws:
    """Return the sum of the laws on some targets.

    Parameters
    ----------
    effects : sequence of ActiveEffect
        The effects.
    quantities : mapping
        Quantities of the laws, by the names of `effects.quantities`.
    targets : frozenset of str
        The targets.
    joint : Joint, optional
        The angles of the flexures, for targets that have a law for each of them.
    """
    result: dict[str, Any] = {}
    for active, index, law in laws_on(effects, targets):
        function = array_law(active.effect, index)
        target = TARGETS[law.target]
        if target.each_flexure:
            assert joint is not None  # such targets come after the motion
            so_far = result.get(target.name, (0.0, 0.0))
            result[target.name] = tuple(
                so_far[side]
                + np.real(
                    function(
                        {**quantities, **active.values, "theta": angle, "theta_rate": rate, "axis": axis}
                    )
                )
                for side, (axis, angle, rate) in enumerate(
                    ((1.0, joint.theta_x, joint.theta_x_rate), (-1.0, joint.theta_y, joint.theta_y_rate))
                )
            )
            continue
        value = function({**quantities, **active.values, **NO_JOINT})
        result[target.name] = result.get(target.name, 0.0) + (value if target.complex else np.real(value))
    return result


def difference(new: Laws, old: Laws) -> Laws:
    """Return the laws `new` less `old`; those that are in `old` must be in `new`."""
    result: dict[str, Any] = {}
    for name, value in new.items():
        before = old.get(name, (0.0, 0.0) if TARGETS[name].each_flexure else 0.0)
        if TARGETS[name].each_flexure:
            result[name] = tuple(a - b for a, b in zip(value, before, strict=True))
        else:
            result[name] = value - before
    return result


def replaced(laws: Laws, new: Laws, old: Laws) -> Laws:
    """Return laws in which one effect gives `new` instead of `old`, but for those of the flexures."""
    changed = {
        name: laws.get(name, 0.0) + value - old.get(name, 0.0)
        for name, value in new.items()
        if not TARGETS[name].each_flexure
    }
    return {**laws, **changed}


def know_warmth_of_motor(effects: Iterable[ActiveEffect]) -> bool:
    """Whether a law of an effect knows the temperature of the motor's winding or magnets."""
    return any(law.expression.free_symbols & _WARM for active in effects for law in active.effect.laws)
