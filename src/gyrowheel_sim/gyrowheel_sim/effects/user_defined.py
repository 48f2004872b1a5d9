"""User-defined effects: declarations in files and formulas, checked, completed and turned into `Effect`.

A declaration in a model file::

    torque: -k*r^2*z
    coefficients:
      k: {unit: N*m/rad, usual: [0.01, 0.05], bounds: [-0.5, 0.5]}

`gyrowheel_sim.effects.user_defined_line` reads the same from one line of text.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Any

import sympy as sp
from pydantic import AfterValidator, BeforeValidator, Field, StrictBool, create_model

from gyrowheel_core.errors import InputError
from gyrowheel_core.schema import Number, Section, check, refuse, shown
from gyrowheel_sim.effects.declaration import Category, Coefficient, Effect, Law
from gyrowheel_sim.effects.dimensions import MissingUnitError, Unit, check_unit
from gyrowheel_sim.effects.formula import Formula, read, to_text
from gyrowheel_sim.effects.grammar import NAME, RESERVED, one_line, shortened
from gyrowheel_sim.effects.memory import Memory
from gyrowheel_sim.effects.quantities import V_coil, theta, theta_rate, z, z_rate
from gyrowheel_sim.effects.registry import require_finite, sized
from gyrowheel_sim.effects.targets import TARGETS
from gyrowheel_sim.effects.torque_map import TorqueMap, map_from_mapping, map_to_mapping

#: Names that a law may have in a declaration, and the targets that they mean.
LAW_FIELDS: dict[str, str] = {"torque": "rotor_torque", **{target: target for target in TARGETS}}
_FAST = frozenset({z, z_rate, V_coil})
_LONGEST_TEXT = 300
_MOST_COEFFICIENTS = 12
_MOST_STATES = 4
_LARGEST = 1e100


def _line(raw: Any) -> str:
    if not isinstance(raw, str) or len(raw) > _LONGEST_TEXT:
        refuse(f"{shown(raw)} is not a text of up to {_LONGEST_TEXT} characters")
    return one_line(raw)


def _unit(raw: Any) -> str:
    try:
        Unit.of(str(raw))
    except InputError as error:
        refuse(str(error))
    return str(raw).strip().replace("**", "^").replace("·", "*").replace(" ", "")


def _is_pair(raw: Any) -> Any:
    if not isinstance(raw, list | tuple) or len(raw) != 2:
        refuse(f"{shown(raw)} is not a pair of numbers, [low, high]")
    return tuple(raw)


def _grows(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] < pair[1]:
        refuse(f"[{pair[0]:g}, {pair[1]:g}] is empty; allowed: low < high")
    return pair


def _not_huge(value: float) -> float:
    if abs(value) > _LARGEST:
        refuse(f"{value:g} is not finite")
    return value


def _some(value: float) -> float:
    if value <= 0.0:
        refuse(f"{value:g} is out of range; allowed: > 0")
    return value


#: A text of one line.
Line = Annotated[str, BeforeValidator(_line)]
Size = Annotated[Number, AfterValidator(_not_huge)]
Pair = Annotated[tuple[Size, Size], BeforeValidator(_is_pair), AfterValidator(_grows)]


class CoefficientEntry(Section):
    """A coefficient in a declaration; `gyrowheel_sim.effects.declaration.Coefficient` says what the fields mean."""

    unit: Annotated[str, BeforeValidator(_unit)] | None = None
    description: Line = ""
    usual: Pair | None = None
    bounds: Pair | None = None
    possible: Pair | None = None
    possible_source: Line = ""
    signed: StrictBool | None = None
    value: Size | None = None
    uncertainty: Size | None = None
    source: Line = ""


def _entry(raw: Any) -> Any:
    if raw is None or isinstance(raw, str):
        return {} if raw is None else {"unit": raw}
    if not isinstance(raw, Mapping):
        refuse(f"{shown(raw)} is not a unit or a mapping with unit, usual, bounds")
    return raw


def _named(raw: Any) -> Any:
    if not isinstance(raw, Mapping) or not raw:
        refuse("missing; an effect needs a coefficient, e.g. k: {unit: N*m/rad}")
    if len(raw) > _MOST_COEFFICIENTS:
        refuse(f"{len(raw)} coefficients; allowed: up to {_MOST_COEFFICIENTS}")
    for name in raw:
        if not isinstance(name, str) or NAME.fullmatch(name) is None:
            refuse(f"{shown(name)} is no name of a coefficient; letters, digits and _ are allowed")
        if name in RESERVED:
            refuse("the name is taken; choose another", name)
    return raw


class StateEntry(Section):
    """A state in a declaration: its unit, the formula of its rate, and that of its value at the first sample."""

    unit: Annotated[str, BeforeValidator(_unit)] | None = None
    rate: Any
    start: Any = "0"


def _remembered(raw: Any) -> Any:
    if raw is None:
        return {}
    if not isinstance(raw, Mapping):
        refuse("a mapping of states is expected, e.g. s: {unit: rad, rate: (z - s)/tau}")
    if len(raw) > _MOST_STATES:
        refuse(f"{len(raw)} states; allowed: up to {_MOST_STATES}")
    return raw


def _alike(raw: Any) -> Any:
    if raw is not None and not isinstance(raw, Mapping):
        refuse("a mapping of effects to tests is expected")
    return {} if raw is None else {_line(str(name))[:40]: test for name, test in raw.items()}


class _Declaration(Section):
    title: Line = ""
    category: Category = "other"
    sentence: Line = ""
    validity: Line = ""
    source: Line = ""
    look_alikes: Annotated[dict[str, Line], BeforeValidator(_alike)] = Field(default_factory=dict)
    greatest: Annotated[Size, AfterValidator(_some)] | None = None
    directions: Annotated[list[Line], Field(min_length=2, max_length=2)] | None = None
    coefficients: Annotated[
        dict[str, Annotated[CoefficientEntry, BeforeValidator(_entry)]], BeforeValidator(_named)
    ] = Field(None, validate_default=True)
    states: Annotated[dict[str, StateEntry], BeforeValidator(_remembered)] = Field(default_factory=dict)

    def laws(self) -> dict[str, Any]:
        """Return the formulas that are given, by the names of their fields."""
        return {field: getattr(self, field) for field in LAW_FIELDS if field in self.model_fields_set}


_FORMULAS: dict[str, Any] = dict.fromkeys(LAW_FIELDS, (Any, None))
#: A declaration: the fields above, and a formula for every target that a law of it acts on.
Declaration: type[_Declaration] = create_model("Declaration", __base__=_Declaration, **_FORMULAS)


def effect_from_mapping(name: str, mapping: object, where: str = "effect") -> Effect:
    """Return the effect that a user declares.

    Parameters
    ----------
    name : str
        Its name.
    mapping : mapping
        ``torque`` (short for ``rotor_torque``) or another target of `TARGETS`, each a formula; ``coefficients``,
        each with ``unit`` and, where known, ``usual``, ``bounds`` and ``possible`` (two numbers), ``signed``,
        ``value``, ``uncertainty``, ``description``, ``source``, ``possible_source``; ``title``, ``category``,
        ``sentence``, ``directions`` (that sentence for either sign), ``validity``, ``source``, ``look_alikes``,
        ``greatest``; ``states``, each with the formula of its ``rate`` and, where needed, of its ``start`` and its
        ``unit``; or ``map`` alone, see `gyrowheel_sim.effects.torque_map`. A coefficient in which the law is linear
        is an amplitude; any other one (an exponent, an edge) needs its ``value`` and ``uncertainty``, or its ``usual``
        range.
    where : str
        Beginning of error messages.

    Raises
    ------
    InputError
        If a field is missing, unknown or wrong, a formula cannot be read, or its unit is not that of its target.
    """
    check_name(name, where)
    if not isinstance(mapping, Mapping):
        raise InputError(f"{where}: a mapping with a law and its coefficients is expected")
    if "map" in mapping:
        return map_from_mapping(name, mapping, where)
    given = check(Declaration, mapping, where, separator=".")
    entries = given.coefficients
    memory = Memory.read(
        {name: (own.unit, own.rate, own.start) for name, own in given.states.items()}, list(entries), where
    )
    formulas = _formulas(given.laws(), [*entries, *memory.names], where, memory.two)
    known = {key: entry.unit for key, entry in entries.items() if entry.unit is not None}
    memory = memory.with_units(known)
    wanted = [(formula, TARGETS[target].unit) for formula, target in formulas] + memory.wanted
    units = _units(wanted, entries, f"{where}.coefficients", memory.units)
    for formula, unit in wanted:
        check_unit(formula, units, unit)
    for formula, target in formulas:
        _check_target(formula, target)
    used = {s.name for formula, _ in wanted for s in formula.expression.free_symbols}
    if unused := [key for key in entries if key not in used]:
        raise InputError(f"{where}.coefficients.{unused[0]}: not used in any law")
    laws = tuple(Law(target, formula.expression) for formula, target in formulas)
    memory.check(laws)
    amplitudes = _amplitudes(laws, {k: e for k, e in entries.items() if k not in memory.symbols}, where)
    drafts = [
        (_amplitude if key in amplitudes else _shape)(key, units[key], entry, f"{where}.coefficients.{key}")
        for key, entry in entries.items()
    ]
    drafts.sort(key=lambda c: c.shape is not None)

    def effect(coefficients: Sequence[Coefficient]) -> Effect:
        return Effect(
            name=name,
            title=given.title or name.replace("_", " "),
            category=given.category,
            sentence=given.sentence or "Declared as a formula.",
            laws=laws,
            coefficients=tuple(coefficients),
            validity=given.validity or "not stated",
            source=given.source or "a user's formula",
            look_alikes=given.look_alikes,
            greatest=given.greatest,
            directions=None if given.directions is None else (given.directions[0], given.directions[1]),
            states=memory.states,
        )

    require_finite(effect(drafts), where)
    return effect(sized(effect(drafts), where))


def effect_to_mapping(effect: Effect) -> dict[str, Any]:
    """Return the declaration of an effect as a mapping that `effect_from_mapping` reads back."""
    if isinstance(effect, TorqueMap):
        return map_to_mapping(effect)
    laws: dict[str, sp.Expr] = {}
    for law in effect.laws:
        laws[law.target] = laws.get(law.target, sp.S.Zero) + law.expression
    coefficients = {}
    for c in effect.coefficients:
        entry: dict[str, Any] = {"unit": c.unit, "usual": list(c.usual), "bounds": list(c.bounds)}
        if c.shape is not None:
            entry |= {"value": c.shape, "uncertainty": c.shape_uncertainty}
        if c.possible is not None:
            entry |= {"possible": list(c.possible), "possible_source": c.possible_source}
        coefficients[c.name] = entry | {
            "signed": c.signed, "description": c.description, "source": c.source,
        }  # fmt: skip
    result: dict[str, Any] = {"title": effect.title, "category": effect.category, "sentence": effect.sentence}
    result |= {target: to_text(expression) for target, expression in laws.items()}
    if effect.states:
        result["states"] = {
            s.name: {"unit": s.unit, "rate": to_text(s.rate), "start": to_text(s.start)}
            for s in effect.states
        }
    result |= {"coefficients": coefficients, "validity": effect.validity, "source": effect.source}
    if effect.greatest is not None:
        result["greatest"] = effect.greatest
    if effect.directions is not None:
        result["directions"] = list(effect.directions)
    return result | ({"look_alikes": dict(effect.look_alikes)} if effect.look_alikes else {})


def check_name(name: str, where: str, taken: Mapping[str, object] | None = None) -> None:
    """Refuse a name that no new effect can have; `taken` has the names in use.

    Raises
    ------
    InputError
        If the name is not made of letters, digits and ``_``, or has a meaning already.
    """
    if not isinstance(name, str) or NAME.fullmatch(name) is None:
        raise InputError(
            f"{where}: {shortened(repr(name), 60)} is not a name for an effect; "
            "allowed: letters, digits and _, at most 40"
        )
    if name.endswith("_error"):
        raise InputError(f"{where}: names that end in _error are reserved for errors of bench parameters")
    if taken is not None and name in taken:
        raise InputError(f"{where}: there is an effect named '{name}' already; choose another name")


def _formulas(
    mapping: Mapping[str, Any], names: list[str], where: str, two: Collection[str]
) -> list[tuple[Formula, str]]:
    formulas: list[tuple[Formula, str]] = []
    for key, target in LAW_FIELDS.items():
        if key not in mapping:
            continue
        if any(target == other for _, other in formulas):
            raise InputError(f"{where}.{key}: torque and rotor_torque are the same; give one of them")
        formulas.append((read(mapping[key], names, f"{where}.{key}", two), target))
    if not formulas:
        raise InputError(f"{where}: a law is missing; allowed: {', '.join(LAW_FIELDS)}")
    return formulas


def _units(
    formulas: list[tuple[Formula, str]],
    entries: Mapping[str, CoefficientEntry],
    where: str,
    known: Mapping[str, str],
) -> dict[str, str]:
    units = {key: entry.unit for key, entry in entries.items() if entry.unit is not None} | dict(known)
    missing = [key for key in entries if key not in units]
    if not missing:
        return units
    hint = "every coefficient needs one, e.g. N*m/rad, or 1 for a pure number"
    if len(missing) == 1:
        try:
            for formula, unit in formulas:
                check_unit(formula, {**units, missing[0]: None}, unit)
        except MissingUnitError as error:
            with contextlib.suppress(InputError):  # nobody would write a fractional power of a unit
                hint = f"{Unit.of(str(error.unit))} would fit"
    raise InputError(f"{where}.{missing[0]}.unit: missing; {hint}")


def _check_target(formula: Formula, target: str) -> None:
    """Refuse a law that does not fit its target."""
    node, expression = formula.node, formula.expression
    if not TARGETS[target].each_flexure and expression.free_symbols & {theta, theta_rate}:
        raise formula.error(node, "theta and theta_rate belong to a flexure: only flexure_torque has them")
    own = TARGETS[target]
    refused = _FAST if own.slow else frozenset({V_coil} if own.changes("reading") else ())
    if used := sorted(symbol.name for symbol in expression.free_symbols & refused):
        raise formula.error(node, f"{target} cannot depend on {used[0]}")
    if not formula.real and not TARGETS[target].complex:
        raise formula.error(node, f"{target} is real, but the formula is complex: use abs, re or im")


def _amplitudes(laws: Sequence[Law], entries: Mapping[str, CoefficientEntry], where: str) -> set[str]:
    """Return the coefficients in which all laws are linear, and without which they vanish."""
    expressions = [law.expression for law in laws]
    free = [
        key
        for key, entry in entries.items()
        if entry.uncertainty is None and not any(_bends(e, key) for e in expressions)
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
    """Whether the law is not linear in a coefficient."""
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


def _shape(name: str, unit: str, entry: CoefficientEntry, where: str) -> Coefficient:
    usual, value, spread = entry.usual, entry.value, entry.uncertainty
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
    bounds = entry.bounds or bounds
    if not bounds[0] <= value <= bounds[1]:
        raise InputError(f"{where}.bounds: {bounds[0]:g} .. {bounds[1]:g} leave out the value {value:g}")
    return Coefficient(
        name, unit, entry.description or "shapes the law", usual, bounds, entry.source or "assumed",
        signed=bounds[0] < 0.0 if entry.signed is None else entry.signed, shape=value, shape_uncertainty=spread,
        possible=_possible(entry, value, where), possible_source=entry.possible_source,
    )  # fmt: skip


def _amplitude(name: str, unit: str, entry: CoefficientEntry, where: str) -> Coefficient:
    usual = (0.0, 0.0)  # not known yet, see _sized
    if entry.value is not None:
        size = entry.value
        if size <= 0.0:
            raise InputError(
                f"{where}.value: {size:g} is out of range; allowed: > 0, a usual size (the sign stands in the law)"
            )
        usual = (_rounded(size / 3.0, 3), _rounded(size * 3.0, 3))
    if entry.usual is not None:
        usual = entry.usual
        if usual[0] <= 0.0:
            raise InputError(
                f"{where}.usual: {usual[0]:g} is out of range; allowed: > 0 (sizes; both signs with signed: true)"
            )
    bounds = (-1000.0 * usual[1], 1000.0 * usual[1])
    if entry.bounds is not None:
        bounds = entry.bounds
        if not bounds[0] <= 0.0 <= bounds[1]:
            raise InputError(
                f"{where}.bounds: {bounds[0]:g} .. {bounds[1]:g} leave out 0, which means no effect"
            )
        if bounds[1] < math.sqrt(usual[0] * usual[1]):
            raise InputError(f"{where}.bounds: {bounds[1]:g} is below the usual size")
    return Coefficient(
        name, unit, entry.description or "size", usual, bounds, entry.source or "assumed",
        signed=(entry.bounds is None or bounds[0] < 0.0) if entry.signed is None else entry.signed,
        possible=_possible(entry, 0.0, where), possible_source=entry.possible_source,
    )  # fmt: skip


def _possible(entry: CoefficientEntry, null: float, where: str) -> tuple[float, float] | None:
    """Return the physically possible values; they must include the value of no effect."""
    if entry.possible is not None and not entry.possible[0] <= null <= entry.possible[1]:
        raise InputError(
            f"{where}.possible: {entry.possible[0]:g} .. {entry.possible[1]:g} leave out {null:g}, "
            f"which {'means no effect' if null == 0.0 else 'is its value'}"
        )
    return entry.possible


def _rounded(value: float, digits: int = 12) -> float:
    return float(f"{value:.{digits}g}")
