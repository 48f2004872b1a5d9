"""The registered effects: those of the library and those of other packages; their sizes on a given bench."""

from __future__ import annotations

import difflib
import functools
import logging
import math
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import entry_points
from types import MappingProxyType

from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.declaration import Effect
from gyrowheel_sim.effects.dimensions import Unit, check_effect
from gyrowheel_sim.effects.library import LIBRARY
from gyrowheel_sim.effects.trial import remembered

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
    torque = 0.5 * (v("flexure_stiffness_x") + v("flexure_stiffness_y")) * tilt
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
