"""Outcome of an estimation: estimates, covariance, profiles, contours, criteria and residuals."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from gyrowheel_analysis.channels import LISTED
from gyrowheel_analysis.estimation.cost import ROUGH, Cost, log_determinant
from gyrowheel_analysis.fitting.fit import Prior
from gyrowheel_analysis.fitting.preparation import Prepared
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.residuals.error_table import channel_parts, channel_values, channels_of
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError, nearest

Array = NDArray[np.float64]

#: Step of central differences in standard errors.
STEP = 0.05
#: Standard errors to which the ends of a profile are searched.
_REACH = 30.0


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
    cost : Cost
        Chi-squared as a function of `values`, for a minimiser of another library; ``cost.residuals`` are its parts.
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
    cost: Cost = field(repr=False)
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

    def evidence(self, other: Estimation) -> float:
        """Return the natural log of the Bayes factor of this estimation over another one on the same rows.

        Raises
        ------
        InputError
            If the rows or their noise differ.
        """
        own, its = self.cost.problem, other.cost.problem
        same = self.recordings == other.recordings and self.rows == other.rows
        if not same or not math.isclose(log_determinant(own.noise), log_determinant(its.noise), abs_tol=1e-6):
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

    def profile(self, name: str, *, points: int = 21, reach: float = 3.0) -> tuple[Array, Array]:
        """Return values of a parameter [SI] and the rise of chi-squared there, all others at their best.

        Parameters
        ----------
        name : str
            A free parameter.
        points : int
            Number of values.
        reach : float
            Standard errors on either side.

        Raises
        ------
        InputError
            If the parameter is unknown or fixed.
        """
        own = self.parameters[self.names[self.free(name)]]
        values = np.linspace(-reach, reach, points) * own.standard_error + own.value
        values = np.clip(values, *own.bounds)
        return values, self.along(name, values)

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Return the profile interval of a parameter [SI]: where the cost rises by the quantile of chi-squared.

        An end beyond a bound of the parameter is the bound.
        """
        k, error = self.free(name), self.parameters[name].standard_error
        best, root = self.parameters[name].value, math.sqrt(chdtri(1, 1.0 - level))
        low, high = self.cost.bounds[:, k]
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
        inside = np.clip(start, *self.cost.bounds)
        found = self.cost.minimum(inside, self._steps, {k: inside[k] for k in held}, ROUGH)
        return math.sqrt(max(self.cost(found.values) - self._least, 0.0))

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
        root, own = math.sqrt(chdtri(2, 1.0 - level)), self.covariance.values[np.ix_(pair, pair)]
        along = self.covariance.values[:, pair] @ np.linalg.inv(own)
        border = []
        with one_thread():
            for angle in np.linspace(0.0, 2.0 * math.pi, points, endpoint=False):
                step = along @ np.linalg.cholesky(own) @ [math.cos(angle), math.sin(angle)]

                def excess(radius: float, step: Array = step) -> float:
                    return self._root_of_rise(pair, self.values + radius * step) - root

                radius = _where_zero(excess, root, _REACH)
                border.append(np.clip(self.values + radius * step, *self.cost.bounds)[pair])
        return np.array(border).T[0], np.array(border).T[1]

    def sample(self, count: int, seed: int = 0) -> dict[str, Array]:
        """Return draws (count,) of every free parameter from the normal posterior, cut at the bounds [SI]."""
        random = np.random.default_rng(seed)
        drawn = random.multivariate_normal(self.values, self.covariance.values, count, method="eigh")
        drawn = np.clip(drawn, *self.cost.bounds)
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
        problem, white = self.cost.problem, self.cost.white(self.values)
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
        problem = self.cost.problem
        with one_thread():
            predicted = problem.predict(self.cost.point(self.values))
            white = self.cost.white(self.values)
            jacobian = self.cost.jacobian(self.values, self._steps)[: len(white)]
            plain = self.cost.slopes(
                lambda x: problem.predict(self.cost.point(x)),
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
        return self.cost(self.values)

    @property
    def _steps(self) -> Array:
        return STEP * np.sqrt(np.diag(self.covariance.values))


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
    from scipy.optimize import brentq  # takes long to load

    return float(brentq(at, 0.0, reach, xtol=1e-7 * guess)) if at(reach) > 0.0 else reach


#: Columns of `Estimation.table`.
TABLE = (
    "recording", "time", "spin_rate", "tilt_x", "tilt_y", "channel", "row", "unit",
    "measured", "predicted", "residual", "noise", "prediction_error", "whitened", "leverage",
)  # fmt: skip
