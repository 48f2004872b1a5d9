"""Torques as smooth functions of tilt, speed and temperature: what a law is where nobody knows one.

A map is a sum of terms u^m conj(u)^n |u|^o T_k(s) w^l. Here u is the tilt over the largest one of the map, s the speed
and w the temperature, both scaled to -1 .. 1 over its range, and T_k a Chebyshev polynomial; o is 0 or 1. On the rotor
coefficients are complex, on the shaft the real part of such terms counts. Beyond its range a map keeps the values at
the edge. `coordinates` and `basis` are the one definition: simulation, torque balance and fit all evaluate them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

import numpy as np
import sympy as sp
from pydantic import AfterValidator, Field

from gyrowheel_core.errors import InputError
from gyrowheel_core.schema import Number, Section, Text, Whole, check, refuse
from gyrowheel_sim.effects.declaration import Coefficient, Effect, Law
from gyrowheel_sim.effects.quantities import Omega, T_coil, T_motor, z

Target = Literal["rotor_torque", "shaft_torque"]
#: What a map acts on, each with the temperature on which it may depend.
TARGETS: Mapping[Target, sp.Symbol] = {"rotor_torque": T_coil, "shaft_torque": T_motor}
#: Largest powers of tilt, mirrored tilt and |tilt|, order in speed and power of temperature that a file may have.
_MOST_ORDERS = (8, 8, 1, 9, 3)
_MOST_MODES = 200
#: Bounds of a coefficient, and its usual size without a better one [N m].
_BOUND, _USUAL = 1.0, (1e-4, 2e-3)
_LETTERS: Mapping[Target, tuple[str, str]] = {"rotor_torque": ("x", "y"), "shaft_torque": ("c", "s")}


def _grow(pair: tuple[float, float]) -> tuple[float, float]:
    if not 0.0 < pair[0] <= pair[1]:
        refuse(f"[{pair[0]:g}, {pair[1]:g}] is no range; allowed: 0 < low <= high")
    return pair


def _small(orders: tuple[int, ...]) -> tuple[int, ...]:
    if not all(0 <= own <= most for own, most in zip(orders, _MOST_ORDERS, strict=True)):
        refuse(f"{list(orders)} is out of range; allowed: 0 .. {list(_MOST_ORDERS)}")
    return orders


def _numbers(text: str) -> str:
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        refuse("a part of it is not a number; allowed: numbers with spaces between them")
    if not np.all(np.abs(values) < _BOUND):
        refuse(f"a number in it is out of range; allowed: -{_BOUND:g} .. {_BOUND:g}")
    return text


_Ends = Annotated[tuple[Number, Number], AfterValidator(_grow)]
_Orders = Annotated[tuple[Whole, Whole, Whole, Whole, Whole], AfterValidator(_small)]


@dataclass(frozen=True)
class MapRange:
    """Where a map holds: speeds [rad/s], largest tilt [rad], temperatures of coils and magnets [K]."""

    speed: tuple[float, float]
    tilt: float
    coils: tuple[float, float]
    magnets: tuple[float, float]

    def of(self, target: Target) -> tuple[float, float]:
        """Return the range of the temperature on which a torque may depend."""
        return self.coils if target == "rotor_torque" else self.magnets


@dataclass(frozen=True)
class MapTerm:
    """A term: its target; powers of tilt, mirrored tilt and |tilt|; order in speed, power of temperature."""

    target: Target
    forward: int
    backward: int
    odd: int
    speed: int
    temperature: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its coefficients: of the real part and, where there is one, of the imaginary part."""
        orders = f"{self.forward}{self.backward}{self.odd}_{self.speed}{self.temperature}"
        real, imaginary = (f"{letter}{orders}" for letter in _LETTERS[self.target])
        return (
            (real,) if self.target == "shaft_torque" and self.forward == self.backward else (real, imaginary)
        )

    @property
    def powers(self) -> tuple[int, int, int]:
        """Its powers of tilt, mirrored tilt and |tilt|."""
        return self.forward, self.backward, self.odd

    @property
    def orders(self) -> tuple[int, ...]:
        """Its powers and orders, in the order of the attributes."""
        return self.forward, self.backward, self.odd, self.speed, self.temperature


def chebyshev(order: int, s: Any) -> Any:
    """Return the Chebyshev polynomial of an order at a number, array or expression."""
    before, now = 1.0 + 0.0 * s, s
    if order == 0:
        return before
    for _ in range(order - 1):
        before, now = now, 2 * s * now - before
    return now


def basis(term: MapTerm, u: Any, mirrored: Any, size: Any, s: Any, w: Any) -> Any:
    """Return the function of a term at `coordinates`, numbers, arrays or expressions alike."""
    value = u**term.forward * mirrored**term.backward * size**term.odd * w**term.temperature
    return value * chebyshev(term.speed, s) if term.speed else value


def _scaled(value: Any, low: float, high: float) -> Any:
    """Return the expression that takes a range to -1 .. 1, and keeps to that; 0 where the range is empty."""
    if not high > low:
        return sp.S.Zero
    return sp.Max(-1, sp.Min(1, (value - sp.Float(0.5 * (low + high))) / sp.Float(0.5 * (high - low))))


def coordinates(within: MapRange, target: Target) -> tuple[sp.Expr, ...]:
    """Return tilt u, mirrored tilt, |u|, speed s and temperature w of a map, by the quantities of the bench."""
    size, most = sp.sqrt(z * sp.conjugate(z)), sp.Float(within.tilt)
    u = z / sp.Max(size, most)
    speed, temperature = _scaled(Omega, *within.speed), _scaled(TARGETS[target], *within.of(target))
    return u, sp.conjugate(u), sp.Min(size / most, 1), speed, temperature


@functools.lru_cache(maxsize=64)
def _coordinates_of(within: MapRange, target: Target) -> Callable[..., Any]:
    return sp.lambdify([z, Omega, TARGETS[target]], coordinates(within, target), modules="numpy")


def values_at(
    terms: Sequence[MapTerm], within: MapRange, quantities: Mapping[str, Any]
) -> list[tuple[MapTerm, Any]]:
    """Return every term with its function at the quantities of the bench, arrays by name; complex on the shaft too."""
    found: dict[Target, tuple[Any, ...]] = {}
    result = []
    for term in terms:
        if term.target not in found:
            at = (quantities["z"], quantities["Omega"], quantities[TARGETS[term.target].name])
            found[term.target] = tuple(_coordinates_of(within, term.target)(*at))
        result.append((term, basis(term, *found[term.target])))
    return result


@dataclass(frozen=True)
class TorqueMap(Effect):
    """An effect whose law is a map.

    Attributes
    ----------
    terms : tuple of MapTerm
        Its terms.
    within : MapRange
        Where it holds.
    modes : ndarray (modes, coefficients)
        Independent errors of the coefficients, each by one standard deviation, in the order of `coefficients` [N m].
    recordings : tuple of str
        From which it was made.
    """

    terms: tuple[MapTerm, ...] = ()
    within: MapRange = MapRange((0.0, 0.0), 0.0, (0.0, 0.0), (0.0, 0.0))
    modes: tuple[tuple[float, ...], ...] = field(default=(), hash=False, compare=False, repr=False)
    recordings: tuple[str, ...] = ()

    @property
    def formula(self) -> str:
        """The law in short: its terms are many."""
        number = len(self.coefficients)
        return f"torque = map(z, Omega, T) with {number} coefficients"

    def law_at(self, index: int, values: Mapping[str, Any]) -> Any:
        """Return law number `index` at quantities and coefficients, arrays or numbers by name."""
        target = self.laws[index].target
        total: Any = 0.0
        for term, own in values_at([t for t in self.terms if t.target == target], self.within, values):
            total = total + _amplitude(term, values) * own
        return total if target == "rotor_torque" else np.real(total)


def _amplitude(term: MapTerm, values: Mapping[str, Any]) -> Any:
    """Return the complex coefficient of a term; its imaginary part is subtracted where real parts are taken."""
    parts = [values[name] for name in term.names]
    if len(parts) == 1:
        return parts[0]
    unit = 1j if term.target == "rotor_torque" else -1j
    return parts[0] + unit * parts[1]


def _law(target: Target, terms: Sequence[MapTerm], within: MapRange) -> Law:
    at = coordinates(within, target)
    unit = sp.I if target == "rotor_torque" else -sp.I
    total: dict[tuple[int, int, int], sp.Expr] = {}
    for term in terms:
        parts = [sp.Symbol(name, real=True) for name in term.names]
        size = parts[0] if len(parts) == 1 else parts[0] + unit * parts[1]
        of_speed = basis(replace(term, forward=0, backward=0, odd=0), *at)
        key = term.powers
        total[key] = total.get(key, sp.S.Zero) + size * of_speed
    law = sp.Add(*(own * basis(MapTerm(target, *key, speed=0), *at) for key, own in total.items()))
    return Law(target, law if target == "rotor_torque" else sp.re(law, evaluate=False))


def torque_map(
    name: str,
    terms: Sequence[MapTerm],
    within: MapRange,
    *,
    sizes: Mapping[str, float] | None = None,
    modes: Sequence[Sequence[float]] = (),
    recordings: Sequence[str] = (),
) -> TorqueMap:
    """Return the effect of a map; `sizes` are usual magnitudes of its coefficients by name [N m]."""
    known = sizes or {}
    coefficients = []
    for term in terms:
        for own in term.names:
            size = known.get(own, 0.0)
            usual = (size / 3.0, size * 3.0) if size > 0.0 else _USUAL
            coefficients.append(
                Coefficient(own, "N*m", _words(term), usual, (-_BOUND, _BOUND), "fitted", signed=True)
            )
    targets: list[Target] = [target for target in TARGETS if any(t.target == target for t in terms)]
    return TorqueMap(
        name=name,
        title="correction map",
        category="other",
        sentence="A torque as a smooth function of tilt, speed and temperature, where no law is known.",
        laws=tuple(_law(target, [t for t in terms if t.target == target], within) for target in targets),
        coefficients=tuple(coefficients),
        validity="the range of its recordings",
        source="fitted to recordings",
        terms=tuple(terms),
        within=within,
        modes=tuple(tuple(float(v) for v in mode) for mode in modes),
        recordings=tuple(recordings),
    )


def _words(term: MapTerm) -> str:
    place = "rotor" if term.target == "rotor_torque" else "shaft"
    return f"torque on the {place}: orders {' '.join(map(str, term.orders))}"


class _MapFile(Section):
    """A map in a model file."""

    speed: _Ends
    tilt: Annotated[Number, Field(gt=0.0, le=1.0)]
    coils: _Ends
    magnets: _Ends
    terms: Annotated[dict[Target, list[_Orders]], Field(min_length=1)]
    modes: Annotated[list[Annotated[str, AfterValidator(_numbers)]], Field(max_length=_MOST_MODES)] = Field(
        default_factory=list
    )
    recordings: Annotated[list[Text], Field(max_length=100)] = Field(default_factory=list)


class _Declaration(Section):
    map: _MapFile


def map_from_mapping(name: str, mapping: Mapping[str, Any], where: str) -> TorqueMap:
    """Return the map of a declaration ``{map: {...}}`` in a model file.

    Raises
    ------
    InputError
        If a field is missing, unknown, wrong or out of range.
    """
    given = check(_Declaration, mapping, where, separator=".").map
    terms = [MapTerm(target, *orders) for target, every in given.terms.items() for orders in every]
    if len(set(terms)) < len(terms) or not terms:
        raise InputError(f"{where}.map.terms: {'a term is given twice' if terms else 'empty'}")
    count = sum(len(term.names) for term in terms)
    modes = [[float(part) for part in line.split()] for line in given.modes]
    for number, mode in enumerate(modes):
        if len(mode) != count:
            raise InputError(
                f"{where}.map.modes.{number}: {len(mode)} numbers; allowed: {count}, one a coefficient"
            )
    within = MapRange(given.speed, given.tilt, given.coils, given.magnets)
    return torque_map(name, terms, within, modes=modes, recordings=given.recordings)


def map_to_mapping(effect: TorqueMap) -> dict[str, Any]:
    """Return the declaration of a map, which `map_from_mapping` reads back."""
    within = effect.within
    terms: dict[str, list[list[int]]] = {}
    for term in effect.terms:
        terms.setdefault(term.target, []).append(list(term.orders))
    return {
        "map": {
            "speed": list(within.speed),
            "tilt": within.tilt,
            "coils": list(within.coils),
            "magnets": list(within.magnets),
            "terms": terms,
            "modes": [" ".join(f"{value:.3g}" for value in mode) for mode in effect.modes],
            "recordings": list(effect.recordings),
        }
    }
