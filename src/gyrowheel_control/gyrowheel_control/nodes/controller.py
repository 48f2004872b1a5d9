"""The node ``controller``: answers each sample of the bench with the voltages of the tilt and spin loops.

A sample at time t is answered once a setpoint with a stamp in (t - 5 ms, t] is known: each setpoint holds
for one setpoint period. Where the conductor is late, at the start and at the end of a plan the loop
therefore waits, and what it computes never depends on which message came first. Invalid samples and setpoints
are counted and not answered; setpoints beyond the tilt limit are reduced to it.

Where the samples go on although no setpoint holds, as in real time when the conductor has ended or was deactivated, the
last one is held, and then brought to rest (`Rest`): the state ``setpoint_lost``. New setpoints take over at once.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.publisher import Publisher
from rclpy.timer import Timer

from gyrowheel_control.loops.controller import Controller, Gains
from gyrowheel_control.loops.supervision import LOWEST_SPIN, Rest, SetpointGuard, tilt_limit
from gyrowheel_control.plans.plan import SETPOINT_PERIOD
from gyrowheel_core import topics, wire
from gyrowheel_core.node import PRIORITY, WAITS_FOR, BenchNode, NodeStatus, Param, run_node
from gyrowheel_sim.bench import Bench

SETPOINT_PERIOD_NS = round(SETPOINT_PERIOD * 1e9)
_USUAL = Gains()


def _gain(name: str, description: str, high: float, low: float = 0.0) -> Param:
    return Param(name, getattr(_USUAL, name), description, low=low, high=high, live=True)


#: Ranges within which the loops are known to hold on some bench; beyond them lies a mistake in the unit.
GAINS = (
    _gain("tilt_bandwidth", "Bandwidth of the tilt loop [1/s]", 60.0),
    _gain("tilt_integral", "Integral gain of the tilt loop [1/s^2]", 600.0),
    _gain("tilt_lowpass", "Low-pass of the tilt readings [Hz]", 500.0, low=1.0),
    _gain("nutation_damping", "Gain of the nutation damper over the angular momentum of the spin", 1.0),
    _gain("derivative_lowpass", "Low-pass of its derivative [Hz]", 1000.0, low=10.0),
    _gain("spin_proportional", "Gain of the spin loop over the moment of inertia [1/s]", 60.0),
    _gain("spin_integral", "Integral gain of the spin loop over the moment of inertia [1/s^2]", 600.0),
    _gain("spin_lowpass", "Low-pass of the spin reading, applied twice [Hz]", 100.0, low=0.5),
)


class ControllerNode(BenchNode):
    """Closes the tilt and spin loops: takes samples and setpoints, publishes commands."""

    NODE_NAME = "controller"
    PARAMETERS = (
        Param("bench", "gyrowheel", "Name of a shipped bench, or path of a bench file"),
        Param("wait_for_subscribers", 1, "Subscribers needed for the first command", low=0, high=100),
        Param(
            "tilt_limit",
            0.0,
            "Largest tilt that a setpoint may ask for [rad]; 0: three fifths of the bench's hard stop",
            low=0.0,
            high=1.0,
            live=True,
        ),
        *GAINS,
        PRIORITY,
    )

    def configure(self) -> None:
        """Build the controller and its topics."""
        self._bench = bench = Bench.load(self.parameter("bench"))
        self._guard = SetpointGuard(bench, self._limit(self.parameter("tilt_limit")))
        self._controller = Controller(bench, self._gains())
        self._setpoint: tuple[float, ...] = (0.0,) * 6  # in force
        self._since = self._until = -1  # the times between which it is [ns]
        self._coming: deque[tuple[int, tuple[float, ...]]] = deque()
        self._sample: tuple[int, int, list[float]] | None = None  # waits for its setpoint
        self._last = -1  # sequence of the last sample answered
        self._command = b""  # the answer
        self._answered = self._skipped = self._malformed = self._refused = 0
        self._motor = 0.0  # voltage of the last answer [V]
        self._rest: Rest | None = None  # where no setpoint holds although the samples go on
        self._told = (
            0,
            0,
            0,
        )  # setpoints limited, messages refused and malformed ones, at the last diagnosis
        self._why = ""  # the last message was malformed
        self._ready = False
        self._matching: Timer | None = None

        self._commands: Publisher | None = None  # while it is active, so that another one can take its place
        self._trial: bytes | None = (
            None  # first command since the start, until another sample shows that it arrived
        )
        self._proven = False  # whether that has happened
        self._inputs = (
            self.subscription(topics.MEASUREMENT, self._on_measurement, raw=True),
            self.subscription(topics.SETPOINT, self._on_setpoint, raw=True),
        )

    def activate(self) -> None:
        """Answer samples as soon as there are enough subscribers."""
        self.prioritise()
        self._rest = None
        if self._commands is None:
            self._commands = self.publisher(topics.COMMAND)
        self._trial, self._proven = None, False
        self._matching = self.wall_timer(0.02, self._check_subscribers)
        self._repeating = self.wall_timer(1.0, self._repeat)

    def deactivate(self) -> None:
        """Destroy the topic of the commands, after a command with the coils off if a sample waits.

        The plant waits for another controller then, with the coils off; its guard brings the motor down if none comes.
        """
        self._ready = False
        self._stop_matching()
        self.destroy_timer(self._repeating)
        if self._sample is not None and self._answered and self._commands is not None:
            stamp, sequence, _ = self._sample
            self._command = wire.COMMAND.pack(stamp, sequence, 0.0, 0.0, self._motor)
            self._commands.publish(self._command)
            self._last = sequence
        self._sample = None
        self._leave()

    def cleanup(self) -> None:
        """Destroy the topics."""
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self._leave()

    def check_tuning(self, values: Mapping[str, Any]) -> None:
        """Refuse a tilt limit beyond that of the bench."""
        self._limit(values["tilt_limit"])

    def tune(self) -> None:
        """Adopt gains and tilt limit."""
        self._guard.limit = self._limit(self.parameter("tilt_limit"))
        self._controller.tune(self._gains())

    def diagnose(self) -> NodeStatus:
        """Return counts, and the actions of the limits since the last diagnosis."""
        guard = self._guard
        values = {
            "commands": self._answered,
            "skipped_samples": self._skipped,
            "refused_samples": self._refused,
            "malformed_messages": self._malformed,
            "setpoints_ahead": len(self._coming),
            "limited_setpoints": guard.limited,
            "refused_setpoints": guard.refused,
            "tilt_limit_deg": f"{math.degrees(guard.limit):g}",
        }
        limited, refused, malformed = self._told
        self._told = guard.limited, guard.refused + self._refused, self._malformed
        if not self._ready:
            return NodeStatus("waiting for subscribers", values)
        if self._rest is not None:
            text = "setpoint_lost: no setpoints come; the last one is held, then brought to rest"
            return NodeStatus(text, values, DiagnosticStatus.WARN)
        if self._malformed > malformed:
            return NodeStatus(f"input_refused: {self._why}", values, DiagnosticStatus.WARN)
        if guard.refused + self._refused > refused:
            return NodeStatus(
                "input_refused: samples or setpoints that are no numbers or out of range",
                values,
                DiagnosticStatus.WARN,
            )
        if guard.limited > limited:
            return NodeStatus(
                f"tilt_limited: setpoints beyond {math.degrees(guard.limit):.2f} deg are held there",
                values,
                DiagnosticStatus.WARN,
            )
        if self._sample is not None:
            return NodeStatus("waiting for a setpoint", values | {WAITS_FOR: topics.SETPOINT.name})
        return NodeStatus("running" if self._answered else "waiting for a sample", values)

    def _limit(self, wanted: float) -> float:
        return tilt_limit(self._bench, wanted, "parameter tilt_limit")

    def _gains(self) -> Gains:
        """Return the gains: of the parameters that were set, else of the bench file."""
        given = {item.name: self.parameter(item.name) for item in fields(Gains)}
        return replace(self._bench.gains, **{n: v for n, v in given.items() if v != getattr(_USUAL, n)})

    def _check_subscribers(self) -> None:
        if self._commands is not None and self._commands.get_subscription_count() >= self.parameter(
            "wait_for_subscribers"
        ):
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
        if sequence == self._last and self._command:  # the plant sends it again: it has not got the answer
            if self._commands is not None:
                self._commands.publish(self._command)
            return
        if sequence < self._last:
            self._restart()
        waits, self._sample = self._sample, None
        goes_on = waits is not None and sequence != waits[1]  # without an answer to the last one
        if goes_on:
            self._skipped += 1
        if self._trial is not None and sequence > self._last:
            self._trial, self._proven = None, True
        if self._ready and (self._advance(stamp) or self._come_to_rest(stamp, goes_on)):
            self._answer(stamp, sequence, values)
        else:
            self._sample = (stamp, sequence, values)

    def _on_setpoint(self, raw: bytes) -> None:
        try:
            stamp, _, _, *setpoint = wire.SETPOINT.unpack(raw)
        except ValueError as error:
            self._complain(error)
            return
        admitted = self._guard.admit(setpoint)
        if admitted is None:
            if self._guard.refused == 1:
                self.get_logger().error(f"setpoint refused, no number or out of range: {setpoint}")
            return
        coming = self._coming
        while coming and coming[-1][0] >= stamp:  # newer word on the same time
            coming.pop()
        coming.append((stamp, admitted))
        if self._sample is not None:
            self._answer_waiting()

    def _answer_waiting(self) -> None:
        if self._sample is not None and self._ready and self._advance(self._sample[0]):
            sample, self._sample = self._sample, None
            self._answer(*sample)

    def _advance(self, now: int) -> bool:
        """Advance to the newest setpoint at or before `now` [ns]; return whether it is still in force then."""
        coming = self._coming
        while coming and coming[0][0] <= now:
            self._since, self._setpoint = coming.popleft()
            self._until = self._since + SETPOINT_PERIOD_NS
        holds = self._since <= now < self._until
        if holds and self._rest is not None:
            self._rest = None
            self.get_logger().info("setpoints come again")
        return holds

    def _come_to_rest(self, now: int, goes_on: bool) -> bool:
        """Make the setpoint of a time without one [ns] if the samples continue; return whether there is one."""
        if self._rest is None:
            if not goes_on or self._since < 0 or now < self._since:
                return False
            self._rest = Rest(self._setpoint, now)
            self.get_logger().warning("setpoint_lost: the last setpoint is held, then brought to rest")
            self.announce()
        self._setpoint = self._rest.at(now)
        self._since = self._until = now
        return True

    def _answer(self, stamp: int, sequence: int, values: list[float]) -> None:
        tilt_x, tilt_y, _, spin_rate, *_ = values
        if not math.isfinite(tilt_x + tilt_y + spin_rate):  # the filters would never forget it
            self._refused += 1
            return
        age = (stamp - self._since) * 1e-9
        voltages = self._controller.update(values, self._setpoint, age)
        if self._rest is not None and abs(self._setpoint[4]) < LOWEST_SPIN:
            voltages = (0.0, 0.0, voltages[2])
        self._motor = voltages[2]
        self._last = sequence
        self._answered += 1
        self._command = wire.COMMAND.pack(stamp, sequence, *voltages)
        if self._commands is not None:
            self._commands.publish(self._command)
        if not self._proven:
            self._trial = self._command if sequence else None

    def _leave(self) -> None:
        """Destroy the topic of the commands, which has one publisher at a time."""
        if self._commands is not None:
            self.deliver(self._commands)
            self.destroy_publisher(self._commands)
            self._commands = None

    def _repeat(self) -> None:
        """Repeat a first command that no sample has followed: a plant that runs may not know this node yet.

        Before its sample 0 it waits until it does.
        """
        if self._trial is not None and self._commands is not None:
            self._commands.publish(self._trial)

    def _restart(self) -> None:
        """Reset for a plant that was started again."""
        self.get_logger().info("samples count from the start again: controller reset")
        self._controller.reset()
        self._since = self._until = -1
        self._rest = None
        self._last, self._command = -1, b""

    def _complain(self, error: ValueError) -> None:
        self._malformed += 1
        self._why = str(error)
        if self._malformed == 1:
            self.get_logger().error(f"{error}; such messages are ignored")


def main() -> int:
    """Run the node."""
    return run_node(ControllerNode)
