"""Effects that a user writes as formulas: checked, completed, and turned into declarations.

A declaration in a model file::

    torque: -k*r^2*z
    coefficients:
      k: {unit: N*m/rad, usual: [0.01, 0.05], bounds: [-0.5, 0.5]}

`gyrowheel_sim.effects.typed` reads the same from one line.
"""

from __future__ import annotations

import contextlib
import difflib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import sympy as sp

from gyrowheel_core.errors import InputError
from gyrowheel_sim.effects.declaration import Category, Coefficient, Effect, Law
from gyrowheel_sim.effects.dimensions import MissingUnitError, Unit, check_unit
from gyrowheel_sim.effects.formula import Formula, read
from gyrowheel_sim.effects.grammar import NAME, RESERVED
from gyrowheel_sim.effects.parts import ComplexArgumentError, is_real
from gyrowheel_sim.effects.printing import to_text
from gyrowheel_sim.effects.quantities import theta, theta_rate
from gyrowheel_sim.effects.targets import TARGETS

#: Names that a law may have in a declaration, and the targets that they mean.
LAW_FIELDS: dict[str, str] = {"torque": "rotor_torque", **{target: target for target in TARGETS}}
_TEXTS = ("title", "sentence", "validity", "source")
_FIELDS = (*LAW_FIELDS, "coefficients", "category", "look_alikes", *_TEXTS)
_COEFFICIENT_FIELDS = (
    "unit",
    "description",
    "usual",
    "bounds",
    "signed",
    "value",
    "uncertainty",
    "source",
)
_LONGEST_TEXT = 300
_MOST_COEFFICIENTS = 12

#: Where a law is tried: at rest on the axis, and tilted at speeds from 1000 to 4000 rpm.
_SPEEDS = np.linspace(105.0, 420.0, 64)
_AT_REST: dict[str, Any] = {
    "z": 0j, "z_rate": 0j, "Omega": _SPEEDS, "theta_z": 0.0, "theta": 0.0, "theta_rate": 0.0, "axis": 1.0,
    "i_motor": 0.05, "T_coil": 295.0, "T_air": 295.0, "T_winding": 295.0, "T_motor": 295.0, "rho": 1.2,
    "up": 1.0, "up_across": 0j, "home_x": 1.0 + 0j, "home_y": 1j, "t": 0.0,
    "Omega_ref": 366.5, "rho_ref": 1.2, "T_ref": 295.0, "z_ref": 0.05, "N_ripple": 6.0,
}  # fmt: skip
_TILTED = _AT_REST | {
    "z": 0.04 + 0.03j, "z_rate": 0.1 - 0.2j, "theta_z": 0.7, "theta": 0.05, "theta_rate": 15.0, "axis": -1.0,
    "i_motor": -0.3, "T_coil": 315.0, "T_air": 296.0, "T_winding": 325.0, "T_motor": 300.0, "rho": 1.0,
    "up": -1.0, "up_across": 0.6 - 0.8j, "home_x": 0.8 + 0j, "home_y": -0.6j, "t": 60.0,
}  # fmt: skip


def effect_from_mapping(name: str, mapping: object, where: str = "effect") -> Effect:
    """Return the effect that a user declares.

    Parameters
    ----------
    name : str
        Its name.
    mapping : mapping
        ``torque`` (short for ``rotor_torque``) or another target of `TARGETS`, each a formula; ``coefficients``,
        each with ``unit`` and, where known, ``usual`` and ``bounds`` (two numbers), ``signed``, ``value``,
        ``uncertainty``, ``description``, ``source``; ``title``, ``category``, ``sentence``, ``validity``,
        ``source``, ``look_alikes``. A coefficient in which the law is linear is an amplitude; another one (an
        exponent, an edge) needs its ``value`` and ``uncertainty``, or its ``usual`` range.
    where : str
        What messages begin with.

    Raises
    ------
    InputError
        If a field is missing, unknown or wrong, a formula is none, or its unit is not that of its target.
    """
    check_name(name, where)
    if not isinstance(mapping, Mapping):
        raise InputError(f"{where}: a mapping with a law and its coefficients is expected")
    for key in mapping:
        if key not in _FIELDS:
            raise InputError(f"{where}.{_one_line(key, 60)}: no such field; {_nearest(str(key), _FIELDS)}")
    entries = _coefficient_entries(mapping.get("coefficients"), f"{where}.coefficients")
    formulas = _formulas(mapping, list(entries), where)
    units = _units(formulas, entries, f"{where}.coefficients")
    for formula, target in formulas:
        check_unit(formula, units, TARGETS[target].unit)
        _check_target(formula, target)
    used = {s.name for formula, _ in formulas for s in formula.expression.free_symbols}
    if unused := [key for key in entries if key not in used]:
        raise InputError(f"{where}.coefficients.{unused[0]}: no law has it")
    laws = tuple(Law(target, formula.expression) for formula, target in formulas)
    amplitudes = _amplitudes(laws, entries, where)
    drafts = [
        (_amplitude if key in amplitudes else _shape)(key, units[key], entry, f"{where}.coefficients.{key}")
        for key, entry in entries.items()
    ]
    drafts.sort(key=lambda c: c.shape is not None)
    texts = {key: _text(mapping.get(key, ""), f"{where}.{key}") for key in _TEXTS}
    category = mapping.get("category", "other")
    if category not in get_args(Category):
        raise InputError(
            f"{where}.category: {_one_line(category)} is not known; allowed: {', '.join(get_args(Category))}"
        )
    alike = mapping.get("look_alikes") or {}
    if not isinstance(alike, Mapping):
        raise InputError(f"{where}.look_alikes: a mapping of effects to tests is expected")

    def effect(coefficients: Sequence[Coefficient]) -> Effect:
        return Effect(
            name=name,
            title=texts["title"] or name.replace("_", " "),
            category=category,
            sentence=texts["sentence"] or "Declared as a formula.",
            laws=laws,
            coefficients=tuple(coefficients),
            validity=texts["validity"] or "not stated",
            source=texts["source"] or "a user's formula",
            look_alikes={
                _one_line(key, 40): _text(value, f"{where}.look_alikes") for key, value in alike.items()
            },
        )

    _try(effect(drafts), where)
    return effect(_sized(effect(drafts), where))


def effect_to_mapping(effect: Effect) -> dict[str, Any]:
    """Return the declaration of an effect as a mapping that `effect_from_mapping` reads back."""
    laws: dict[str, sp.Expr] = {}
    for law in effect.laws:
        laws[law.target] = laws.get(law.target, sp.S.Zero) + law.expression
    coefficients = {}
    for c in effect.coefficients:
        entry: dict[str, Any] = {"unit": c.unit, "usual": list(c.usual), "bounds": list(c.bounds)}
        if c.shape is not None:
            entry |= {"value": c.shape, "uncertainty": c.shape_uncertainty}
        coefficients[c.name] = entry | {
            "signed": c.signed, "description": c.description, "source": c.source,
        }  # fmt: skip
    result: dict[str, Any] = {"title": effect.title, "category": effect.category, "sentence": effect.sentence}
    result |= {target: to_text(expression) for target, expression in laws.items()}
    result |= {"coefficients": coefficients, "validity": effect.validity, "source": effect.source}
    return result | ({"look_alikes": dict(effect.look_alikes)} if effect.look_alikes else {})


def check_name(name: str, where: str, taken: Mapping[str, object] | None = None) -> None:
    """Refuse a name that no new effect can have; `taken` has the names in use.

    Raises
    ------
    InputError
        If the name is not made of letters, digits and ``_``, or means something already.
    """
    if not isinstance(name, str) or NAME.fullmatch(name) is None:
        raise InputError(
            f"{where}: {_one_line(repr(name))} is no name of an effect; letters, digits and _ are allowed, 40 at most"
        )
    if name.endswith("_error"):
        raise InputError(f"{where}: names that end in _error are kept for errors of bench parameters")
    if taken is not None and name in taken:
        raise InputError(f"{where}: there is an effect named '{name}' already; choose another name")


def _coefficient_entries(raw: object, where: str) -> dict[str, dict[str, Any]]:
    if not isinstance(raw, Mapping) or not raw:
        raise InputError(f"{where}: missing; an effect needs a coefficient, e.g. k: {{unit: N*m/rad}}")
    if len(raw) > _MOST_COEFFICIENTS:
        raise InputError(f"{where}: {len(raw)} coefficients; allowed: up to {_MOST_COEFFICIENTS}")
    entries: dict[str, dict[str, Any]] = {}
    for key, given in raw.items():
        if not isinstance(key, str) or NAME.fullmatch(key) is None:
            raise InputError(
                f"{where}: {_one_line(repr(key))} is no name of a coefficient; letters, digits and _ are allowed"
            )
        if key in RESERVED:
            raise InputError(f"{where}.{key}: the name is taken; choose another")
        entry = {} if given is None else {"unit": given} if isinstance(given, str) else given
        if not isinstance(entry, Mapping):
            raise InputError(
                f"{where}.{key}: {_one_line(given)} is not a unit or a mapping with unit, usual, bounds"
            )
        for item in entry:
            if item not in _COEFFICIENT_FIELDS:
                hint = _nearest(str(item), _COEFFICIENT_FIELDS)
                raise InputError(f"{where}.{key}.{_one_line(item)}: no such field; {hint}")
        entries[key] = dict(entry)
    return entries


def _formulas(mapping: Mapping[Any, Any], names: list[str], where: str) -> list[tuple[Formula, str]]:
    formulas: list[tuple[Formula, str]] = []
    for key, target in LAW_FIELDS.items():
        if key not in mapping:
            continue
        if any(target == other for _, other in formulas):
            raise InputError(f"{where}.{key}: torque and rotor_torque are the same; give one of them")
        formulas.append((read(mapping[key], names, f"{where}.{key}"), target))
    if not formulas:
        raise InputError(f"{where}: a law is missing; allowed: {', '.join(LAW_FIELDS)}")
    return formulas


def _units(
    formulas: list[tuple[Formula, str]], entries: Mapping[str, Mapping[str, Any]], where: str
) -> dict[str, str]:
    units: dict[str, str] = {}
    for key, entry in entries.items():
        if "unit" in entry:
            try:
                Unit.of(entry["unit"])
            except InputError as error:
                raise InputError(f"{where}.{key}.unit: {error}") from None
            units[key] = str(entry["unit"]).strip().replace("**", "^").replace("·", "*").replace(" ", "")
    missing = [key for key in entries if key not in units]
    if not missing:
        return units
    hint = "every coefficient needs one, e.g. N*m/rad, or 1 for a pure number"
    if len(missing) == 1:
        try:
            for formula, target in formulas:
                check_unit(formula, {**units, missing[0]: None}, TARGETS[target].unit)
        except MissingUnitError as error:
            with contextlib.suppress(InputError):  # a broken power is nothing that one would write
                hint = f"{Unit.of(str(error.unit))} would fit"
    raise InputError(f"{where}.{missing[0]}.unit: missing; {hint}")


def _check_target(formula: Formula, target: str) -> None:
    """Refuse a law that its target cannot take."""
    node, expression = formula.node, formula.expression
    if not TARGETS[target].each_flexure and expression.free_symbols & {theta, theta_rate}:
        raise formula.error(node, "theta and theta_rate belong to a flexure: only flexure_torque has them")
    try:
        real = is_real(expression)
    except ComplexArgumentError as error:
        part = _one_line(to_text(error.argument))
        raise formula.error(node, f"'{part}' is complex where a real number is needed") from None
    if not TARGETS[target].complex and not real:
        raise formula.error(node, f"{target} is real, but the formula is complex: use abs, re or im")


def _amplitudes(laws: Sequence[Law], entries: Mapping[str, Mapping[str, Any]], where: str) -> set[str]:
    """Return the coefficients in which all laws are linear, and without which they vanish."""
    expressions = [law.expression for law in laws]
    free = [
        key
        for key, entry in entries.items()
        if "uncertainty" not in entry and not any(_bends(e, key) for e in expressions)
    ]
    found: list[set[str]] = []
    for count in range(len(free), 0, -1):
        found = [
            set(chosen)
            for chosen in itertools.combinations(free, count)
            if all(_degree(e, set(chosen)) == 1 for e in expressions)
        ]
        if found:
            break
    if not found:
        raise InputError(
            f"{where}: every term of a law needs a factor that switches it off: a coefficient in which it is linear"
        )
    if len(found) > 1:
        both = sorted(found[0] ^ found[1])
        raise InputError(
            f"{where}.coefficients: {' and '.join(both)} multiply each other; give all but one of them a value "
            "with an uncertainty"
        )
    return found[0]


def _bends(e: sp.Expr, name: str) -> bool:
    """Whether a coefficient stands where the law is not linear in it."""
    if not any(s.name == name for s in e.free_symbols) or e.is_Symbol:
        return False
    if e.is_Mul and sum(any(s.name == name for s in a.free_symbols) for a in e.args) > 1:
        return True
    return not _linear(e) or any(_bends(a, name) for a in e.args)


def _linear(e: sp.Expr) -> bool:
    return bool(e.is_Add or e.is_Mul or isinstance(e, sp.conjugate | sp.re | sp.im))


def _degree(e: sp.Expr, names: set[str]) -> int | None:
    """Return 0 if an expression has none of the names, 1 if it is linear in them and vanishes with them, else None."""
    if not any(s.name in names for s in e.free_symbols):
        return 0
    if e.is_Symbol:
        return 1
    if not _linear(e):
        return None
    degrees = [_degree(a, names) for a in e.args]
    if None in degrees:
        return None
    if e.is_Mul:
        return 1 if sum(filter(None, degrees)) == 1 else None
    return 1 if all(degrees) else None


def _shape(name: str, unit: str, entry: Mapping[str, Any], where: str) -> Coefficient:
    usual = _pair(entry["usual"], f"{where}.usual") if "usual" in entry else None
    value = _number(entry["value"], f"{where}.value") if "value" in entry else None
    spread = _number(entry["uncertainty"], f"{where}.uncertainty") if "uncertainty" in entry else None
    if usual is not None:
        value = 0.5 * (usual[0] + usual[1]) if value is None else value
        spread = 0.5 * (usual[1] - usual[0]) if spread is None else spread
    if value is None or spread is None:
        raise InputError(
            f"{where}: the law is not linear in it: give its value and uncertainty, or its usual range"
        )
    if spread <= 0.0:
        raise InputError(f"{where}.uncertainty: {spread:g} is out of range; allowed: > 0")
    usual = usual or (_rounded(value - spread), _rounded(value + spread))
    bounds = (_rounded(value - 10.0 * spread), _rounded(value + 10.0 * spread))
    if spread < abs(value):  # a sign that is known stays: no width becomes zero
        bounds = (
            (max(bounds[0], 0.01 * value), bounds[1])
            if value > 0.0
            else (bounds[0], min(bounds[1], 0.01 * value))
        )
    if "bounds" in entry:
        bounds = _pair(entry["bounds"], f"{where}.bounds")
    if not bounds[0] <= value <= bounds[1]:
        raise InputError(f"{where}.bounds: {bounds[0]:g} .. {bounds[1]:g} leave out the value {value:g}")
    about, source = (_text(entry.get(key, ""), f"{where}.{key}") for key in ("description", "source"))
    return Coefficient(
        name, unit, about or "shapes the law", usual, bounds, source or "assumed",
        signed=_flag(entry, where, default=bounds[0] < 0.0), shape=value, shape_uncertainty=spread,
    )  # fmt: skip


def _amplitude(name: str, unit: str, entry: Mapping[str, Any], where: str) -> Coefficient:
    usual = (0.0, 0.0)  # not known yet, see _sized
    if "value" in entry:
        size = abs(_number(entry["value"], f"{where}.value"))
        if size == 0.0:
            raise InputError(f"{where}.value: 0 is no usual size")
        usual = (_rounded(size / 3.0, 3), _rounded(size * 3.0, 3))
    if "usual" in entry:
        usual = _pair(entry["usual"], f"{where}.usual")
        if usual[0] <= 0.0:
            raise InputError(
                f"{where}.usual: {usual[0]:g} is out of range; allowed: > 0 (sizes; both signs with signed: true)"
            )
    bounds = (-1000.0 * usual[1], 1000.0 * usual[1])
    if "bounds" in entry:
        bounds = _pair(entry["bounds"], f"{where}.bounds")
        if not bounds[0] <= 0.0 <= bounds[1]:
            raise InputError(
                f"{where}.bounds: {bounds[0]:g} .. {bounds[1]:g} leave out 0, which means no effect"
            )
        if bounds[1] < math.sqrt(usual[0] * usual[1]):
            raise InputError(f"{where}.bounds: {bounds[1]:g} is below the usual size")
    about, source = (_text(entry.get(key, ""), f"{where}.{key}") for key in ("description", "source"))
    return Coefficient(
        name, unit, about or "size", usual, bounds, source or "assumed",
        signed=_flag(entry, where, default="bounds" not in entry or bounds[0] < 0.0),
    )  # fmt: skip


def _try(effect: Effect, where: str) -> None:
    """Refuse a law that is not finite where the bench works."""
    coefficients = {c.name: 1.0 if c.shape is None else c.shape for c in effect.coefficients}
    for place, instant in (("at rest (z = 0, t = 0)", _AT_REST), ("with a tilt", _TILTED)):
        for law, value in zip(effect.laws, _values(effect, instant, coefficients), strict=True):
            if not np.isfinite(value).all():
                raise InputError(
                    f"{where}: {law.target} is not finite {place}; add a small number to a divisor"
                )


def _sized(effect: Effect, where: str) -> list[Coefficient]:
    """Return the coefficients; those without a usual size get that of a noticeable effect."""
    result = []
    for c in effect.coefficients:
        if c.shape is not None or c.usual[1] > 0.0:
            result.append(c)
            continue
        alone = effect.nulls() | {c.name: 1.0}
        sizes = [
            (low / most, high / most)
            for law, value in zip(effect.laws, _values(effect, _TILTED, alone), strict=True)
            for low, high in (TARGETS[law.target].noticeable,)
            if (most := float(np.abs(value).max())) > 0.0
        ]
        if not sizes:
            raise InputError(f"{where}.coefficients.{c.name}.usual: missing, and the law does not tell it")
        usual = min(sizes)
        usual = (_rounded(usual[0], 2), _rounded(usual[1], 2))
        bounds = c.bounds if c.bounds[1] > 0.0 else (-1000.0 * usual[1], 1000.0 * usual[1])
        if bounds[1] < usual[1]:  # keep what the user allows
            usual = (0.01 * bounds[1], bounds[1])
        result.append(replace(c, usual=usual, bounds=bounds))
    return result


def _values(effect: Effect, instant: Mapping[str, Any], coefficients: Mapping[str, float]) -> list[Any]:
    from gyrowheel_sim.effects.code import array_law  # brings in the compiler, which few callers need

    # arrays: numbers of Python would raise where an array has an infinity
    values = {name: np.asarray(value) for name, value in {**instant, **coefficients}.items()}
    with np.errstate(all="ignore"):
        return [np.asarray(array_law(effect, index)(values)) for index in range(len(effect.laws))]


def _rounded(value: float, digits: int = 12) -> float:
    return float(f"{value:.{digits}g}")


def _number(raw: object, where: str) -> float:
    if isinstance(raw, bool) or not isinstance(raw, int | float):
        raise InputError(f"{where}: {_one_line(raw)} is not a number")
    if not math.isfinite(raw) or abs(raw) > 1e100:
        raise InputError(f"{where}: {_one_line(raw)} is not finite")
    return float(raw)


def _pair(raw: object, where: str) -> tuple[float, float]:
    if not isinstance(raw, list | tuple) or len(raw) != 2:
        raise InputError(f"{where}: {_one_line(raw)} is not a pair of numbers, [low, high]")
    low, high = (_number(value, where) for value in raw)
    if not low < high:
        raise InputError(f"{where}: [{low:g}, {high:g}] is empty; allowed: low < high")
    return low, high


def _flag(entry: Mapping[str, Any], where: str, *, default: bool) -> bool:
    raw = entry.get("signed", default)
    if not isinstance(raw, bool):
        raise InputError(f"{where}.signed: {_one_line(raw)} is neither true nor false")
    return raw


def _text(raw: object, where: str) -> str:
    if not isinstance(raw, str) or len(raw) > _LONGEST_TEXT:
        raise InputError(f"{where}: {_one_line(raw)} is not a text of up to {_LONGEST_TEXT} characters")
    return _one_line(raw, _LONGEST_TEXT)


def _one_line(raw: object, longest: int = 60) -> str:
    text = "".join(c if c.isprintable() else " " for c in " ".join(str(raw).split()))
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


def _nearest(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name[:60], known, n=1)
    return f"did you mean {near[0]}?" if near else f"allowed: {', '.join(known)}"
