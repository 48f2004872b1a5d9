"""The scan for events: how much likelier a change at any time, of any quantity, makes the recordings.

A change in the middle of a recording looks like a slow drift that happens to move there. The two are compared by
marginal likelihood with the size of the drift left free, so that neither passes for the other. What bench parameters
and effects can explain is no event: all of them are regressors beside it.

For every place the likelihood needs the products of that event with itself and with the rows, once everything else is
projected out. These are sums over the products of single windows, which are formed once for each quantity.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from gyrowheel_analysis.fitting.drift import DriftCovariance
from gyrowheel_analysis.fitting.events import QUANTITIES, Event, Kind, unit_rows
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.noise import scale_cost
from gyrowheel_analysis.fitting.problem import Problem

Array = NDArray[np.float64]

#: Between the likeliest drifts without an event and those as stated: drifts that are tried with an event.
_DRIFT_STEPS = 5
_RAISED = 1.05  # scale of a drift that counts as enlarged
_BREAKS = 28  # times at which a trend may begin or end
_SHORTEST_TREND = 8.0  # s; anything shorter is a step
_BESIDE = 3  # windows at least before and after a burst
#: Gain that a kind must bring beyond its number of places, so that the simplest kind is taken where two serve.
_PRICE: dict[Kind, float] = {"step": 0.0, "burst": 3.0, "trend": 3.0}
PREFERRED = 6.0  # likelihood by which a quantity must be better than a simpler one


@dataclass(frozen=True)
class Candidate:
    """An event that may have happened.

    Attributes
    ----------
    event : Event
        The event.
    gain : float
        By how much it raises twice the log marginal likelihood.
    score : float
        The gain less what chance alone brings somewhere among all places.
    """

    event: Event
    gain: float
    score: float


class Evidence:
    """Marginal likelihood of the averages beside everything that bench parameters and effects can explain.

    Parameters
    ----------
    problem : Problem
        The problem, with the events that are known already.
    fit : Fit
        The fit about which everything is linear.
    """

    def __init__(self, problem: Problem, fit: Fit) -> None:
        unknowns = problem.unknowns
        offset = np.concatenate([fit.nuisance, [fit.coefficients[t][name] for t, name in fit.columns]])
        rows = fit.residual + fit.jacobian @ (offset - unknowns.centre(fit.terms))
        columns = np.hstack([fit.jacobian * unknowns.widths(fit.terms), problem.prediction.candidate_columns])
        self.problem = problem
        self.scales, _ = problem.noise.best_scales(rows, columns)
        self._blocks, self._rows, self._columns, _ = problem.noise.of_averages(rows, columns)
        self._states: dict[tuple[float, ...], _State] = {}

    @property
    def average_rows(self) -> list[tuple[int, str]]:
        """Recording and name of every block of rows, in order."""
        per_recording = len(self._blocks) // len(self.problem.balances)
        return [
            (number, balance.rows[k])
            for number, balance in enumerate(self.problem.balances)
            for k in range(per_recording)
        ]

    def state(self, scales: Mapping[str, float]) -> _State:
        """Return rows and regressors whitened for scales of the drifts."""
        key = tuple(scales.values())
        if key not in self._states:
            self._states[key] = _State.of(self._blocks, self._rows, self._columns, scales)
        return self._states[key]

    def paths(self, drifts: Sequence[str]) -> Iterator[dict[str, float]]:
        """Yield scales of the drifts, from the likeliest without an event to some of them as stated."""
        raised = any(self.scales[name] > _RAISED for name in drifts)
        for share in np.linspace(1.0, 0.0, _DRIFT_STEPS) if raised else (1.0,):
            yield self.scales | {name: self.scales[name] ** float(share) for name in drifts}

    def gains(self, quantity: str, recording: int, profiles: Profiles) -> Array:
        """Return by how much events raise twice the log likelihood, each with the drifts that suit it best.

        Parameters
        ----------
        quantity : str
            What changes.
        recording : int
            In which recording.
        profiles : Profiles
            The course of the events.
        """
        what = QUANTITIES[quantity]
        unit = self._unit(quantity, recording)
        count = len(self.problem.balances[recording].windows)
        best = np.full(len(profiles), -math.inf)
        without = self.state(self.scales).cost + scale_cost(self.scales)
        for scales in self.paths(what.drifts):
            state = self.state(scales)
            square, along = state.of_windows(unit, count)
            m, b = profiles.square(square), profiles.along(along)
            cost = state.cost + scale_cost(scales) + np.log1p(m) - b**2 / (1.0 + m)
            best = np.maximum(best, without - cost)
        return best

    def limit(self, quantity: str, recording: int, profiles: Profiles, needed: float) -> float:
        """Return the smallest size of the first of some events that is expected to bring a score [SI]."""
        unit = self._unit(quantity, recording)
        count = len(self.problem.balances[recording].windows)
        square, _ = self.state(self.scales).of_windows(unit, count)
        m = float(profiles.square(square)[0])
        gain = needed + chance(profiles.kind, _count(profiles.kind, places(self.problem))) + math.log1p(m)
        return QUANTITIES[quantity].width(self.problem.bench) * math.sqrt(gain * (1.0 + m)) / m

    def _unit(self, quantity: str, recording: int) -> list[Array]:
        """Return the rows of a large change of a quantity all the time, block by block."""
        what = QUANTITIES[quantity]
        balance = self.problem.balances[recording]
        rows = unit_rows(balance, what) * what.width(self.problem.bench)
        return [
            rows[balance.row(name)] if number == recording else np.zeros(len(block))
            for (number, name), (block, _) in zip(self.average_rows, self._blocks, strict=True)
        ]


@dataclass(frozen=True)
class _State:
    """Rows whitened for some scales of the drifts, with what the regressors explain of them.

    `explained` and `inverse` give the products of any two columns beside the regressors: their scalar product less that
    of their images.
    """

    blocks: Sequence[tuple[DriftCovariance, str]]
    scales: Mapping[str, float]
    rows: Array
    images: Array
    root: Array
    image: Array
    cost: float

    @classmethod
    def of(
        cls,
        blocks: Sequence[tuple[DriftCovariance, str]],
        rows: Array,
        columns: Array,
        scales: Mapping[str, float],
    ) -> _State:
        parts, at, log_det = [], 0, 0.0
        both = np.column_stack([columns, rows])
        for block, drift in blocks:
            parts.append(block.whiten(both[at : at + len(block)], scales[drift]))
            log_det += block.log_determinant(scales[drift])
            at += len(block)
        white = np.concatenate(parts)
        design, target = white[:, :-1], white[:, -1]
        root = np.asarray(np.linalg.cholesky(design.T @ design + np.eye(design.shape[1])), dtype=np.float64)
        images = solve_triangular(root, design.T, lower=True, check_finite=False)
        image = images @ target
        log_det += 2.0 * float(np.log(np.diag(root)).sum())
        return cls(
            blocks, scales, target, images, root, image, log_det + float(target @ target - image @ image)
        )

    def of_windows(self, unit: Sequence[Array], count: int) -> tuple[Array, Array]:
        """Return products of the single windows of a quantity with each other (n, n) and with the rows (n,).

        `unit` has the rows of the quantity, block by block; the blocks of other recordings are zero.
        """
        square, along = np.zeros((count, count)), np.zeros(count)
        image, at = np.zeros((len(self.image), count)), 0
        for (block, drift), rows in zip(self.blocks, unit, strict=True):
            n = len(block)
            if rows.any():
                pulses = block.whiten(np.diag(rows), self.scales[drift])
                square += pulses.T @ pulses
                along += pulses.T @ self.rows[at : at + n]
                image += self.images[:, at : at + n] @ pulses
            at += n
        return square - image.T @ image, along - image.T @ self.image


class Profiles:
    """The course of many events of one kind over the windows of a recording (events, n)."""

    def __init__(self, kind: Kind, edges: Sequence[tuple[float, ...]], weights: Array) -> None:
        self.kind, self.edges, self._weights = kind, edges, weights

    def __len__(self) -> int:
        return len(self.edges)

    def square(self, products: Array) -> Array:
        """Return the product of every event with itself."""
        return np.einsum("en,en->e", self._weights @ products, self._weights)

    def along(self, products: Array) -> Array:
        """Return the product of every event with the rows."""
        return np.asarray(self._weights @ products)


class _Bursts(Profiles):
    """Bursts from one window to another; their products are differences of cumulative sums."""

    def __init__(
        self, edges: Sequence[tuple[float, ...]], first: NDArray[np.int64], last: NDArray[np.int64]
    ) -> None:
        super().__init__("burst", edges, np.zeros((0, 0)))
        self._first, self._last = first, last

    def square(self, products: Array) -> Array:
        total = np.zeros((len(products) + 1, len(products) + 1))
        total[1:, 1:] = products.cumsum(axis=0).cumsum(axis=1)
        a, b = self._first, self._last
        return total[b, b] - total[a, b] - total[b, a] + total[a, a]

    def along(self, products: Array) -> Array:
        total = np.concatenate([[0.0], products.cumsum()])
        return np.asarray(total[self._last] - total[self._first])


def _profiles(start: Array, duration: Array) -> list[Profiles]:
    """Return the events of every kind that windows in the order of time may show."""
    n = len(start)
    steps = np.arange(1, n)
    stop = start + duration
    # between two windows, if not somewhere in the second one
    between = 0.5 * (stop[:-1] + start[1:])
    result = [
        Profiles("step", [(float(t),) for t in between], (np.arange(n) >= steps[:, None]).astype(np.float64))
    ]
    first, last = (part + 1 for part in np.triu_indices(n - 1, k=1))
    # a burst with hardly anything before or after it is a step
    within = (first >= _BESIDE) & (last <= n - _BESIDE)
    first, last = first[within], last[within]
    if len(first):
        edges = [(float(between[a - 1]), float(between[b - 1])) for a, b in zip(first, last, strict=True)]
        result.append(_Bursts(edges, first, last))
    breaks = np.unique(np.r_[start[:: max(n // _BREAKS, 1)], stop[-1]])
    spans = [
        (float(a), float(b))
        for i, a in enumerate(breaks)
        for b in breaks[i + 1 :]
        if b - a >= _SHORTEST_TREND
    ]
    if spans:
        weights = np.array([Event(0, "", "trend", a, b).profile(start, duration) for a, b in spans])
        result.append(Profiles("trend", spans, weights))
    return result


def chance(kind: Kind, places: int) -> float:
    """Return the gain that chance brings somewhere among all places at which an event of a kind may be."""
    return 2.0 * math.log(max(places, 1) * len(QUANTITIES)) + _PRICE[kind]


def places(problem: Problem) -> list[list[Profiles]]:
    """Return the events that every recording may show, by kind."""
    return [_profiles(balance.windows.start, balance.windows.duration) for balance in problem.balances]


def scan(evidence: Evidence) -> list[Candidate]:
    """Return the best candidate of every quantity and kind, best first."""
    found = []
    of_recordings = places(evidence.problem)
    for recording, kinds in enumerate(of_recordings):
        for profiles in kinds:
            price = chance(profiles.kind, _count(profiles.kind, of_recordings))
            for quantity in QUANTITIES:
                gains = evidence.gains(quantity, recording, profiles)
                k = int(np.argmax(gains))
                event = Event(recording, quantity, profiles.kind, *profiles.edges[k])
                found.append(Candidate(event, float(gains[k]), float(gains[k]) - price))
    return sorted(found, key=lambda candidate: -candidate.score)


def _count(kind: Kind, of_recordings: Sequence[Sequence[Profiles]]) -> int:
    return sum(len(profiles) for kinds in of_recordings for profiles in kinds if profiles.kind == kind)
