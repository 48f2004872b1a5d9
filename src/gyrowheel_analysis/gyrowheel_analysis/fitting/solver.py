"""Nonlinear least squares: Gauss-Newton steps, shortened where they fail.

It replaces `scipy.optimize.least_squares` because it finds the same minimum in a third to a fifth of the time
(`python -m benchmarks solver`): the derivatives by the bench parameters, most of the work, are kept from step to step.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.fitting.fit import Fit, Point, Term
from gyrowheel_analysis.fitting.noise import NOT_FINITE, Noise
from gyrowheel_analysis.fitting.prediction import Prediction
from gyrowheel_core.errors import InputError
from gyrowheel_sim.effects import EffectValues

Array = NDArray[np.float64]

_FAR = 5.0  # stated uncertainties after which the derivatives by the bench parameters are computed again
_BOLD_STEPS = 3
_WORTH = 5.0  # predicted gain in chi-squared from which on a step is followed uphill
#: Shares of a step that are tried: the whole one first, or the next larger one than that of the last step.
_SHORTENINGS = (1.0, 0.5, 0.2, 0.05, 0.01)
#: A fit creeps where a step is shortened to this number and gains less than this part of chi-squared: it ends.
_SHORT, _PROGRESS = 3, 1.0e-4
_HELD = 1.0e6  # inverse relative deviation of an unknown that is held
_GAIN = 1.0e-3  # in chi-squared: a step that gains less is the last one


@dataclass(frozen=True)
class Evaluated:
    """Prediction of a vector of unknowns, and its cost.

    `point` has the unknowns by name, `predicted` (N,) the rows; `white` (N,) is the whitened residual, `pull`
    (unknowns,) are the deviations from the priors. `chi2_rows` is the sum of squares of `white`, `chi2` that with the
    pulls; infinite where not finite.
    """

    point: Point
    predicted: Array
    white: Array
    pull: Array
    chi2_rows: float
    chi2: float


class Objective:
    """Chi-squared of recordings and priors as a function of the vector of all unknowns, those of `terms` included."""

    def __init__(self, prediction: Prediction, measured: Array, noise: Noise, terms: Sequence[Term]) -> None:
        self.prediction, self.measured, self.noise = prediction, measured, noise
        self.terms = tuple(terms)
        self.count = prediction.unknowns.count
        self.inverse, self.columns = prediction.unknowns.prior(self.terms)
        self.centre = prediction.unknowns.centre(self.terms)
        self._bounds = self._all_bounds()

    def holding(self, place: int, value: float) -> Objective:
        """Return the objective where one unknown is held at a value, without the cost of its prior."""
        result = copy(self)
        result.centre, result.inverse = self.centre.copy(), self.inverse.copy()
        result.centre[place], result.inverse[place] = value, _HELD / max(abs(value), 1e-300)
        return result

    def start(self, point: Point | None) -> Array:
        """Return the vector of a point, with the prior centre for missing coefficients; the prior centre for None."""
        x = self.centre.copy()
        if point is not None:
            x[: self.count] = point.nuisance
            for index, (term, name) in enumerate(self.columns):
                x[self.count + index] = point.coefficients.get(term, {}).get(name, x[self.count + index])
        return x

    def at(self, x: Array) -> Evaluated:
        """Return the prediction of the unknowns `x`, and its cost."""
        coefficients: EffectValues = {term.name: {} for term in self.terms}
        for (term, name), value in zip(self.columns, x[self.count :], strict=True):
            coefficients[term][name] = float(value)
        point = Point(self.terms, x[: self.count].copy(), coefficients)
        predicted = self.prediction.rows(point)
        white, pull = self.noise.whiten(self.measured - predicted), self.inverse * (x - self.centre)
        rows = float(white @ white)
        chi2 = rows + float(pull @ pull)
        return Evaluated(point, predicted, white, pull, rows, chi2 if np.isfinite(chi2) else np.inf)

    def nuisance_jacobian(self, at: Evaluated, before: Array | None = None) -> Array:
        """Return the derivatives of the rows by the nuisance unknowns, see `Prediction.nuisance_jacobian`."""
        return self.prediction.nuisance_jacobian(at.point, before)

    def jacobian(self, at: Evaluated, nuisance_jacobian: Array) -> Array:
        """Return the derivatives of the rows by all unknowns, given those by the nuisance unknowns."""
        parts = [nuisance_jacobian]
        parts += [self.prediction.term_jacobian(t, at.point) for t in self.terms]
        return np.hstack(parts)

    def design(self, jacobian: Array) -> Array:
        """Return the whitened derivatives of rows and priors."""
        return np.vstack([self.noise.whiten(jacobian), np.diag(self.inverse)])

    def _all_bounds(self) -> tuple[Array, Array]:
        pairs = [self.prediction.unknowns.bounds(t, name) for t in self.terms for name in t.coefficients]
        low, high = self.prediction.unknowns.limits()
        return np.concatenate([low, [p[0] for p in pairs]]), np.concatenate([high, [p[1] for p in pairs]])

    def bounds(self) -> tuple[Array, Array]:
        """Return lower and upper bounds of all unknowns."""
        return self._bounds

    def within_bounds(self, x: Array) -> Array:
        """Return the nearest vector within the bounds."""
        return np.clip(x, *self._bounds)

    def to_bounds(self, x: Array, step: Array) -> Array:
        """Return the steps of nuisance unknowns that a step would take beyond their bounds to those; NaN for others."""
        low, high = (own[: self.count] - x[: self.count] for own in self._bounds)
        result = np.full(len(step), np.nan)
        own = step[: self.count]
        result[: self.count] = np.where(own < low, low, np.where(own > high, high, np.nan))
        return result


@dataclass(frozen=True)
class _Step:
    """A solved linear problem: derivatives, whitened design, norms of its columns, step, and predicted gain."""

    jacobian: Array
    design: Array
    size: Array
    step: Array
    predicted_gain: float


# a trial step may lead where the law of a coil needs an infinite voltage: its cost is infinite
@np.errstate(over="ignore", divide="ignore", invalid="ignore")
def solve(objective: Objective, x: Array, nuisance_jacobian: Array, *, iterations: int = 12) -> Fit:
    """Minimise an objective from `x` on, in at most so many iterations.

    The derivatives by the nuisance unknowns, `nuisance_jacobian` (N, q) at `x` or nearby, change little; they are
    computed again where one has moved far.

    Raises
    ------
    InputError
        If derivatives are not finite: the readings are absurd.
    """
    count = objective.count
    taken_at = x[:count].copy()
    at = objective.at(x)
    bold, begin = True, 0
    for _ in range(iterations):
        if np.abs(x[:count] - taken_at).max() > _FAR:
            nuisance_jacobian = objective.nuisance_jacobian(at, nuisance_jacobian)
            taken_at = x[:count].copy()
        linear = _linear(objective, x, at, nuisance_jacobian)
        for part in range(begin, len(_SHORTENINGS)):
            trial = objective.within_bounds(x + _SHORTENINGS[part] * linear.step)
            there = objective.at(trial)
            if there.chi2 <= at.chi2:
                break
            if bold and linear.predicted_gain > _WORTH and np.abs(linear.step[:count]).max() > 1.0:
                bold = False
                trial, there = _boldly(objective, trial, there, nuisance_jacobian)
                if there.chi2 <= at.chi2:
                    break
        else:
            break  # no step along this direction lowers chi-squared
        gain, x, at, begin = at.chi2 - there.chi2, trial, there, max(part - 1, 0)
        if gain < _GAIN * max(1.0, 1e-3 * at.chi2) or (part >= _SHORT and gain < _PROGRESS * at.chi2):
            break
    scaled = linear.design / linear.size
    if not np.isfinite(scaled).all():
        raise InputError(NOT_FINITE)
    covariance = np.linalg.pinv(scaled.T @ scaled, rcond=1e-13) / np.outer(linear.size, linear.size)
    return Fit(
        objective.terms,
        at.point.nuisance,
        at.point.coefficients,
        at.chi2,
        at.chi2_rows,
        covariance,
        objective.columns,
        objective.measured - at.predicted,
        at.pull,
        linear.jacobian,
    )


def _linear(objective: Objective, x: Array, at: Evaluated, nuisance_jacobian: Array) -> _Step:
    """Return the Gauss-Newton step from `x` and the gain in chi-squared that the linear model predicts for it.

    A nuisance unknown that it would take beyond its bounds goes there, and the others make the best of it.
    """
    jacobian = objective.jacobian(at, nuisance_jacobian)
    design = objective.design(jacobian)
    # columns of very different size: scale before solving
    size = np.linalg.norm(design, axis=0)
    size[size == 0.0] = 1.0
    now = np.concatenate([at.white, -at.pull])
    if not (np.isfinite(design).all() and np.isfinite(now).all()):
        # absurd readings, or a bold step far off: no direction is better than another
        return _Step(jacobian, design, size, np.zeros(design.shape[1]), 0.0)
    scaled = design / size
    step, *_ = np.linalg.lstsq(scaled, now, rcond=1e-12)
    fixed = np.full(len(step), np.nan)
    while True:
        beyond = objective.to_bounds(x, step / size) * size
        if not (np.isfinite(beyond) & np.isnan(fixed)).any():
            break
        fixed = np.where(np.isnan(fixed), beyond, fixed)
        free = np.isnan(fixed)
        step = np.where(free, 0.0, fixed)
        step[free] = np.linalg.lstsq(scaled[:, free], now - scaled @ step, rcond=1e-12)[0]
    then = now - scaled @ step
    return _Step(jacobian, design, size, step / size, float(now @ now - then @ then))


def _boldly(objective: Objective, x: Array, at: Evaluated, before: Array) -> tuple[Array, Evaluated]:
    """Continue from the end of a whole step, uphill though it was, by whole steps with new derivatives.

    Where a scale factor is far off, chi-squared has a narrow curved valley. A whole step misses it and the next
    ones lead into it, while steps that are short enough to go downhill make no progress.
    """
    for _ in range(_BOLD_STEPS):
        if not np.isfinite(at.chi2):
            break
        columns = objective.nuisance_jacobian(at, before)
        x = objective.within_bounds(x + _linear(objective, x, at, columns).step)
        at = objective.at(x)
    return x, at


_MOST_CHANGES = 10  # of the fixed unknowns, for each


def bounded(design: Array, target: Array, low: Array, high: Array) -> Array:
    """Return the least-squares solution (n,) between bounds, each `low` at most as large as its `high`.

    Unknowns at a bound are fixed there, the others make the best of it, until no fixed one would rather come back.
    """
    gram, along = design.T @ design, design.T @ target
    x, free = np.clip(0.0, low, high), np.ones(len(low), dtype=bool)
    for _ in range(_MOST_CHANGES * len(x)):
        step = np.zeros(len(x))
        step[free] = np.linalg.lstsq(gram[np.ix_(free, free)], (along - gram @ x)[free], rcond=1e-14)[0]
        # as far along the step as all bounds allow
        room = np.where(step > 0.0, high - x, low - x)
        parts = np.divide(room, step, out=np.full(len(x), np.inf), where=step != 0.0)
        if parts.min(initial=np.inf) < 1.0:
            first = int(parts.argmin())
            x = np.clip(x + parts[first] * step, low, high)
            x[first], free[first] = (high if step[first] > 0.0 else low)[first], False
            continue
        x = np.clip(x + step, low, high)
        slope = along - gram @ x
        inwards = np.where(free, 0.0, np.where(x >= high, -slope, slope))
        if not inwards.max(initial=0.0) > 1e-9 * max(float(np.abs(along).max(initial=0.0)), 1.0):
            break
        free[int(inwards.argmax())] = True
    return x
