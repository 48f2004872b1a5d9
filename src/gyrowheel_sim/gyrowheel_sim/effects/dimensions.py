"""Units of formulas: every law must have the unit of its target. Radians count as dimensionless."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from gyrowheel_core.errors import InputError
from gyrowheel_core.units import unit_registry
from gyrowheel_sim.effects.declaration import Effect
from gyrowheel_sim.effects.formula import Formula, read, to_text
from gyrowheel_sim.effects.grammar import Node
from gyrowheel_sim.effects.quantities import QUANTITIES
from gyrowheel_sim.effects.targets import TARGETS

_FACTOR = re.compile(r"([*/]?)(1|[^\W\d_]+)(?:\^(-?[0-9]))?")
_SPELLED = str.maketrans({"·": "*", "⋅": "*", "²": "^2", "³": "^3", "Ω": "ohm", "µ": "u", "μ": "u"})
_UNKNOWN = "?"  # stands for the unit of a coefficient that has none


@dataclass(frozen=True)
class Unit:
    """A product of powers of units."""

    #: Exponents of the units by the names that pint has for them.
    powers: Mapping[str, Fraction] = field(default_factory=dict)

    @classmethod
    def of(cls, text: str) -> Unit:
        """Read a unit: SI units without prefix (but kg) with ``*``, ``/``, ``^``; ``1`` for a pure number.

        Raises
        ------
        InputError
            If the text is no such unit.
        """
        plain = re.sub(r" *([*/^]) *", r"\1", str(text).strip().translate(_SPELLED).replace("**", "^"))
        factors = list(_FACTOR.finditer(plain[:100]))
        signs = [bool(f[1]) for f in factors]  # one between two factors each
        if (
            not plain
            or "".join(f.group() for f in factors) != plain
            or signs != [k > 0 for k in range(len(signs))]
        ):
            raise InputError(f"{str(text)[:40]!r} is no unit; write it like N*m/rad, kg/m^3 or 1")
        result = cls()
        for sign, name, exponent in (f.groups() for f in factors):
            power = Fraction(int(exponent or 1)) * (-1 if sign == "/" else 1)
            result = result * cls({_si_name(name): Fraction(1)} if name != "1" else {}) ** power
        return result

    def __mul__(self, other: Unit) -> Unit:
        powers = dict(self.powers)
        for name, power in other.powers.items():
            powers[name] = powers.get(name, Fraction()) + power
        return Unit({name: power for name, power in powers.items() if power})

    def __pow__(self, exponent: Fraction | int) -> Unit:
        return Unit({name: power * exponent for name, power in self.powers.items() if power * exponent})

    def __truediv__(self, other: Unit) -> Unit:
        return self * other**-1

    def __str__(self) -> str:
        def part(name: str, power: Fraction) -> str:
            symbol = name if name == _UNKNOWN else f"{unit_registry().get_symbol(name)}"
            if power.denominator != 1:
                return f"{symbol}^({power})"
            return symbol if power == 1 else f"{symbol}^{power}"

        over = "*".join(part(name, power) for name, power in self.powers.items() if power > 0)
        under = "/".join(part(name, -power) for name, power in self.powers.items() if power < 0)
        return f"{over or 1}/{under}" if under else over or "1"

    @property
    def dimension(self) -> dict[str, Fraction]:
        """The exponents of the physical dimensions; empty for a pure number and for angles."""
        result: dict[str, Fraction] = {}
        for name, power in self.powers.items():
            for dimension, exponent in _dimension(name).items():
                result[dimension] = result.get(dimension, Fraction()) + power * exponent
        return {dimension: power for dimension, power in result.items() if power}

    @property
    def simple(self) -> bool:
        """Whether it is a pure number, or an angle."""
        return not self.dimension


class MissingUnitError(InputError):
    """A coefficient has no unit; `unit` would fit."""

    def __init__(self, unit: Unit) -> None:
        super().__init__(f"a unit is missing; {unit} would fit")
        self.unit = unit


@functools.cache
def _si_name(symbol: str) -> str:
    # takes long to load, and a machine without effects of a user has no use for it
    from pint.errors import PintError

    registry = unit_registry()
    try:
        name = registry.get_name(symbol)
        base = registry.Quantity(1.0, name).to_base_units()
    except PintError:
        raise InputError(f"{symbol!r} is no unit; write it like N*m/rad, kg/m^3 or 1") from None
    if not math.isclose(base.magnitude, 1.0, rel_tol=1e-12):
        raise InputError(f"{symbol!r} is no SI unit without prefix (N, m, rad, s, kg, K, V, A ...)")
    return name


@functools.cache
def _dimension(name: str) -> dict[str, Fraction]:
    if name == _UNKNOWN:
        return {_UNKNOWN: Fraction(1)}
    return {
        d: Fraction(float(power)).limit_denominator(12)  # type: ignore[arg-type]
        for d, power in unit_registry().get_dimensionality(name).items()
    }


def check_effect(effect: Effect) -> None:
    """Check that every law of an effect has the unit of its target; formulas of users are checked when they are read.

    Raises InputError if one has not, or is none that a formula could write; the message has law, place and
    units.
    """
    units = {c.name: c.unit for c in effect.coefficients}
    units |= {state.name: state.unit for state in effect.states}
    two = [state.name for state in effect.states if state.complex]
    wanted: list[tuple[str, Any, str | Unit]] = []
    for law in effect.laws:
        wanted += [(law.target, law.expression, TARGETS[law.target].unit)]
    for state in effect.states:
        wanted += [(f"d({state.name})/dt", state.rate, rate_unit(state.unit))]
        wanted += [(f"{state.name}(0)", state.start, state.unit)]
    for place, expression, unit in wanted:
        check_unit(read(to_text(expression), list(units), f"{effect.name}.{place}", two), units, unit)


def rate_unit(unit: str | None) -> str | Unit:
    """Return the unit of the rate of a state; None for a state whose unit is asked for."""
    return Unit({_UNKNOWN: Fraction(1)}) / Unit.of("s") if unit is None else f"{unit}/s"


def check_unit(formula: Formula, units: Mapping[str, str | None], wanted: str | Unit) -> None:
    """Check that a formula has a unit.

    `units`: units of the coefficients in it; None for the one whose unit is asked for. `wanted`: unit that
    the whole must have. Raises MissingUnitError if one coefficient has no unit, and one can be found that
    fits. Raises InputError if units do not match; the message has the place, the part of the formula, and
    both units.
    """
    checker = _checker(formula, units)
    found = checker.unit(formula.node)
    target = Unit.of(wanted) if isinstance(wanted, str) else wanted
    if found is not None and not checker.same(found, target):
        raise formula.error(
            formula.node, f"'{formula.shown(formula.node)}' has the unit {found}; {target} is needed"
        )


def unit_of(formula: Formula, units: Mapping[str, str | None]) -> Unit:
    """Return the unit that a formula has, with the units of the coefficients in it; InputError if units differ."""
    return _checker(formula, units).unit(formula.node) or Unit()


def _checker(formula: Formula, units: Mapping[str, str | None]) -> _Checker:
    known = {name: Unit.of(q.unit) for name, q in QUANTITIES.items()}
    known |= {name: Unit({_UNKNOWN: Fraction(1)}) if u is None else Unit.of(u) for name, u in units.items()}
    return _Checker(formula, known)


class _Checker:
    def __init__(self, formula: Formula, known: Mapping[str, Unit]) -> None:
        self.formula, self.known = formula, known

    def same(self, a: Unit, b: Unit) -> bool:
        """Whether two units match; if the unknown one decides, that unit is raised."""
        ratio = b / a
        power = ratio.powers.get(_UNKNOWN)
        if power is None:
            return ratio.simple
        rest = Unit({name: p for name, p in ratio.powers.items() if name != _UNKNOWN})
        raise MissingUnitError(rest ** (-1 / power))

    def fail(self, node: Node, message: str) -> InputError:
        return self.formula.error(node, message)

    def unit(self, node: Node) -> Unit | None:
        """Return the unit of a part; None for zero, which matches all."""
        if node.kind == "number":
            return None if node.number == 0 else Unit()
        if node.kind == "name":
            return self.known.get(node.name, Unit())
        if node.kind == "sum":
            return self.common(node, "cannot be added")
        if node.kind == "product":
            result = Unit()
            for item, divides in zip(node.items, node.inverse, strict=True):
                unit = self.unit(item)
                if unit is None:
                    return None
                result = result / unit if divides else result * unit
            return result
        if node.kind == "power":
            return self.power(node)
        return self.call(node)

    def common(self, node: Node, cannot: str) -> Unit | None:
        first: tuple[Node, Unit] | None = None
        for item in node.items:
            unit = self.unit(item)
            if unit is None:
                continue
            if first is None:
                first = (item, unit)
            elif not self.same(first[1], unit):
                raise self.fail(
                    item,
                    f"'{self.formula.shown(first[0])}' [{first[1]}] and '{self.formula.shown(item)}' [{unit}] "
                    f"{cannot}: their units differ",
                )
            elif unit.simple and not unit.powers:
                first = (item, unit)  # a pure number makes a pure number of an angle
        return first[1] if first else None

    def pure(self, node: Node, what: str) -> None:
        unit = self.unit(node)
        if unit is not None and not self.same(unit, Unit()):
            raise self.fail(
                node, f"'{self.formula.shown(node)}' has the unit {unit}; {what} must be a pure number"
            )

    def power(self, node: Node) -> Unit | None:
        base, exponent = node.items
        self.pure(exponent, "an exponent")
        unit = self.unit(base)
        if unit is None:
            return None
        if not exponent.constant:
            if unit.simple:
                return Unit()
            raise self.fail(
                base,
                f"'{self.formula.shown(base)}' has the unit {unit}; with the exponent "
                f"'{self.formula.shown(exponent)}' it must be a pure number",
            )
        return unit ** Fraction(self.formula.value(exponent)).limit_denominator(1000)

    def call(self, node: Node) -> Unit | None:
        name = node.name
        if name in ("max", "min"):
            return self.common(node, "cannot be compared")
        (argument,) = node.items
        if name in ("conj", "abs", "re", "im"):
            return self.unit(argument)
        if name == "sqrt":
            unit = self.unit(argument)
            return None if unit is None else unit ** Fraction(1, 2)
        if name == "sign":
            self.unit(argument)
        else:
            self.pure(argument, f"the argument of {name}")
        return Unit()
