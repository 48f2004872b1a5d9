"""The scan for events and for shapes of drifts: possible changes, their times or shapes, and their likelihood."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import (
    BURST_BESIDE,
    DRIFT_WARMING,
    EVENT_LIKELY,
    EVENT_PRICE,
    SWING_FASTEST,
    SWINGS_FEWEST,
    TREND_SHORTEST,
)
from gyrowheel_analysis.diagnosis.evidence import Array, Evidence, Profiles
from gyrowheel_analysis.fitting.events import AFTER_TILT, TEMPERATURES, TOGETHER, Event, Kind, temperature
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_recording.bags.reader import pauses

_BREAKS = 28  # times at which a trend may begin or end
_PAUSE = 3600.0  # s between windows; longer than in any plan
_PHASES = 6  # of a swing, over half a period
#: Times in which a torque that follows the tilt may relax [s].
LAGS = (3.0, 10.0, 30.0)


@dataclass(frozen=True)
class Candidate:
    """A possible change of one quantity or of two at once.

    `events` has the change of every quantity, all with the same recording, kind and edges. `gain` is the increase of
    twice the log marginal likelihood, `score` the gain less that which chance alone brings somewhere among all places.
    `spans` are the ranges of times in which each of the edges is about as likely [s].
    """

    events: tuple[Event, ...]
    gain: float
    score: float
    spans: tuple[tuple[float, float], ...]

    @property
    def first(self) -> Event:
        """The first of its events; all have its recording, kind and edges."""
        return self.events[0]

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the quantities that change."""
        return tuple(event.quantity for event in self.events)


class _Bursts(Profiles):
    """Bursts from one window to another; their products are differences of cumulative sums."""

    def __init__(self, edges: Array, first: NDArray[np.int64], last: NDArray[np.int64]) -> None:
        super().__init__("burst", edges, np.zeros((0, 0)))
        self._first, self._last = first, last

    def norms(self, products: Array) -> Array:
        total = np.zeros((len(products) + 1, len(products) + 1))
        total[1:, 1:] = products.cumsum(axis=0).cumsum(axis=1)
        a, b = self._first, self._last
        return total[b, b] - total[a, b] - total[b, a] + total[a, a]

    def projections(self, products: Array) -> Array:
        total = np.concatenate([[0.0], products.cumsum()])
        return np.asarray(total[self._last] - total[self._first])


def _profiles(start: Array, duration: Array) -> list[Profiles]:
    """Return the events of every kind that windows in the order of time may show."""
    n = len(start)
    steps = np.arange(1, n)
    stop = start + duration
    # between two windows, unless within the second one
    between = 0.5 * (stop[:-1] + start[1:])
    result = [Profiles("step", between[:, None], (np.arange(n) >= steps[:, None]).astype(np.float64))]
    first, last = (part + 1 for part in np.triu_indices(n - 1, k=1))
    # a burst with hardly anything before or after it is a step
    within = (first >= BURST_BESIDE) & (last <= n - BURST_BESIDE)
    first, last = first[within], last[within]
    if len(first):
        result.append(_Bursts(np.column_stack([between[first - 1], between[last - 1]]), first, last))
    breaks = np.unique(np.r_[start[:: max(n // _BREAKS, 1)], stop[-1]])
    spans = [
        (float(a), float(b)) for i, a in enumerate(breaks) for b in breaks[i + 1 :] if b - a >= TREND_SHORTEST
    ]
    if spans:
        weights = np.array([Event(0, "", "trend", a, b).profile(start, duration) for a, b in spans])
        result.append(Profiles("trend", spans, weights))
    return result


def _shapes(windows: Windows) -> list[Profiles]:
    """Return the shapes that drifts may have, except those that follow the tilt."""
    start, duration = windows.start, windows.duration
    length = float((start + duration).max(initial=0.0) - start.min(initial=math.inf))
    result = []
    # over pauses a fast swing cannot be followed, and would need too many shapes
    most = (length - float(np.diff(pauses(start, _PAUSE)).sum())) / SWING_FASTEST
    if most > SWINGS_FEWEST:
        turns = np.arange(SWINGS_FEWEST, most, 0.25)
        edges = [
            (float(start.min() + 0.5 * phase * length / turn / _PHASES), float(length / turn))
            for turn in turns
            for phase in range(_PHASES)
        ]
        weights = np.array([Event(0, "", "swing", *own).profile(start, duration) for own in edges])
        result.append(Profiles("swing", edges, weights))
    for kind in TEMPERATURES:
        if np.ptp(temperature(windows, kind)) > DRIFT_WARMING:
            result.append(Profiles(kind, [()], Event(0, "", kind).course(windows)[None, :]))
    return result


def chance(kind: Kind, places: int) -> float:
    """Return the gain that chance brings somewhere among all places at which an event of a kind may be."""
    return 2.0 * math.log(max(places, 1) * len(TOGETHER)) + EVENT_PRICE.get(kind, 0.0)


def places(problem: Problem) -> list[list[Profiles]]:
    """Return the events that every recording may show, by kind."""
    return [
        [*_profiles(balance.windows.start, balance.windows.duration), *_shapes(balance.windows)]
        for balance in problem.balances
    ]


def price(kind: Kind, of_recordings: Sequence[Sequence[Profiles]]) -> float:
    """Return the gain that chance brings among the places of a kind in all recordings."""
    return chance(
        kind, sum(len(profiles) for kinds in of_recordings for profiles in kinds if profiles.kind == kind)
    )


def scan(evidence: Evidence) -> list[Candidate]:
    """Return the best candidate of every kind and of all that changes together, best first."""
    found = []
    of_recordings = places(evidence.problem)
    for recording, kinds in enumerate(of_recordings):
        prices = [price(profiles.kind, of_recordings) for profiles in kinds]
        for quantities in TOGETHER:
            all_gains = evidence.gains(quantities, recording, kinds)
            for profiles, gains, own in zip(kinds, all_gains, prices, strict=True):
                found.append(_best(recording, quantities, profiles, gains, own))
        for lag in LAGS:
            found.append(_after_tilt(evidence, recording, lag))
    return sorted(found, key=lambda candidate: -candidate.score)


def _best(
    recording: int, quantities: Sequence[str], profiles: Profiles, gains: Array, price: float
) -> Candidate:
    """Return the best of some profiles."""
    k = int(np.argmax(gains))
    gain, edges = float(gains[k]), profiles.edges[k].tolist()
    events = tuple(Event(recording, name, profiles.kind, *edges) for name in quantities)
    return Candidate(events, gain, gain - price, _spans(profiles, gains > gain - EVENT_LIKELY))


def _after_tilt(evidence: Evidence, recording: int, lag: float) -> Candidate:
    """Return a torque that follows the tilt with a delay."""
    count = len(evidence.problem.balances[recording].windows)
    always = Profiles("after_tilt", [(lag,)], np.ones((1, count)))
    (gains,) = evidence.gains((AFTER_TILT.name,), recording, [always], lag)
    gain = float(gains[0])
    event = Event(recording, AFTER_TILT.name, "after_tilt", lag)
    number = len(LAGS) * len(evidence.problem.balances)
    return Candidate((event,), gain, gain - chance("after_tilt", number), ((lag, lag),))


def _spans(profiles: Profiles, likely: NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """Return the range of times in which each edge is about as likely, up to the next less likely time."""
    result = []
    for tried, own in zip(profiles.tried, profiles.edges[likely].T, strict=True):
        low, high = np.searchsorted(tried, (own.min(), own.max()))
        result.append((float(tried[max(low - 1, 0)]), float(tried[min(high + 1, len(tried) - 1)])))
    return tuple(result)
