"""The registered effects, of the library and of other packages: their sizes on a bench, and trials of their laws."""

from __future__ import annotations

import difflib
import functools
import logging
import math
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import entry_points
from types import MappingProxyType
from typing import Any

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.declaration import Coefficient, Effect
from gyrowheel_sim.effects.dimensions import Unit, check_effect
from gyrowheel_sim.effects.library import LIBRARY
from gyrowheel_sim.effects.quantities import theta, theta_rate, theta_z
from gyrowheel_sim.effects.targets import TARGETS

#: States in which a law is tried: at rest on the axis, and tilted at speeds from 1000 to 4000 rpm.
_SPEEDS = np.linspace(105.0, 420.0, 64)
_AT_REST: dict[str, Any] = {
    "z": 0j, "z_rate": 0j, "Omega": _SPEEDS, "theta_z": 0.0, "theta": 0.0, "theta_rate": 0.0, "axis": 1.0,
    "i_motor": 0.05, "V_coil": 0j, "T_coil": 295.0, "T_air": 295.0, "T_winding": 295.0, "T_motor": 295.0, "rho": 1.2,
    "up": 1.0, "up_across": 0j, "home_x": 1.0 + 0j, "home_y": 1j, "t": 0.0,
    "Omega_ref": 366.5, "rho_ref": 1.2, "T_ref": 295.0, "z_ref": 0.05, "N_ripple": 6.0,
}  # fmt: skip
_TILTED = _AT_REST | {
    "z": 0.04 + 0.03j, "z_rate": 0.1 - 0.2j, "theta_z": 0.7, "theta": 0.05, "theta_rate": 15.0, "axis": -1.0,
    "i_motor": -0.3, "V_coil": 3.0 - 2.0j, "T_coil": 315.0, "T_air": 296.0, "T_winding": 325.0,
    "T_motor": 300.0, "rho": 1.0,
    "up": -1.0, "up_across": 0.6 - 0.8j, "home_x": 0.8 + 0j, "home_y": -0.6j, "t": 60.0,
}  # fmt: skip
#: A state that follows in less than a sample cannot be integrated from samples [s].
SHORTEST_MEMORY = 0.5e-3
_FINEST, _LONGEST = 0.5e-3, 200.0  # s: first steps of a trial of states, and its length
_MOVES = 0.5  # s, in which the rotor tilts and comes back half of the way
_PART = 0.2  # of the shortest memory: step once the rotor stands
_LARGEST = 1.0e6
_OFF = 1.0e-4  # of a state and one
_TURNING = frozenset((theta, theta_rate, theta_z))  # what changes within a revolution
_MOST_STEPS = 3000
_EVERY = 10  # steps of a moving rotor between two looks at how fast a state follows


def require_finite(effect: Effect, where: str) -> None:
    """Refuse a law that is not finite at states of the bench.

    Raises
    ------
    InputError
        If a law or the rate of a state is not finite, or if a state cannot be integrated.
    """
    coefficients = {c.name: 1.0 if c.shape is None else c.shape for c in effect.coefficients}
    start = _start(effect, _AT_REST | {"Omega": _AT_REST["Omega_ref"]}, coefficients)
    for place, instant in (("at rest (z = 0, t = 0)", _AT_REST), ("with a tilt", _TILTED)):
        known = {**instant, **coefficients, **start}
        what = [(law.target, value) for law, value in zip(effect.laws, _laws(effect, known), strict=True)]
        what += [(f"d({name})/dt", value) for name, value in _rates(effect, known).items()]
        what += [(f"{name}(0)", value) for name, value in start.items()]
        for name, value in what:
            if not np.isfinite(value).all():
                raise InputError(f"{where}: {name} is not finite {place}; add a small number to a divisor")


def sized(effect: Effect, where: str) -> list[Coefficient]:
    """Return the coefficients; those without a usual size get that of a noticeable effect."""
    instants = [_TILTED]
    if effect.states:
        shapes = {c.name: 1.0 if c.shape is None else c.shape for c in effect.coefficients}
        course = remembered(effect, shapes, where)
        instants = [_TILTED | course[k] for k in range(0, len(course), max(len(course) // 50, 1))]
        instants.append(_TILTED | course[-1])
    result = []
    for c in effect.coefficients:
        if c.shape is not None or c.usual[1] > 0.0:
            result.append(c)
            continue
        alone = effect.nulls() | {c.name: 1.0}
        tried = [_laws(effect, {**instant, **alone}) for instant in instants]
        sizes = [
            (low / most, high / most)
            for index, law in enumerate(effect.laws)
            for low, high in (TARGETS[law.target].noticeable,)
            if (most := max(float(np.abs(values[index]).max()) for values in tried)) > 0.0
        ]
        if not sizes:
            raise InputError(
                f"{where}.coefficients.{c.name}.usual: missing, and it does not follow from the law"
            )
        usual = min(sizes)
        usual = (_two_digits(usual[0]), _two_digits(usual[1]))
        bounds = c.bounds if c.bounds[1] > 0.0 else (-1000.0 * usual[1], 1000.0 * usual[1])
        if bounds[1] < usual[1]:  # keep the user's bounds
            usual = (0.01 * bounds[1], bounds[1])
        result.append(replace(c, usual=usual, bounds=bounds))
    return result


def remembered(effect: Effect, coefficients: Mapping[str, float], where: str) -> list[dict[str, Any]]:
    """Return the states of an effect along a trial: the rotor tilts, comes back half of the way, and stands for long.

    Raises
    ------
    InputError
        If a state grows without limit, or follows faster than samples show.
    """
    known = {**_TILTED, **coefficients, "Omega": _TILTED["Omega_ref"]}
    start = _start(effect, {**known, **_moved(0.0)}, coefficients)
    # off its start, so that one that grows from zero shows it
    states = {name: value + _OFF * (1.0 + abs(value)) for name, value in start.items()}
    turns = any(state.rate.free_symbols & _TURNING for state in effect.states)
    course, time, fastest = [states], 0.0, 0.0
    while time < (2.0 * _MOVES if turns else _LONGEST) and len(course) < _MOST_STEPS:
        at = {**known, **_moved(time), **states}
        rates = _rates(effect, at)
        if time >= _MOVES or len(course) % _EVERY == 1:
            fastest = _fastest(effect, at, rates)
        if fastest * SHORTEST_MEMORY > 1.0:
            raise InputError(
                f"{where}: a state follows within {1e3 / fastest:.2g} ms, within a sample of the bench; "
                f"allowed: {1e3 * SHORTEST_MEMORY:g} ms or more"
            )
        step = _FINEST if time < _MOVES or turns else min(max(_PART / max(fastest, 1e-9), _FINEST), 1.0)
        middle = {name: value + 0.5 * step * rates[name] for name, value in states.items()}
        rates = _rates(effect, {**known, **_moved(time + 0.5 * step), **middle})
        states = {name: value + step * rates[name] for name, value in states.items()}
        time += step
        if any(not np.isfinite(value) or abs(value) > _LARGEST for value in states.values()):
            raise InputError(f"{where}: a state grows without limit; a rate that brings it back is needed")
        course.append(states)
    return course


def _moved(time: float) -> dict[str, Any]:
    """Return the motion of a trial at a time [s]."""
    part = min(time / (0.4 * _MOVES), 1.0) - 0.5 * min(max(time / (0.3 * _MOVES) - 2.0, 0.0), 1.0)
    rate = (time < 0.4 * _MOVES) / (0.4 * _MOVES) - 0.5 * (0.6 * _MOVES <= time < 0.9 * _MOVES) / (
        0.3 * _MOVES
    )
    tilt = 0.04 + 0.03j
    turn = _TILTED["Omega_ref"] * time
    return {
        "z": tilt * part, "z_rate": tilt * rate, "V_coil": part * _TILTED["V_coil"], "t": time,
        "theta_z": turn % (2.0 * np.pi), "theta": 0.05 * part * np.cos(turn),
        "theta_rate": -0.05 * part * _TILTED["Omega_ref"] * np.sin(turn),
    }  # fmt: skip


def _fastest(effect: Effect, known: Mapping[str, Any], rates: Mapping[str, Any]) -> float:
    """Return the largest relative rate at which a state returns or runs away [1/s]."""
    result = 0.0
    for state in effect.states:
        for unit in (1.0, 1j) if state.complex else (1.0,):
            step = 1.0e-6 * (1.0 + abs(known[state.name]))
            moved = _rates(effect, {**known, state.name: known[state.name] + unit * step})
            result = max(result, *(abs(moved[name] - rates[name]) / step for name in moved))
    return float(result)


def _start(effect: Effect, instant: Mapping[str, Any], coefficients: Mapping[str, float]) -> dict[str, Any]:
    known = {**instant, **coefficients}
    return {state.name: _value(state.start, known) for state in effect.states}


def _rates(effect: Effect, known: Mapping[str, Any]) -> dict[str, Any]:
    return {state.name: _value(state.rate, known) for state in effect.states}


def _laws(effect: Effect, known: Mapping[str, Any]) -> list[Any]:
    return [_value(law.expression, known) for law in effect.laws]


def _value(expression: Any, known: Mapping[str, Any]) -> Any:
    from gyrowheel_sim.effects.law_code import array_function  # imports the compiler, which few callers need

    function, names = array_function(expression), _names(expression)
    # numbers of NumPy: plain ones would raise an exception where arrays hold an infinity
    with np.errstate(all="ignore"):
        return function({name: np.asarray(known[name])[()] for name in names})


@functools.lru_cache(maxsize=256)
def _names(expression: Any) -> tuple[str, ...]:
    return tuple(s.name for s in expression.free_symbols)


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")


ENTRY_POINT_GROUP = "gyrowheel.effects"


@functools.cache
def registry() -> Mapping[str, Effect]:
    """Return every registered effect by name.

    An entry point of the group ``gyrowheel.effects`` names an `Effect` or a sequence of them. An entry point that
    cannot be loaded, that takes a name in use, or a law of which has a wrong unit or a state that cannot be integrated,
    is logged and skipped.
    """
    effects = {effect.name: effect for effect in LIBRARY}
    for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda p: p.name):
        try:
            loaded, own = point.load(), {}
            for effect in (loaded,) if isinstance(loaded, Effect) else tuple(loaded):
                if not isinstance(effect, Effect):
                    raise TypeError(f"{effect!r} is no Effect")
                if effect.name in effects or effect.name in own:
                    raise ValueError(f"the name {effect.name} is taken")
                check_effect(effect)
                if effect.states:
                    remembered(effect, effect.defaults(), f"effect {effect.name}")
                own[effect.name] = effect
            effects |= own
        except Exception as error:  # a broken plug-in must not break the bench
            logging.getLogger(__name__).warning("effects of '%s' skipped: %s", point.value, error)
    return MappingProxyType(effects)


@functools.cache
def physical() -> Mapping[str, Effect]:
    """Return the registered effects that act on the machine at an instant: no instruments, no memory."""
    return MappingProxyType(
        {
            name: effect
            for name, effect in registry().items()
            if effect.category != "instrument" and not effect.states
        }
    )


@functools.cache
def remembering() -> Mapping[str, Effect]:
    """Return the registered effects with a memory: a diagnosis tries them where those of an instant leave something."""
    return MappingProxyType({name: effect for name, effect in registry().items() if effect.states})


def get(
    name: str,
    *,
    where: str = "effect",
    declared: Mapping[str, Effect] | None = None,
    bench: Bench | None = None,
) -> Effect:
    """Return an effect that is registered, with its sizes on a bench if one is given, or beside those declared.

    Raises
    ------
    InputError
        If there is none of that name; the message has the nearest names.
    """
    effects = {**(declared or {}), **registry()}
    if name in effects:
        return effects[name] if bench is None or name not in registry() else for_bench(effects[name], bench)
    near = difflib.get_close_matches(name, effects, n=3, cutoff=0.4)
    hint = f"did you mean {', '.join(near)}?" if near else f"known: {', '.join(effects)}"
    raise InputError(f"{where}: '{name}' is not a known effect; {hint}")


def validated(
    name: str,
    values: Mapping[str, object],
    *,
    where: str = "effect",
    declared: Mapping[str, Effect] | None = None,
    bench: Bench | None = None,
) -> dict[str, float]:
    """Return the coefficients of an effect, checked and completed with the usual values; see `get`.

    Raises
    ------
    InputError
        If effect or coefficient is unknown, or a value is no finite number within the bounds.
    """
    effect = get(name, where=where, declared=declared, bench=bench)
    coefficients = {c.name: c for c in effect.coefficients}
    result = effect.defaults()
    for key, raw in values.items():
        if key not in coefficients:
            raise InputError(f"{where}.{name}.{key}: no such coefficient; it has {', '.join(coefficients)}")
        try:
            if isinstance(raw, bool):
                raise TypeError
            value = float(raw)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            raise InputError(f"{where}.{name}.{key}: {raw!r} is not a number") from None
        low, high = coefficients[key].bounds
        if not math.isfinite(value) or not low <= value <= high:
            raise InputError(
                f"{where}.{name}.{key}: {value:g} is out of range; "
                f"allowed: {low:g} .. {high:g} {coefficients[key].unit}"
            )
        result[key] = value
    return result


def parse_option(
    text: str, declared: Mapping[str, Effect] | None = None, bench: Bench | None = None
) -> tuple[str, dict[str, float]]:
    """Read ``NAME`` or ``NAME:COEF=VALUE,...`` (coefficients not given take their usual size); see `get`.

    Raises
    ------
    InputError
        If the text is not of that form or a name or value is not allowed.
    """
    name, colon, rest = text.partition(":")
    values: dict[str, object] = {}
    for item in rest.split(",") if colon else ():
        key, equals, value = (part.strip() for part in item.partition("="))
        if not equals:
            raise InputError(f"effects: {text!r}: expected NAME:COEF=VALUE,..., not {item!r}")
        if key in values:
            raise InputError(f"effects: {text!r}: {key} is given twice")
        values[key] = value
    return name.strip(), validated(name.strip(), values, where="effects", declared=declared, bench=bench)


def for_bench(effect: Effect, bench: Bench) -> Effect:
    """Return an effect with the usual sizes and bounds that it has on a bench; on the default bench, the effect itself.

    Coefficients that shape a law keep theirs, unless they have a unit: an exponent is the same for every size.
    """
    return _sized(effect, _scales(bench))


def torque_scale(bench: Bench) -> float:
    """Return the torque of the flexures at the reference tilt over that of the default bench."""
    return _scales(bench)[0]


@functools.cache
def _default() -> Bench:
    return Bench.load()


def _measures(bench: Bench) -> tuple[float, float, float, float]:
    """Return what sizes go with: torque [N m], tilt [rad], spin rate [rad/s] and current of the motor [A]."""
    v = bench.value
    tilt = v("tilt_reference")
    torque = bench.flexure_stiffness * tilt
    return torque, tilt, v("spin_rate_reference"), torque / v("motor_constant")


def _scales(bench: Bench) -> tuple[float, float, float, float]:
    own, default = _measures(bench), _measures(_default())
    return (own[0] / default[0], own[1] / default[1], own[2] / default[2], own[3] / default[3])


@functools.lru_cache(maxsize=1024)
def _sized(effect: Effect, scales: tuple[float, float, float, float]) -> Effect:
    if scales == (1.0, 1.0, 1.0, 1.0):
        return effect
    coefficients = []
    for c in effect.coefficients:
        factor = _factor(c.unit, scales)
        low, high = c.usual
        coefficients.append(
            replace(
                c,
                usual=(low * factor, high * factor),
                bounds=(c.bounds[0] * factor, c.bounds[1] * factor),
                shape=None if c.shape is None else c.shape * factor,
                shape_uncertainty=c.shape_uncertainty * factor,
                possible=None if c.possible is None else (c.possible[0] * factor, c.possible[1] * factor),
            )
        )
    if effect.greatest is None:
        return replace(effect, coefficients=tuple(coefficients))
    return replace(
        effect,
        coefficients=tuple(coefficients),
        greatest=effect.greatest * _factor(effect.amplitudes[0].unit, scales),
    )


def _factor(unit: str, scales: tuple[float, float, float, float]) -> float:
    """Return by how much a coefficient of a unit is larger than on the default bench."""
    torque, tilt, rate, current = scales
    parsed = Unit.of(unit)
    powers = {name: float(power) for name, power in parsed.dimension.items()}
    mass, length = powers.pop("[mass]", 0.0), powers.pop("[length]", 0.0)
    time, amperes = powers.pop("[time]", 0.0), powers.pop("[current]", 0.0)
    # not made of torques, inertias, angles and times: nothing of the bench scales it
    if length != 2.0 * mass or (mass == 0.0 and time < 0.0):
        return 1.0
    # kg m^2 is torque over rate squared, a second is one over the rate
    return (
        (torque / rate**2) ** mass
        * rate**-time
        * current**amperes
        * tilt ** float(parsed.powers.get("radian", 0))
    )
