"""Real time: samples at the pace of the wall clock, answered or not.

Stamps are the time of the computer. Where no command has come, the last one stays in force. After a long interruption
the bench has stood still: the stamps continue at the present time, and the report names the gap.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, Protocol

from gyrowheel_core import wire
from gyrowheel_sim.plant.machine import Plant
from gyrowheel_sim.plant.protection import HELD_SHARE, Guard, GuardState, Refusal

#: Periods for which a sample that is due waits for the answer to the last one, since that was made.
GRACE = 2.0
#: Samples in a row that a controller must have answered to be waited for, and that may be without an answer meanwhile.
STEADY, UNANSWERED = 5, 3


class Pacer:
    """Determines when samples are due by a monotonic clock, and recovers from a delay at the pace of the answers.

    After a delay several samples are due. They are made one by one, each when the last one is answered or is `GRACE`
    periods old, so that every answer has its time; if the controller does not answer every sample, or there is none,
    they are made at once. After a longer delay the bench has stood still until the sample that is due now. No sample
    is lost.

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

        `now_ns`: the time [ns]; `unanswered`: how many samples, up to the last one, have no answer; `steady`:
        how many samples in a row were answered before these.
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
        """Return ``NAME_mean_ms``, ``NAME_deviation_ms`` and ``NAME_worst_ms`` as texts, and start again."""
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


#: Time between two messages of the clock [ns]; the stamps of a bench in real time begin on a multiple of it.
CLOCK_PERIOD_NS = 10_000_000
#: A stall of this length is reported at once, a shorter one with the next diagnosis [ns].
TOLD_AT_ONCE_NS = 20_000_000
#: Total adjustment of the system clock since the start that counts as a jump [s].
CLOCK_JUMP = 0.02
#: Interval of the checks for a controller [s].
LOOK = 0.05
RELEASED = "released: the controller has left; coils off, the motor goes on until another one comes"


def clocks_apart() -> int:
    """Return the system clock minus the monotonic clock [ns], read as nearly simultaneously as possible."""
    reads = [(time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(3)]
    before, now, after = min(reads, key=lambda read: read[2] - read[0])
    return now - (before + after) // 2


class Paced(Protocol):
    """Interface of the node that is paced."""

    epoch: int
    """Stamp of sample 0 [ns]."""

    def step(self) -> None:
        """Advance by one sample."""

    def controllers(self) -> int:
        """Return the number of controllers."""

    def announce(self) -> None:
        """Publish the diagnosis now."""

    def get_logger(self) -> Any:
        """Return the logger."""

    def wall_timer(self, period: float, callback: Callable[[], None]) -> Any:
        """Return a timer that calls `callback` every `period` [s]."""

    def destroy_timer(self, timer: Any) -> Any:
        """Destroy a timer."""


class RealTime:
    """Paces a plant by the wall clock, takes commands as they arrive, and reports timing.

    `node`: the node, which makes a sample at every step; `plant`: the simulated bench; `guard`: the guard of
    the machine; `period_ns`: time between two samples [ns].
    """

    def __init__(self, node: Paced, plant: Plant, guard: Guard, period_ns: int) -> None:
        self._node, self._plant, self._guard, self._period_ns = node, plant, guard, period_ns
        self._watch: Any = None  # looks for a controller, as long as the node is active
        self._seen = False  # a controller was there at the last look
        self._pacer: Pacer | None = None  # since the last start
        self._going = False  # samples are made
        self._period, self._execution = Statistics(), Statistics()  # of the samples
        self._ticked = 0  # time of the last one [ns]
        self._begun = 0  # stamp of the first sample [ns]
        self._told_late = (0, 0)  # late samples, and all, at the last diagnosis
        self._stall = ""  # the last one, in words
        self._told_stalls = 0
        self._apart = 0  # of the clocks, at the start [ns]
        #: Total adjustment of the system clock since the start, at the last report [s]: its distance from the
        #: stamps.
        self.clock_jump = 0.0

    def watch(self) -> None:
        """Take commands, and check regularly for a controller."""
        self._seen = False
        self._watch = self._node.wall_timer(LOOK, self._look_for_controller)

    def start(self) -> None:
        """Continue from the present sample at the pace of the clock."""
        # stamps are true times on the grid of the setpoints: wait for the next point of the grid
        time.sleep((-time.time_ns() % CLOCK_PERIOD_NS) * 1e-9)
        self._apart, self._ticked = clocks_apart(), time.monotonic_ns()
        now = self._ticked + self._apart
        after = now % CLOCK_PERIOD_NS
        self._node.epoch = now - after - self._plant.time_ns
        self._begun = self._begun or now - after
        self._pacer, self._going = Pacer(self._period_ns, self._ticked - after), True
        self._told_stalls, self._told_late = 0, (0, self._plant.sequence)

    def stop(self) -> None:
        """Stop making samples and taking commands."""
        if self._watch is not None:
            self._node.destroy_timer(self._watch)
        self._watch, self._going = None, False

    def patience(self) -> float:
        """Return the time until the next sample if no command comes before [s]."""
        if self._pacer is None or not self._going:
            return math.inf
        return self._pacer.patience_ns(time.monotonic_ns()) * 1e-9

    def pace(self) -> None:
        """Make the samples that are due."""
        pacer = self._pacer
        if pacer is None or not self._going or (now := time.monotonic_ns()) < pacer.next_ns:
            return
        guard, stood = self._guard, pacer.behind_ns
        due = pacer.due(now, guard.unanswered(self._plant.sequence), guard.steady)
        if stood := pacer.behind_ns - stood:
            self._stand_still(stood)
        if not due:
            return
        self._period.add(now - self._ticked)
        self._ticked = now
        for _ in range(due):
            self._node.step()
        self._execution.add(time.monotonic_ns() - now)

    def _stand_still(self, stood: int) -> None:
        """Continue at the present time after an interruption [ns] without samples."""
        at = self._node.epoch + self._plant.time_ns - self._begun
        self._node.epoch += stood
        self._stall = f"stood_still: {stood * 1e-9:.3f} s at {at * 1e-9:.1f} s"
        if stood >= TOLD_AT_ONCE_NS:
            self._node.get_logger().warning(self._stall)
            self._node.announce()

    def _look_for_controller(self) -> None:
        """Wait for another controller after a regular exit of the last one; a killed one is still listed."""
        # the first command of a controller may come before the middleware counts it
        left, self._seen = self._seen, self._node.controllers() > 0
        if left and not self._seen and self._guard.release():
            self._node.get_logger().info(RELEASED)
            self._node.announce()

    def on_command(self, raw: bytes) -> None:
        """Take a command as it came."""
        if self._watch is None:
            return
        guard = self._guard
        try:
            _, answered, voltage_x, voltage_y, motor_voltage = wire.COMMAND.unpack(raw)
        except ValueError as error:
            if guard.refuse(Refusal.MALFORMED) and guard.refused[Refusal.MALFORMED] == 1:
                self._node.get_logger().error(f"{error}; such commands are refused")
            return
        released = guard.state is GuardState.RELEASED
        refused = guard.take(answered, self._plant.sequence, voltage_x, voltage_y, motor_voltage)
        if released and refused is None:
            self._node.get_logger().info("a controller is there again")
            self._node.announce()

    def report(self) -> dict[str, object]:
        """Return the values of the diagnosis about timing."""
        guard, pacer = self._guard, self._pacer
        values: dict[str, object] = {
            "late_commands": guard.late,
            "missing_commands": guard.missing,
            "held_samples": guard.held,
        }
        if pacer is not None:
            self.clock_jump = (clocks_apart() - self._apart) * 1e-9
            values |= {
                "late_samples": pacer.late,
                "displaced_samples": pacer.displaced,
                "worst_delay_ms": f"{pacer.worst_ns * 1e-6:.2f}",
                "behind_s": f"{pacer.behind_ns * 1e-9:.4f}",
                "stalls": pacer.stalls,
                "last_stall": self._stall.partition(": ")[2],
                "clock_jump_s": f"{self.clock_jump:.3f}",
            }
            if self._going:  # else the newest stamp grows old
                stamp = self._node.epoch + self._plant.time_ns
                values["clock_offset_s"] = f"{(time.time_ns() - stamp) * 1e-9:.3f}"
            values |= self._period.report("period") | self._execution.report("execution")
        return values

    def lateness(self) -> tuple[str, str]:
        """Return stall and late samples since the last call, in words."""
        pacer = self._pacer
        if pacer is None:
            return "", ""
        stalled = pacer.stalls > self._told_stalls
        late, before = pacer.late, self._told_late
        share = (late - before[0]) / max(self._plant.sequence - before[1], 1)
        self._told_stalls, self._told_late = pacer.stalls, (late, self._plant.sequence)
        text = f"{share:.1%} of the samples more than a period late" if share > HELD_SHARE else ""
        return self._stall if stalled else "", text
