"""The node ``joint_commands``: replaces the controller by an external one that uses standard messages.

It takes efforts as ``sensor_msgs/JointState``, joints ``tilt_x``, ``tilt_y`` and ``spin``, turns them into voltages
and answers the newest sample that has no answer. Efforts that come while every sample is answered wait for the
next one; only the newest wait. So a controller closes the loop at any rate; in lock-step one message
makes one step. It publishes commands while it is active, so that it and another controller can take each other's place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState

from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PRIORITY, BenchNode, NodeStatus, Param, run_node
from gyrowheel_core.topics import JOINTS
from gyrowheel_sim.bench import Bench


class Efforts:
    """Turns efforts of the joints into voltages of coils and motor.

    `bench`: the bench as its file describes it: its constants are those of the conversion; `meaning`: what an
    effort is: ``torque`` [N·m], or ``voltage`` [V].
    """

    def __init__(self, bench: Bench, meaning: str) -> None:
        self._voltage = meaning == "voltage"
        v = bench.value
        self._coil, self._motor, self._resistance = (
            v("coil_constant"),
            v("motor_constant"),
            v("motor_resistance"),
        )

    def voltages(self, efforts: Sequence[float], spin_rate: float) -> tuple[float, float, float]:
        """Return coil voltage x, coil voltage y and motor voltage [V].

        `efforts`: of the joints, in the order of `gyrowheel_core.topics.JOINTS`; `spin_rate`: measured spin
        rate, whose voltage the motor must overcome [rad/s].
        """
        x, y, spin = efforts
        if self._voltage:
            return x, y, spin
        motor = self._motor * spin_rate + self._resistance * spin / self._motor
        return x / self._coil, y / self._coil, motor


def efforts_of(names: Sequence[str], values: Sequence[float]) -> tuple[float, float, float]:
    """Return the efforts in the order of their voltages from a message; other joints in it are left alone.

    Raises InputError if a joint is missing or named twice, or an effort is missing or no number.
    """
    if len(values) != len(names):
        raise InputError(f"effort: {len(values)} values for {len(names)} joints; allowed: one for each")
    found = dict(zip(names, values, strict=True))
    if missing := [joint for joint in JOINTS if joint not in found]:
        raise InputError(f"name: no joint {', '.join(missing)}; needed: {', '.join(JOINTS)}")
    if len(found) != len(names):
        raise InputError("name: a joint is named twice")
    for joint in JOINTS:
        if not math.isfinite(found[joint]):
            raise InputError(f"effort: {joint}: {found[joint]!r}; allowed: finite numbers")
    x, y, spin = (float(found[joint]) for joint in JOINTS)
    return x, y, spin


class JointCommandsNode(BenchNode):
    """Turns efforts of the joints, as ros2_control sends them, into commands of the bench."""

    NODE_NAME = "joint_commands"
    PARAMETERS = (
        Param("bench", "gyrowheel", "Name of a shipped bench, or path of a bench file"),
        Param(
            "effort",
            "torque",
            "What the effort of a joint is: torque [N·m], or voltage [V]",
            choices=("torque", "voltage"),
        ),
        PRIORITY,
    )

    def configure(self) -> None:
        """Read the bench, create the topics."""
        self._efforts = Efforts(Bench.load(self.parameter("bench")), self.parameter("effort"))
        self._sample: tuple[int, int, float] | None = (
            None  # stamp, number and spin rate of one without an answer
        )
        self._waiting: tuple[float, float, float] | None = None  # efforts that wait for a sample
        self._passed = 0  # samples that have come since
        self._answered = self._refused = self._told = 0
        self._why = ""
        self._commands: Publisher | None = None  # while it is active
        # first command since the start, and the sample that it answers, until another one shows that it arrived
        self._trial: tuple[int, bytes] | None = None
        self._proven = False  # whether that has happened
        self._inputs = (
            self.subscription(topics.MEASUREMENT, self._on_measurement, raw=True),
            self.subscription(topics.JOINT_COMMANDS, self._on_efforts),
        )

    def activate(self) -> None:
        """Answer samples as efforts come."""
        self.prioritise()
        self._commands = self.publisher(topics.COMMAND)
        self._trial, self._proven = None, False
        self._repeating = self.wall_timer(1.0, self._repeat)
        self._answer()

    def deactivate(self) -> None:
        """Destroy the topic of the commands: the plant switches the coils off and waits for another controller."""
        self.destroy_timer(self._repeating)
        if self._commands is not None:
            self.deliver(self._commands)
            self.destroy_publisher(self._commands)
            self._commands = None

    def cleanup(self) -> None:
        """Destroy the topics."""
        for subscription in self._inputs:
            self.destroy_subscription(subscription)

    def diagnose(self) -> NodeStatus:
        """Return counts, and why messages were refused."""
        values = {"commands": self._answered, "refused_messages": self._refused}
        if self._refused > self._told:
            self._told = self._refused
            return NodeStatus(f"input_refused: {self._why}", values, DiagnosticStatus.WARN)
        return NodeStatus("running" if self._answered else "waiting for efforts", values)

    def _on_measurement(self, raw: bytes) -> None:
        try:
            stamp, number, *values = wire.MEASUREMENT.unpack(raw)
        except ValueError as error:
            self._refuse(str(error))
            return
        self._sample = stamp, number, values[3]
        self._passed += 1
        if self._commands is None and self._passed > 1:  # another controller answers, and what waits is old
            self._waiting = None
        if self._trial is not None and number > self._trial[0]:
            self._trial, self._proven = None, True
        self._answer()

    def _on_efforts(self, message: JointState) -> None:
        try:
            self._waiting, self._passed = efforts_of(message.name, message.effort), 0
        except InputError as error:
            self._refuse(f"{topics.JOINT_COMMANDS.name}: {error}")
            return
        self._answer()

    def _answer(self) -> None:
        if self._commands is None or self._sample is None or self._waiting is None:
            return
        (stamp, number, spin_rate), efforts = self._sample, self._waiting
        self._sample = self._waiting = None
        command = wire.COMMAND.pack(stamp, number, *self._efforts.voltages(efforts, spin_rate))
        self._commands.publish(command)
        self._answered += 1
        if not self._proven:
            self._trial = number, command

    def _repeat(self) -> None:
        """Repeat a first command that no sample has followed: the plant may not have known this node yet."""
        if self._trial is not None and self._commands is not None:
            self._commands.publish(self._trial[1])

    def _refuse(self, why: str) -> None:
        self._refused += 1
        self._why = why
        if self._refused == 1:
            self.get_logger().error(f"{why}; such messages are refused")


def main() -> int:
    """Run the node."""
    return run_node(JointCommandsNode)
