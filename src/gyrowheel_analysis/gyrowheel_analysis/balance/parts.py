"""The torque budget: the torque of coils and motor that each part of the bench and each effect requires.

At a given motion the required torques are linear in everything that acts: each flexure, each inertia, each law adds its
own share. The shares therefore sum to the whole, in whatever order they are named; what one part does to the motion (a
tilt or a spin rate that ripples) is part of the motion and stands with what resists it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.balance.laws import READING, ActiveEffect
from gyrowheel_analysis.balance.motion import mean
from gyrowheel_analysis.balance.torques import Instants, required_torques
from gyrowheel_sim.effects.targets import INERTIAS, TORQUE_PARAMETERS

#: Parts of the bench: the parameters to which the torque is proportional. A tilted universal joint makes rotor and
#: shaft ripple twice a revolution against each other: in a hold their inertias ask for nothing else, so it is one part.
BENCH_PARTS: dict[str, tuple[str, ...]] = {
    "flexure_stiffness": ("flexure_stiffness_x", "flexure_stiffness_y"),
    "gimbal_inertia": ("gimbal_inertia_x", "gimbal_inertia_y", "gimbal_inertia_z"),
    "joint_ripple": ("shaft_inertia", "rotor_inertia_x", "rotor_inertia_y", "rotor_inertia_z"),
    "flexure_damping": ("flexure_damping_x", "flexure_damping_y"),
    "bearing": ("bearing_coulomb", "bearing_viscous"),
    "fixed_torque": ("fixed_torque_x", "fixed_torque_y"),
}


@dataclass(frozen=True)
class TorquePart:
    """Torque of coils and motor that one part of the machine requires, window by window.

    Attributes
    ----------
    name : str
        Part of the bench (`BENCH_PARTS`), or name of an effect.
    effect : bool
        Whether it is an effect.
    coil : complex ndarray (n,)
        Mean torque that the coils give for it, x + i y in case axes [N m].
    motor : ndarray (n,)
        Mean torque that the motor gives for it [N m].
    """

    name: str
    effect: bool
    coil: Any
    motor: Any


def torque_parts(
    balance: Balance, values: Mapping[str, float], effects: Sequence[ActiveEffect]
) -> list[TorquePart]:
    """Return the required torques part by part: the parts of the bench, then the effects.

    Their sum is what `Balance.required` gives.

    Parameters
    ----------
    balance : Balance
        The windows.
    values : mapping
        Bench parameters by name [SI].
    effects : sequence of ActiveEffect
        Effects with their coefficients.
    """
    whole = balance.instants(values, effects)
    reading = _readings(effects)
    acting = {*INERTIAS, *TORQUE_PARAMETERS}

    def at(kept: Sequence[str]) -> Instants:
        only = {name: value if name in kept or name not in acting else 0.0 for name, value in values.items()}
        return required_torques(whole.motion, only, reading, whole.ripple)

    nothing = at(())
    parts = [
        _part(name, at(parameters), nothing, whole, effect=False) for name, parameters in BENCH_PARTS.items()
    ]
    return [*parts, *effect_parts(balance, values, effects, whole, [e.effect.name for e in effects])]


def effect_parts(
    balance: Balance,
    values: Mapping[str, float],
    effects: Sequence[ActiveEffect],
    whole: Instants,
    names: Collection[str],
) -> list[TorquePart]:
    """Return the shares of some effects in the required torques (see `torque_parts`).

    Parameters
    ----------
    balance, values, effects
        As for `torque_parts`.
    whole : Instants
        State of the balance with all effects.
    names : collection of str
        The effects whose shares are wanted.
    """
    if not names:
        return []
    # a law may also act through a part of the bench: a case that turns through the inertias, a flexure that softens
    reading = _readings(effects)
    bench = required_torques(whole.motion, values, reading, whole.ripple)
    return [
        _part(
            active.effect.name,
            required_torques(whole.motion, values, [*reading, _only(active, reading=False)], whole.ripple),
            bench,
            whole,
            effect=True,
        )
        for active in effects
        if active.effect.name in names
    ]


def _readings(effects: Sequence[ActiveEffect]) -> list[ActiveEffect]:
    """Return an error of a reading as a part: it causes no torque, but the true motion follows only with it."""
    return [_only(active, reading=True) for active in effects]


def _part(name: str, state: Instants, less: Instants, whole: Instants, *, effect: bool) -> TorquePart:
    coil, motor = state.coil - less.coil, state.motor - less.motor
    return TorquePart(name, effect, mean(coil, whole.weights), mean(motor, whole.weights))


def _only(active: ActiveEffect, *, reading: bool) -> ActiveEffect:
    """Return an effect with those of its laws alone that change a reading, or with all others."""
    laws = tuple(law for law in active.effect.laws if (law.target in READING) == reading)
    return replace(active, effect=replace(active.effect, laws=laws))
