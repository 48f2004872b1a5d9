"""Millions of samples as a line of a thousand points that loses no spike: smallest and largest of every stretch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_BLOCK = 256  # samples whose extremes are kept
_DIRECT = 2 * _BLOCK  # samples of a stretch from which on the extremes of blocks are used


class Envelope:
    """A signal with the extremes of its blocks, from which any part of it is drawn at once.

    Parameters
    ----------
    values : ndarray (n,)
        The signal; kept as it is. What is not finite is left out of the extremes.
    """

    def __init__(self, values: NDArray[np.float64]) -> None:
        self._values = values
        starts = np.arange(0, len(values), _BLOCK)
        self._low = np.fmin.reduceat(values, starts) if len(values) else values
        self._high = np.fmax.reduceat(values, starts) if len(values) else values

    def cut(self, first: int, last: int, points: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return a part of the signal as a line.

        Parameters
        ----------
        first, last : int
            Samples from `first` to before `last`.
        points : int
            Most points of the line; 4 or more.

        Returns
        -------
        positions, values : ndarray (m,)
            Where the points lie [samples] and their values: the samples themselves where there are few, else smallest
            and largest value of every stretch, at its beginning and its middle. Positions depend on the arguments
            alone.
        """
        first, last = max(first, 0), min(last, len(self._values))
        count = last - first
        if count <= points:
            return np.arange(first, max(last, first), dtype=np.float64), self._values[
                first : max(last, first)
            ]
        buckets = points // 2
        unit, low, high = 1, self._values, self._values
        if count >= buckets * _DIRECT:
            unit, low, high = _BLOCK, self._low, self._high
            first, last = first // unit, -(-last // unit)
        edges = np.linspace(first, last, buckets + 1).astype(np.int64)
        ends = np.stack(
            [
                np.fmin.reduceat(low[:last], edges[:-1]),
                np.fmax.reduceat(high[:last], edges[:-1]),
            ],
            axis=1,
        )
        width = np.diff(edges)
        places = np.stack([edges[:-1], edges[:-1] + 0.5 * width], axis=1) * float(unit)
        return places.ravel(), ends.ravel()
