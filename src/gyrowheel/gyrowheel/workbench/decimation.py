"""Decimation of long signals that keeps every spike: minimum and maximum of each interval."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.arrays import by_blocks

_BLOCK = 256  # samples per stored pair of extremes; `by_blocks` uses a multiple of it
_DIRECT = 2 * _BLOCK  # samples of an interval from which on the extremes of blocks are used

Array = NDArray[np.float64]


class Envelope:
    """A signal with the extremes of its blocks, from which any part is drawn without delay.

    Parameters
    ----------
    values : ndarray (n,)
        The signal, not copied; the extremes ignore values that are not finite.
    extremes : (ndarray, ndarray), optional
        Extremes of the blocks, from `envelopes`.
    """

    def __init__(self, values: Array, extremes: tuple[Array, Array] | None = None) -> None:
        self._values = values
        self._low, self._high = extremes or _extremes([values], len(values))[0]

    def cut(self, first: int, last: int, points: int) -> tuple[Array, Array]:
        """Return a part of the signal as a line.

        Parameters
        ----------
        first, last : int
            Samples from `first` to before `last`.
        points : int
            Largest number of points; 4 or more.

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


def envelopes(rows: NDArray[Any], wanted: Collection[str]) -> dict[str, Envelope]:
    """Return some columns as signals; one pass finds the extremes of all."""
    names = [name for name in rows.dtype.names or () if name in wanted]
    columns = [rows[name] for name in names]
    found = _extremes(columns, len(rows))
    return {name: Envelope(rows[name], own) for name, own in zip(names, found, strict=True)}


def _extremes(columns: Sequence[Array], count: int) -> list[tuple[Array, Array]]:
    """Return smallest and largest value of every block of each column."""
    found = [(np.empty(-(-count // _BLOCK)), np.empty(-(-count // _BLOCK))) for _ in columns]

    def look(first: int, last: int) -> None:
        to = slice(first // _BLOCK, -(-last // _BLOCK))
        whole = (last - first) // _BLOCK
        for column, (low, high) in zip(columns, found, strict=True):
            part = np.ascontiguousarray(column[first:last])
            blocks = part[: whole * _BLOCK].reshape(whole, _BLOCK)
            for quick, careful, out in ((np.minimum, np.fmin, low[to]), (np.maximum, np.fmax, high[to])):
                quick.reduce(blocks, axis=1, out=out[:whole])
                out[whole:] = np.nan
                # NaN is ignored, which is slower
                for k in np.flatnonzero(np.isnan(out)):
                    out[k] = careful.reduce(part[k * _BLOCK : (k + 1) * _BLOCK])

    by_blocks(count, look)
    return found
