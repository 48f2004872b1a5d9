"""Name, type and quality of service of every topic of the bench."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from gyrowheel_core import wire

if TYPE_CHECKING:
    from rclpy.qos import QoSProfile

# Reliable delivery keeps up to this many messages: in the writer those that a reader has not acknowledged, in the
# reader those that it has not taken. Beyond that the oldest are lost. In lock-step the nodes reach 10 000 samples per
# second; at that rate a reader may be busy elsewhere for five seconds.
_HIGH_RATE: Final = 50_000


#: The joints of the wheel in standard messages.
JOINTS: Final = ("tilt_x", "tilt_y", "spin")


@dataclass(frozen=True)
class Topic:
    """One topic; delivery is reliable on all of them."""

    name: str  # full name where no namespace is given
    type_name: str  # message type, such as ``"std_msgs/msg/String"``
    depth: int = 10  # how many messages are kept for a slow reader
    #: Whether the last messages are delivered to a reader that comes later (durability `transient_local`).
    latched: bool = False
    layout: wire.Layout | None = None  # layout of the serialized message where it is a fixed one
    shared: bool = False  # whether several nodes publish it; every other topic has one publisher
    fixed: bool = False  # whether it has this name in every namespace

    @property
    def relative(self) -> str:
        """Name by which a node asks for it, so that it moves with the node's namespace."""
        return self.name if self.fixed else self.name.removeprefix("/")

    def within(self, namespace: str) -> str:
        """Return its full name in a namespace: empty for the root, else such as ``/bench2``."""
        return self.name if self.fixed else f"{namespace}{self.name}"

    @property
    def qos(self) -> QoSProfile:
        """Quality of service for publishers and subscriptions alike."""
        # rclpy only here: recordings are read without ROS, and need names and types, too.
        from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

        return QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=self.depth,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if self.latched else DurabilityPolicy.VOLATILE,
        )

    @property
    def message_class(self) -> type[Any]:
        """Python class of the messages; its package must be installed."""
        package, kind, name = self.type_name.split("/")
        result: type[Any] = getattr(import_module(f"{package}.{kind}"), name)
        return result


def _fixed(name: str, layout: wire.Layout, depth: int) -> Topic:
    return Topic(name, layout.type_name, depth, layout=layout)


MEASUREMENT: Final = _fixed("/gyrowheel/measurement", wire.MEASUREMENT, _HIGH_RATE)
COMMAND: Final = _fixed("/gyrowheel/command", wire.COMMAND, _HIGH_RATE)
SETPOINT: Final = _fixed("/gyrowheel/setpoint", wire.SETPOINT, _HIGH_RATE)
DRAG_ESTIMATE: Final = _fixed("/gyrowheel/drag_estimate", wire.DRAG_ESTIMATE, 100)
BENCH: Final = Topic("/gyrowheel/bench", "std_msgs/msg/String", 1, latched=True)
ENVIRONMENT: Final = Topic("/gyrowheel/environment", "std_msgs/msg/String", 10, latched=True)
TRUTH: Final = Topic("/gyrowheel/truth", "std_msgs/msg/String", 1_000)
CLOCK: Final = _fixed("/clock", wire.CLOCK, 100)
JOINT_STATES: Final = Topic("/joint_states", "sensor_msgs/msg/JointState")
JOINT_COMMANDS: Final = Topic("/joint_commands", "sensor_msgs/msg/JointState")
DIAGNOSTICS: Final = Topic(
    "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", 100, shared=True, fixed=True
)

TOPICS: Final = (
    MEASUREMENT, COMMAND, SETPOINT, DRAG_ESTIMATE, BENCH, ENVIRONMENT, TRUTH, CLOCK, JOINT_STATES,
    JOINT_COMMANDS, DIAGNOSTICS,
)  # fmt: skip
