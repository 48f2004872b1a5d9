"""Terms that may be missing in a model, values of the unknowns of a fit, and the result of one."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import Effect, EffectValues, physical, registry
from gyrowheel_sim.effects.registry import for_bench

#: Bench parameters whose error is a separate finding: {finding: groups that move by one common factor}.
ERRORS: dict[str, tuple[str, ...]] = {
    "stiffness_error": ("flexure_stiffness_x", "flexure_stiffness_y"),
    "gimbal_inertia_error": ("gimbal_inertia",),
    "shaft_inertia_error": ("shaft_inertia",),
    "rotor_inertia_error": ("rotor_inertia_z",),
    "coil_gain_error": ("coil_constant",),
    "motor_constant_error": ("motor_constant",),
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
    """Return every physical effect, as usual on a bench, and every parameter error that can be a finding."""
    effects = [Term(name, for_bench(effect, bench)) for name, effect in physical().items()]
    return effects + [Term(name) for name in parameter_errors(bench)]


def is_instrument(term: Term) -> bool:
    """Whether a term is an instrument that is not as stated."""
    return term.effect is not None and term.effect.category == "instrument"


def instrument_terms() -> list[Term]:
    """Return every instrument that may not be as stated; its size is the same on every bench."""
    return [Term(name, effect) for name, effect in registry().items() if is_instrument(Term(name, effect))]


Array = NDArray[np.float64]


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
        {term: {coefficient: value}}; a registered effect, or one of the model, may be here without being among `terms`.
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
