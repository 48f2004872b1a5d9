"""The node ``plant``: the simulated bench in lock-step with whatever answers its samples.

It publishes sample 0 once enough subscribers listen and from then on one sample for each command that
answers the last one: the run is reproducible, and as fast as the two nodes can talk. ``/clock`` carries the
simulated time.
"""

from __future__ import annotations

import json
import math
import time

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray
from rclpy.time import Time
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from gyrowheel_sim import topics, wire
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import from_json
from gyrowheel_sim.errors import InputError
from gyrowheel_sim.node import BenchNode, Diagnosis, Param, run_node
from gyrowheel_sim.plant import Plant
from gyrowheel_sim.scenario import Scenario

CLOCK_PERIOD_NS = 10_000_000
JOINT_STATE_PERIOD_NS = 1_000_000_000 // 60
JOINTS = ("tilt_x", "tilt_y", "spin")


class PlantNode(BenchNode):
    """Simulates the bench: publishes its samples, takes the commands."""

    NODE_NAME = "plant"
    PARAMETERS = (
        Param("bench", "gyrowheel", "Name of a shipped bench, or path of a bench file"),
        Param("scenario_file", "", "JSON file of what the machine really is; empty: the bench file"),
        Param("environment", "", "JSON list of environments from the start on; empty: upright, ambient air"),
        Param("initial_spin_rate", 0.0, "Spin rate at the start [rad/s]", low=0.0, high=2000.0),
        Param("clock", "lockstep", "What the plant waits for before it steps", choices=("lockstep",)),
        Param("command_timeout", 5.0, "Silence of the controller that is a fault [s]", low=0.1, high=3600.0),
        Param("wait_for_subscribers", 1, "Subscribers needed for sample 0", low=0, high=100),
        Param("publish_truth", False, "Publish the true state on /gyrowheel/truth"),
    )

    def configure(self) -> None:
        """Build the plant and its topics."""
        bench = Bench.load(self.parameter("bench"))
        file = self.parameter("scenario_file")
        scenario = Scenario.load(file, bench) if file else Scenario.nominal()
        self._plant = Plant(bench, scenario, initial_spin_rate=self.parameter("initial_spin_rate"))
        # Compiled code is loaded at its first call, which takes seconds: now rather than in the loop.
        trial = Plant(bench, scenario, initial_spin_rate=0.0)
        trial.measure()
        trial.step(0.0, 0.0, 0.0)
        if self.parameter("environment"):
            self._plant.schedule(from_json(self.parameter("environment")))
        self._period_ns = round(bench.sample_period * 1e9)
        self._coil_limit = bench.value("coil_voltage_limit")
        self._motor_limit = bench.value("supply_voltage")

        self._commands = self._saturated = self._ignored = self._late_environments = 0
        self._first: Timer | None = None  # runs until sample 0 is published
        self._active = False
        self._waiting: bytes | None = None  # command that came while the node was inactive
        self._due = self._clock_due = self._joints_due = 0  # times at which the slow topics are due [ns]

        self._measurements = self.publisher(topics.MEASUREMENT)
        self._clock_publisher = self.publisher(topics.CLOCK)
        self._joints = self.publisher(topics.JOINT_STATES)
        self._truth = self.publisher(topics.TRUTH) if self.parameter("publish_truth") else None
        self._description = self.publisher(topics.BENCH)
        self._description.publish(String(data=bench.describe()))
        self._inputs = (
            self.subscription(topics.ENVIRONMENT, self._on_environment),
            self.subscription(topics.COMMAND, self._on_command, raw=True),
        )

    def activate(self) -> None:
        """Publish sample 0 as soon as enough subscribers listen, or go on where the node was deactivated."""
        self._active = True
        self._watched = (self._commands, time.monotonic())
        self._watch = self.wall_timer(self.parameter("command_timeout") / 20.0, self._check_silence)
        if self._plant.sequence == 0 and self._commands == 0:
            self._first = self.wall_timer(0.02, self._publish_first)
        elif self._waiting is not None:
            self._on_command(self._waiting)

    def deactivate(self) -> None:
        """Stop stepping."""
        self._active = False
        self.destroy_timer(self._watch)
        self._stop_waiting()
        self.deliver(self._measurements)

    def cleanup(self) -> None:
        """Give up the plant and its topics."""
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        for publisher in (
            self._measurements,
            self._clock_publisher,
            self._joints,
            self._truth,
            self._description,
        ):
            if publisher is not None:
                self.destroy_publisher(publisher)

    def diagnose(self) -> Diagnosis:
        """Return counts and the simulated time."""
        values = {
            "samples": self._plant.sequence + (self._first is None),
            "simulated_time": f"{self._plant.time_ns * 1e-9:.4f}",
            "commands": self._commands,
            "saturated_commands": self._saturated,
            "ignored_commands": self._ignored,
            "late_environments": self._late_environments,
        }
        if self._first is not None:
            have, need = self._measurements.get_subscription_count(), self.parameter("wait_for_subscribers")
            return Diagnosis(f"waiting for subscribers: {have} of {need}", values)
        if self._commands == 0:
            return Diagnosis("waiting for the first command", values)
        if self._ignored or self._late_environments:
            return Diagnosis("running; some input came late or twice", values, DiagnosticStatus.WARN)
        return Diagnosis("running", values)

    def _publish_first(self) -> None:
        if self._measurements.get_subscription_count() >= self.parameter("wait_for_subscribers"):
            self._stop_waiting()
            self._publish_sample(self._plant.measure())

    def _stop_waiting(self) -> None:
        if self._first is not None:
            self.destroy_timer(self._first)
            self._first = None

    def _on_command(self, raw: bytes) -> None:
        if not self._active:
            self._waiting = raw
            return
        sequence = self._plant.sequence
        try:
            _, answered, voltage_x, voltage_y, motor_voltage = wire.COMMAND.unpack(raw)
        except ValueError as error:
            self.fault("command_malformed", f"after sample {sequence}: {error}")
            return
        if answered != sequence:
            self._ignored += 1
            return
        if not (math.isfinite(voltage_x) and math.isfinite(voltage_y) and math.isfinite(motor_voltage)):
            self.fault(
                "command_not_finite",
                f"command for sample {sequence}: coil_voltage_x {voltage_x:g}, coil_voltage_y {voltage_y:g}, "
                f"motor_voltage {motor_voltage:g} V; every voltage must be finite",
            )
            return
        limit = self._coil_limit
        if abs(voltage_x) > limit or abs(voltage_y) > limit or abs(motor_voltage) > self._motor_limit:
            self._saturated += 1
        self._commands += 1
        self._publish_sample(self._plant.step(voltage_x, voltage_y, motor_voltage))

    def _publish_sample(self, reading: NDArray[np.float64]) -> None:
        sequence = self._plant.sequence
        now = sequence * self._period_ns
        values = reading.tolist()
        self._measurements.publish(wire.MEASUREMENT.pack(now, sequence, *values))
        if now >= self._due:
            self._publish_slow(now, values)

    def _publish_slow(self, now: int, values: list[float]) -> None:
        if now >= self._clock_due:
            self._clock_due += CLOCK_PERIOD_NS
            self._clock_publisher.publish(wire.CLOCK.pack(now))
            if self._truth is not None:
                truth = {"time": now * 1e-9, **self._plant.truth()}
                self._truth.publish(String(data=json.dumps(truth)))
        if now >= self._joints_due:
            self._joints_due += JOINT_STATE_PERIOD_NS
            message = JointState(name=JOINTS, position=values[:3])
            message.header.stamp = Time(nanoseconds=now).to_msg()
            self._joints.publish(message)
        self._due = min(self._clock_due, self._joints_due)

    def _on_environment(self, message: String) -> None:
        try:
            events = from_json(message.data)
        except InputError as error:
            self.get_logger().error(f"{topics.ENVIRONMENT.name}: {error}; the message is ignored")
            return
        period = self._period_ns * 1e-9
        late = [event for event in events if round(event.time / period) < self._plant.sequence]
        if late:
            self._late_environments += len(late)
            self.get_logger().warning(
                f"an environment for {late[0].time:g} s came at {self._plant.time_ns * 1e-9:g} s"
            )
        self._plant.schedule(events)

    def _check_silence(self) -> None:
        commands, since = self._watched
        now = time.monotonic()
        if commands != self._commands or commands == 0:
            self._watched = (self._commands, now)
        elif now - since > self.parameter("command_timeout"):
            self.fault(
                "controller_silent",
                f"no command for {self.parameter('command_timeout'):g} s after sample {self._plant.sequence}",
            )


def main() -> int:
    """Run the node."""
    return run_node(PlantNode)
