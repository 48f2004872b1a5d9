"""Sampling of a recording: the usual step, what any analysis needs, and long pauses."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags.reader import Recording

#: A longer time without samples is a pause [s].
PAUSE: Final = 60.0
_STRIDE: Final = 1000  # samples between those that are looked at first


def pauses(time: NDArray[np.float64], longest: float = PAUSE) -> NDArray[np.float64]:
    """Return the pauses between samples: times of the last sample before and of the first one after each [s], (k, 2).

    Code whose time or memory grows with the length of a recording must leave them out: they may last for years.
    `time` (n,) ascends [s]; `longest` is the longest time without samples that is no pause [s].
    """
    # a pause lies between two of those that are looked at first
    few = np.append(time[::_STRIDE], time[-1:])
    found = []
    for k in (np.flatnonzero(np.diff(few) > longest) * _STRIDE).tolist():
        near = time[k : k + _STRIDE + 1]
        at = np.flatnonzero(np.diff(near) > longest)
        found.append(np.column_stack([near[at], near[at + 1]]))
    return np.concatenate(found) if found else np.zeros((0, 2))


#: Sampling periods that a recording of a wheel can have [s].
SHORTEST: Final = 5e-6
LONGEST: Final = 0.05
_LOOKED_AT: Final = 100_001  # samples


def usual_step(recording: Recording) -> float:
    """Return the usual time from one sample to the next [s], of two samples at least."""
    return 1e-9 * float(np.median(np.diff(recording.measurement["stamp_ns"][:_LOOKED_AT])))


def require_rate(recording: Recording) -> None:
    """Refuse a recording whose samples are too far apart, or too close, for any analysis.

    Raises
    ------
    InputError
        If they are.
    """
    if len(recording.measurement) < 2:
        return
    step = usual_step(recording)
    if not SHORTEST <= step <= LONGEST:
        raise InputError(
            f"{recording.path}: a sample every {1e3 * step:.6g} ms; allowed: {1e3 * SHORTEST:g} .. {1e3 * LONGEST:g} ms"
        )
