"""Long pauses of a recording: a computer that slept over night, or a clock that was set years ahead."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

#: A longer time without samples is a pause [s].
PAUSE: Final = 60.0
_STRIDE: Final = 1000  # samples between those that are looked at first


def pauses(time: NDArray[np.float64], longest: float = PAUSE) -> NDArray[np.float64]:
    """Find the pauses between samples.

    What costs time or memory in proportion to the length of a recording must leave them out: they may last for years.

    Parameters
    ----------
    time : ndarray (n,)
        Times of the samples [s], ascending.
    longest : float
        Longest time without samples that is no pause [s].

    Returns
    -------
    ndarray (k, 2)
        Times of the last sample before and of the first one after each pause [s].
    """
    # a pause lies between two of those that are looked at first
    few = np.append(time[::_STRIDE], time[-1:])
    found = []
    for k in (np.flatnonzero(np.diff(few) > longest) * _STRIDE).tolist():
        near = time[k : k + _STRIDE + 1]
        at = np.flatnonzero(np.diff(near) > longest)
        found.append(np.column_stack([near[at], near[at + 1]]))
    return np.concatenate(found) if found else np.zeros((0, 2))
