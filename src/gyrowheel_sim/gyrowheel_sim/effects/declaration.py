"""Declarations of effects: laws, coefficients and all that is known about an effect."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import sympy as sp

from gyrowheel_core.units import require_unit
from gyrowheel_sim.effects.complex_parts import components, is_real
from gyrowheel_sim.effects.formula import to_text
from gyrowheel_sim.effects.grammar import RESERVED
from gyrowheel_sim.effects.quantities import QUANTITIES
from gyrowheel_sim.effects.targets import TARGETS

#: Coefficients of effects: {effect: {coefficient: value}}.
EffectValues: TypeAlias = dict[str, dict[str, float]]
Category = Literal[
    "air", "flexure", "gravity", "actuator", "sensor", "bearing", "motor", "inertia", "environment", "instrument",
    "other",
]  # fmt: skip


@dataclass(frozen=True)
class Coefficient:
    """One coefficient of an effect."""

    name: str  # name, unique in the effect
    unit: str  # SI unit
    description: str
    #: Range of the sizes met in practice (low, high); where `signed`, of the magnitude.
    usual: tuple[float, float]
    bounds: tuple[float, float]  # values that a user may type and a fit may search
    source: str  # where the usual size comes from
    signed: bool = False  # whether both signs occur
    #: For a coefficient that shapes the law (an exponent): its usual value, about which the law is
    #: linearised; None for an amplitude, in which the law is linear and zero means no effect.
    shape: float | None = None
    shape_uncertainty: float = 0.0  # standard uncertainty of `shape` before a measurement
    #: Values that physics allows (low, high), narrower than `bounds`. None: an amplitude that is not `signed`
    #: only brakes, resists or heats and cannot be below zero; any other coefficient has no limit.
    possible: tuple[float, float] | None = None
    possible_source: str = ""  # reason for `possible`

    @property
    def physical(self) -> tuple[float, float]:
        """Physically possible values (low, high), infinite where there is no limit."""
        if self.possible is not None:
            return self.possible
        return (-math.inf if self.signed or self.shape is not None else 0.0, math.inf)

    @property
    def why_possible(self) -> str:
        """Reason for the limits of `physical`; empty without limits."""
        if self.possible is not None:
            return self.possible_source
        return (
            "of the other sign it would drive what it brakes, resists or delays"
            if self.physical[0] == 0.0
            else ""
        )

    @property
    def symbol(self) -> sp.Symbol:
        """The symbol that stands for it in the law."""
        return sp.Symbol(self.name, real=True)

    @property
    def default(self) -> float:
        """Value used where none is given: the usual shape, or the geometric middle of the usual sizes."""
        return self.shape if self.shape is not None else math.sqrt(self.usual[0] * self.usual[1])

    @property
    def null(self) -> float:
        """Value of "no effect": zero for an amplitude, the usual shape otherwise."""
        return self.shape if self.shape is not None else 0.0


@dataclass(frozen=True)
class Law:
    """What an effect does: a SymPy expression and the target it acts on (see `gyrowheel_sim.effects.targets`)."""

    target: str
    expression: sp.Expr


@dataclass(frozen=True)
class LawState:
    """A state of an effect, by which its laws remember what was before.

    Attributes
    ----------
    name : str
        Its name in the laws.
    unit : str
        SI unit.
    rate : sympy expression
        Its derivative by time: of quantities, coefficients and states.
    start : sympy expression
        Its value at the first sample: of quantities and coefficients.
    complex : bool
        Whether it is x + i y in case axes.
    """

    name: str
    unit: str
    rate: sp.Expr
    start: sp.Expr = sp.S.Zero
    complex: bool = False

    @property
    def symbol(self) -> sp.Symbol:
        """The symbol that stands for it in laws and rates."""
        return sp.Symbol(self.name, complex=True) if self.complex else sp.Symbol(self.name, real=True)


@dataclass(frozen=True)
class Effect:
    """A physical effect: laws, coefficients, validity, source."""

    #: Canonical name, one-line title, and category.
    name: str
    title: str
    category: Category
    sentence: str  # the physics in one sentence
    laws: tuple[Law, ...]  # what it does
    coefficients: tuple[Coefficient, ...]  # its coefficients, amplitudes first
    validity: str  # where the law holds
    source: str  # where the law comes from
    #: Effects (or bench errors) with a similar signature, each with the test that separates them.
    look_alikes: Mapping[str, str] = field(default_factory=dict, hash=False)
    #: Largest possible size of the amplitudes together, the root of the sum of their squares: for the
    #: components of one vector. None where there is no limit.
    greatest: float | None = None
    directions: tuple[str, str] | None = None
    states: tuple[LawState, ...] = ()  # what the laws remember

    def __post_init__(self) -> None:
        """Refuse a declaration that contradicts itself."""
        names = [c.name for c in self.coefficients]
        if len(set(names)) != len(names) or not names:
            raise ValueError(f"effect {self.name}: coefficients need distinct names")
        if taken := set(names) & RESERVED:
            raise ValueError(f"effect {self.name}: a coefficient has the name {min(taken)}, which is taken")
        taken = {*names, *RESERVED}
        for state in self.states:
            own = {state.name, *(part.name for part in components(state.symbol))}
            if own & taken:
                raise ValueError(
                    f"effect {self.name}: a state has the name {min(own & taken)}, which is taken"
                )
            taken |= own
        known = {q.symbol for q in QUANTITIES.values()} | {c.symbol for c in self.coefficients}
        remembered = {state.symbol for state in self.states}
        expressions = [(law.expression, known | remembered) for law in self.laws]
        expressions += [(state.rate, known | remembered) for state in self.states]
        expressions += [(state.start, known) for state in self.states]
        for expression, allowed in expressions:
            if stray := expression.free_symbols - allowed:
                raise ValueError(f"effect {self.name}: unknown symbols {sorted(map(str, stray))}")
        for law in self.laws:
            if law.target not in TARGETS:
                raise ValueError(f"effect {self.name}: unknown target {law.target}")
        self._check_states()
        for c in self.coefficients:
            require_unit(c.unit)
            low, high = c.physical
            if not low <= c.null <= high:
                raise ValueError(f"effect {self.name}: {c.name}: what is possible leaves out {c.null:g}")

    def _check_states(self) -> None:
        flexures = {TARGETS[law.target].each_flexure for law in self.laws}
        for state in self.states:
            require_unit(state.unit)
            if len(flexures) > 1:
                raise ValueError(
                    f"effect {self.name}: a law of the flexures and another one cannot share a state"
                )
            if state.complex and flexures == {True}:
                raise ValueError(f"effect {self.name}: {state.name}: the state of a flexure is real")
            if not state.complex and not (is_real(state.rate) and is_real(state.start)):
                raise ValueError(f"effect {self.name}: {state.name}: its rate or start is complex")

    def sentence_for(self, values: Mapping[str, float]) -> str:
        """Return the physics in one sentence for coefficients of some sign."""
        if self.directions is None:
            return self.sentence
        return self.directions[values[self.amplitudes[0].name] > 0.0]

    @property
    def amplitudes(self) -> tuple[Coefficient, ...]:
        """The coefficients in which the law is linear; all zero means no effect."""
        return tuple(c for c in self.coefficients if c.shape is None)

    @property
    def shapes(self) -> tuple[Coefficient, ...]:
        """The coefficients that shape the law (exponents)."""
        return tuple(c for c in self.coefficients if c.shape is not None)

    def defaults(self) -> dict[str, float]:
        """Return a value for every coefficient: usual size and usual shape."""
        return {c.name: c.default for c in self.coefficients}

    def nulls(self) -> dict[str, float]:
        """Return the value of every coefficient that means no effect."""
        return {c.name: c.null for c in self.coefficients}

    @property
    def formula(self) -> str:
        """The laws as one line of text, which `formula.read` reads back law by law; rates of states follow."""
        parts = [f"{law.target} = {to_text(law.expression)}" for law in self.laws]
        for state in self.states:
            parts.append(f"d({state.name})/dt = {to_text(state.rate)}")
            if state.start != 0:
                parts.append(f"{state.name}(0) = {to_text(state.start)}")
        return "; ".join(parts)

    @property
    def each_flexure(self) -> bool:
        """Whether each flexure has its own states, which follow its own angle and rate."""
        return all(TARGETS[law.target].each_flexure for law in self.laws)
