"""A grid of times that leaves out long pauses: a bench that slept over night has no blocks to judge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_recording.bags.pauses import PAUSE, pauses

Array = NDArray[np.float64]
Times = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Shortened:
    """Times of a recording whose long pauses are shortened, so that whatever is averaged around one sees it still.

    Attributes
    ----------
    begin : ndarray (k,)
        When what is left out of each pause begins [s].
    left_out : ndarray (k,)
        How much of it is left out [s].
    """

    begin: Array
    left_out: Array

    @classmethod
    def of(cls, time: Array, step: float) -> Shortened:
        """Shorten the pauses between samples.

        Parameters
        ----------
        time : ndarray (n,)
            Times of the samples [s], ascending.
        step : float
            What is left out of a pause is a multiple of this [s], so that a grid of such steps goes on unmoved.
        """
        found = pauses(time, PAUSE + 2.0 * step)
        # one step less than could be left out, so that rounding puts no sample on the other side of it
        steps = np.floor((found[:, 1] - found[:, 0] - PAUSE) / step) - 1.0
        return cls(found[:, 0] + PAUSE, steps * step)

    def without(self, time: Times) -> Times:
        """Return times as they are where the pauses are shortened; what is left out is where it begins."""
        if not len(self.begin):
            return time
        begun = np.searchsorted(self.begin, time, side="right")
        last = np.maximum(begun - 1, 0)
        before = np.concatenate([[0.0], np.cumsum(self.left_out)])[last]
        passed = before + np.minimum(time - self.begin[last], self.left_out[last])
        return np.where(begun > 0, time - passed, time)

    def recorded(self, time: Times) -> Array:
        """Return times of the recording, given those where its pauses are shortened."""
        before = np.concatenate([[0.0], np.cumsum(self.left_out)])
        place = np.searchsorted(self.begin - before[:-1], time, side="right")
        return np.asarray(time + before[place])
