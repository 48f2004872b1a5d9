"""When samples are due by the wall clock."""

from __future__ import annotations

import math


class Pacer:
    """Counts the samples that are due by a monotonic clock.

    After a delay the missed samples are made up for, at most `burst` at once. For the rest of the delay the bench
    stood still, before the samples that are made up for. So no sample is lost, and no burst is too long to be answered.

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
    stalls : int
        How often it did.
    """

    def __init__(self, period_ns: int, now_ns: int, *, burst: int = 20) -> None:
        self._period = period_ns
        self._burst = burst
        self._next = now_ns + period_ns
        self.late = self.worst_ns = self.behind_ns = self.stalls = 0

    def due(self, now_ns: int) -> int:
        """Return how many samples are to be made now; they count as made."""
        delay = now_ns - self._next
        if delay < 0:
            return 0
        count = delay // self._period + 1
        if count > self._burst:
            lost = (count - self._burst) * self._period
            self.behind_ns += lost
            self.stalls += 1
            self._next += lost
            count = self._burst
        if delay > self._period:
            self.late += count - 1
            self.worst_ns = max(self.worst_ns, delay)
        self._next += count * self._period
        return int(count)


class Statistics:
    """Mean, standard deviation and worst of times, from one report to the next.

    The names are those of the statistics of ros2_control's controller manager.
    """

    def __init__(self) -> None:
        self._count, self._sum, self._squares, self._worst = 0, 0.0, 0.0, 0.0

    def add(self, value_ns: int) -> None:
        """Take a time [ns]."""
        value = value_ns * 1e-6
        self._count += 1
        self._sum += value
        self._squares += value * value
        if value > self._worst:
            self._worst = value

    def report(self, name: str) -> dict[str, str]:
        """Return ``NAME_mean_ms``, ``NAME_deviation_ms`` and ``NAME_worst_ms`` as texts, and begin anew."""
        count = max(self._count, 1)
        mean = self._sum / count
        deviation = math.sqrt(max(self._squares / count - mean * mean, 0.0))
        worst = self._worst
        self._count, self._sum, self._squares, self._worst = 0, 0.0, 0.0, 0.0
        return {
            f"{name}_mean_ms": f"{mean:.4f}",
            f"{name}_deviation_ms": f"{deviation:.4f}",
            f"{name}_worst_ms": f"{worst:.4f}",
        }
