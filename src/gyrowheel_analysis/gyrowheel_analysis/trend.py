"""Coefficients and bench parameters over many recordings: control limits, and what left them first.

A quantity is judged twice: machine by machine, and recording by recording after the mean of the machine is subtracted.
What machines or days differ by in any case sets the limits, estimated from the differences of neighbours in time. A
slow change hardly enlarges those, and a single jump not at all.
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
from gyrowheel_analysis.machines import Shared, shared

Array = NDArray[np.float64]
Over = Literal["machines", "recordings"]
Change = Literal["outlier", "step", "drift"]

#: Median of the square of a normal variable.
_MEDIAN_SQUARE = 0.4549
#: Differences of neighbours that count as one independent square in their median.
_PER_DEGREE = 3.0
_ROUNDING = 1.0e-12  # of the size; values that scatter by less are the same


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
        Machine and recording of each value.
    value, standard_error : ndarray (n,)
        Values with the standard errors that their fits state [SI].
    """

    name: str
    over: Over
    time: Array
    machines: tuple[str, ...]
    recordings: tuple[str, ...]
    value: Array
    standard_error: Array


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
    too few recordings have. `shared` is what the machines share in each quantity, whatever the time.
    """

    courses: tuple[Course, ...]
    few: tuple[str, ...]
    shared: tuple[Shared, ...] = ()

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
        Rows with ``recording``, ``machine``, ``start`` [s since 1970] and, for every quantity, ``NAME`` and
        ``NAME.error``; rows without a start are left out. For further columns of `shared` see there.
    """
    dated = sorted((row for row in rows if row.get("start") is not None), key=lambda row: float(row["start"]))
    names = dict.fromkeys(
        name.removesuffix(".error") for row in dated for name in row if name.endswith(".error")
    )
    found = [
        series for name in names for series in _series(name, [row for row in dated if _known(row, name)])
    ]
    few = names.keys() - {series.name for series in found}
    courses = [_judged(series, tests=len(found)) for series in found]
    order = {course.name: k for k, course in reversed(list(enumerate(courses)))}
    courses.sort(key=lambda c: (c.departure is None, c.departure.chance if c.departure else order[c.name]))
    return Trend(tuple(courses), tuple(name for name in names if name in few), shared(rows))


def _known(row: Mapping[str, Any], name: str) -> bool:
    value, error = row.get(name), row.get(f"{name}.error")
    if value is None or error is None:
        return False
    return math.isfinite(value) and math.isfinite(error) and error > 0.0


def _series(name: str, rows: Sequence[Mapping[str, Any]]) -> Iterator[Series]:
    """Yield a quantity over the machines, and over the recordings of each, where there are enough."""
    value, error, time = (
        np.array([float(row[column]) for row in rows]) for column in (name, f"{name}.error", "start")
    )
    machines = [str(row.get("machine") or "") for row in rows]
    recordings = [str(row.get("recording") or "") for row in rows]
    places = {
        machine: np.flatnonzero([m == machine for m in machines]) for machine in dict.fromkeys(machines)
    }
    means = {m: float(np.average(value[at], weights=error[at] ** -2)) for m, at in places.items()}
    if len(places) >= TREND_FEWEST:
        first = [at[0] for at in places.values()]
        yield Series(
            name, "machines", time[first], tuple(places), tuple(recordings[k] for k in first),
            np.array(list(means.values())), np.array([np.sum(error[at] ** -2) ** -0.5 for at in places.values()]),
        )  # fmt: skip
    if len(rows) - len(places) >= TREND_FEWEST:
        together = float(np.average(value, weights=error**-2))
        within = value - np.array([means[m] for m in machines]) + together
        kept = [k for k, machine in enumerate(machines) if len(places[machine]) > 1]
        yield Series(
            name, "recordings", time[kept], tuple(machines[k] for k in kept),
            tuple(recordings[k] for k in kept), within[kept], error[kept],
        )  # fmt: skip


def _judged(series: Series, tests: int) -> Course:
    """Return a series with its limits; `tests` is the number of series that are judged."""
    value, n = series.value, len(series.value)
    deviation = _usual(value, series.standard_error)
    degrees = max((n - 1) / _PER_DEGREE, 2.0)
    weight = deviation**-2
    centre = float(np.average(value, weights=weight))
    # a value each, a step before each but the first, and a drift
    places = 2.0 * n * tests
    limit = float(-stdtrit(degrees, 0.5 * TREND_CHANCE / places))
    candidates = [_outlier(value, deviation), _step(value, weight), _drift(series.time, value, weight)]
    kind, first, size, error = max(candidates, key=lambda candidate: abs(candidate[2]) / candidate[3])
    chance = min(2.0 * float(stdtr(degrees, -abs(size) / error)) * places, 1.0)
    departure = None
    if abs(size) > limit * error:
        if kind == "drift":
            first = _left(value, deviation, limit)
        departure = Departure(kind, first, size, error, chance)
    return Course(**vars(series), centre=centre, deviation=deviation, limit=limit, departure=departure)


def _usual(value: Array, error: Array) -> Array:
    """Return the usual standard deviation of every value: its error, and what neighbours in time differ by beyond it.

    Where they differ by less than their errors, which then have a part in common, the errors count in proportion.
    """
    square, expected = np.diff(value) ** 2, error[1:] ** 2 + error[:-1] ** 2
    ratio = float(np.median(square / expected)) / _MEDIAN_SQUARE
    least = _ROUNDING * float(np.abs(value).max(initial=0.0))
    if ratio <= 1.0:
        return np.maximum(error * math.sqrt(ratio), least + math.ulp(0.0) ** 0.5)
    low, high = 0.0, float(square.max())
    for _ in range(60):  # the spread for which the median of the squares is as expected
        middle = 0.5 * (low + high)
        more = float(np.median(square / (expected + 2.0 * middle))) > _MEDIAN_SQUARE
        low, high = (middle, high) if more else (low, middle)
    return np.sqrt(error**2 + high)


_Candidate = tuple[Change, int, float, float]


def _outlier(value: Array, deviation: Array) -> _Candidate:
    """Return the value that is farthest from the mean of all others."""
    weight = deviation**-2
    total = weight.sum()
    others = (np.sum(weight * value) - weight * value) / (total - weight)
    error = np.sqrt(deviation**2 + 1.0 / (total - weight))
    k = int(np.argmax(np.abs(value - others) / error))
    return "outlier", k, float(value[k] - others[k]), float(error[k])


def _step(value: Array, weight: Array) -> _Candidate:
    """Return the step between two means that is clearest; at least two values are on either side."""
    before, total = weight.cumsum()[1:-2], weight.sum()
    mean = (weight * value).cumsum()[1:-2] / before
    after = total - before
    later = (np.sum(weight * value) - mean * before) / after
    error = np.sqrt(1.0 / before + 1.0 / after)
    k = int(np.argmax(np.abs(later - mean) / error))
    return "step", k + 2, float(later[k] - mean[k]), float(error[k])


def _drift(time: Array, value: Array, weight: Array) -> _Candidate:
    """Return the straight line over time, as its growth from the first to the last value."""
    span = float(np.ptp(time))
    where = (time - time[0]) / span if span > 0.0 else np.linspace(0.0, 1.0, len(time))
    off = where - np.average(where, weights=weight)
    square = float(np.sum(weight * off**2))
    if square == 0.0:
        return "drift", 0, 0.0, 1.0
    return "drift", 0, float(np.sum(weight * off * value)) / square, square**-0.5


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
