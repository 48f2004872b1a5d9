"""The torques of coils and motor that the measured motion requires, by exact inverse dynamics instant by instant.

The laws of the effects are summed target by target; the action of each target on the equations is declared once, in
`gyrowheel_sim.effects.targets`. Effects that act on the tilt readings are evaluated along the measured motion.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import sympy as sp

from gyrowheel_analysis.balance.motion import Motion
from gyrowheel_sim.effects.declaration import Effect, Law
from gyrowheel_sim.effects.law_code import array_function, array_law, symbols_of
from gyrowheel_sim.effects.quantities import T_motor, T_winding, V_coil, t, theta_z, z, z_rate
from gyrowheel_sim.effects.targets import (
    INERTIAS,
    INSTRUMENT_PARAMETERS,
    TARGETS,
    TORQUE_PARAMETERS,
    TORQUE_PLACES,
    added,
    changed,
)
from gyrowheel_sim.jit import compile_kernels
from gyrowheel_sim.mechanics.dynamics import Joint, generalised_forces
from gyrowheel_sim.mechanics.inverse import N_POINT

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
#: Targets of laws that change the motion itself, so that the state of the balance must be computed again.
OF_MOTION = (
    READING | AHEAD | {t.name for t in TARGETS.values() for e in t.enters if e.of in TORQUE_PARAMETERS}
)
_WARM = frozenset((T_winding, T_motor))
_VOLTS = 1e-6  # V, to which the voltages of the coils settle where laws depend on them
_SETTLING = 50  # repetitions; a law that takes half of the torque of a further volt needs 20


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
    motion: Motion,
    quantities: Mapping[str, Any],
    targets: frozenset[str],
    joint: Joint | None = None,
    known: dict[int, Any] | None = None,
) -> Laws:
    """Return the sum of the laws on some targets.

    `motion` has what effects remember; `quantities` are those of the laws, by the names of `effects.quantities`;
    `joint` has the angles of the flexures, for targets with a law for each of them. `known` keeps the values of laws
    without the voltages of the coils, for an evaluation in which these alone are others.
    """
    result: dict[str, Any] = {}
    for number, (active, index, law) in enumerate(laws_on(effects, targets)):
        target = TARGETS[law.target]
        if known is None or number not in known:
            assert joint is not None or not target.each_flexure  # such targets come after the motion
            value = _law_at(active, index, motion, quantities, joint if target.each_flexure else None)
            if known is not None and V_coil not in symbols_of(law.expression):
                known[number] = value
        else:
            value = known[number]
        if target.each_flexure:
            so_far = result.get(target.name, (0.0, 0.0))
            result[target.name] = tuple(a + b for a, b in zip(so_far, value, strict=True))
        else:
            result[target.name] = result.get(target.name, 0.0) + value
    return result


def _law_at(
    active: ActiveEffect, index: int, motion: Motion, quantities: Mapping[str, Any], joint: Joint | None
) -> Any:
    """Return a law; with the angles of the flexures, that of each of them."""
    function = array_law(active.effect, index)
    memory = motion.remembered(active.effect, active.values)
    if joint is None:
        value = function({**quantities, **active.values, **memory, **NO_JOINT})
        return value if TARGETS[active.effect.laws[index].target].complex else np.real(value)
    values = []
    angles = (1.0, joint.theta_x, joint.theta_x_rate), (-1.0, joint.theta_y, joint.theta_y_rate)
    for side, (axis, angle, rate) in enumerate(angles):
        own = {name: pair[side] for name, pair in memory.items()}
        own |= {"theta": angle, "theta_rate": rate, "axis": axis}
        values.append(np.real(function({**quantities, **active.values, **own})))
    return tuple(values)


def difference(new: Laws, old: Laws) -> Laws:
    """Return the laws `new` less `old`; `new` must have those of `old`."""
    result: dict[str, Any] = {}
    for name, value in new.items():
        before = old.get(name, (0.0, 0.0) if TARGETS[name].each_flexure else 0.0)
        pairs = TARGETS[name].each_flexure
        result[name] = tuple(a - b for a, b in zip(value, before, strict=True)) if pairs else value - before
    return result


def replaced(laws: Laws, new: Laws, old: Laws) -> Laws:
    """Return laws in which one effect gives `new` instead of `old`, except those of the flexures."""
    changed = {
        name: laws.get(name, 0.0) + value - old.get(name, 0.0)
        for name, value in new.items()
        if not TARGETS[name].each_flexure
    }
    return {**laws, **changed}


def depend_on_motor_temperature(effects: Iterable[ActiveEffect]) -> bool:
    """Whether a law of an effect depends on the temperature of the motor's winding or magnets."""
    return any(symbols_of(law.expression) & _WARM for active in effects for law in active.effect.laws)


def depends_on_coil_voltage(effect: Effect) -> bool:
    """Whether a law of an effect depends on the voltages of the coils, which follow from the torques of all laws."""
    return any(V_coil in symbols_of(law.expression) for law in effect.laws)


def coil_voltages(coil: Any, laws: Laws, values: Mapping[str, float]) -> Any:
    """Return the voltages of the coils, x + i y [V], that give a torque `coil` [N m] with the laws on their gain."""
    gain = added(laws, values, "relative", "coil_constant", start=1.0)
    constant = added(laws, values, "offset", "coil_constant", start=values["coil_constant"])
    volts = coil / (gain * constant)
    mirror = added(laws, values, "mirror")
    if np.any(mirror):
        volts = (volts - mirror * np.conj(volts)) / (1.0 - np.abs(mirror) ** 2)
    return volts


#: Step of the derivatives of a reading's error [rad of the spin angle], and their five-point formulas.
_STENCIL = 0.05
_FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
_SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0
_REPETITIONS = 3
#: Quantities that change within a revolution.
_MOVING = frozenset((z, z_rate, theta_z, t))


def tangents(angles: Any) -> Any:
    """Return the tangents of real and imaginary parts."""
    return np.tan(np.ascontiguousarray(angles).view(np.float64)).view(np.complex128)


@functools.lru_cache(maxsize=1024)
def _factors(expression: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
    """Return the factor of a law that is constant within a revolution, and the other one."""
    constant, moving = expression.as_independent(*_MOVING, as_Add=False)
    return constant, moving


def tilt_reading_error(
    effects: Sequence[ActiveEffect],
    q: Mapping[str, Any],
    phi: Any,
    tilt_rate: Any,
    tilt_acc: Any,
    acceleration: Any,
    motion: Motion,
) -> tuple[Any, Any, Any]:
    """Return the contribution of the effects to the tilt readings, with its first and second derivative.

    The laws take the true tilt, the reading less their own contribution: it is found by repetition. The derivatives are
    taken along the motion, with slow quantities held. `q` has the quantities of the laws except the tilt; `phi` is the
    reading without the bench's own zero and scale [rad], `tilt_rate` and `tilt_acc` are its derivatives, and
    `acceleration` is the spin acceleration [rad/s²].
    """
    error: Any = 0.0j
    first: Any = 0.0j
    second: Any = 0.0j
    for active, index, law in laws_on(effects, READING):
        # what is remembered changes slowly
        fixed = {**q, **active.values, **motion.remembered(active.effect, active.values), **NO_JOINT}
        moving = symbols_of(law.expression) & _MOVING
        if not moving:
            error = error + array_law(active.effect, index)({**fixed, **AT_REST})
            continue
        held, function = (array_function(part) for part in _factors(law.expression))
        factor = held(fixed)
        step = _STENCIL / q["Omega"]
        own: Any = 0.0j
        rate: Any = 0.0j
        acc: Any = 0.0j
        for _ in range(_REPETITIONS if {z, z_rate} & moving else 1):
            samples = []
            tilt, speed = phi - own, tilt_rate - rate
            straight, bent = step * speed, 0.5 * step**2 * (tilt_acc - acc)
            for k in (-2, -1, 0, 1, 2):
                there = {
                    **fixed,
                    "z": tangents(tilt + k * straight + k**2 * bent) if z in moving else 0.0j,
                    "z_rate": speed + 2.0 * k * bent / step if z_rate in moving else 0.0j,
                    "theta_z": motion.angle + k * _STENCIL + 0.5 * (k * step) ** 2 * acceleration,
                    "t": fixed["t"] + k * step,
                }
                samples.append(np.broadcast_to(function(there), motion.shape))
            stack = np.array(samples)
            own = factor * stack[2]
            rate = factor * np.tensordot(_FIRST, stack, 1) / step
            acc = factor * np.tensordot(_SECOND, stack, 1) / step**2
        error, first, second = error + own, first + rate, second + acc
    return error, first, second


_KERNELS = (("gyrowheel_sim", "mechanics/dynamics.py"), ("gyrowheel_sim", "mechanics/inverse.py"))


class SpinAxis(NamedTuple):
    """The spin axis in case axes: across z as n_x + i n_y, and along z."""

    across: Any
    along: Any


@dataclass(frozen=True)
class Instants:
    """Torques that the measured motion requires at every instant of every window, for a state of the model.

    Arrays are (n, nodes, phases): the torques of the coils, complex, and of the motor [N m], the spin rate [rad/s], and
    the weights of a mean over time; `ripple` (n, harmonics, nodes) are the amplitudes of that of the spin rate [rad/s].
    `motion` is the true one; `laws` are those of the effects by target, and `quantities` theirs; `joint` has the angles
    of the flexures, `axis` is the spin axis; `by_voltage` is whether a law depends on the voltages of the coils.
    """

    motion: Motion
    ripple: Any
    coil: Any
    motor: Any
    rate: Any
    weights: Any
    laws: Laws
    quantities: dict[str, Any]
    joint: Joint
    axis: SpinAxis
    by_voltage: bool


@dataclass(frozen=True)
class Kinematics:
    """The true motion at every instant of every window, for a ripple of the spin rate, and what follows from it alone.

    Attributes are those of `Instants`; `laws` are those that the motion needs.
    """

    motion: Motion
    ripple: Any
    rate: Any
    weights: Any
    laws: Laws
    quantities: Mapping[str, Any]
    joint: Joint
    axis: SpinAxis


#: Bench parameters that act on torques and readings alone: the kinematics are the same for others of them.
_BESIDE_KINEMATICS = frozenset((*TORQUE_PARAMETERS, "coil_constant", "motor_constant", "motor_resistance"))


def kinematics_key(values: Mapping[str, float], effects: Sequence[ActiveEffect]) -> tuple[Any, ...]:
    """Return what kinematics follow from besides the motion and the ripple."""
    own = (active for active in effects if any(law.target in READING | AHEAD for law in active.effect.laws))
    return (
        tuple(value for name, value in values.items() if name not in _BESIDE_KINEMATICS),
        tuple((active.effect.laws, tuple(active.values.items())) for active in own),
    )


def required_torques(
    motion: Motion, values: Mapping[str, float], effects: Sequence[ActiveEffect], ripple: Any
) -> Instants:
    """Return the required torques for a given ripple of the spin rate.

    `motion` is free of the instruments' errors; `values` are the bench parameters [SI]; `ripple` (n, harmonics, nodes)
    are the amplitudes of the ripple [rad/s].
    """
    return torques_along(kinematics(motion, values, effects, ripple), values, effects)


def kinematics(
    motion: Motion, values: Mapping[str, float], effects: Sequence[ActiveEffect], ripple: Any
) -> Kinematics:
    """Return the motion for a given ripple; the arguments are those of `required_torques`."""
    rate, acceleration = motion.spin_with(ripple)
    tilt_rate, tilt_acc = motion.tilt_derivatives(rate, acceleration)
    q = motion.quantities_at(rate, values)
    bias = complex(values["tilt_bias_x"], values["tilt_bias_y"])
    scale = values["tilt_scale"]
    # the error of the reading first: every other law takes the true tilt
    error, error_rate, error_acc = tilt_reading_error(
        effects, q, (motion.tilt - bias) / scale, tilt_rate, tilt_acc, acceleration, motion
    )
    phi, phi_rate, phi_acc = motion.instruments.true_tilt(
        (motion.tilt - bias - error) / scale, (tilt_rate - error_rate) / scale, (tilt_acc - error_acc) / scale
    )
    ahead = evaluated(effects, motion, q | AT_REST, AHEAD)
    q["z"] = tangents(phi)
    points = _inverse(motion, (q["z"], phi_rate, phi_acc), rate, acceleration, values, ahead)
    q["z_rate"] = points.tilt_rate_x + 1j * points.tilt_rate_y
    joint = Joint(
        sx=points.sine_x,
        cx=points.cosine_x,
        sz=motion.sines.reshape(motion.shape),
        cz=motion.cosines.reshape(motion.shape),
        theta_x=np.arctan2(points.sine_x, points.cosine_x),
        theta_y=np.arctan2(points.sine_y, points.cosine_y),
        theta_x_rate=points.theta_rate_x,
        theta_y_rate=points.theta_rate_y,
        inertial=(points.inertial_x, points.inertial_y, points.inertial_z),
    )
    # a spin angle that passes quickly has a small share of the time
    weights = motion.weights * motion.spin / rate
    weights = weights / weights.sum(axis=(1, 2), keepdims=True)
    axis = SpinAxis(points.axis_x + 1j * points.axis_y, points.axis_z)
    return Kinematics(motion, ripple, rate, weights, ahead, q, joint, axis)


def torques_along(
    along: Kinematics, values: Mapping[str, float], effects: Sequence[ActiveEffect]
) -> Instants:
    """Return the required torques for some kinematics."""
    motion, joint, axis, q = along.motion, along.joint, along.axis, dict(along.quantities)
    first = {**along.laws, **evaluated(effects, motion, q, INSTRUMENT)}
    q["V_coil"], by_voltage = 0.0j, any(depends_on_coil_voltage(active.effect) for active in effects)
    known: dict[int, Any] = {}
    for _ in range(_SETTLING if by_voltage else 1):
        laws = {**evaluated(effects, motion, q, AFTER, joint, known), **first}
        coil, motor = _needed(motion, values, laws, along.rate, joint, axis, q["z"])
        before, q["V_coil"] = q["V_coil"], coil_voltages(coil, laws, values)
        if np.abs(q["V_coil"] - before).max(initial=0.0) < _VOLTS:
            break
    return Instants(
        motion, along.ripple, coil, motor, along.rate, along.weights, laws, q, joint, axis, by_voltage
    )


def _needed(
    motion: Motion,
    values: Mapping[str, float],
    laws: Laws,
    rate: Any,
    joint: Joint,
    axis: SpinAxis,
    tilt: Any,
) -> tuple[Any, Any]:
    """Return the torques that coils (complex) and motor must give [N m]."""
    own = bench_torques({name: changed(laws, values, name) for name in TORQUE_PARAMETERS}, rate, joint)
    forces = _forces(
        joint, axis, tilt, added(laws, values, "across", start=own.across), added(laws, values, "along")
    )
    by_laws = flexure_laws(laws)
    need_x = joint.inertial[0] - (own.flexures[0] + by_laws[0]) - forces[0]
    need_y = joint.inertial[1] - (own.flexures[1] + by_laws[1]) - forces[1]
    coil = motion.turn * (need_x + 1j * need_y / joint.cx)
    return coil, joint.inertial[2] - added(laws, values, "shaft", start=own.shaft) - forces[2]


class Torques(NamedTuple):
    """Torques on the rotor, across (x + i y, case axes) and along its spin axis, on the shaft, and on the flexures."""

    across: Any
    along: Any
    shaft: Any
    flexures: tuple[Any, Any]


def bench_torques(values: Mapping[str, float], rate: Any, joint: Joint) -> Torques:
    """Return the torques of the bench's own `TORQUE_PARAMETERS` [N m]; they are proportional to the parameters."""
    flexures = (
        -values["flexure_stiffness_x"] * joint.theta_x - values["flexure_damping_x"] * joint.theta_x_rate,
        -values["flexure_stiffness_y"] * joint.theta_y - values["flexure_damping_y"] * joint.theta_y_rate,
    )
    shaft = -values["bearing_coulomb"] * np.sign(rate) - values["bearing_viscous"] * rate
    return Torques(values["fixed_torque_x"] + 1j * values["fixed_torque_y"], 0.0, shaft, flexures)


def law_torques(laws: Laws, values: Mapping[str, float]) -> Torques:
    """Return the torques of laws [N m]."""
    return Torques(
        added(laws, values, "across"),
        added(laws, values, "along"),
        added(laws, values, "shaft"),
        flexure_laws(laws),
    )


def flexure_laws(laws: Laws) -> tuple[Any, Any]:
    """Return the torques of laws on the two flexures [N m]."""
    pairs = {name: pair for name, pair in laws.items() if TARGETS[name].each_flexure}
    if not pairs:
        return 0.0, 0.0
    first, second = (
        added({name: pair[side] for name, pair in pairs.items()}, {}, "flexure") for side in (0, 1)
    )
    return first, second


def pushed(motion: Motion, at: Instants, torques: Torques) -> Instants:
    """Return a state with further torques; its ripple is still that of the state before."""
    forces = _forces(at.joint, at.axis, at.quantities["z"], torques.across, torques.along)
    flexures = torques.flexures
    coil = at.coil - motion.turn * (forces[0] + flexures[0] + 1j * (forces[1] + flexures[1]) / at.joint.cx)
    return replace(at, coil=coil, motor=at.motor - torques.shaft - forces[2])


def _forces(joint: Joint, axis: SpinAxis, tilt: Any, across: Any, axial: Any) -> tuple[Any, Any, Any]:
    """Return the generalised forces of torques across and along the spin axis."""
    # the z component follows: a torque across the spin axis has no component along it
    along = (np.conj(tilt) * across).imag
    total = across + axial * axis.across
    forces: tuple[Any, Any, Any] = generalised_forces(
        joint.sx, joint.cx, joint.sz, joint.cz, np.real(total), np.imag(total), along + axial * axis.along
    )
    return forces


class _Points(NamedTuple):
    """Output of `mechanics.inverse` at every instant: its rows, in order."""

    tilt_rate_x: Any
    tilt_rate_y: Any
    axis_x: Any
    axis_y: Any
    axis_z: Any
    sine_x: Any
    cosine_x: Any
    sine_y: Any
    cosine_y: Any
    theta_rate_x: Any
    theta_rate_y: Any
    inertial_x: Any
    inertial_y: Any
    inertial_z: Any


def _inverse(
    motion: Motion,
    tilt: tuple[Any, Any, Any],
    rate: Any,
    acceleration: Any,
    values: Mapping[str, float],
    ahead: Laws,
) -> _Points:
    """Return the inverse dynamics of complex tilts and two derivatives of their angles.

    `ahead` are the laws that change the mechanics.
    """
    # inertias are constant
    laws = {
        name: value if TARGETS[name].changes("case_rate") else float(np.mean(value))
        for name, value in ahead.items()
    }
    turn = added(laws, values, "case_rate") + motion.table_rate * motion.quantities["up_across"]

    def flat(array: Any) -> Any:
        return np.ascontiguousarray(np.broadcast_to(array, motion.shape)).reshape(-1)

    turning = bool(np.any(turn))
    none = np.zeros(0)
    up = motion.table_rate * motion.quantities["up"]
    case = (flat(turn.real), flat(turn.imag), flat(up)) if turning else (none, none, none)
    inertias = [changed(laws, values, name) for name in INERTIAS]
    out = np.empty((N_POINT, motion.angle.size))
    compile_kernels(*_KERNELS).inverse_points(
        *(flat(np.asarray(part, dtype=complex)) for part in tilt), motion.sines, motion.cosines,
        flat(rate), flat(acceleration), *case, turning, *inertias, out,
    )  # fmt: skip
    return _Points(*out.reshape(N_POINT, *motion.shape))
