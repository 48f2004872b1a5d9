"""Cost of an estimation: chi-squared of rows and priors, its minimum and its second derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.fitting.fit import Point, Prior, Term
from gyrowheel_analysis.fitting.noise import Noise
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_core.errors import InputError

Array = NDArray[np.float64]

#: Relative change of the cost at which a minimum is found.
_TOLERANCE = 1e-12
#: Relative change at which it is good enough to start from, or to compare.
ROUGH = 1e-9
#: Evaluations of a minimum at most.
_EVALUATIONS = 60
#: The losses of `scipy.optimize.least_squares`, as functions of the squared residual.
LOSSES: dict[str, Callable[[Array], Array]] = {
    "linear": lambda z: z,
    "soft_l1": lambda z: 2.0 * (np.sqrt(1.0 + z) - 1.0),
    "huber": lambda z: np.where(z <= 1.0, z, 2.0 * np.sqrt(z) - 1.0),
    "cauchy": np.log1p,
}


class Unknown(NamedTuple):
    """An unknown of the fit [SI]: value = offset + size times the fitted number.

    `centre` and `width` are a generous prior where it has none.
    """

    name: str
    offset: float
    size: float
    unit: str
    start: float
    prior: Prior | None
    bounds: tuple[float, float]
    centre: float
    width: float


class Minimum(NamedTuple):
    """A minimum of a cost: values of the free parameters [SI], cost, and which of them lie at a bound."""

    values: Array
    cost: float
    at_bound: frozenset[int]


class Cost:
    """Chi-squared of rows and priors as a function of the free parameters [SI].

    Parameters
    ----------
    problem : Problem
        Rows and noise.
    terms : sequence of Term
        The effects of the model.
    unknowns : sequence of Unknown
        All unknowns in the order of the fit.
    free : sequence of int
        Which of them are free.
    loss : Loss
        Weight of large residuals.
    """

    def __init__(
        self,
        problem: Problem,
        terms: Sequence[Term],
        unknowns: Sequence[Unknown],
        free: Sequence[int],
        loss: str,
    ) -> None:
        self.problem, self.terms, self.loss = problem, tuple(terms), loss
        self.unknowns, self._free = tuple(unknowns), list(free)
        self.free = tuple(unknowns[k] for k in free)
        self._every = np.array([u.start for u in unknowns])
        self._offset, self._size = np.array([(u.offset, u.size) for u in unknowns]).T
        self._columns = [(t.name, name) for t in terms for name in t.coefficients]
        self._known = [k for k, u in enumerate(self.free) if u.prior is not None]
        self._prior = np.array([u.prior for u in self.free if u.prior is not None]).reshape(-1, 2)
        self.bounds = np.array([u.bounds for u in self.free]).reshape(-1, 2).T
        self.start = np.clip([u.start for u in self.free], *self.bounds)

    def point(self, values: Array) -> Point:
        """Return the unknowns of the fit for values of the free parameters."""
        every = self._every.copy()
        every[self._free] = values
        x = (every - self._offset) / self._size
        count = self.problem.count
        coefficients: dict[str, dict[str, float]] = {t.name: {} for t in self.terms}
        for (term, name), value in zip(self._columns, x[count:], strict=True):
            coefficients[term][name] = float(value)
        return Point(self.terms, x[:count], coefficients)

    def white(self, values: Array) -> Array:
        """Return the whitened residuals of the rows (N,)."""
        return self.problem.noise.whiten(self.problem.measured - self.problem.predict(self.point(values)))

    def residuals(self, values: Array) -> Array:
        """Return the whitened residuals of the rows, then the deviations from the priors in prior deviations."""
        pull = (values[self._known] - self._prior[:, 0]) / self._prior[:, 1]
        return np.concatenate([self.white(values), pull])

    def __call__(self, values: Array) -> float:
        """Return the cost: chi-squared of rows and priors, large residuals weighted by the loss."""
        return float(np.sum(LOSSES[self.loss](self.residuals(values) ** 2)))

    def slopes(
        self, function: Callable[[Array], Array], values: Array, steps: Array, which: Sequence[int]
    ) -> Array:
        """Return the derivatives of a function by some free parameters, by central differences within the bounds."""
        columns = []
        for k in which:
            low, high = values.copy(), values.copy()
            high[k], low[k] = np.clip([values[k] + steps[k], values[k] - steps[k]], *self.bounds[:, k])
            columns.append((function(high) - function(low)) / (high[k] - low[k]))
        return np.column_stack(columns)

    def jacobian(self, values: Array, steps: Array) -> Array:
        """Return the derivatives of `residuals` by the free parameters."""
        return self.slopes(self.residuals, values, steps, range(len(steps)))

    def minimum(
        self,
        start: Array,
        steps: Array,
        held: Mapping[int, float] | None = None,
        tolerance: float = _TOLERANCE,
    ) -> Minimum:
        """Return the minimum over the free parameters but those that are `held` at a value."""
        base = np.array(start, dtype=np.float64)
        for k, value in (held or {}).items():
            base[k] = value
        moving = [k for k in range(len(base)) if k not in (held or {})]
        if not moving:
            return Minimum(base, self(base), frozenset())
        size = steps[moving]

        def whole(part: Array) -> Array:
            every = base.copy()
            every[moving] = part * size
            return every

        def slopes(part: Array) -> Array:
            return self.slopes(self.residuals, whole(part), steps, moving) * size

        low, high = self.bounds[:, moving] / size
        start_at = np.clip(base[moving] / size, low, high)
        if not np.isfinite(self.residuals(whole(start_at))).all():
            raise InputError(
                "fit: the residual is not finite where the search begins; allowed: other values or bounds"
            )
        from scipy.optimize import least_squares  # takes long to load

        found = least_squares(
            lambda part: self.residuals(whole(part)),
            start_at,
            slopes,
            bounds=(low, high),
            loss=self.loss,
            ftol=tolerance,
            xtol=tolerance,
            gtol=tolerance,
            max_nfev=_EVALUATIONS,
        )
        values = whole(found.x)
        at_bound = {k: int(side > 0) for k, side in zip(moving, found.active_mask, strict=True) if side}
        for k, side in at_bound.items():
            values[k] = self.bounds[side, k]
        return Minimum(values, 2.0 * float(found.cost), frozenset(at_bound))

    def hessian(self, values: Array, steps: Array) -> Array:
        """Return half the second derivatives of the cost (p, p) at a minimum."""
        if self.loss != "linear":
            return _second_differences(self, values, steps)
        n = self.problem.measured.size
        jacobian, white = self.jacobian(values, steps), self.residuals(values)[:n]
        # what the curvature of the rows adds to the squares of their slopes
        curved = _second_differences(lambda x: 2.0 * float(white @ self.white(x)), values, steps)
        return np.asarray(jacobian.T @ jacobian + curved)


def _second_differences(function: Callable[[Array], float], at: Array, steps: Array) -> Array:
    """Return half the second derivatives of a function by central differences."""
    middle = function(at)
    unit = np.diag(steps)
    alone = [function(at + own) + function(at - own) - 2.0 * middle for own in unit]
    result = np.diag(alone)
    for i, own in enumerate(unit):
        for j, other in enumerate(unit[:i]):
            both = function(at + own + other) + function(at - own - other) - 2.0 * middle
            result[i, j] = result[j, i] = 0.5 * (both - alone[i] - alone[j])
    return np.asarray(0.5 * result / np.outer(steps, steps))


def log_determinant(noise: Noise) -> float:
    """Return the logarithm of the determinant of the covariance of the rows."""
    averages = sum(c.log_determinant(noise.scales[drift]) for own in noise.averages for c, drift in own)
    return float(averages + 2.0 * sum(np.log(own).sum() for own in noise.amplitudes))
