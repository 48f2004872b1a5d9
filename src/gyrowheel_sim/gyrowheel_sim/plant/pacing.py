"""When samples are due by the wall clock."""

from __future__ import annotations

import math

#: Periods for which a sample that is due waits for the answer to the last one, since that was made.
GRACE = 2.0
#: Samples in a row that a controller must have answered to be waited for, and that may be without an answer meanwhile.
STEADY, UNANSWERED = 5, 3


class Pacer:
    """Tells when samples are due by a monotonic clock, and makes up for a delay at the pace of the answers.

    After a delay several samples are due. They are made one by one, each once the last one is answered or was made
    `GRACE` periods ago, so that every answer has its time; where not every sample is answered, by a slower controller
    or by none, they are made at once. After a longer delay the bench stood still until the sample that is due now. So
    no sample is lost.

    Parameters
    ----------
    period_ns : int
        Time between two samples [ns].
    now_ns : int
        Time of the first one by that clock [ns].
    burst : int
        Number of samples that a delay may last to be made up for.

    Attributes
    ----------
    next_ns : int
        When the next sample is due [ns].
    late : int
        Samples that were made more than one period after they were due.
    worst_ns : int
        The longest of these delays [ns].
    behind_ns : int
        How long the bench stood still in all [ns].
    stalls : int
        How often it did.
    displaced : int
        Samples made without an answer to the last one, more than half a period after the wait for it: the computer
        ran something else. Where others were, the answer took too long.
    """

    def __init__(self, period_ns: int, now_ns: int, *, burst: int = 20) -> None:
        self._period = period_ns
        self._grace = round(GRACE * period_ns)
        self._burst = burst
        self.next_ns = now_ns + period_ns
        self._made = now_ns
        self.late = self.worst_ns = self.behind_ns = self.stalls = self.displaced = 0

    def patience_ns(self, now_ns: int) -> int:
        """Return how long until a sample may be made [ns], if the last one gets no answer before."""
        if now_ns < self.next_ns:
            return self.next_ns - now_ns
        # never nothing: who runs at a real-time priority would keep the controller from the core that they share
        return max(self._made + self._grace - now_ns, self._period // 10)

    def due(self, now_ns: int, unanswered: int, steady: int) -> int:
        """Return how many samples are to be made now; they count as made.

        Parameters
        ----------
        now_ns : int
            The time [ns].
        unanswered : int
            How many samples, up to the last one, have no answer.
        steady : int
            How many samples in a row were answered before these.
        """
        delay = now_ns - self.next_ns
        if delay < 0:
            return 0
        if delay > self._period:
            self.worst_ns = max(self.worst_ns, delay)
        waited = now_ns - self._made - self._grace
        count = delay // self._period + 1
        if count > self._burst:
            lost = (count - 1) * self._period
            self.behind_ns += lost
            self.stalls += 1
            self.next_ns += lost
            delay, count = delay - lost, 1
        elif steady >= STEADY and unanswered <= UNANSWERED:
            if unanswered and waited < 0:
                return 0
            count = 1
            self.displaced += bool(unanswered) and waited > self._period // 2
        if delay > self._period:
            self.late += min(count, delay // self._period)
        self.next_ns += count * self._period
        self._made = now_ns
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
