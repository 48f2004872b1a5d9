"""Values of the unknowns of a fit, and the result of one."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.fitting.terms import Term
from gyrowheel_sim.effects import EffectValues

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Point:
    """A value for every unknown.

    Attributes
    ----------
    terms : tuple of Term
        What may be missing in the model and is in the prediction.
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
        What the unknowns after the nuisance ones are.
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
