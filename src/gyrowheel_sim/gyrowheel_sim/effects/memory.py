"""States of a declared effect, read from the formulas of their rates: ``d(s)/dt = (z - s)/tau; s(0) = z``."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import sympy as sp

from gyrowheel_core.errors import InputError
from gyrowheel_sim.effects.complex_parts import components
from gyrowheel_sim.effects.declaration import Law, LawState
from gyrowheel_sim.effects.dimensions import MissingUnitError, Unit, check_unit, rate_unit
from gyrowheel_sim.effects.formula import Formula, read
from gyrowheel_sim.effects.grammar import NAME, RESERVED, shortened
from gyrowheel_sim.effects.quantities import QUANTITIES, theta, theta_rate
from gyrowheel_sim.effects.targets import INERTIAS, INSTRUMENT_PARAMETERS, TARGETS

_CONSTANT = frozenset(
    target.name
    for target in TARGETS.values()
    for entry in target.enters
    if entry.place == "coil_lag" or entry.of in (*INERTIAS, *INSTRUMENT_PARAMETERS)
)


@dataclass(frozen=True)
class Memory:
    """The states of a declaration: formulas of their rates and start values by name, and their units where known."""

    where: str
    rates: Mapping[str, Formula]
    starts: Mapping[str, Formula]
    units: Mapping[str, str]
    two: frozenset[str]  # names of complex ones

    @classmethod
    def read(
        cls, given: Mapping[str, tuple[str | None, Any, Any]], coefficients: Collection[str], where: str
    ) -> Memory:
        """Return the states of a declaration: unit, formula of the rate and of the start value, by name.

        Whether a state is complex follows from its rate and start.

        Raises
        ------
        InputError
            If a name is taken, or a formula cannot be read.
        """
        _check_names(list(given), coefficients, where)
        rates: dict[str, Formula] = {}
        starts: dict[str, Formula] = {}
        two: frozenset[str] = frozenset()
        for _ in range(len(given) + 1):
            for name, (_, rate, start) in given.items():
                place = f"{where}.states.{name}"
                rates[name] = read(rate, [*coefficients, *given], f"{place}.rate", two)
                starts[name] = read(str(start), coefficients, f"{place}.start")
            more = {name for name in given if not (rates[name].real and starts[name].real)}
            if more <= two:
                break
            two |= more
        units = {name: unit for name, (unit, _, _) in given.items() if unit is not None}
        return cls(where, rates, starts, units, two)

    @property
    def names(self) -> list[str]:
        """Names of the states."""
        return list(self.rates)

    @property
    def formulas(self) -> list[Formula]:
        """Formulas of rates and start values."""
        return [*self.rates.values(), *self.starts.values()]

    @property
    def symbols(self) -> set[str]:
        """Names in the formulas of rates and start values."""
        return {s.name for formula in self.formulas for s in formula.expression.free_symbols}

    @property
    def wanted(self) -> list[tuple[Formula, str]]:
        """Formulas of rates and start values, each with the unit that it must have."""
        rates = [(formula, f"{self.units[name]}/s") for name, formula in self.rates.items()]
        return [*rates, *((formula, self.units[name]) for name, formula in self.starts.items())]

    def with_units(self, known: Mapping[str, str]) -> Memory:
        """Return the same with the unit of every state; those not given follow from the rates.

        `known` are the units of coefficients. Raises InputError where a unit does not follow.
        """
        units = dict(self.units)
        for name, formula in self.rates.items():
            if name in units:
                continue
            others = {s.name for s in formula.expression.free_symbols} - {name, *known, *units, *QUANTITIES}
            if others:
                raise InputError(
                    f"{self.where}.states.{name}.unit: missing, and it does not follow while {min(others)} has none; "
                    f"state it, e.g. {name} [rad]"
                )
            try:
                check_unit(formula, {**known, **units, name: None}, rate_unit(None))
            except MissingUnitError as error:
                units[name] = str(Unit.of(str(error.unit)))
            else:
                raise InputError(
                    f"{self.where}.states.{name}.unit: missing, and it does not follow from the rate; state it, e.g. "
                    f"{name} [rad]"
                )
        return replace(self, units=units)

    def check(self, laws: Sequence[Law]) -> None:
        """Refuse states that no law uses, that a law cannot use, or that are not of its flexure."""
        used = {s.name for law in laws for s in law.expression.free_symbols}
        for _ in self.rates:
            used |= {
                s.name for name in used & self.rates.keys() for s in self.rates[name].expression.free_symbols
            }
        if unused := [name for name in self.rates if name not in used]:
            raise InputError(f"{self.where}.states.{unused[0]}: not used in any law")
        if not self.rates:
            return
        flexures = [TARGETS[law.target].each_flexure for law in laws]
        if any(flexures) and not all(flexures):
            raise InputError(
                f"{self.where}: flexure_torque has a state for each flexure; declare the other law as another effect"
            )
        for law in laws:
            if law.target in _CONSTANT and {s.name for s in law.expression.free_symbols} & self.rates.keys():
                raise InputError(
                    f"{self.where}.{law.target}: is constant, so that it cannot depend on a state"
                )
        for name, formula in [*self.rates.items(), *self.starts.items()]:
            if not any(flexures) and formula.expression.free_symbols & {theta, theta_rate}:
                raise formula.error(
                    formula.node, "theta and theta_rate belong to a flexure: only flexure_torque has them"
                )
            if any(flexures) and name in self.two:
                raise formula.error(formula.node, "the state of a flexure is real: use abs, re or im")

    @property
    def states(self) -> tuple[LawState, ...]:
        """The states as an effect has them."""
        return tuple(
            LawState(
                name, self.units[name], formula.expression, self.starts[name].expression, name in self.two
            )
            for name, formula in self.rates.items()
        )


def _check_names(names: Sequence[str], coefficients: Collection[str], where: str) -> None:
    taken = {*coefficients, *RESERVED}
    for name in names:
        if not isinstance(name, str) or NAME.fullmatch(name) is None:
            raise InputError(
                f"{where}.states: {shortened(repr(name))} is no name of a state; letters, digits and _ are allowed"
            )
        parts = {name, *(part.name for part in components(sp.Symbol(name, complex=True)))}
        if parts & taken:
            raise InputError(f"{where}.states.{name}: the name {min(parts & taken)} is taken; choose another")
        taken |= parts
