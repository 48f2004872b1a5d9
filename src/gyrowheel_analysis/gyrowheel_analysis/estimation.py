"""Estimation of chosen parameters of a model: which are free, their priors and bounds; covariance, profile, contour.

The rows, their noise and their events are those of `add.add_effect`. What differs is that the user decides what is
estimated. The minimum is that of `scipy.optimize.least_squares`.
"""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, least_squares
from scipy.stats import chi2 as chi2_distribution

from gyrowheel_analysis.channels import LISTED
from gyrowheel_analysis.diagnosis.events import accepted, beside_events
from gyrowheel_analysis.fitting.fit import Point, Term
from gyrowheel_analysis.fitting.noise import Noise
from gyrowheel_analysis.fitting.preparation import Prepared, Progress, one_thread, prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model, Override
from gyrowheel_analysis.residuals.error_table import channel_parts, channel_values, channels_of
from gyrowheel_core.errors import InputError, nearest
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.parameter import physical_range

if TYPE_CHECKING:
    import pandas

Array = NDArray[np.float64]
#: Weight of large residuals: plain least squares, or one of SciPy's losses for noise with heavy tails.
Loss = Literal["linear", "soft_l1", "huber", "cauchy"]

#: Relative change of the cost at which a minimum is found, and at which it is good enough to start from or to compare.
_TOLERANCE = 1e-12
_ROUGH = 1e-9
#: Steps of central differences: in units of the unknowns before the standard errors are known, and in standard errors.
_FIRST_STEP = 1e-3
_STEP = 0.1
#: Evaluations of a minimum at most.
_EVALUATIONS = 60
#: Standard errors to which the ends of a profile are searched.
_REACH = 30.0
#: Part of the prior deviation from which on the data do not determine a parameter.
_FROM_PRIOR = 0.995
#: The losses of `scipy.optimize.least_squares`, as functions of the squared residual.
_LOSSES: dict[str, Callable[[Array], Array]] = {
    "linear": lambda z: z,
    "soft_l1": lambda z: 2.0 * (np.sqrt(1.0 + z) - 1.0),
    "huber": lambda z: np.where(z <= 1.0, z, 2.0 * np.sqrt(z) - 1.0),
    "cauchy": np.log1p,
}


class Prior(NamedTuple):
    """A normal prior, in the SI unit of its parameter."""

    mean: float
    deviation: float


@dataclass(frozen=True)
class Parameter:
    """A parameter of an estimation, in SI units.

    Attributes
    ----------
    name : str
        ``EFFECT.COEFFICIENT``, or a parameter (group) of the bench.
    value, standard_error : float
        Estimate; the error of a fixed parameter is 0.
    unit : str
        SI unit.
    start : float
        Value in the model.
    free : bool
        Whether it was estimated.
    prior : Prior or None
        Its prior; None where the data alone decide.
    bounds : tuple of float
        Range to which it was limited.
    at_bound : bool
        Whether the estimate lies at a bound; its standard error then means little.
    data : tuple of float or None
        Estimate and standard error from the data alone, with the priors of all other parameters; None where it has no
        prior, and where the data do not determine it.
    """

    name: str
    value: float
    standard_error: float
    unit: str
    start: float
    free: bool
    prior: Prior | None = None
    bounds: tuple[float, float] = (-math.inf, math.inf)
    at_bound: bool = False
    data: tuple[float, float] | None = None


@dataclass(frozen=True)
class Matrix:
    """A symmetric matrix whose rows and columns have names.

    Attributes
    ----------
    names : tuple of str
        Names of the rows.
    values : ndarray (p, p)
        The numbers.
    """

    names: tuple[str, ...]
    values: Array

    def __getitem__(self, pair: tuple[str, str]) -> float:
        """Return the element of two names."""
        first, second = (self.names.index(name) for name in pair)
        return float(self.values[first, second])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        """Return the numbers, for functions of NumPy."""
        return np.array(self.values, dtype=dtype, copy=True if copy is None else copy)

    def to_columns(self) -> dict[str, Any]:
        """Return the rows as columns, the first of which has the names."""
        return {"parameter": list(self.names)} | {n: self.values[:, k] for k, n in enumerate(self.names)}

    def to_frame(self) -> pandas.DataFrame:
        """Return a data frame labelled by the names; it needs pandas."""
        import pandas as pd

        return pd.DataFrame(self.values, index=list(self.names), columns=list(self.names))


class _Unknown(NamedTuple):
    """An unknown of the fit: its name, SI value = offset + size times the fitted number, unit, prior, bounds [SI]."""

    name: str
    offset: float
    size: float
    unit: str
    start: float
    prior: Prior | None
    bounds: tuple[float, float]
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
    unknowns : sequence of _Unknown
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
        unknowns: Sequence[_Unknown],
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
        return float(np.sum(_LOSSES[self.loss](self.residuals(values) ** 2)))

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
        found = least_squares(
            lambda part: self.residuals(whole(part)),
            np.clip(base[moving] / size, low, high),
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


def _log_determinant(noise: Noise) -> float:
    """Return the logarithm of the determinant of the covariance of the rows."""
    averages = sum(c.log_determinant(noise.scales[drift]) for own in noise.averages for c, drift in own)
    return float(averages + 2.0 * sum(np.log(own).sum() for own in noise.amplitudes))


@dataclass(frozen=True)
class Estimation:
    """Outcome of `estimate`.

    Attributes
    ----------
    parameters : dict of str to Parameter
        All parameters by name, the free ones first.
    covariance : Matrix
        Covariance of the free parameters [SI]: the inverse of half the second derivatives of the cost.
    chi2, chi2_rows : float
        Cost: sum of squares of the whitened rows and of the deviations from the priors; of the rows alone.
    rows : int
        Number of rows N.
    degrees_of_freedom : int
        Rows and priors minus free parameters and events.
    channels : dict of str to (float, int)
        Sum of squares of the whitened rows, and their number, by channel.
    log_likelihood : float
        Of the rows at the estimate.
    log_evidence : float
        Log of the marginal likelihood by Laplace's approximation. A parameter without a prior counts as one with the
        width of `fitting.unknowns.Unknowns.scale`.
    loss : str
        Weight of large residuals.
    recordings : tuple of str
        Their paths.
    fitted : Model
        The model with the estimates, and an entry in its history.
    """

    parameters: dict[str, Parameter]
    covariance: Matrix
    chi2: float
    chi2_rows: float
    rows: int
    degrees_of_freedom: int
    channels: dict[str, tuple[float, int]]
    log_likelihood: float
    log_evidence: float
    loss: str
    recordings: tuple[str, ...]
    fitted: Model
    _cost: Cost = field(repr=False)
    _prepared: Prepared = field(repr=False)

    @property
    def names(self) -> list[str]:
        """Names of the free parameters, in the order of `covariance`."""
        return [name for name, own in self.parameters.items() if own.free]

    @property
    def values(self) -> Array:
        """Estimates of the free parameters [SI]."""
        return np.array([self.parameters[name].value for name in self.names])

    @property
    def correlation(self) -> Matrix:
        """Correlation of the free parameters."""
        deviation = np.sqrt(np.diag(self.covariance.values))
        return Matrix(self.covariance.names, self.covariance.values / np.outer(deviation, deviation))

    @property
    def aic(self) -> float:
        """Akaike's criterion: cost, minus twice the log likelihood's constant, plus two a free parameter."""
        return self._deviance + 2.0 * len(self.names)

    @property
    def bic(self) -> float:
        """Schwarz's criterion: the same with log N a free parameter, N the rows and priors."""
        priors = sum(own.prior is not None for own in self.parameters.values() if own.free)
        return self._deviance + math.log(self.rows + priors) * len(self.names)

    def evidence_over(self, other: Estimation) -> float:
        """Return the natural log of the Bayes factor of this estimation over another one on the same rows.

        Raises
        ------
        InputError
            If the rows or their noise differ.
        """
        own, its = self._cost.problem, other._cost.problem
        same = self.recordings == other.recordings and self.rows == other.rows
        if not same or not math.isclose(
            _log_determinant(own.noise), _log_determinant(its.noise), abs_tol=1e-6
        ):
            raise InputError(
                "evidence: the two fits have different rows or noise; allowed: fits of the same recordings"
            )
        return self.log_evidence - other.log_evidence

    @property
    def _deviance(self) -> float:
        return -2.0 * self.log_likelihood + self.chi2 - self.chi2_rows

    def free(self, name: str) -> int:
        """Return the number of a free parameter; InputError for any other name."""
        if name in self.names:
            return self.names.index(name)
        if name in self.parameters:
            raise InputError(f"{name}: is fixed; allowed: {', '.join(self.names)}")
        raise InputError(f"{name}: no such parameter; {nearest(name, self.names)}")

    def along(self, name: str, values: Iterable[float]) -> Array:
        """Return the rise of the cost along a parameter, all others at their best: its profile.

        Parameters
        ----------
        name : str
            A free parameter.
        values : iterable of float
            Its values [SI].
        """
        k = self.free(name)
        step = self.covariance.values[k] / self.covariance.values[k, k]
        with one_thread():
            return np.array(
                [self._root_of_rise([k], self.values + (v - self.values[k]) * step) ** 2 for v in values]
            )

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Return the profile interval of a parameter [SI]: where the cost rises by the quantile of chi-squared.

        An end beyond a bound of the parameter is the bound.
        """
        k, error = self.free(name), self.parameters[name].standard_error
        best, root = self.parameters[name].value, math.sqrt(chi2_distribution.ppf(level, 1))
        low, high = self._cost.bounds[:, k]
        ends = []
        with one_thread():
            for side, bound in ((-1.0, low), (1.0, high)):
                step = side * self.covariance.values[k] / error**2

                def excess(distance: float, step: Array = step) -> float:
                    return self._root_of_rise([k], self.values + distance * step) - root

                ends.append(
                    best + side * _where_zero(excess, root * error, min(abs(bound - best), _REACH * error))
                )
        return ends[0], ends[1]

    def _root_of_rise(self, held: Sequence[int], start: Array) -> float:
        """Return the root of the rise of the cost where some parameters are held, the others at their best."""
        inside = np.clip(start, *self._cost.bounds)
        found = self._cost.minimum(inside, self._steps, {k: inside[k] for k in held}, _ROUGH)
        return math.sqrt(max(self._cost(found.values) - self._least, 0.0))

    def contour(self, first: str, second: str, level: float = 0.95, points: int = 24) -> tuple[Array, Array]:
        """Return the region of two parameters at a level of confidence: its border, by the rise of the cost.

        Returns
        -------
        x, y : ndarray (points,)
            The border [SI], counterclockwise.
        """
        pair = [self.free(first), self.free(second)]
        if pair[0] == pair[1]:
            raise InputError(f"contour: {first} is given twice; allowed: two parameters")
        root, own = math.sqrt(chi2_distribution.ppf(level, 2)), self.covariance.values[np.ix_(pair, pair)]
        along = self.covariance.values[:, pair] @ np.linalg.inv(own)
        border = []
        with one_thread():
            for angle in np.linspace(0.0, 2.0 * math.pi, points, endpoint=False):
                step = along @ np.linalg.cholesky(own) @ [math.cos(angle), math.sin(angle)]

                def excess(radius: float, step: Array = step) -> float:
                    return self._root_of_rise(pair, self.values + radius * step) - root

                radius = _where_zero(excess, root, _REACH)
                border.append(np.clip(self.values + radius * step, *self._cost.bounds)[pair])
        return np.array(border).T[0], np.array(border).T[1]

    def sample(self, count: int, seed: int = 0) -> dict[str, Array]:
        """Return draws (count,) of every free parameter from the normal posterior, cut at the bounds [SI]."""
        random = np.random.default_rng(seed)
        drawn = random.multivariate_normal(self.values, self.covariance.values, count, method="eigh")
        drawn = np.clip(drawn, *self._cost.bounds)
        return {name: drawn[:, k] for k, name in enumerate(self.names)}

    def correlations(self, first: str, second: str, lags: int = 20) -> tuple[Array, Array, float]:
        """Return the correlation of the whitened residuals of two rows over lags of windows; of one with itself.

        Parameters
        ----------
        first, second : str
            Rows, as in the column ``row`` of `table`.
        lags : int
            Largest lag [windows].

        Returns
        -------
        lag, correlation : ndarray
            Lags -lags .. lags and the correlation there.
        band : float
            95 % of white noise lie within plus and minus this.
        """
        problem, white = self._cost.problem, self._cost.white(self.values)
        rows = {row for own in channels_of(problem.balances) for row in LISTED[own].rows}
        for name in (first, second):
            if name not in rows:
                raise InputError(f"{name}: no such row; {nearest(name, sorted(rows))}")
        pairs = zip(*(channel_parts(problem.balances, white, name) for name in (first, second)), strict=True)
        lag = np.arange(-lags, lags + 1, dtype=np.float64)
        total, count = np.zeros(len(lag)), np.zeros(len(lag))
        for a, b in pairs:
            for k, shift in enumerate(range(-lags, lags + 1)):
                left, right = (
                    (a[: len(a) - shift], b[shift:]) if shift >= 0 else (a[-shift:], b[: len(b) + shift])
                )
                total[k] += float(left @ right)
                count[k] += len(left)
        size = math.sqrt(
            np.mean(np.square(channel_values(problem.balances, white, first)))
            * np.mean(np.square(channel_values(problem.balances, white, second)))
        )
        return lag, total / np.maximum(count, 1.0) / (size or 1.0), 1.96 / math.sqrt(max(count[lags], 1.0))

    def table(self) -> dict[str, Any]:
        """Return every row as columns, window by window, channel by channel.

        Columns: recording, time [s], spin_rate [rad/s], tilt_x, tilt_y [rad], channel, row, unit; measured, predicted,
        residual, noise, prediction_error [unit]; whitened and leverage [1].
        """
        problem = self._cost.problem
        with one_thread():
            predicted = problem.predict(self._cost.point(self.values))
            white = self._cost.white(self.values)
            jacobian = self._cost.jacobian(self.values, self._steps)[: len(white)]
            plain = self._cost.slopes(
                lambda x: problem.predict(self._cost.point(x)),
                self.values,
                self._steps,
                range(len(self.names)),
            )
        leverage = np.einsum("ij,jk,ik->i", jacobian, self.covariance.values, jacobian)
        spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", plain, self.covariance.values, plain), 0.0))
        noise = problem.noise.deviation()
        parts: dict[str, list[Any]] = {name: [] for name in TABLE}
        at = 0
        for balance, recording in zip(problem.balances, self._prepared.names, strict=True):
            windows = balance.windows
            n = len(windows)
            for name in channels_of([balance]):
                for row in LISTED[name].rows:
                    own = slice(at + balance.row(row).start, at + balance.row(row).stop)
                    parts["recording"] += [recording] * n
                    parts["channel"] += [name] * n
                    parts["row"] += [row] * n
                    parts["unit"] += [LISTED[name].unit] * n
                    for key, values in (
                        ("time", windows.middle),
                        ("spin_rate", windows.mean_spin),
                        ("tilt_x", windows.mean_tilt.real),
                        ("tilt_y", windows.mean_tilt.imag),
                        ("measured", problem.measured[own]),
                        ("predicted", predicted[own]),
                        ("residual", problem.measured[own] - predicted[own]),
                        ("noise", noise[own]),
                        ("prediction_error", spread[own]),
                        ("whitened", white[own]),
                        ("leverage", leverage[own]),
                    ):
                        parts[key].append(values)
            at += len(balance)
        return {k: v if isinstance(v[0], str) else np.concatenate(v) for k, v in parts.items()}

    @property
    def _least(self) -> float:
        return self._cost(self.values)

    @property
    def _steps(self) -> Array:
        return _STEP * np.sqrt(np.diag(self.covariance.values))


def _where_zero(excess: Callable[[float], float], guess: float, farthest: float) -> float:
    """Return the distance at which a rising function is zero; `farthest` where it is below zero there."""
    known: dict[float, float] = {}

    def at(distance: float) -> float:
        if distance not in known:
            known[distance] = excess(distance)
        return known[distance]

    reach = min(guess, farthest)
    while at(reach) < 0.0 and reach < farthest:
        reach = min(1.1 * reach, farthest)
    return float(brentq(at, 0.0, reach, xtol=1e-7 * guess)) if at(reach) > 0.0 else reach


#: Columns of `Estimation.table`.
TABLE = (
    "recording", "time", "spin_rate", "tilt_x", "tilt_y", "channel", "row", "unit",
    "measured", "predicted", "residual", "noise", "prediction_error", "whitened", "leverage",
)  # fmt: skip


@one_thread()
def estimate(
    model: Model,
    recordings: Sequence[Recording],
    *,
    free: str | Sequence[str] | None = None,
    fixed: str | Sequence[str] = (),
    priors: Mapping[str, tuple[float, float] | None] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    loss: str = "linear",
    progress: Progress | None = None,
) -> Estimation:
    """Estimate parameters of a model from recordings.

    Parameters
    ----------
    model : Model
        The model; where nothing else is given, its values are where the search begins and what is fixed.
    recordings : sequence of Recording
        Recordings of one machine.
    free, fixed : sequence of str, optional
        Parameters to estimate, all unless given; and those of them to hold. ``windage.w`` is a coefficient, ``windage``
        all coefficients of an effect, ``bench`` all uncertain bench parameters; ``*`` stands for any letters.
    priors : mapping, optional
        {parameter: (mean, standard deviation)} or {parameter: None} for no prior. Unless given, bench parameters have
        their stated uncertainty, and shapes of laws that of their declaration.
    bounds : mapping, optional
        {parameter: (lowest, highest)} [SI]; unless given, what a model file may hold.
    loss : str
        ``linear`` (least squares), or ``soft_l1``, ``huber``, ``cauchy`` for noise with heavy tails.
    progress : callable, optional
        Called with a line of text now and then.

    Raises
    ------
    InputError
        If a name is unknown, a prior or bound is impossible, or the recordings do not determine a free parameter.
    """
    if loss not in get_args(Loss):
        raise InputError(f"loss: {loss!r} is not allowed; allowed: {', '.join(get_args(Loss))}")
    prepared = prepare(recordings, replace(model, effect_errors={}), progress=progress)
    terms = [prepared.problem.unknowns.term(name) for name in model.effects]
    if progress:
        progress("fitting")
    prepared = prepared.reweighed(prepared.problem.fit(terms))
    happened = accepted(prepared.problem, prepared.problem.fit(terms), recordings)
    prepared = replace(prepared, problem=beside_events(prepared.problem, terms, happened))
    problem = prepared.problem
    unknowns = _limited(_unknowns(model, problem, terms), priors or {}, bounds or {})
    chosen = _chosen([u.name for u in unknowns], free, fixed)
    if not chosen:
        raise InputError("free: no parameter is left to estimate")
    cost = Cost(problem, terms, unknowns, chosen, loss)
    found, covariance = _minimised(cost)
    return _estimation(model, recordings, prepared, cost, found, covariance)


def _unknowns(model: Model, problem: Problem, terms: Sequence[Term]) -> list[_Unknown]:
    """Return all unknowns in the order of the fit, with what the bench and the declarations state."""
    result = []
    for group, parameters in problem.unknowns.nuisances:
        p = parameters[0]
        own = model.overrides.get(p.name)
        start = p.value if own is None else own.value
        prior = Prior(p.value, p.uncertainty)
        result.append(
            _Unknown(
                group,
                p.value,
                p.uncertainty,
                p.unit,
                start,
                prior,
                physical_range(p.name),
                100.0 * p.uncertainty,
            )
        )
    for term in terms:
        assert term.effect is not None  # the effects of a model
        for c in term.effect.coefficients:
            shaped = c.shape is not None and c.shape_uncertainty > 0.0
            result.append(
                _Unknown(
                    f"{term.name}.{c.name}",
                    0.0,
                    1.0,
                    c.unit,
                    model.effects[term.name][c.name],
                    Prior(float(c.shape or 0.0), c.shape_uncertainty) if shaped else None,
                    c.bounds,
                    problem.unknowns.scale(term, c.name),
                )
            )
    return result


def _limited(
    unknowns: Sequence[_Unknown],
    priors: Mapping[str, tuple[float, float] | None],
    bounds: Mapping[str, tuple[float, float]],
) -> list[_Unknown]:
    """Return the unknowns with the priors and bounds that the user gave."""
    own = {u.name: u for u in unknowns}
    for name in (*priors, *bounds):
        if name not in own:
            raise InputError(f"{name}: no such parameter; {nearest(name, own)}")
    for name, prior in priors.items():
        if prior is not None and not (len(prior) == 2 and np.isfinite(prior).all() and prior[1] > 0.0):
            raise InputError(
                f"priors.{name}: {prior} is not allowed; allowed: (mean, standard deviation > 0)"
            )
        own[name] = own[name]._replace(prior=None if prior is None else Prior(*map(float, prior)))
    for name, given in bounds.items():
        low, high = own[name].bounds
        if len(given) != 2 or not low <= given[0] < given[1] <= high:
            raise InputError(
                f"bounds.{name}: {given} is not allowed; allowed: (lowest, highest) within {low:g} .. {high:g} "
                f"{own[name].unit}"
            )
        own[name] = own[name]._replace(bounds=(float(given[0]), float(given[1])))
    return list(own.values())


def _chosen(names: Sequence[str], free: str | Sequence[str] | None, fixed: str | Sequence[str]) -> list[int]:
    """Return the numbers of the unknowns that are free."""

    def matching(field: str, patterns: str | Sequence[str]) -> set[str]:
        found: set[str] = set()
        for pattern in [patterns] if isinstance(patterns, str) else patterns:
            own = {
                name
                for name in names
                if fnmatch.fnmatchcase(name, pattern)
                or name.startswith(f"{pattern}.")
                or (pattern == "bench" and "." not in name)
            }
            if not own:
                raise InputError(f"{field}: {pattern}: no such parameter; {nearest(pattern, names)}")
            found |= own
        return found

    wanted = set(names) if free is None else matching("free", free)
    wanted -= matching("fixed", fixed)
    free_ones = [k for k, name in enumerate(names) if name in wanted]
    return sorted(free_ones, key=lambda k: "." not in names[k])  # coefficients of effects first


def _minimised(cost: Cost) -> tuple[Minimum, Array]:
    """Return the minimum of a cost, and the covariance of the free parameters there."""
    steps = _FIRST_STEP * np.array([u.width for u in cost.free])
    first = cost.minimum(cost.start, steps, tolerance=_ROUGH)
    jacobian = cost.jacobian(first.values, steps)
    size = np.linalg.norm(jacobian, axis=0)
    for unknown, own in zip(cost.free, size, strict=True):
        if own == 0.0:
            raise InputError(
                f"{unknown.name}: these recordings do not depend on it; allowed: fixed, or with a prior"
            )
    inverse = np.linalg.pinv((jacobian / size).T @ (jacobian / size), rcond=1e-13) / np.outer(size, size)
    steps = _STEP * np.sqrt(np.diag(inverse))
    found = cost.minimum(first.values, steps)
    inside = np.clip(found.values, cost.bounds[0] + 2.0 * steps, cost.bounds[1] - 2.0 * steps)
    curvature = cost.hessian(inside, steps)
    covariance = np.linalg.pinv(curvature * np.outer(steps, steps)) * np.outer(steps, steps)
    if not (np.isfinite(covariance).all() and np.all(np.diag(covariance) > 0.0)):
        raise InputError(
            "fit: the recordings do not determine all free parameters; allowed: fewer free ones, or priors for them"
        )
    return found, covariance


def _estimation(
    model: Model,
    recordings: Sequence[Recording],
    prepared: Prepared,
    cost: Cost,
    found: Minimum,
    covariance: Array,
) -> Estimation:
    """Return the facts of a minimum."""
    problem, chi2 = prepared.problem, float(np.sum(cost.residuals(found.values) ** 2))
    white = cost.white(found.values)
    errors = np.sqrt(np.diag(covariance))
    parameters = {
        u.name: Parameter(
            u.name, float(x), float(error), u.unit, u.start, True, u.prior, u.bounds, k in found.at_bound,
            None if k in found.at_bound else _without_prior(float(x), float(error), u.prior),
        )
        for k, (u, x, error) in enumerate(zip(cost.free, found.values, errors, strict=True))
    }  # fmt: skip
    parameters |= {
        u.name: Parameter(u.name, u.start, 0.0, u.unit, u.start, False, u.prior, u.bounds)
        for u in cost.unknowns
        if u.name not in parameters
    }
    events = 0 if problem.noise.events is None else problem.noise.events.shape[1]
    likelihood = -0.5 * (
        float(white @ white)
        + _log_determinant(problem.noise)
        + (len(white) - events) * math.log(2.0 * math.pi)
    )
    evidence = likelihood + 0.5 * float(np.linalg.slogdet(covariance / np.outer(errors, errors))[1])
    for u, value, error in zip(cost.free, found.values, errors, strict=True):
        mean, deviation = u.prior or (0.0 if "." in u.name else u.offset, u.width)
        evidence += math.log(error / deviation) - 0.5 * ((value - mean) / deviation) ** 2
    names = channels_of(problem.balances)
    by_channel = {
        name: np.concatenate([channel_values(problem.balances, white, row) for row in LISTED[name].rows])
        for name in names
    }
    return Estimation(
        parameters=parameters,
        covariance=Matrix(tuple(u.name for u in cost.free), covariance),
        chi2=chi2,
        chi2_rows=float(white @ white),
        rows=len(white),
        degrees_of_freedom=len(white) - events - sum(u.prior is None for u in cost.free),
        channels={name: (float(own @ own), len(own)) for name, own in by_channel.items()},
        log_likelihood=likelihood,
        log_evidence=evidence,
        loss=cost.loss,
        recordings=tuple(str(r.path) for r in recordings),
        fitted=_changed(model, recordings, problem, parameters),
        _cost=cost,
        _prepared=prepared,
    )


def _without_prior(value: float, error: float, prior: Prior | None) -> tuple[float, float] | None:
    """Return what the data alone give of a parameter with a normal prior; None where they give nothing."""
    if prior is None or error >= _FROM_PRIOR * prior.deviation:
        return None
    variance = 1.0 / (1.0 / error**2 - 1.0 / prior.deviation**2)
    return variance * (value / error**2 - prior.mean / prior.deviation**2), math.sqrt(variance)


def _summary(parameters: Mapping[str, Parameter]) -> list[str]:
    """Return the names of the free parameters; those of the bench counted where they are many."""
    free = [name for name, own in parameters.items() if own.free]
    bench = [name for name in free if "." not in name]
    if len(bench) <= 3:
        return free
    return [*(name for name in free if "." in name), f"{len(bench)} bench parameters"]


def _changed(
    model: Model, recordings: Sequence[Recording], problem: Problem, parameters: Mapping[str, Parameter]
) -> Model:
    """Return the model with the estimates."""
    overrides = dict(model.overrides)
    for group, members in problem.unknowns.nuisances:
        own, first = parameters[group], members[0]
        for p in members if own.free and group not in problem.unknowns.assumed else ():
            scale = p.uncertainty / first.uncertainty
            overrides[p.name] = Override(
                p.value + scale * (own.value - first.value), scale * own.standard_error
            )
    effects, errors = ({n: dict(v) for n, v in own.items()} for own in (model.effects, model.effect_errors))
    for name, own in parameters.items():
        effect, dot, key = name.partition(".")
        if dot and own.free:
            effects[effect][key] = own.value
            errors.setdefault(effect, {})[key] = own.standard_error
    entry = {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "what": f"fit {', '.join(_summary(parameters))}",
        "fit": [str(r.path) for r in recordings],
    }
    return model.changed(entry, overrides=overrides, effects=effects, effect_errors=errors)
