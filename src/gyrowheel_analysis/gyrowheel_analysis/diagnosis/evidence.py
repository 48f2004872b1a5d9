"""The evidence of recordings for a change of any quantity at any time, given every other explanation.

A change in the middle of a recording looks like a slow drift that happens to move there. The two are compared by
marginal likelihood with the size of the drift left free, so that neither passes for the other. Changes that bench
parameters and effects can explain are no events: all of these are regressors next to it.

For every place the likelihood needs the products of that event with itself and with the rows, once everything else is
projected out. Drifts are Markov, so that all of them follow from recursions over the windows: time and memory grow with
the windows, not with their square.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.criteria import DRIFT_ENLARGED, SCATTER_EXCESS, SCATTER_WINDOWS
from gyrowheel_analysis.fitting.events import QUANTITIES, Kind, unit_rows
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.noise import scale_cost
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.fitting.variance import DriftCovariance, course_products, precision_root
from gyrowheel_analysis.reduction.windows import SAME_SPEED

Array = NDArray[np.float64]

#: Number of tried drifts between the likeliest without an event and those as stated.
_DRIFT_STEPS = 5
#: Median of the differences of two values of unit variance.
_MEDIAN = 0.6745 * math.sqrt(2.0)
_APART = 10.0  # s; windows that are further from each other belong to different groups
_SHORT = 1.0  # s; windows of a cone are shorter, those of a hold are not


class Profiles:
    """The courses of many events of one kind over the windows of a recording.

    `edges` (events, edges of the kind) are those of every event, as an `Event` takes them; `weights` (events, n) are
    the courses over the windows.
    """

    #: Number of windows between edges that are tried.
    stride = 1

    def __init__(self, kind: Kind, edges: ArrayLike, weights: Array) -> None:
        self.kind, self.edges = kind, np.asarray(edges, dtype=np.float64)
        self._courses = np.ascontiguousarray(weights.T)  # (n, events)

    @functools.cached_property
    def tried(self) -> list[Array]:
        """All values of each of the edges, in order."""
        return [np.unique(times) for times in self.edges.T]

    def __len__(self) -> int:
        return len(self.edges)

    @property
    def places(self) -> int:
        """Number of places at which such an event may be: those between the tried ones are possible, too."""
        return len(self)

    def sums(self, values: Array) -> Array:
        """Return the sums (..., events) of values (..., n) of the windows over the course of every event."""
        return np.asarray(values @ self._courses)

    def squares(self, block: Rows, left: Array, right: Array) -> Array:
        """Return the products (events,) of whitened rows, changed by `left` and by `right` (n,) along each course."""
        return block.of_courses(self._courses[:, None], left, right)[0, 0]

    def explained(self, left: Array, right: Array) -> Array:
        """Return the products (events,) of the sums of `left` and of `right` (p, n)."""
        own = self.sums(left)
        return np.einsum("pe,pe->e", own, own if right is left else self.sums(right))


@dataclass(frozen=True)
class _White:
    """Rows without a drift, with their standard deviations."""

    deviation: Array

    def __len__(self) -> int:
        return len(self.deviation)

    def whiten(self, rows: Array, scale: float) -> Array:
        return np.asarray((rows.T / self.deviation).T)

    def whiten_back(self, rows: Array, scale: float) -> Array:
        return self.whiten(rows, scale)

    def of_courses(self, courses: Array, left: Array, right: Array, factor: Array, scale: float) -> Array:
        none = np.zeros(len(left))
        return course_products(courses, left, right, none, none, 1.0 / (self.deviation * factor) ** 2)

    def log_determinant(self, scale: float) -> float:
        return 0.0  # always the same


@dataclass(frozen=True)
class _Block:
    """Rows of one name in one recording."""

    recording: int
    row: str
    covariance: DriftCovariance | _White
    drift: str


@dataclass(frozen=True)
class Rows:
    """Rows of one name in one recording, with the scale of their drift and the scatter over their known noise (n,)."""

    covariance: DriftCovariance | _White
    scale: float
    factor: Array

    def whiten(self, rows: Array) -> Array:
        """Return rows (n, ...) divided by the square root of their covariance, and by their scatter."""
        return np.asarray((self.covariance.whiten(rows, self.scale).T / self.factor).T)

    def whiten_back(self, rows: Array) -> Array:
        """Return rows (n, ...) times the transpose of the matrix of `whiten`."""
        return self.covariance.whiten_back((rows.T / self.factor).T, self.scale)

    def of_courses(self, courses: Array, left: Array, right: Array) -> Array:
        """Return the products of whitened courses, see `DriftCovariance.of_courses`."""
        return self.covariance.of_courses(courses, left, right, self.factor, self.scale)

    def of_steps(self, left: Array, right: Array, pairs: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the products of whitened courses from each window on (n,), and within pairs of windows (m,)."""
        if isinstance(self.covariance, _White):
            own = left * right / (self.covariance.deviation * self.factor) ** 2
            before = np.concatenate([[0.0], own.cumsum()])
            return before[-1] - before[:-1], before[pairs[:, 1]] - before[pairs[:, 0]]
        return self.covariance.of_steps(left, right, self.factor, self.scale, pairs)


class Evidence:
    """Marginal likelihood of recordings, given all explanations by bench parameters and effects.

    `problem` has the known events; everything is linear about `fit`. `others` (N, k) are the rows of further
    explanations, each for a large size of it.
    """

    def __init__(self, problem: Problem, fit: Fit, others: Array | None = None) -> None:
        unknowns = problem.unknowns
        offset = np.concatenate([fit.nuisance, [fit.coefficients[t][name] for t, name in fit.columns]])
        rows = fit.residual + fit.jacobian @ (offset - unknowns.centre(fit.terms))
        columns = np.hstack([fit.jacobian * unknowns.widths(fit.terms), problem.prediction.candidate_columns])
        if others is not None:
            columns = np.hstack([columns, others])
        self.problem = problem
        self.scales, _ = problem.noise.best_scales(rows, columns)
        self._blocks = _blocks(problem)
        self._rows, self._columns = rows, problem.noise.beside_events(columns)
        self._states: dict[tuple[float, ...], _State] = {}
        self._units: dict[tuple[str, int, float | None], dict[int, Array]] = {}
        self._noise_factor = np.ones(len(rows))
        self._noise_factor = self._noise_factors(self.state(self.scales).residual())
        self._states.clear()

    def state(self, scales: Mapping[str, float]) -> _State:
        """Return rows and regressors whitened for scales of the drifts."""
        key = tuple(scales.values())
        if key not in self._states:
            self._states[key] = _State.of(self._blocks, self._rows, self._columns, scales, self._noise_factor)
        return self._states[key]

    def paths(self, drifts: Sequence[str]) -> Iterator[dict[str, float]]:
        """Yield scales of the drifts, from the likeliest without an event to some of them as stated."""
        raised = any(self.scales[name] > DRIFT_ENLARGED for name in drifts)
        for share in np.linspace(1.0, 0.0, _DRIFT_STEPS) if raised else (1.0,):
            yield self.scales | {name: self.scales[name] ** float(share) for name in drifts}

    def gains(
        self, quantities: Sequence[str], recording: int, courses: Sequence[Profiles], lag: float | None = None
    ) -> list[Array]:
        """Return the increase of twice the log likelihood by each event, with the drifts that suit it best.

        One or two quantities change at once in a recording, with the given courses; `lag` is the relaxation time of a
        torque that follows the tilt [s].
        """
        units = [self._unit(quantity, recording, lag) for quantity in quantities]
        count = len(self.problem.balances[recording].windows)
        best = [np.full(len(profiles), -math.inf) for profiles in courses]
        without = self.state(self.scales).cost + scale_cost(self.scales)
        drifts = dict.fromkeys(drift for name in quantities for drift in QUANTITIES[name].drifts)
        for scales in self.paths(tuple(drifts)):
            state = self.state(scales)
            above = without - state.cost - scale_cost(scales)
            products = state.products(units, count)
            for own, profiles in zip(best, courses, strict=True):
                np.maximum(own, above + products.gained(profiles), out=own)
        return best

    def limit(self, quantities: Sequence[str], recording: int, profiles: Profiles, gain: float) -> float:
        """Return the size, over the large one of every quantity, at which an event is expected to bring a gain.

        The event is the first of `profiles`, of all quantities by equally many of their large sizes; `gain` is in twice
        the log likelihood.
        """
        count = len(self.problem.balances[recording].windows)
        units = [self._unit(quantity, recording) for quantity in quantities]
        products = self.state(self.scales).products(units, count)
        every = range(len(units))
        known = np.array([[float(products.norms(profiles, i, j)[0]) for j in every] for i in every])
        m, size = every, np.ones(len(every))
        with_one = float(size @ known @ np.linalg.solve(np.eye(len(m)) + known, known @ size))
        return math.sqrt((gain + float(np.linalg.slogdet(np.eye(len(m)) + known)[1])) / with_one)

    def _unit(self, quantity: str, recording: int, lag: float | None = None) -> dict[int, Array]:
        """Return the rows of a constant large change of a quantity, by block; blocks of zeros are left out."""
        key = quantity, recording, lag
        if key not in self._units:
            what, balance = QUANTITIES[quantity], self.problem.balances[recording]
            rows = unit_rows(balance, what, lag) * what.width(self.problem.bench)
            self._units[key] = {
                index: own
                for index, block in enumerate(self._blocks)
                if block.recording == recording and (own := rows[balance.row(block.row)]).any()
            }
        return self._units[key]

    def _noise_factors(self, left: Array) -> Array:
        """Return the scatter of the rows from window to window over the known noise, in groups of windows.

        A change in the middle moves only two neighbours apart, and is no scatter.
        """
        result, at = np.ones(len(left)), 0
        for block in self._blocks:
            for group in _groups(self.problem.balances[block.recording]):
                steps = np.abs(np.diff(left[at + group]))
                if len(group) >= SCATTER_WINDOWS:
                    scatter = float(np.median(steps)) / _MEDIAN
                    # standard error of a variance from a median of such differences
                    if scatter**2 > 1.0 + SCATTER_EXCESS * 2.3 / math.sqrt(len(steps)):
                        result[at + group] = scatter
            at += len(block.covariance)
        return result


def _blocks(problem: Problem) -> list[_Block]:
    """Return the blocks of rows of all recordings, in their order."""
    result = []
    noise = problem.noise
    for number, balance in enumerate(problem.balances):
        own = noise.averages[number]
        result += [
            _Block(number, row, covariance, drift)
            for row, (covariance, drift) in zip(balance.rows, own, strict=False)
        ]
        turning, n = balance.rows[len(own) :], len(balance.windows)
        result += [
            _Block(number, row, _White(noise.amplitudes[number][k * n : (k + 1) * n]), "")
            for k, row in enumerate(turning)
        ]
    return result


def _groups(balance: Balance) -> Iterator[NDArray[np.int64]]:
    """Yield the windows of every cone, and of the holds between two changes of the speed."""
    w = balance.windows
    if not len(w):
        return
    order = np.argsort(w.start, kind="stable")
    spin, short = w.mean_spin[order], w.duration[order] < _SHORT
    turned = np.abs(np.diff(spin)) > SAME_SPEED * np.abs(spin[:-1])
    apart = np.diff(w.start[order]) > _APART
    edges = np.flatnonzero(turned | apart | (np.diff(short.astype(np.int8)) != 0)) + 1
    yield from np.split(order, edges)


@dataclass(frozen=True)
class _Products:
    """Products of a change of one or two quantities in single windows, beyond what the regressors explain.

    `parts` has the rows in which a quantity shows, with the change of each by the number of the quantity; `with_rows`
    (n,) are the products with the measured rows, `with_regressors` (p, n) those with the regressors.
    """

    parts: list[tuple[Rows, dict[int, Array]]]
    with_rows: list[Array]
    with_regressors: list[Array]

    def norms(self, profiles: Profiles, i: int, j: int) -> Array:
        """Return the products (events,) of two quantities that change along every course."""
        own = -profiles.explained(self.with_regressors[i], self.with_regressors[j])
        for rows, changes in self.parts:
            if i in changes and j in changes:
                own = own + profiles.squares(rows, changes[i], changes[j])
        return own

    def gained(self, profiles: Profiles) -> Array:
        """Return the increase of twice the log likelihood by every event."""
        b = [profiles.sums(own) for own in self.with_rows]
        xx = 1.0 + self.norms(profiles, 0, 0)
        if len(b) == 1:
            return np.asarray(b[0] ** 2 / xx - np.log(xx))
        xy, yy = self.norms(profiles, 0, 1), 1.0 + self.norms(profiles, 1, 1)
        determinant = xx * yy - xy**2
        gained = (yy * b[0] ** 2 - 2.0 * xy * b[0] * b[1] + xx * b[1] ** 2) / determinant
        return np.asarray(gained - np.log(determinant))


@dataclass(frozen=True)
class _State:
    """Rows whitened for some scales of the drifts, with their projection on the regressors.

    `projection` and `projected_rows` give the products of any two columns beyond the regressors: their scalar product
    minus that of their projections.
    """

    blocks: Sequence[_Block]
    scales: Mapping[str, float]
    noise_factor: Array
    rows: Array
    projection: Array
    projected_rows: Array
    cost: float
    known: dict[int, tuple[Rows, Array, Array]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        blocks: Sequence[_Block],
        rows: Array,
        columns: Array,
        scales: Mapping[str, float],
        noise_factor: Array,
    ) -> _State:
        parts, at, log_det = [], 0, 0.0
        both = np.column_stack([columns, rows])
        for block in blocks:
            scale = scales.get(block.drift, 1.0)
            parts.append(block.covariance.whiten(both[at : at + len(block.covariance)], scale))
            log_det += block.covariance.log_determinant(scale)
            at += len(block.covariance)
        white = np.concatenate(parts) / noise_factor[:, None]
        design, target = white[:, :-1], white[:, -1]
        root = precision_root(design)
        projection = solve_triangular(root, design.T, lower=True, check_finite=False)
        projected_rows = projection @ target
        log_det += 2.0 * float(np.log(np.diag(root)).sum())
        cost = log_det + float(target @ target - projected_rows @ projected_rows)
        return cls(blocks, scales, noise_factor, target, projection, projected_rows, cost)

    def residual(self) -> Array:
        """Return the rows (N,) without their projection on the regressors."""
        return self.rows - self.projection.T @ self.projected_rows

    def products(self, units: Sequence[Mapping[int, Array]], count: int) -> _Products:
        """Return the products of changes in the single windows of a recording.

        `units` has the rows of every quantity by the number of the block; `count` is the number of windows.
        """
        result = _Products(
            [], [np.zeros(count) for _ in units], [np.zeros((len(self.projected_rows), count)) for _ in units]
        )
        at = 0
        for index, block in enumerate(self.blocks):
            here = slice(at, at + len(block.covariance))
            at = here.stop
            own = {k: unit[index] for k, unit in enumerate(units) if index in unit}
            if not own:
                continue
            rows, with_rows, with_regressors = self._of(index, block, here)
            result.parts.append((rows, own))
            for k, change in own.items():
                result.with_rows[k] += change * with_rows
                result.with_regressors[k] += change * with_regressors
        for rows_, regressors in zip(result.with_rows, result.with_regressors, strict=True):
            rows_ -= self.projected_rows @ regressors
        return result

    def _of(self, index: int, block: _Block, here: slice) -> tuple[Rows, Array, Array]:
        """Return a block with the products of a unit change in each of its windows with rows and regressors."""
        if index not in self.known:
            rows = Rows(block.covariance, self.scales.get(block.drift, 1.0), self.noise_factor[here])
            back = rows.whiten_back(np.column_stack([self.rows[here], self.projection[:, here].T]))
            self.known[index] = rows, np.ascontiguousarray(back[:, 0]), np.ascontiguousarray(back[:, 1:].T)
        return self.known[index]
