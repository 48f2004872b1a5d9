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
    EVENT_NEAR,
    EVENT_PRICE,
    FORM_GAIN,
    SWING_FASTEST,
    SWINGS_FEWEST,
    SWINGS_MOST,
    TREND_SHORTEST,
)
from gyrowheel_analysis.diagnosis.evidence import Array, Evidence, Profiles, Rows
from gyrowheel_analysis.fitting.events import (
    AFTER_TILT,
    HAPPENS,
    TEMPERATURES,
    TOGETHER,
    Event,
    Kind,
    is_law,
    temperature,
)
from gyrowheel_analysis.fitting.noise import NOT_FINITE
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags.reader import pauses

_BURST_EDGES = 300  # windows between all of which bursts are tried
_SHORT_BURST = 16  # windows of a burst that is tried anywhere
_BREAKS = 28  # times at which a trend may begin or end
_PAUSE = 3600.0  # s between windows; longer than in any plan
#: Phases of a swing that are tried, over half a period.
PHASES = 6
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


_NO_PAIRS = np.zeros((0, 2), dtype=np.int64)


class _Steps(Profiles):
    """Steps between all windows; their sums are cumulative."""

    def __init__(self, between: Array) -> None:
        super().__init__("step", between[:, None], np.zeros((0, 0)))

    def sums(self, values: Array) -> Array:
        return np.asarray(values[..., ::-1].cumsum(axis=-1)[..., -2::-1])

    def squares(self, block: Rows, left: Array, right: Array) -> Array:
        return block.of_steps(left, right, _NO_PAIRS)[0][1:]


class _Bursts(Profiles):
    """Bursts from one window to another, by the numbers of the first one and of that after the last one (m, 2).

    Between many windows, not all pairs are tried: all short bursts, and long ones whose edges are on a grid.
    """

    def __init__(self, between: Array) -> None:
        n = len(between) + 1
        self.stride = -(-n // _BURST_EDGES)
        # a burst with hardly anything before or after it is a step
        every = np.arange(BURST_BESIDE, n - BURST_BESIDE + 1)
        self._grid = every[:: self.stride]
        self._ends = np.triu_indices(len(self._grid), k=1)  # of a burst, on the grid
        pairs = np.column_stack([self._grid[end] for end in self._ends])
        self._order = np.arange(len(pairs))  # of those on the grid, then the short ones by their length
        self._within = slice(every[0], every[-1] + 1)
        if self.stride > 1:
            short = [np.column_stack([every[:-k], every[k:]]) for k in range(1, _SHORT_BURST + 1)]
            # in the order of time
            pairs, self._order = np.unique(np.concatenate([pairs, *short]), axis=0, return_index=True)
        self._pairs, self._possible = pairs, _within(n)
        edges = np.column_stack([between[self._pairs[:, 0] - 1], between[self._pairs[:, 1] - 1]])
        super().__init__("burst", edges, np.zeros((0, 0)))

    @property
    def places(self) -> int:
        return self._possible

    def sums(self, values: Array) -> Array:
        before = np.concatenate([np.zeros((*values.shape[:-1], 1)), values.cumsum(axis=-1)], axis=-1)
        return np.asarray(before[..., self._pairs[:, 1]] - before[..., self._pairs[:, 0]])

    def squares(self, block: Rows, left: Array, right: Array) -> Array:
        return block.of_steps(left, right, self._pairs)[1]

    def explained(self, left: Array, right: Array) -> Array:
        one, other = (
            np.concatenate([np.zeros((1, len(own))), own.T.cumsum(axis=0)]) for own in (left, right)
        )
        own = np.einsum("np,np->n", one, other)
        mixed = self._mixed(one, other)
        mixed += mixed if right is left else self._mixed(other, one)
        a, b = self._pairs.T
        return np.asarray(own[a] + own[b] - mixed)

    def _mixed(self, one: Array, other: Array) -> Array:
        """Return the products (events,) of the rows of `one` (n + 1, p) at the begins and of `other` at the ends."""
        found = [(one[self._grid] @ other[self._grid].T)[self._ends]]
        if self.stride > 1:
            begins, ends = one[self._within], other[self._within]
            found += [np.einsum("np,np->n", begins[:-k], ends[k:]) for k in range(1, _SHORT_BURST + 1)]
        return np.concatenate(found)[self._order]


class _Swings(Profiles):
    """Swings of some periods [s], each with `PHASES` phases: all of a period are sums of the same two courses."""

    def __init__(self, start: Array, duration: Array, periods: Array) -> None:
        begin, self._count = float(start.min()), len(periods)
        shift = np.arange(PHASES) / (2.0 * PHASES)  # of a period
        edges = np.column_stack(
            [
                (begin + shift * periods[:, None]).ravel(),
                np.repeat(periods, PHASES),
            ]
        )
        # at the begin of the recording, and a quarter of a period later
        pairs = [
            Event(0, "", "swing", begin + quarter * period, period).profile(start, duration)
            for quarter in (0.0, 0.25)
            for period in periods.tolist()
        ]
        super().__init__("swing", edges, np.array(pairs))
        self._parts = np.cos(2.0 * math.pi * shift), np.sin(2.0 * math.pi * shift)

    def sums(self, values: Array) -> Array:
        both = super().sums(values).reshape(*values.shape[:-1], 2, self._count, 1)
        cosine, sine = self._parts
        return (both[..., 0, :, :] * cosine + both[..., 1, :, :] * sine).reshape(*values.shape[:-1], -1)

    def squares(self, block: Rows, left: Array, right: Array) -> Array:
        return self._phased(block.of_courses(self._courses.reshape(-1, 2, self._count), left, right))

    def explained(self, left: Array, right: Array) -> Array:
        one = super().sums(left).reshape(len(left), 2, self._count)
        other = one if right is left else super().sums(right).reshape(one.shape)
        products = [[np.einsum("np,np->p", one[:, i], other[:, j]) for j in (0, 1)] for i in (0, 1)]
        return self._phased(np.array(products))

    def _phased(self, products: Array) -> Array:
        """Return the products (events,) of all phases from those (2, 2, periods) of the two courses of every period."""
        cosine, sine = self._parts
        mixed = (products[0, 1] + products[1, 0])[:, None]
        return np.asarray(
            products[0, 0][:, None] * cosine**2 + mixed * (cosine * sine) + products[1, 1][:, None] * sine**2
        ).ravel()


def _within(n: int) -> int:
    """Return the number of bursts between n windows that have windows before and after them."""
    edges = max(n - 2 * BURST_BESIDE + 1, 0)
    return edges * (edges - 1) // 2


def _profiles(start: Array, duration: Array) -> list[Profiles]:
    """Return the events of every kind that windows in the order of time may show."""
    n = len(start)
    stop = start + duration
    # between two windows, unless within the second one
    between = 0.5 * (stop[:-1] + start[1:])
    result: list[Profiles] = [_Steps(between)]
    if _within(n):
        result.append(_Bursts(between))
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
    result: list[Profiles] = []
    # over pauses a fast swing cannot be followed, and would need too many shapes
    most = (length - float(np.diff(pauses(start, _PAUSE)).sum())) / SWING_FASTEST
    if most > SWINGS_FEWEST:
        periods = length / np.arange(SWINGS_FEWEST, min(most, SWINGS_MOST), 0.25)
        result.append(_Swings(start, duration, periods))
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
        kind, sum(profiles.places for kinds in of_recordings for profiles in kinds if profiles.kind == kind)
    )


def scan(evidence: Evidence, of_recordings: Sequence[Sequence[Profiles]]) -> list[Candidate]:
    """Return the best candidate of every kind and of all that changes together, best first.

    `of_recordings` are the `places` of the problem. A shape that is a law must gain as much more as a free form.
    """
    found = []
    for recording, kinds in enumerate(of_recordings):
        prices = [price(profiles.kind, of_recordings) for profiles in kinds]
        for quantities in TOGETHER:
            all_gains = evidence.gains(quantities, recording, kinds)
            for profiles, gains, own in zip(kinds, all_gains, prices, strict=True):
                if is_law(profiles.kind, quantities[0]):
                    own += FORM_GAIN
                found.append(_best(recording, quantities, profiles, gains, own))
        for lag in LAGS:
            found.append(_after_tilt(evidence, recording, lag))
    return sorted(found, key=lambda candidate: -candidate.score)


def best_at(
    evidence: Evidence, events: Sequence[Event], of_recordings: Sequence[Sequence[Profiles]]
) -> Candidate:
    """Return the best candidate like an event: of its kind and quantities, with edges near its own."""
    first = events[0]
    names = [event.quantity for event in events]
    profiles = next(own for own in of_recordings[first.recording] if own.kind == first.kind)
    (gains,) = evidence.gains(names, first.recording, [profiles])
    near = np.abs(profiles.edges - np.array(first.edges)).max(axis=1, initial=0.0)
    if first.kind in HAPPENS:
        gains = np.where(near <= max(EVENT_NEAR, near.min()), gains, -math.inf)
    return _best(first.recording, names, profiles, gains, chance(first.kind, profiles.places))


def _best(
    recording: int, quantities: Sequence[str], profiles: Profiles, gains: Array, price: float
) -> Candidate:
    """Return the best of some profiles; InputError if a gain is not finite."""
    k = int(np.argmax(gains))
    if not math.isfinite(gains[k]):
        raise InputError(NOT_FINITE)
    gain, edges = float(gains[k]), profiles.edges[k].tolist()
    events = tuple(Event(recording, name, profiles.kind, *edges) for name in quantities)
    return Candidate(events, gain, gain - price, _spans(profiles, gains >= gain - EVENT_LIKELY))


def _after_tilt(evidence: Evidence, recording: int, lag: float) -> Candidate:
    """Return a torque that follows the tilt with a delay."""
    count = len(evidence.problem.balances[recording].windows)
    always = Profiles("after_tilt", [(lag,)], np.ones((1, count)))
    (gains,) = evidence.gains((AFTER_TILT.name,), recording, [always], lag)
    gain = float(gains[0])
    event = Event(recording, AFTER_TILT.name, "after_tilt", lag)
    number = len(LAGS) * len(evidence.problem.balances)
    return Candidate((event,), gain, gain - chance("after_tilt", number) - FORM_GAIN, ((lag, lag),))


def _spans(profiles: Profiles, likely: NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """Return the range of times in which each edge is about as likely, up to the next less likely time."""
    result = []
    for tried, own in zip(profiles.tried, profiles.edges[likely].T, strict=True):
        low, high = np.searchsorted(tried, (own.min(), own.max()))
        low, high = max(low - profiles.stride, 0), min(high + profiles.stride, len(tried) - 1)
        result.append((float(tried[low]), float(tried[high])))
    return tuple(result)
