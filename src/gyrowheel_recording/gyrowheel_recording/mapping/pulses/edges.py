"""When the edges of pulses were: from samples of a level, from a running count, or from times that a counter took."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Part of the height of a pulse within which a sample lies on its edge, and about the level that it must leave to count
#: again.
_ON_EDGE, _PLAY = (0.1, 0.9), 0.15
_RESOLVED: Final = 0.5  # part of the edges that must show a sample on them
_LOW, _HIGH = 1.0, 99.0  # percentiles; a short pulse is high in few samples


@dataclass(frozen=True)
class Edges:
    """Edges of pulses.

    Attributes
    ----------
    times : ndarray (m,)
        When they were [s], ascending.
    within : ndarray (m,)
        Each was within this of its time [s]: half a sample where all that is known is between which two it was.
    high : float
        Part of the time for which the signal is high; of a pulse shorter than a sample only those are seen that are
        high at one, so that its edge was just before that.
    """

    times: Array
    within: Array
    high: float = 1.0

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.times)


def edges_of_level(times: Array, values: Array, level: float = math.nan) -> Edges:
    """Return the rising edges of a signal.

    Where it is sampled so fast that edges show samples on their way up, the crossing is interpolated; where it jumps
    from one sample to the next, the edge was anywhere between the two.

    Parameters
    ----------
    times, values : ndarray (n,)
        The samples [s]; a value that is not there is NaN.
    level : float
        What is crossed; the middle between low and high if not a number.
    """
    known = np.isfinite(values)
    if known.sum() < 2:
        return Edges(np.zeros(0), np.zeros(0))
    low, high = levels(values[known])
    height = high - low
    middle = 0.5 * (low + high) if math.isnan(level) else level
    if not height > 0.0:
        return Edges(np.zeros(0), np.zeros(0))
    # a signal that wavers about the level has one edge: it counts again when it was clearly below
    state = np.zeros(len(values), dtype=np.int8)
    state[known & (values >= middle)] = 1
    state[known & (values < middle - _PLAY * height)] = -1
    last = np.maximum.accumulate(np.where(state != 0, np.arange(len(values)), -1))
    held = np.where(last >= 0, state[np.maximum(last, 0)], 0)
    up = np.flatnonzero((held[1:] == 1) & (held[:-1] == -1) & known[1:] & known[:-1]) + 1
    if not len(up):
        return Edges(np.zeros(0), np.zeros(0))
    before, after = values[up - 1], values[up]
    part = np.clip((middle - before) / np.maximum(after - before, 1e-300), 0.0, 1.0)
    step = times[up] - times[up - 1]
    inside = (values - low) / height
    on = np.zeros(len(up), dtype=bool)
    for k in (up - 1, up):
        on |= (inside[k] > _ON_EDGE[0]) & (inside[k] < _ON_EDGE[1])
    if float(np.mean(on)) > _RESOLVED:
        return Edges(times[up - 1] + part * step, np.zeros(len(up)))
    return Edges(times[up] - 0.5 * step, 0.5 * step, float(np.mean(held[known] == 1)))


def levels(values: Array) -> tuple[float, float]:
    """Return the low and the high level of a signal of pulses."""
    low, high = (float(np.percentile(values, at)) for at in (_LOW, _HIGH))
    if not high - low > 0.5 * float(np.ptp(values)):  # pulses in fewer samples than that
        low, high = float(values.min()), float(values.max())
    return low, high


def edges_of_count(times: Array, counts: Array) -> Edges:
    """Return the edges of a running count of pulses: it changed between two samples.

    A counter that begins anew changes there, too; one that counts more than once between two samples has one edge.
    """
    known = np.flatnonzero(np.isfinite(counts))
    up = np.flatnonzero(np.diff(counts[known]) != 0.0)
    first, then = times[known[up]], times[known[up + 1]]
    return Edges(0.5 * (first + then), 0.5 * (then - first))


def edges_of_times(times: Array) -> Edges:
    """Return edges whose times a counter took; one that is repeated until the next comes counts once."""
    found = np.unique(times[np.isfinite(times)])
    return Edges(found, np.zeros(len(found)))
