"""Terms, unknowns with their priors, their values, and the result of a fit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import ActiveEffect
from gyrowheel_analysis.criteria import UNCONSTRAINED
from gyrowheel_analysis.reduction.motor_temperature import MOTOR_THERMAL
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import Effect, EffectValues, physical, registry, remembering
from gyrowheel_sim.effects.registry import for_bench
from gyrowheel_sim.effects.targets import INSTRUMENT_PARAMETERS
from gyrowheel_sim.effects.torque_map import TorqueMap
from gyrowheel_sim.parameter import Parameter, physical_range

#: Bench parameters whose error is a separate finding: {finding: groups that move by one common factor}.
ERRORS: dict[str, tuple[str, ...]] = {
    "stiffness_error": ("flexure_stiffness_x", "flexure_stiffness_y"),
    "gimbal_inertia_error": ("gimbal_inertia",),
    "shaft_inertia_error": ("shaft_inertia",),
    "rotor_inertia_error": ("rotor_inertia_z",),
    "transverse_inertia_error": ("rotor_inertia_transverse",),
    "coil_gain_error": ("coil_constant",),
    "motor_constant_error": ("motor_constant",),
    "motor_resistance_error": ("motor_resistance",),
}


@dataclass(frozen=True)
class Term:
    """A term of a fit besides the nuisance parameters: an effect, or the error of a bench parameter."""

    name: str
    effect: Effect | None = None

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Names of the free coefficients; the error of a parameter has one, its relative deviation."""
        return tuple(c.name for c in self.effect.coefficients) if self.effect else ("relative_error",)

    @property
    def amplitudes(self) -> tuple[str, ...]:
        """Names of the coefficients for which zero means no effect."""
        return tuple(c.name for c in self.effect.amplitudes) if self.effect else ("relative_error",)


def parameter_errors(bench: Bench) -> list[str]:
    """Return the errors of bench parameters that can be a finding: a parameter stated as exact has none."""
    uncertain = bench.groups()
    return [name for name, groups in ERRORS.items() if all(group in uncertain for group in groups)]


def candidate_terms(bench: Bench) -> list[Term]:
    """Return the effects without a memory, as sized on a bench, and the parameter errors that can be a finding."""
    effects = [Term(name, for_bench(effect, bench)) for name, effect in physical().items()]
    return effects + [Term(name) for name in parameter_errors(bench)]


def memory_terms(bench: Bench) -> list[Term]:
    """Return the effects with a memory, as sized on a bench."""
    return [Term(name, for_bench(effect, bench)) for name, effect in remembering().items()]


def is_instrument(term: Term) -> bool:
    """Whether a term is a deviation of an instrument."""
    return term.effect is not None and term.effect.category == "instrument"


def instrument_terms() -> list[Term]:
    """Return every possible deviation of an instrument; its size is the same on every bench."""
    return [Term(name, effect) for name, effect in registry().items() if is_instrument(Term(name, effect))]


Array = NDArray[np.float64]


class Prior(NamedTuple):
    """A normal prior of a parameter, in its SI unit."""

    mean: float
    deviation: float


def without_prior(value: float, error: float, prior: Prior | None) -> tuple[float, float] | None:
    """Return estimate and standard error that the data alone give of a parameter with a prior.

    None where it has no prior, or the data do not determine it: more than `UNCONSTRAINED` of the prior is left.
    """
    if prior is None or error >= UNCONSTRAINED * prior.deviation:
        return None
    variance = 1.0 / (1.0 / error**2 - 1.0 / prior.deviation**2)
    return variance * (value / error**2 - prior.mean / prior.deviation**2), math.sqrt(variance)


@dataclass(frozen=True)
class Point:
    """A value for every unknown.

    Attributes
    ----------
    terms : tuple of Term
        Terms in addition to the model.
    nuisance : ndarray (q,)
        Deviations from the stated values in stated uncertainties: of the bench parameters, then of the coefficients of
        the model's effects.
    coefficients : dict
        {term: {coefficient: value}}; effects that are registered or in the model may be here without being `terms`.
    """

    terms: tuple[Term, ...]
    nuisance: Array
    coefficients: EffectValues


@dataclass(frozen=True)
class Fit(Point):
    """Result of a fit.

    Attributes
    ----------
    terms, nuisance, coefficients
        The best values, see `Point`.
    chi2 : float
        Weighted sum of squares of the rows plus that of the deviations of parameters with a prior.
    chi2_rows : float
        The part of the rows alone.
    covariance : ndarray
        Of all unknowns: the nuisance deviations, then the coefficients in the order of `columns`.
    columns : list of (term, coefficient)
        Term and coefficient of the unknowns after the nuisance ones.
    residual : ndarray (N,)
        Rows measured minus predicted.
    pull : ndarray (unknowns,)
        Deviation of every unknown from its prior, in prior deviations; 0 where it has none.
    jacobian : ndarray (N, unknowns)
        Derivatives of the predicted rows.
    """

    chi2: float
    chi2_rows: float
    covariance: Array
    columns: list[tuple[str, str]]
    residual: Array
    pull: Array
    jacobian: Array = field(repr=False)

    @property
    def point(self) -> Point:
        """The best values alone."""
        return Point(self.terms, self.nuisance, self.coefficients)

    def standard_error(self, term: str, coefficient: str) -> float:
        """Return the standard error of one coefficient."""
        index = len(self.nuisance) + self.columns.index((term, coefficient))
        return float(np.sqrt(self.covariance[index, index]))

    def significance(self, term: str) -> float:
        """Return the magnitude of a term's amplitudes in standard errors (square root of its Wald statistic)."""
        names = [c for t in self.terms if t.name == term for c in t.amplitudes]
        index = [len(self.nuisance) + self.columns.index((term, name)) for name in names]
        values = np.array([self.coefficients[term][name] for name in names])
        return float(np.sqrt(values @ np.linalg.solve(self.covariance[np.ix_(index, index)], values)))


#: Bench parameters that are estimated in every fit, by the name of their group in the bench file.
NUISANCE_GROUPS = (
    "flexure_stiffness_x",
    "flexure_stiffness_y",
    "gimbal_inertia",
    "rotor_inertia_transverse",
    "rotor_inertia_z",
    "shaft_inertia",
    "flexure_damping_x",
    "flexure_damping_y",
    "bearing_coulomb",
    "bearing_viscous",
    "coil_constant",
    "motor_constant",
    "motor_resistance",
    *MOTOR_THERMAL,
    "fixed_torque_x",
    "fixed_torque_y",
    "tilt_bias_x",
    "tilt_bias_y",
    "tilt_scale",
    *INSTRUMENT_PARAMETERS,
)
_HELD = 1.0e4  # inverse prior deviation of an unknown that is fixed at its prior value
_INSIDE = 1.0 - 1.0e-9  # of the way to a limit, which rounding must not pass
_RELATIVE_ERROR_BOUNDS = (-0.9, 10.0)


def _deviations(value: float, size: float, limits: tuple[float, float]) -> tuple[float, float]:
    """Return between which multiples of a size a value stays within limits; one beyond them may stay."""
    low, high = limits
    return min((low - value) / size * _INSIDE, 0.0), max((high - value) / size * _INSIDE, 0.0)


class Unknowns:
    """The unknowns of a fit and their priors. Nothing here depends on a recording.

    Parameters
    ----------
    bench : Bench
        The bench as its file describes it: the stated values and uncertainties.
    known : EffectValues
        Effects that the model already has. A term of the same name replaces such an effect.
    known_errors : dict
        Standard errors of their coefficients; a coefficient without one is fixed.
    declared : dict of str to Effect
        Declarations of effects that are not registered.
    assumed : dict of str to float
        Uncertainty of readings that are assumed, not measured [SI], by the bench parameter that is their static error.
        It adds to the stated uncertainty of a parameter that is estimated anyway.

    Attributes
    ----------
    library : mapping of str to Effect
        The registered effects, with their usual sizes on the bench, and those declared. All other effects come with the
        terms of a `Point`.
    nuisances : list of (str, list of Parameter)
        The groups of uncertain bench parameters.
    count : int
        Number of nuisance unknowns: those groups, then the uncertain coefficients of the known effects.
    of_instruments : frozenset of int
        The numbers of parameters of instruments among them.
    memory : bool
        Whether registered effects with a memory may be missing, too.
    """

    memory = False

    def __init__(
        self,
        bench: Bench,
        known: EffectValues | None = None,
        known_errors: EffectValues | None = None,
        declared: Mapping[str, Effect] | None = None,
        assumed: Mapping[str, float] | None = None,
    ) -> None:
        self.bench = bench
        self.assumed = dict(assumed or {})
        self.declared = dict(declared or {})
        self.library: Mapping[str, Effect] = MappingProxyType(
            {name: for_bench(effect, bench) for name, effect in registry().items()} | self.declared
        )
        self.known = {name: dict(values) for name, values in (known or {}).items()}
        self.known_errors = {name: dict(errors) for name, errors in (known_errors or {}).items()}
        #: Uncertain coefficients of known effects: effect, coefficient, standard error. Those of a map err together, so
        #: it has its independent errors in their place.
        self.loose: list[tuple[str, str, float]] = []
        for name, errors in self.known_errors.items():
            if name in self.known:
                effect = self.library.get(name)
                if isinstance(effect, TorqueMap):
                    self.loose += [(name, f"error {k}", 1.0) for k in range(1, len(effect.modes) + 1)]
                else:
                    self.loose += [(name, key, error) for key, error in errors.items() if error > 0.0]
        groups = bench.groups()
        wider = {
            name: replace(p, uncertainty=math.hypot(p.uncertainty, self.assumed[name]))
            for name, p in bench.parameters.items()
            if name in self.assumed and p.group in NUISANCE_GROUPS
        }
        self.nuisances: list[tuple[str, list[Parameter]]] = [
            (g, [wider.get(p.name, p) for p in groups[g]]) for g in NUISANCE_GROUPS if g in groups
        ]
        there = {group for group, _ in self.nuisances}
        self.nuisances += [
            (name, [replace(bench.parameters[name], uncertainty=size)])
            for name, size in self.assumed.items()
            if name not in there
        ]
        self.count = len(self.nuisances) + len(self.loose)
        self.of_instruments = frozenset(
            k for k, (group, _) in enumerate(self.nuisances) if group in INSTRUMENT_PARAMETERS
        )

    def on_bench(self, bench: Bench) -> Unknowns:
        """Return the same unknowns with the statements of another bench."""
        return Unknowns(bench, self.known, self.known_errors, self.declared, self.assumed)

    def with_memory(self) -> Unknowns:
        """Return the same unknowns where registered effects with a memory may be missing, too."""
        result = copy(self)
        result.memory = True
        return result

    def with_errors(self, name: str, errors: Mapping[str, float]) -> Unknowns:
        """Return the same unknowns and the coefficients of a known effect, with their standard errors."""
        known = {**self.known_errors, name: dict(errors)}
        return Unknowns(self.bench, self.known, known, self.declared, self.assumed)

    def stated(self, coefficients: EffectValues | None = None) -> Point:
        """Return all unknowns as stated, with given coefficients of registered effects or parameter errors."""
        return Point((), np.zeros(self.count), coefficients or {})

    def term(self, name: str) -> Term:
        """Return the term of a name: an effect of the library or the error of a bench parameter."""
        return Term(name) if name in ERRORS else Term(name, self.library[name])

    def values(self, point: Point) -> dict[str, float]:
        """Return the bench parameters at a point."""
        values = self.bench.values()
        for (_, parameters), u in zip(self.nuisances, point.nuisance[: len(self.nuisances)], strict=True):
            for p in parameters:
                values[p.name] = p.value + u * p.uncertainty
        for name, groups in ERRORS.items():
            if name in point.coefficients:
                for group, parameters in self.nuisances:
                    if group in groups:
                        for p in parameters:
                            values[p.name] += p.value * point.coefficients[name]["relative_error"]
        return values

    def effects(self, point: Point) -> list[ActiveEffect]:
        """Return all effects at a point with their coefficients: the known ones and those of the terms."""
        every = {t.name: t.effect for t in point.terms if t.effect is not None} | dict(self.library)
        present = {**self._known_at(point.nuisance), **point.coefficients}
        return [ActiveEffect(every[name], v) for name, v in present.items() if name in every]

    def _known_at(self, nuisance: Array) -> EffectValues:
        """Return the coefficients of the known effects for deviations `nuisance`."""
        known = {name: dict(v) for name, v in self.known.items()}
        for (name, key, error), u in zip(self.loose, nuisance[len(self.nuisances) :], strict=True):
            if key in known[name]:
                known[name][key] += u * error
            elif u != 0.0:
                effect = self.library[name]
                assert isinstance(effect, TorqueMap)  # its errors have names of their own
                mode = effect.modes[int(key.split()[1]) - 1]
                for c, change in zip(effect.coefficients, mode, strict=True):
                    known[name][c.name] += u * change
        return known

    def of_known(self, nuisance: Array, place: int) -> tuple[Effect, dict[str, float]]:
        """Return the known effect to which a nuisance unknown belongs, and its coefficients for deviations."""
        name, _, _ = self.loose[place - len(self.nuisances)]
        return self.library[name], self._known_at(nuisance)[name]

    def moved(self, nuisance: Array) -> dict[tuple[str, str], float]:
        """Return the change of each coefficient of the known effects, in its standard errors."""
        names = [(name, key) for name, key, _ in self.loose]
        return dict(zip(names, nuisance[len(self.nuisances) :].tolist(), strict=True))

    def present(self, term: Term, point: Point) -> dict[str, float] | None:
        """Return the coefficients of a term at a point; None if it is absent."""
        if term.name in point.coefficients:
            return point.coefficients[term.name]
        return self._known_at(point.nuisance).get(term.name)

    def candidates(self) -> list[Term]:
        """Return every term that may be missing: effects, instruments, and errors of parameters that can be a finding.

        Effects of the model are included, as their coefficients may be wrong: as terms they replace those of the model.
        A map is not: its coefficients mean nothing one by one, and what is left of it shows as anything else does.
        """
        own = [
            Term(name, self.library[name])
            for name in self.known
            if name not in registry() and not isinstance(self.library[name], TorqueMap)
        ]
        own += [Term(name, self.library[name]) for name in remembering() if self.memory or name in self.known]
        return candidate_terms(self.bench) + instrument_terms() + own

    def null(self, term: Term) -> dict[str, float]:
        """Return the coefficients for which a term changes nothing: those of an effect of the model itself."""
        if term.name in self.known:
            return dict(self.known[term.name])
        return term.effect.nulls() if term.effect else {"relative_error": 0.0}

    @staticmethod
    def scale(term: Term, name: str) -> float:
        """Return a large size of a coefficient: five times the usual amplitude, the uncertainty of a shape."""
        if term.effect is None:
            return 1.0
        c = next(c for c in term.effect.coefficients if c.name == name)
        return c.shape_uncertainty if c.shape is not None else 5.0 * c.usual[1]

    @staticmethod
    def bounds(term: Term, name: str) -> tuple[float, float]:
        """Return the range of a coefficient."""
        if term.effect is None:
            return _RELATIVE_ERROR_BOUNDS
        return next(c.bounds for c in term.effect.coefficients if c.name == name)

    def limits(self) -> tuple[Array, Array]:
        """Return the least and the largest nuisance unknowns (q,): those of values that a model file may hold."""
        found = [
            [_deviations(p.value, p.uncertainty, physical_range(p.name)) for p in group]
            for _, group in self.nuisances
        ]
        for name, key, error in self.loose:
            bounds = next((c.bounds for c in self.library[name].coefficients if c.name == key), None)
            found.append(
                [
                    (-math.inf, math.inf)
                    if bounds is None
                    else _deviations(self.known[name][key], error, bounds)
                ]
            )
        return (
            np.array([max(low for low, _ in own) for own in found]),
            np.array([min(high for _, high in own) for own in found]),
        )

    def prior(self, terms: Sequence[Term]) -> tuple[Array, list[tuple[str, str]]]:
        """Return the inverse prior deviations of all unknowns and the list of the coefficients among them.

        The error of a parameter has no prior. Where it equals the deviation of a single group, that deviation is fixed
        at zero, and likewise for deviations of instruments. Shapes keep the uncertainty of their declaration.
        """
        columns = [(t.name, name) for t in terms for name in t.coefficients]
        inverse = [1.0] * self.count
        places = {name: k for k, (name, _) in enumerate(self.nuisances)}
        for term in terms:
            for group in self._replaced(term):
                if group in places:
                    inverse[places[group]] = _HELD
            for name in term.coefficients:
                shape = term.effect is not None and name not in term.amplitudes
                inverse.append(1.0 / self.scale(term, name) if shape else 0.0)
        return np.array(inverse), columns

    def same_as(self, term: Term) -> dict[str, tuple[int, float]]:
        """Return the nuisance unknowns that equal coefficients of a term: a deviation of an instrument.

        By coefficient, the number of the unknown and its unit [unit of the coefficient]; empty where one of the
        coefficients has no such unknown.
        """
        if not is_instrument(term) or term.effect is None:
            return {}
        places = {name: (k, own[0].uncertainty) for k, (name, own) in enumerate(self.nuisances)}
        found = {str(law.expression): places[law.target] for law in term.effect.laws if law.target in places}
        return found if set(found) == set(term.coefficients) else {}

    @staticmethod
    def _replaced(term: Term) -> tuple[str, ...]:
        """Return the groups of bench parameters whose deviations equal the coefficients of a term."""
        if term.effect is None:
            groups = ERRORS[term.name]
            return groups if len(groups) == 1 else ()
        return tuple(law.target for law in term.effect.laws if law.target in INSTRUMENT_PARAMETERS)

    def centre(self, terms: Sequence[Term]) -> Array:
        """Return the prior centre of all unknowns."""
        return np.concatenate(
            [np.zeros(self.count), [self.null(t)[n] for t in terms for n in t.coefficients]]
        )

    def widths(self, terms: Sequence[Term]) -> Array:
        """Return a large prior deviation of every unknown."""
        return np.array([1.0] * self.count + [self.scale(t, n) for t in terms for n in t.coefficients])
