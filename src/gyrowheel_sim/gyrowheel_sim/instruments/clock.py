"""The clock that gives the stamps: its rate, and the random error of each stamp."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_LARGEST = 0.4  # of a sampling period: no stamp overtakes another


class StampClock:
    """Stamps of the samples, one after the other.

    Parameters
    ----------
    period : float
        Sampling period [s].
    rate_error : float
        Relative error of the rate.
    jitter : float
        Standard deviation of the random errors [s].
    seed : int
        Seed of the random errors; not that of the readings' noise, which stays as it is.
    """

    def __init__(self, period: float, rate_error: float, jitter: float, seed: int) -> None:
        self._period, self._rate, self._jitter = period, rate_error, jitter
        self._rng = np.random.default_rng([seed, 0x636C6F63])
        self._next = 0

    @property
    def perfect(self) -> bool:
        """Whether every stamp is the sampling instant itself."""
        return self._rate == 0.0 and self._jitter == 0.0

    def stamps(self, count: int) -> NDArray[np.int64]:
        """Return the stamps of the next samples [ns]."""
        sample = np.arange(self._next, self._next + count, dtype=np.int64)
        self._next += count
        stamps = sample * round(self._period * 1e9)
        if self.perfect:
            return stamps
        late = stamps * self._rate * 1e-9
        if self._jitter > 0.0:
            limit = _LARGEST * self._period
            late = late + np.clip(self._jitter * self._rng.standard_normal(count), -limit, limit)
        return np.maximum(stamps + np.round(late * 1e9).astype(np.int64), 0)
