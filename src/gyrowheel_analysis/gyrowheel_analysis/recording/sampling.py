"""How fast a wheel can be sampled so that anything can be said of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from gyrowheel_analysis.recording.reader import Recording

#: Sampling periods that a recording of a wheel can have [s].
SHORTEST: Final = 5e-6
LONGEST: Final = 0.05
_LOOKED_AT: Final = 100_001  # samples


def require_rate(recording: Recording) -> None:
    """Refuse a recording whose samples are too far apart, or too close, for any analysis.

    Raises
    ------
    InputError
        If they are.
    """
    stamps = recording.measurement["stamp_ns"][:_LOOKED_AT]
    if len(stamps) < 2:
        return
    step = 1e-9 * float(np.median(np.diff(stamps)))
    if not SHORTEST <= step <= LONGEST:
        raise InputError(
            f"{recording.path}: a sample every {1e3 * step:.6g} ms; allowed: {1e3 * SHORTEST:g} .. {1e3 * LONGEST:g} ms"
        )
