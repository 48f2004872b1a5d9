"""The node ``controller``: answers each sample of the bench with the voltages of the tilt and spin loops.

A sample at time t is answered once a setpoint with a stamp in (t - 5 ms, t] is known: each setpoint holds
for one setpoint period. Where the conductor is late, at the start and at the end of a plan the loop
therefore waits, and what it computes never depends on which message came first.
"""

from __future__ import annotations

from collections import deque

from rclpy.timer import Timer

from gyrowheel_control.controller import Controller
from gyrowheel_control.plans import SETPOINT_PERIOD
from gyrowheel_sim import topics, wire
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.node import BenchNode, Diagnosis, Param, run_node

SETPOINT_PERIOD_NS = round(SETPOINT_PERIOD * 1e9)


class ControllerNode(BenchNode):
    """Closes the tilt and spin loops: takes samples and setpoints, publishes commands."""

    NODE_NAME = "controller"
    PARAMETERS = (
        Param("bench", "gyrowheel", "Name of a shipped bench, or path of a bench file"),
        Param("wait_for_subscribers", 1, "Subscribers needed for the first command", low=0, high=100),
    )

    def configure(self) -> None:
        """Build the controller and its topics."""
        self._controller = Controller(Bench.load(self.parameter("bench")))
        # Compiled code is loaded at its first call, which takes seconds: now rather than in the loop.
        self._controller.update((0.0,) * 11, (0.0,) * 6, 0.0)
        self._controller.reset()
        self._setpoint: tuple[float, ...] = (0.0,) * 6  # in force
        self._since = self._until = -1  # the times between which it is [ns]
        self._coming: deque[tuple[int, tuple[float, ...]]] = deque()
        self._sample: tuple[int, int, list[float]] | None = None  # waits for its setpoint
        self._last = -1  # sequence of the last sample answered
        self._answered = self._skipped = self._malformed = 0
        self._ready = False
        self._matching: Timer | None = None

        self._commands = self.publisher(topics.COMMAND)
        self._inputs = (
            self.subscription(topics.MEASUREMENT, self._on_measurement, raw=True),
            self.subscription(topics.SETPOINT, self._on_setpoint, raw=True),
        )

    def activate(self) -> None:
        """Answer samples as soon as enough subscribers listen."""
        self._matching = self.wall_timer(0.02, self._check_subscribers)

    def deactivate(self) -> None:
        """Leave samples unanswered."""
        self._ready = False
        self._stop_matching()
        self.deliver(self._commands)

    def cleanup(self) -> None:
        """Give up the topics."""
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self.destroy_publisher(self._commands)

    def diagnose(self) -> Diagnosis:
        """Return counts."""
        values = {
            "commands": self._answered,
            "skipped_samples": self._skipped,
            "malformed_messages": self._malformed,
            "setpoints_ahead": len(self._coming),
        }
        if not self._ready:
            return Diagnosis("waiting for subscribers", values)
        if self._sample is not None:
            return Diagnosis("waiting for a setpoint", values)
        return Diagnosis("running" if self._answered else "waiting for a sample", values)

    def _check_subscribers(self) -> None:
        if self._commands.get_subscription_count() >= self.parameter("wait_for_subscribers"):
            self._stop_matching()
            self._ready = True
            self._answer_waiting()

    def _stop_matching(self) -> None:
        if self._matching is not None:
            self.destroy_timer(self._matching)
            self._matching = None

    def _on_measurement(self, raw: bytes) -> None:
        try:
            stamp, sequence, *values = wire.MEASUREMENT.unpack(raw)
        except ValueError as error:
            self._complain(error)
            return
        if sequence <= self._last:
            self._restart()
        if self._sample is not None:
            self._skipped += 1
            self._sample = None
        if self._ready and self._advance(stamp):
            self._answer(stamp, sequence, values)
        else:
            self._sample = (stamp, sequence, values)

    def _on_setpoint(self, raw: bytes) -> None:
        try:
            stamp, _, _, *setpoint = wire.SETPOINT.unpack(raw)
        except ValueError as error:
            self._complain(error)
            return
        coming = self._coming
        while coming and coming[-1][0] >= stamp:  # newer word on the same time
            coming.pop()
        coming.append((stamp, tuple(setpoint)))
        if self._sample is not None:
            self._answer_waiting()

    def _answer_waiting(self) -> None:
        if self._sample is not None and self._ready and self._advance(self._sample[0]):
            sample, self._sample = self._sample, None
            self._answer(*sample)

    def _advance(self, now: int) -> bool:
        """Go on to the newest setpoint at or before `now` [ns]; return whether it still holds then."""
        coming = self._coming
        while coming and coming[0][0] <= now:
            self._since, self._setpoint = coming.popleft()
            self._until = self._since + SETPOINT_PERIOD_NS
        return self._since <= now < self._until

    def _answer(self, stamp: int, sequence: int, values: list[float]) -> None:
        age = (stamp - self._since) * 1e-9
        voltages = self._controller.update(values, self._setpoint, age)
        self._last = sequence
        self._answered += 1
        self._commands.publish(wire.COMMAND.pack(stamp, sequence, *voltages))

    def _restart(self) -> None:
        """Begin anew with a plant that was started again."""
        self.get_logger().info("samples count from the start again: controller reset")
        self._controller.reset()
        self._since = self._until = -1
        self._last = -1

    def _complain(self, error: ValueError) -> None:
        self._malformed += 1
        if self._malformed == 1:
            self.get_logger().error(f"{error}; such messages are ignored")


def main() -> int:
    """Run the node."""
    return run_node(ControllerNode)
