"""A user's law tried at states of the bench: whether it has a value, its size, and whether its states can be kept."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_sim.effects.declaration import Coefficient, Effect
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
