"""The node ``plant``: the simulated bench, sample by sample, paced by one of two clocks.

``lockstep``: it publishes sample 0 once there are enough subscribers and a controller, and from then on one sample for
each command that answers the last one. The run is reproducible, and as fast as the two nodes communicate;
``/clock`` carries the simulated time.

``realtime``: a sample every period of the bench by the wall clock, answered or not (`real_time`).

In both a `Guard` protects the machine.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from numpy.typing import NDArray
from rclpy.qos import ReliabilityPolicy
from rclpy.time import Time
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from gyrowheel_core import namespaces, topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PRIORITY, WAITS_FOR, BenchNode, Newcomers, NodeStatus, Param, run_node
from gyrowheel_core.units import RPM
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import from_json
from gyrowheel_sim.plant.machine import Plant
from gyrowheel_sim.plant.protection import HELD_SHARE, Guard, GuardLimits, GuardState, Refusal
from gyrowheel_sim.plant.real_time import CLOCK_JUMP, CLOCK_PERIOD_NS, RELEASED, RealTime
from gyrowheel_sim.plant.scenario import Scenario

#: Low-pass of the tilt rates of the joint states: they are derived from the readings [Hz].
TILT_RATE_LOWPASS = 400.0

_MESSAGES = {
    GuardState.STOPPED: "stopped",
    GuardState.WAITING: "waiting for the first command",
    GuardState.NORMAL: "running",
    GuardState.RELEASED: RELEASED,
    GuardState.VOLTAGE_LIMITED: "voltage_limited: commands beyond the limits are held at them",
    GuardState.COMMAND_REFUSED: "command_refused: invalid commands, or answers to old samples",
}


class PlantNode(BenchNode):
    """Simulates the bench: publishes its samples, takes the commands."""

    NODE_NAME = "plant"
    PARAMETERS = (
        Param("bench", "gyrowheel", "Name of a shipped bench, or path of a bench file"),
        Param("scenario_file", "", "JSON file of what the machine really is; empty: the bench file"),
        Param("environment", "", "JSON list of environments from the start on; empty: upright, ambient air"),
        Param("initial_spin_rate", 0.0, "Spin rate at the start [rad/s]", low=0.0, high=2000.0),
        Param(
            "clock",
            "lockstep",
            "What makes the plant step: a command, or the wall clock",
            choices=("lockstep", "realtime"),
        ),
        Param(
            "command_timeout",
            5.0,
            "Lock-step: silence of the controller that is a fault [s]",
            low=0.1,
            high=3600.0,
        ),
        Param(
            "watchdog",
            0.5,
            "Real time: time without a valid command that means the loss of the controller [s]",
            low=0.002,
            high=60.0,
            live=True,
        ),
        Param(
            "exchange_time",
            10.0,
            "Time without a controller, after the last one has left in order, that means its loss [s]",
            low=0.1,
            high=3600.0,
            live=True,
        ),
        Param(
            "oldest_command",
            0.05,
            "Real time: age of the sample that a command may answer [s]",
            low=0.0,
            high=10.0,
            live=True,
        ),
        Param(
            "tilt_stop",
            0.0,
            "Hard stop of the tilt [rad]; 0: that of the bench",
            low=0.0,
            high=1.0,
            live=True,
        ),
        Param(
            "coil_voltage_limit",
            0.0,
            "Largest coil voltage [V]; 0: that of the bench",
            low=0.0,
            high=1000.0,
            live=True,
        ),
        Param(
            "motor_voltage_limit",
            0.0,
            "Largest motor voltage [V]; 0: that of the bench",
            low=0.0,
            high=1000.0,
            live=True,
        ),
        Param(
            "spin_down_rate",
            100.0,
            "How fast the motor is brought down when the guard trips [rad/s^2]",
            low=1.0,
            high=10_000.0,
            live=True,
        ),
        Param("wait_for_subscribers", 1, "Subscribers needed for sample 0", low=0, high=100),
        Param(
            "joint_state_rate",
            60.0,
            "Joint states per second of bench time [Hz]; at most every sample has one",
            low=0.1,
            high=100_000.0,
            live=True,
        ),
        PRIORITY,
        Param("publish_truth", False, "Publish the true state on gyrowheel/truth"),
    )

    def configure(self) -> None:
        """Build the plant, its guard and its topics."""
        self._bench = bench = Bench.load(self.parameter("bench"))
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
        values = {param.name: self.parameter(param.name) for param in self.PARAMETERS if param.live}
        self._guard = Guard(self._limits(values), motor_voltage=float(self._plant.machine.held[2]))

        self._ignored = self._late_environments = 0
        self._first: Timer | None = None  # runs until sample 0 is published
        self.epoch = 0  # stamp of sample 0 [ns]
        self._real_time = (
            RealTime(self, self._plant, self._guard, self._period_ns)
            if self.parameter("clock") == "realtime"
            else None
        )
        self._active = False
        self._newcomers = Newcomers(self, topics.MEASUREMENT)
        self._sample = b""  # the last one, as it was published
        self._waiting: bytes | None = None  # command that came while the node was inactive
        self._due = self._clock_due = self._joints_due = 0  # times at which the slow topics are due [ns]
        self._clock_told = 0  # the last one [ns]
        self._joint_period = round(1e9 / self.parameter("joint_state_rate"))
        v = bench.value
        self._constants = v("coil_constant"), v("coil_constant"), v("motor_constant")
        # tilt rates by the high-pass that belongs to a first-order low-pass
        share = 1.0 - math.exp(-2.0 * math.pi * TILT_RATE_LOWPASS * bench.sample_period)
        self._derivative = share, 1.0 / bench.sample_period
        self._smooth: list[float] | None = None  # tilts, low-passed
        self._tilt_rates = 0.0, 0.0
        self._reading: list[float] = [0.0] * len(wire.MEASUREMENT.fields)

        self._measurements = self.publisher(topics.MEASUREMENT)
        # In real time there is none: time is that of the computer.
        self._clock_publisher = None if self._real_time else self.publisher(topics.CLOCK)
        self._joints = self.publisher(topics.JOINT_STATES)
        self._truth = self.publisher(topics.TRUTH) if self.parameter("publish_truth") else None
        self._description = self.publisher(topics.BENCH)
        self._description.publish(String(data=bench.describe()))
        self._environment = self.subscription(topics.ENVIRONMENT, self._on_environment)
        self._waiter, self._without_setpoint = (
            "",
            False,
        )  # who said that it waits for a setpoint, and whether it does
        self._diagnoses = (
            None if self._real_time else self.subscription(topics.DIAGNOSTICS, self._on_diagnostics)
        )
        self._commands = self.subscription(
            topics.COMMAND, self._real_time.on_command if self._real_time else self._on_command, raw=True
        )

    def activate(self) -> None:
        """Publish sample 0 once all its subscribers exist, or continue after a deactivation."""
        self.prioritise()
        self._guard.start()
        self._active = True
        self._untouched = self._plant.sequence == 0
        if self._untouched:
            self._first = self.wall_timer(0.02, self._publish_first)
        if self._real_time:
            self._real_time.watch()
            if not self._untouched:
                self._real_time.start()
            return
        self._watched = (self._plant.sequence, time.monotonic())
        self._watch = self.wall_timer(self.parameter("command_timeout") / 20.0, self._check_silence)
        if not self._untouched and self._waiting is not None:
            self._on_command(self._waiting)

    def deactivate(self) -> None:
        """Stop stepping, with no voltage on coils and motor."""
        self._active = False
        self._guard.stop()
        if self._real_time:
            self._real_time.stop()
        else:
            self.destroy_timer(self._watch)
        self._stop_waiting()
        self.deliver(self._measurements)

    def cleanup(self) -> None:
        """Destroy the topics."""
        for subscription in (self._environment, self._commands, self._diagnoses):
            if subscription is not None:
                self.destroy_subscription(subscription)
        samples, others = (self._measurements, self._joints), (self._clock_publisher, self._truth)
        for publisher in (*samples, *others, self._description):
            if publisher is not None:
                self.destroy_publisher(publisher)

    def check_tuning(self, values: Mapping[str, Any]) -> None:
        """Refuse limits beyond those of the bench."""
        self._limits(values)

    def tune(self) -> None:
        """Adopt the limits, and the rate of the joint states."""
        self._joint_period = round(1e9 / self.parameter("joint_state_rate"))
        self._joints_due = min(self._joints_due, self._plant.time_ns + self._joint_period)
        self._due = min(self._due, self._joints_due)
        values = {param.name: self.parameter(param.name) for param in self.PARAMETERS if param.live}
        self._guard.limits = self._limits(values)

    def patience(self) -> float:
        """Return the time until a sample is due in real time [s]."""
        usual = super().patience()
        return usual if self._real_time is None else min(self._real_time.patience(), usual)

    def pace(self) -> None:
        """Make the samples that are due, in real time."""
        if self._real_time is not None:
            self._real_time.pace()

    def diagnose(self) -> NodeStatus:
        """Return the state of the guard, counts and time."""
        guard = self._guard
        share = guard.held_share
        state = guard.report()
        outputs = "off" if guard.off else "driven" if guard.trip is None else "spinning down"
        values: dict[str, object] = {
            "clock": self.parameter("clock"),
            "guard": state,
            "outputs": outputs,
            "samples": self._plant.sequence + (self._first is None),
            "simulated_time": f"{self._plant.time_ns * 1e-9:.4f}",
            "spin_rate_rpm": f"{self._reading[3] / RPM:.0f}",
            "tilt_deg": f"{math.degrees(math.hypot(*self._reading[:2])):.3f}",
            "tilt_stop_deg": f"{math.degrees(guard.limits.tilt_stop):g}",
            "commands": guard.taken + guard.refused[Refusal.OUT_OF_RANGE],
            "saturated_commands": guard.limited,
            "ignored_commands": self._ignored,
            "late_environments": self._late_environments,
        }
        values |= {f"refused_{why}": count for why, count in guard.refused.items()}
        stall = late = ""
        jump = 0.0
        if self._real_time:
            values |= self._real_time.report()
            stall, late = self._real_time.lateness()
            jump = self._real_time.clock_jump
        if self._first is not None and (missing := self._missing()):
            return NodeStatus(f"waiting for {' and '.join(missing)}", values)
        if guard.trip is not None:
            return NodeStatus(
                f"{guard.trip}: {guard.reason}; coils off, motor {outputs}", values, DiagnosticStatus.ERROR
            )
        if stall:
            return NodeStatus(stall, values, DiagnosticStatus.WARN)
        if state in (GuardState.WAITING, GuardState.STOPPED):
            why = guard.refusals() or self._unheard()
            if not why and self._ignored:
                why = f": {self._ignored} came, and none answers the sample that waits"
            level = DiagnosticStatus.WARN if why else DiagnosticStatus.OK
            return NodeStatus(f"{_MESSAGES[state]}{why}", values, level)
        holding = f"holding: {share:.1%} of the samples had no new command, the last one went on acting"
        if state is GuardState.HOLDING and share > HELD_SHARE:
            return NodeStatus(holding, values, DiagnosticStatus.WARN)
        if state not in (GuardState.NORMAL, GuardState.HOLDING):
            return NodeStatus(_MESSAGES[state], values, DiagnosticStatus.WARN)
        if abs(jump) > CLOCK_JUMP:
            return NodeStatus(
                f"clock_jump: the clock of the computer was set and is {jump:+.2f} s from the stamps",
                values,
                DiagnosticStatus.WARN,
            )
        if late:
            return NodeStatus(f"late: {late}", values, DiagnosticStatus.WARN)
        if self._ignored or self._late_environments:
            return NodeStatus("running; some input came late or twice", values, DiagnosticStatus.WARN)
        return NodeStatus(holding if state is GuardState.HOLDING else "running", values)

    def _limits(self, values: Mapping[str, Any]) -> GuardLimits:
        """Return the limits of the guard; InputError where one is beyond that of the bench."""
        v, period = self._bench.value, self._bench.sample_period

        def limit(name: str, of_bench: str) -> float:
            given, largest = float(values[name]), v(of_bench)
            if given > largest * (1.0 + 1e-9):
                raise InputError(
                    f"parameter {name}: {given:g} is beyond the bench; allowed: up to {largest:.6g}"
                )
            return given or largest

        return GuardLimits(
            coil_voltage=limit("coil_voltage_limit", "coil_voltage_limit"),
            motor_voltage=limit("motor_voltage_limit", "supply_voltage"),
            tilt_stop=limit("tilt_stop", "tilt_limit"),
            watchdog=max(round(values["watchdog"] / period), 1),
            oldest=round(values["oldest_command"] / period),
            exchange=max(round(values["exchange_time"] / period), 1),
            spin_down=v("motor_constant") * values["spin_down_rate"] * period,
        )

    # ---- the first sample

    def _publish_first(self) -> None:
        if not self._missing():
            self._stop_waiting()
            if self._real_time:
                self._real_time.start()
            self._newcomers.begin()
            self._publish_sample(self._plant.measure())

    def _missing(self) -> list[str]:
        """Return the missing conditions of sample 0, in words."""
        missing = []
        have, need = self._measurements.get_subscription_count(), self.parameter("wait_for_subscribers")
        if have < need:
            missing.append(f"subscribers: {have} of {need}")
        # Two ends of a line do not know of each other at the same moment: a command from one that this node does not
        # know yet would be lost, and in lock-step nothing goes on without it.
        if not self._real_time and not self.controllers():
            missing.append(f"a publisher of commands{self._unheard()}")
        return missing

    def _unheard(self) -> str:
        """Return the publishers of commands whose quality of service does not match, in words; empty without any."""
        there = () if self.controllers() else self.get_publishers_info_by_topic(topics.COMMAND.relative)
        best = ReliabilityPolicy.BEST_EFFORT
        names = sorted({info.node_name for info in there if info.qos_profile.reliability == best})
        return f" ({', '.join(names)}: best effort, and reliable is needed)" if names else ""

    def _stop_waiting(self) -> None:
        if self._first is not None:
            self.destroy_timer(self._first)
            self._first = None

    # ---- lock-step

    def _on_command(self, raw: bytes) -> None:
        if not self._active:
            self._waiting = raw
            return
        if self._first is not None:  # nobody has seen a sample that it could answer
            self._ignored += 1
            return
        sequence, guard = self._plant.sequence, self._guard
        try:
            _, answered, voltage_x, voltage_y, motor_voltage = wire.COMMAND.unpack(raw)
        except ValueError as error:
            self.fault("command_malformed", f"after sample {sequence}: {error}")
            return
        if answered != sequence:
            self._ignored += 1
            return
        if guard.take(answered, sequence, voltage_x, voltage_y, motor_voltage) is Refusal.NOT_FINITE:
            # nothing else would make the next step: bench time would stop for ever
            self.fault(
                "command_not_finite",
                f"command for sample {sequence}: coil_voltage_x {voltage_x:g}, coil_voltage_y {voltage_y:g}, "
                f"motor_voltage {motor_voltage:g} V; every voltage must be finite",
            )
            return
        self.step()

    def _check_silence(self) -> None:
        sequence, since = self._watched
        now = time.monotonic()
        goes_on = sequence != self._plant.sequence
        if self._newcomers.look(goes_on=goes_on, now=now) and self._sample:
            self._measurements.publish(self._sample)
        if self._sample and not goes_on:
            self._publish_clock(self._clock_told)
        if goes_on or sequence == 0:
            self._watched = (self._plant.sequence, now)
            return
        what, limit = "command", self.parameter("command_timeout")
        if not self.controllers():
            what = "controller"
        if what == "controller" or self._without_setpoint:  # a node has left, and another one may come
            limit = max(limit, self.parameter("exchange_time"))
        if now - since <= limit:
            return
        text = f"no {what} for {limit:g} s after sample {self._plant.sequence}"
        if what == "command" and self._without_setpoint:
            self.fault(
                "setpoint_lost", f"{text}: the controller has no setpoint; the conductor is gone or inactive"
            )
        else:
            self.fault("controller_silent", text)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        """Note whether the controller itself waits for a setpoint."""
        for status in message.status:
            if not namespaces.is_of_another(status.hardware_id, self.namespace):
                waits = {pair.value for pair in status.values if pair.key == WAITS_FOR}
                if waits or namespaces.local_name(status.name, self.namespace) == self._waiter:
                    self._waiter = namespaces.local_name(status.name, self.namespace)
                    self._without_setpoint = topics.SETPOINT.name in waits

    # ---- both

    def controllers(self) -> int:
        """Return the number of controllers."""
        return int(self._commands.get_publisher_count())

    def step(self) -> None:
        """Advance by one sample."""
        guard = self._guard
        tripped = guard.trip
        reading = self._plant.step(*guard.output())
        self._publish_sample(reading)
        if guard.trip is not tripped:
            self.get_logger().error(f"{guard.trip}: {guard.reason}; coils off, the motor is brought down")
            self.announce()

    def _publish_sample(self, reading: NDArray[np.float64]) -> None:
        sequence = self._plant.sequence
        now = sequence * self._period_ns
        self._reading = values = reading.tolist()
        self._guard.observe(values[0], values[1])
        self._derive(values[0], values[1])
        self._sample = wire.MEASUREMENT.pack(self.epoch + self._plant.stamp_ns, sequence, *values)
        self._measurements.publish(self._sample)
        if now >= self._due:
            self._publish_slow(now, values)

    def _derive(self, tilt_x: float, tilt_y: float) -> None:
        """Update the tilt rates from readings: joint states contain only what sensors measure."""
        smooth = self._smooth
        if smooth is None:
            self._smooth = [tilt_x, tilt_y]
            return
        share, rate = self._derivative
        step_x, step_y = share * (tilt_x - smooth[0]), share * (tilt_y - smooth[1])
        smooth[0] += step_x
        smooth[1] += step_y
        self._tilt_rates = step_x * rate, step_y * rate

    def _publish_slow(self, now: int, values: list[float]) -> None:
        if now >= self._clock_due:
            self._clock_due = now - now % CLOCK_PERIOD_NS + CLOCK_PERIOD_NS
            self._publish_clock(now)
            if self._truth is not None:
                truth = {"time": (self.epoch + now) * 1e-9, **self._plant.truth()}
                self._truth.publish(String(data=json.dumps(truth)))
        if now >= self._joints_due:
            # of a rate beyond that of the samples nothing is left to be made up for
            self._joints_due = max(self._joints_due + self._joint_period, now + 1)
            message = JointState(
                name=topics.JOINTS,
                position=values[:3],
                velocity=(*self._tilt_rates, values[3]),
                # coil voltages [V] and motor current [A], times their constants
                effort=[k * values[place] for k, place in zip(self._constants, (4, 5, 7), strict=True)],
            )
            message.header.stamp = Time(nanoseconds=self.epoch + now).to_msg()
            self._joints.publish(message)
        self._due = min(self._clock_due, self._joints_due)

    def _publish_clock(self, now: int) -> None:
        self._clock_told = now
        if self._clock_publisher is not None:
            self._clock_publisher.publish(wire.CLOCK.pack(now))

    def _on_environment(self, message: String) -> None:
        try:
            events = from_json(message.data)
        except InputError as error:
            self.get_logger().error(f"{topics.ENVIRONMENT.name}: {error}; the message is ignored")
            return
        period = self._period_ns * 1e-9
        if self._real_time:  # the plant counts from sample 0
            events = [
                replace(event, time=max(event.time - self.epoch * 1e-9, 0.0) if event.time else 0.0)
                for event in events
            ]
        late = [event for event in events if round(event.time / period) < self._plant.sequence]
        if late and not self._real_time:
            self._late_environments += len(late)
            self.get_logger().warning(
                f"an environment for {late[0].time:g} s came at {self._plant.time_ns * 1e-9:g} s"
            )
        self._plant.schedule(events)


def main() -> int:
    """Run the node."""
    return run_node(PlantNode)
