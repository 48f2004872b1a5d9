"""Coefficients and bench parameters over many recordings: control limits, and what left them first.

A quantity is judged twice: machine by machine, and recording by recording after the mean of the machine is subtracted.
What machines or days differ by in any case sets the limits, estimated from the differences of neighbours in time. A
slow change hardly enlarges those, and a single jump not at all.

A value is what the recordings say without its prior, which would draw those with large errors to the stated value: to
begin another plan would then be a step. The part of an error that is the same in all recordings of a machine is not in
what they differ by.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit

from gyrowheel_analysis.criteria import TREND_CHANCE, TREND_FEWEST, TREND_SMOOTHING
from gyrowheel_analysis.machines import Shared, Value, by_machine, machine_mean, shared, values

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]
Over = Literal["machines", "recordings"]
Change = Literal["outlier", "step", "drift"]

#: Median of the square of a normal variable.
_MEDIAN_SQUARE = 0.4549
#: Differences of neighbours that count as one independent square in their median.
_PER_DEGREE = 3.0
_ROUNDING = 1.0e-12  # of the size; values that scatter by less are the same
_NEW = 1.0e-6  # of an error at least is new in every recording


@dataclass(frozen=True)
class Departure:
    """How a quantity left its limits.

    Attributes
    ----------
    kind : Change
        ``outlier`` (a single value), ``step`` (from one value on) or ``drift`` (steadily).
    first : int
        Number of the first value that left: the outlier, the first after the step, or the first of the drift whose
        smoothed course is outside of the limits of the first values.
    size, standard_error : float
        Distance of the outlier, height of the step, or growth of the drift over the whole time.
    chance : float
        Probability that chance alone leaves the limits as far anywhere in the table.
    """

    kind: Change
    first: int
    size: float
    standard_error: float
    chance: float


@dataclass(frozen=True)
class Series:
    """Values of a quantity over time.

    Attributes
    ----------
    name : str
        The quantity, as a column of the table.
    over : Over
        Whether a value is that of a machine, or of a recording with the differences between machines subtracted.
    time : ndarray (n,)
        Start of the recording, of a machine that of its first one [s since 1970]; ascending.
    machines, recordings : tuple of str
        Machine and recording of each value; a recording that names no machine is one, with an empty name.
    value : ndarray (n,)
        Values without their priors [SI].
    standard_error : ndarray (n,)
        What their fits state of their errors; of a recording only the part that is new in it.
    repeated : ndarray (n,)
        Standard error by constants that are not as stated, which all recordings of a machine have in common, and all
        machines where a constant is wrong for all.
    """

    name: str
    over: Over
    time: Array
    machines: tuple[str, ...]
    recordings: tuple[str, ...]
    value: Array
    standard_error: Array
    repeated: Array


@dataclass(frozen=True)
class Course(Series):
    """A series with its control limits.

    Attributes
    ----------
    centre : float
        Weighted mean.
    deviation : ndarray (n,)
        Standard deviation about the centre that is usual: standard errors and differences of neighbours.
    limit : float
        Usual deviations beyond which a single value is outside of the control limits.
    departure : Departure or None
        How it left its limits; None if it did not.
    """

    centre: float
    deviation: Array
    limit: float
    departure: Departure | None

    @property
    def limits(self) -> tuple[Array, Array]:
        """Control limits of every value (n,)."""
        return self.centre - self.limit * self.deviation, self.centre + self.limit * self.deviation


@dataclass(frozen=True)
class Trend:
    """All quantities over time.

    `courses` has those that left their limits first, the least likely by chance in front; `few` are the quantities that
    too few recordings have. `shared` is what the machines share in each quantity, whatever the time. `versions` is the
    number of versions of the code that diagnosed the recordings.
    """

    courses: tuple[Course, ...]
    few: tuple[str, ...]
    shared: tuple[Shared, ...] = ()
    versions: int = 1

    @property
    def departed(self) -> tuple[Course, ...]:
        """The courses that left their limits."""
        return tuple(course for course in self.courses if course.departure is not None)

    @property
    def differing(self) -> tuple[Shared, ...]:
        """Quantities in which machines differ by more than errors; any is here by chance with `TREND_CHANCE`."""
        return tuple(own for own in self.shared if self._unlikely(own.chance))

    @property
    def unsteady(self) -> tuple[Shared, ...]:
        """Quantities in which the recordings of a machine differ by more than errors; by chance as `differing`."""
        return tuple(own for own in self.shared if self._unlikely(own.repeat_chance))

    def _unlikely(self, chance: float | None) -> bool:
        return chance is not None and chance * len(self.shared) < TREND_CHANCE


def trend(rows: Sequence[Mapping[str, Any]]) -> Trend:
    """Return every quantity of a table over time, with control limits.

    Parameters
    ----------
    rows : sequence of mapping
        Rows with ``recording``, ``start`` [s since 1970], ``version`` if known, and the columns of `shared`; those
        without a start are left out of the limits.
    """
    dated = sorted((row for row in rows if row.get("start") is not None), key=lambda row: float(row["start"]))
    known = values(dated)
    found = [series for name, own in known.items() for series in _series(name, own, dated)]
    few = known.keys() - {series.name for series in found}
    courses = [_judged(series, tests=len(found)) for series in found]
    order = {course.name: k for k, course in reversed(list(enumerate(courses)))}
    courses.sort(key=lambda c: (c.departure is None, c.departure.chance if c.departure else order[c.name]))
    versions = len({row.get("version") for row in rows})
    return Trend(tuple(courses), tuple(name for name in known if name in few), shared(rows), versions)


def _series(name: str, known: Sequence[Value], rows: Sequence[Mapping[str, Any]]) -> Iterator[Series]:
    """Yield a quantity over the machines, and over the recordings of each, where there are enough."""
    every = by_machine(known)
    if len(every) >= TREND_FEWEST:
        first = _when([own[0] for own in every.values()], rows)
        value, scatter, repeated = np.array([machine_mean(own) for own in every.values()]).T
        yield Series(name, "machines", *first, value, np.hypot(scatter, repeated), repeated)
    if len(known) - len(every) >= TREND_FEWEST:
        kept = [own for own in known if len(every[own.machine]) > 1]
        value, error, scatter = np.array([own[2:] for own in kept]).T
        scatter = np.maximum(scatter, _NEW * error)
        within = _about_mean(value, scatter**-2, _numbers([own.machine for own in kept]))
        together = float(np.average(value, weights=scatter**-2))
        repeated = np.sqrt(error**2 - scatter**2)
        yield Series(name, "recordings", *_when(kept, rows), within + together, scatter, repeated)


def _when(
    known: Sequence[Value], rows: Sequence[Mapping[str, Any]]
) -> tuple[Array, tuple[str, ...], tuple[str, ...]]:
    """Return times, machines and recordings of some values."""
    own = [rows[value.row] for value in known]
    return (
        np.array([float(row["start"]) for row in own]),
        tuple(str(row.get("machine") or "") for row in own),
        tuple(str(row.get("recording") or "") for row in own),
    )


def _numbers(names: Sequence[str]) -> Numbers:
    """Return names as numbers from 0 on."""
    return np.unique(names, return_inverse=True)[1]


def _about_mean(value: Array, weight: Array, group: Numbers) -> Array:
    """Return values about the weighted mean of their group."""
    mean: Array = np.bincount(group, weight * value) / np.bincount(group, weight)
    return value - mean[group]


def _judged(series: Series, tests: int) -> Course:
    """Return a series with its limits; `tests` is the number of series that are judged."""
    value, n = series.value, len(series.value)
    usual = _usual(series)
    centre = float(np.average(value, weights=usual.weight))
    # a value each, a step before each but the first, and a drift
    places = 2.0 * n * tests
    limit = float(-stdtrit(usual.degrees, 0.5 * TREND_CHANCE / places))
    candidates = [usual.outlier(value), usual.step(value), usual.drift(value, series.time)]
    kind, first, size, error = max(candidates, key=lambda candidate: abs(candidate[2]) / candidate[3])
    chance = min(2.0 * float(stdtr(usual.degrees, -abs(size) / error)) * places, 1.0)
    deviation = usual.weight**-0.5
    departure = None
    if abs(size) > limit * error:
        if kind == "drift":
            first = _left(value, deviation, limit)
        departure = Departure(kind, first, size, error, chance)
    return Course(**vars(series), centre=centre, deviation=deviation, limit=limit, departure=departure)


_Candidate = tuple[Change, int, float, float]


@dataclass(frozen=True)
class _Usual:
    """How values differ where nothing changes, and the clearest changes beyond.

    Attributes
    ----------
    weight : ndarray (n,)
        Inverse variances.
    group : ndarray (n,)
        Values with the same number have a mean of their own.
    common : ndarray (n,)
        Change of each value, about the mean of its group, by one standard deviation of the error that the values of a
        group have in common.
    degrees : float
        Degrees of freedom of the variances.
    """

    weight: Array
    group: Numbers
    common: Array
    degrees: float

    def off(self, value: Array) -> Array:
        """Return values about the mean of their group, without the likeliest size of the error in common."""
        about = _about_mean(value, self.weight, self.group)
        return about - self.common * self._sum(self.weight * self.common * about) / self._known

    def outlier(self, value: Array) -> _Candidate:
        """Return the value that is farthest from the mean of all others."""
        weight, lever = self.weight, self.weight * self.common
        square = weight - weight**2 / self._sum(weight) - lever**2 / self._known
        return _clearest("outlier", 0, weight * self.off(value), square, weight)

    def step(self, value: Array) -> _Candidate:
        """Return the step between two means that is clearest; at least two values are on either side."""
        weight, lever = self.weight, self.weight * self.common
        square = np.cumsum(
            weight
            - weight * (2.0 * self._before(weight) + weight) / self._sum(weight)
            - lever * (2.0 * self._before(lever) + lever) / self._known
        )
        return _clearest("step", 2, -np.cumsum(weight * self.off(value))[1:-2], square[1:-2], weight)

    def drift(self, value: Array, time: Array) -> _Candidate:
        """Return the straight line over time, as its growth from the first to the last value."""
        span = float(np.ptp(time))
        where = (time - time[0]) / span if span > 0.0 else np.linspace(0.0, 1.0, len(time))
        weighed = self.weight * self.off(where)
        return _clearest("drift", 0, np.array([weighed @ value]), np.array([weighed @ where]), self.weight)

    @property
    def _known(self) -> Array:
        """The inverse variance of the size of the error in common, by the values and as stated."""
        return 1.0 + self._sum(self.weight * self.common**2)

    def _sum(self, value: Array) -> Array:
        """Return the sum over the group of each value."""
        return np.asarray(np.bincount(self.group, value)[self.group], dtype=float)

    def _before(self, value: Array) -> Array:
        """Return the sum of the values before each in its group."""
        order = np.argsort(self.group, kind="stable")
        total = np.bincount(self.group, value)
        result = np.empty_like(value)
        result[order] = np.cumsum(value[order]) - value[order] - (np.cumsum(total) - total)[self.group[order]]
        return result


def _clearest(kind: Change, first: int, slope: Array, square: Array, weight: Array) -> _Candidate:
    """Return the clearest of several changes with normal equations ``square * size = slope``; `first` is the first.

    The values do not determine a step between the recordings of one machine and those of the next.
    """
    determined = square > _ROUNDING * weight.sum()
    square = np.where(determined, square, 1.0)
    size = np.where(determined, slope / square, 0.0)
    k = int(np.argmax(np.abs(size) * np.sqrt(square)))
    return kind, first + k, float(size[k]), float(square[k] ** -0.5)


def _usual(series: Series) -> _Usual:
    """Return the usual variances: those of the errors, and what neighbours in time differ by beyond them."""
    value, error = series.value, series.standard_error
    group = _numbers(series.machines) if series.over == "recordings" else np.zeros(len(value), dtype=np.intp)
    together = group[1:] == group[:-1]

    def expected(variance: Array) -> Array:
        """Return the expected squares of the differences of neighbours."""
        about = variance - (1.0 / np.bincount(group, 1.0 / variance))[group]
        return np.where(together, variance[1:] + variance[:-1], about[1:] + about[:-1])

    def more(spread: float) -> bool:
        """Return whether neighbours differ by more than by their errors and this variance."""
        variance = error**2 + spread
        square = np.diff(_about_mean(value, 1.0 / variance, group)) ** 2
        return float(np.median(square / expected(variance))) > _MEDIAN_SQUARE

    low, high = 0.0, float(np.ptp(value)) ** 2 / _MEDIAN_SQUARE if more(0.0) else 0.0
    for _ in range(40 if high else 0):  # to 1e-12 of the range
        middle = 0.5 * (low + high)
        low, high = (middle, high) if more(middle) else (low, middle)
    variance = error**2 + high
    weight = 1.0 / variance
    # Satterthwaite: how well the differences determine a variance that all have, and how much a mean depends on it
    known = float(np.sum((2.0 / expected(variance)) ** 2)) / _PER_DEGREE
    degrees = known * (np.sum(weight) / float(weight @ weight)) ** 2
    return _Usual(weight, group, _about_mean(series.repeated, weight, group), max(float(degrees), 2.0))


def _left(value: Array, deviation: Array, limit: float) -> int:
    """Return the number of the first value at which the smoothed course leaves the limits of the first values.

    The smoothing is exponential (a chart of Roberts); where the course never leaves them, it is the last value.
    """
    base = max(TREND_FEWEST, len(value) // 4)
    weight = deviation[:base] ** -2
    centre, error = float(np.average(value[:base], weights=weight)), float(weight.sum() ** -0.5)
    level, variance = centre, 0.0
    for k in range(base, len(value)):
        level += TREND_SMOOTHING * (value[k] - level)
        variance = (1.0 - TREND_SMOOTHING) ** 2 * variance + (TREND_SMOOTHING * deviation[k]) ** 2
        if abs(level - centre) > limit * math.sqrt(variance + error**2):
            return k
    return len(value) - 1
