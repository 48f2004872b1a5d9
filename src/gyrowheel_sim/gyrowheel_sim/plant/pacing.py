"""When samples are due by the wall clock."""

from __future__ import annotations


class Pacer:
    """Counts the samples that are due by a monotonic clock.

    After a delay the missed samples are made up for, at most `burst` at once. For the rest of the delay the bench
    pauses. So no sample is lost, and no burst is too long to be answered.

    Parameters
    ----------
    period_ns : int
        Time between two samples [ns].
    now_ns : int
        Time of the first one by that clock [ns].
    burst : int
        Largest number of samples that are made up for at once.

    Attributes
    ----------
    late : int
        Samples that were made more than one period after they were due.
    worst_ns : int
        The longest of these delays [ns].
    behind_ns : int
        How long the bench stood still in all [ns].
    """

    def __init__(self, period_ns: int, now_ns: int, *, burst: int = 20) -> None:
        self._period = period_ns
        self._burst = burst
        self._next = now_ns + period_ns
        self.late = self.worst_ns = self.behind_ns = 0

    def due(self, now_ns: int) -> int:
        """Return how many samples are to be made now; they count as made."""
        delay = now_ns - self._next
        if delay < 0:
            return 0
        count = delay // self._period + 1
        if count > self._burst:
            lost = (count - self._burst) * self._period
            self.behind_ns += lost
            self._next += lost
            count = self._burst
        if delay > self._period:
            self.late += count - 1
            self.worst_ns = max(self.worst_ns, delay)
        self._next += count * self._period
        return int(count)
