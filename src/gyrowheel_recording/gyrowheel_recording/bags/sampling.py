"""How fast a wheel can be sampled so that anything can be said of it."""

from __future__ import annotations

from typing import Final

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags.reader import Recording

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
