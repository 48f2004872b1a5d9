"""The node ``joint_commands``: takes the controller's place for one that speaks standard messages.

It takes efforts as ``sensor_msgs/JointState``, joints ``tilt_x``, ``tilt_y`` and ``spin``, turns them into voltages
and answers the newest sample that has no answer. Efforts that come while every sample is answered wait for the
next one; only the newest wait. So a controller closes the loop at any rate; in lock-step one message
makes one step.
"""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState

from gyrowheel_control.loops.efforts import Efforts, efforts_of
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PRIORITY, BenchNode, Diagnosis, Param, run_node
from gyrowheel_sim.bench import Bench


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
        self._answered = self._refused = self._told = 0
        self._active = False
        self._why = ""
        self._commands = self.publisher(topics.COMMAND)
        self._inputs = (
            self.subscription(topics.MEASUREMENT, self._on_measurement, raw=True),
            self.subscription(topics.JOINT_COMMANDS, self._on_efforts),
        )

    def activate(self) -> None:
        """Answer samples as efforts come."""
        self.prioritise()
        self._waiting = None
        self._active = True

    def deactivate(self) -> None:
        """Answer no more; the plant's guard switches the coils off and brings the motor down."""
        self._active = False
        self.deliver(self._commands)

    def cleanup(self) -> None:
        """Give up the topics."""
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self.destroy_publisher(self._commands)

    def diagnose(self) -> Diagnosis:
        """Return counts, and why messages were refused."""
        values = {"commands": self._answered, "refused_messages": self._refused}
        if self._refused > self._told:
            self._told = self._refused
            return Diagnosis(f"input_refused: {self._why}", values, DiagnosticStatus.WARN)
        return Diagnosis("running" if self._answered else "waiting for efforts", values)

    def _on_measurement(self, raw: bytes) -> None:
        try:
            stamp, number, *values = wire.MEASUREMENT.unpack(raw)
        except ValueError as error:
            self._refuse(str(error))
            return
        self._sample = stamp, number, values[3]
        self._answer()

    def _on_efforts(self, message: JointState) -> None:
        try:
            self._waiting = efforts_of(message.name, message.effort)
        except InputError as error:
            self._refuse(f"{topics.JOINT_COMMANDS.name}: {error}")
            return
        self._answer()

    def _answer(self) -> None:
        if not self._active or self._sample is None or self._waiting is None:
            return
        (stamp, number, spin_rate), efforts = self._sample, self._waiting
        self._sample = self._waiting = None
        self._commands.publish(wire.COMMAND.pack(stamp, number, *self._efforts.voltages(efforts, spin_rate)))
        self._answered += 1

    def _refuse(self, why: str) -> None:
        self._refused += 1
        self._why = why
        if self._refused == 1:
            self.get_logger().error(f"{why}; such messages are refused")


def main() -> int:
    """Run the node."""
    return run_node(JointCommandsNode)
