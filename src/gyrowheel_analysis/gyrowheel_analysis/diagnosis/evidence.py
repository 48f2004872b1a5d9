"""The evidence of recordings for a change of any quantity at any time, given every other explanation.

A change in the middle of a recording looks like a slow drift that happens to move there. The two are compared by
marginal likelihood with the size of the drift left free, so that neither passes for the other. Changes that bench
parameters and effects can explain are no events: all of these are regressors next to it.

For every place the likelihood needs the products of that event with itself and with the rows, once everything else is
projected out. These are sums over the products of single windows, which are formed once for each quantity.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.criteria import DRIFT_ENLARGED, SCATTER_EXCESS, SCATTER_WINDOWS
from gyrowheel_analysis.fitting.events import QUANTITIES, Kind, unit_rows
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.noise import scale_cost
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.fitting.variance import DriftCovariance, precision_root
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

    def __init__(self, kind: Kind, edges: ArrayLike, weights: Array) -> None:
        self.kind, self.edges, self._weights = kind, np.asarray(edges, dtype=np.float64), weights

    @functools.cached_property
    def tried(self) -> list[Array]:
        """All values of each of the edges, in order."""
        return [np.unique(times) for times in self.edges.T]

    def __len__(self) -> int:
        return len(self.edges)

    def norms(self, products: Array) -> Array:
        """Return the product of every event with itself."""
        return np.einsum("en,en->e", self._weights @ products, self._weights)

    def projections(self, products: Array) -> Array:
        """Return the product of every event with the rows."""
        return np.asarray(self._weights @ products)


@dataclass(frozen=True)
class _White:
    """Rows without a drift, with their standard deviations."""

    deviation: Array

    def __len__(self) -> int:
        return len(self.deviation)

    def whiten(self, rows: Array, scale: float) -> Array:
        return np.asarray((rows.T / self.deviation).T)

    def log_determinant(self, scale: float) -> float:
        return 0.0  # always the same


@dataclass(frozen=True)
class _Block:
    """Rows of one name in one recording."""

    recording: int
    row: str
    covariance: DriftCovariance | _White
    drift: str


class Evidence:
    """Marginal likelihood of recordings, given all explanations by bench parameters and effects.

    `problem` has the known events; everything is linear about `fit`.
    """

    def __init__(self, problem: Problem, fit: Fit) -> None:
        unknowns = problem.unknowns
        offset = np.concatenate([fit.nuisance, [fit.coefficients[t][name] for t, name in fit.columns]])
        rows = fit.residual + fit.jacobian @ (offset - unknowns.centre(fit.terms))
        columns = np.hstack([fit.jacobian * unknowns.widths(fit.terms), problem.prediction.candidate_columns])
        self.problem = problem
        self.scales, _ = problem.noise.best_scales(rows, columns)
        self._blocks = _blocks(problem)
        self._rows, self._columns = rows, problem.noise.beside_events(columns)
        self._states: dict[tuple[float, ...], _State] = {}
        self._units: dict[tuple[str, int, float | None], dict[int, Array]] = {}
        self._noise_factor = np.ones(len(rows))
        self._mutual: dict[tuple[int, float], Array] = {}
        self._noise_factor = self._noise_factors(self.state(self.scales).residual())
        self._states.clear()

    def state(self, scales: Mapping[str, float]) -> _State:
        """Return rows and regressors whitened for scales of the drifts."""
        key = tuple(scales.values())
        if key not in self._states:
            self._states[key] = _State.of(
                self._blocks, self._rows, self._columns, scales, self._noise_factor, self._mutual
            )
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
            mutual, with_rows = state.of_windows(units, count)
            for own, profiles in zip(best, courses, strict=True):
                np.maximum(own, above + _gained(mutual, with_rows, profiles), out=own)
        return best

    def limit(self, quantities: Sequence[str], recording: int, profiles: Profiles, gain: float) -> float:
        """Return the size, over the large one of every quantity, at which an event is expected to bring a gain.

        The event is the first of `profiles`, of all quantities by equally many of their large sizes; `gain` is in twice
        the log likelihood.
        """
        count = len(self.problem.balances[recording].windows)
        units = [self._unit(quantity, recording) for quantity in quantities]
        mutual, _ = self.state(self.scales).of_windows(units, count)
        m = [[float(profiles.norms(own)[0]) for own in line] for line in mutual]
        known, size = np.array(m), np.ones(len(m))
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


def _gained(mutual: Sequence[Sequence[Array]], with_rows: Sequence[Array], profiles: Profiles) -> Array:
    """Return the increase of twice the log likelihood by events of one or two quantities, for given drifts."""
    b = [profiles.projections(own) for own in with_rows]
    xx = 1.0 + profiles.norms(mutual[0][0])
    if len(b) == 1:
        return np.asarray(b[0] ** 2 / xx - np.log(xx))
    xy, yy = profiles.norms(mutual[0][1]), 1.0 + profiles.norms(mutual[1][1])
    determinant = xx * yy - xy**2
    gained = (yy * b[0] ** 2 - 2.0 * xy * b[0] * b[1] + xx * b[1] ** 2) / determinant
    return np.asarray(gained - np.log(determinant))


class _Products(NamedTuple):
    """Products of unit changes in the single windows of a block: the factors of all sizes.

    `mutual` is with each other (n, n), or the diagonal alone (n,) where the rows are independent; `with_rows` (n,) with
    the rows; `with_regressors` (p, n) with the regressors.
    """

    mutual: Array
    with_rows: Array
    with_regressors: Array


@dataclass(frozen=True)
class _State:
    """Rows whitened for some scales of the drifts, with their projection on the regressors.

    `projection` and `projected_rows` give the products of any two columns beyond the regressors: their scalar product
    minus that of their projections. `mutual` caches `_Products.mutual` of all states, by the number of the block and
    the scale of its drift.
    """

    blocks: Sequence[_Block]
    scales: Mapping[str, float]
    noise_factor: Array
    rows: Array
    projection: Array
    projected_rows: Array
    cost: float
    mutual: dict[tuple[int, float], Array]
    known: dict[int, _Products] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        blocks: Sequence[_Block],
        rows: Array,
        columns: Array,
        scales: Mapping[str, float],
        noise_factor: Array,
        mutual: dict[tuple[int, float], Array],
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
        return cls(blocks, scales, noise_factor, target, projection, projected_rows, cost, mutual)

    def residual(self) -> Array:
        """Return the rows (N,) without their projection on the regressors."""
        return self.rows - self.projection.T @ self.projected_rows

    def of_windows(
        self, units: Sequence[Mapping[int, Array]], count: int
    ) -> tuple[list[list[Array]], list[Array]]:
        """Return products of the single windows of quantities with each other (n, n) and with the rows (n,).

        `units` has the rows of every quantity by the number of the block; `count` is the number of windows.
        """
        mutual = [[np.zeros((count, count)) for _ in units] for _ in units]
        with_rows = [np.zeros(count) for _ in units]
        with_regressors = [np.zeros((len(self.projected_rows), count)) for _ in units]
        at = 0
        for index, block in enumerate(self.blocks):
            here = slice(at, at + len(block.covariance))
            at = here.stop
            own = [unit.get(index) for unit in units]
            if all(rows is None for rows in own):
                continue
            known = self._products(index, block, here)
            for i, left in enumerate(own):
                if left is None:
                    continue
                with_rows[i] += left * known.with_rows
                with_regressors[i] += left * known.with_regressors
                for j, right in enumerate(own[i:], i):
                    if right is None:
                        continue
                    if known.mutual.ndim == 1:
                        np.einsum("nn->n", mutual[i][j])[:] += left * known.mutual * right
                    else:
                        mutual[i][j] += left[:, None] * known.mutual * right
        for i, left in enumerate(with_regressors):
            with_rows[i] -= left.T @ self.projected_rows
            for j, right in enumerate(with_regressors[i:], i):
                mutual[i][j] -= left.T @ right
                if j > i:
                    mutual[j][i] = mutual[i][j].T
        return mutual, with_rows

    def _products(self, index: int, block: _Block, here: slice) -> _Products:
        """Return the products of unit changes in the windows of a block."""
        if index not in self.known:
            projection, rows = self.projection[:, here], self.rows[here]
            noise_factor = self.noise_factor[here]
            if isinstance(block.covariance, _White):
                weight = 1.0 / (block.covariance.deviation * noise_factor)
                self.known[index] = _Products(weight**2, weight * rows, projection * weight)
            else:
                scale = self.scales.get(block.drift, 1.0)
                pulses = block.covariance.whiten(np.eye(len(rows)), scale) / noise_factor[:, None]
                if (index, scale) not in self.mutual:
                    self.mutual[index, scale] = pulses.T @ pulses
                self.known[index] = _Products(self.mutual[index, scale], rows @ pulses, projection @ pulses)
        return self.known[index]
