"""What the conductor observes of the bench: the source of its time, and whether the wheel follows."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Sequence

from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from gyrowheel_control.loops.supervision import Tracking
from gyrowheel_core import topics, wire

#: Time for which the publishers of the clock are remembered [s].
_WHOSE_TIME = 1.0
#: In the name of a node, until it has arrived.
_UNKNOWN = "UNKNOWN"


class TimeSources:
    """The nodes that publish the clock, the samples and the joint states.

    Parameters
    ----------
    node : Node
        The node that needs the time.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._looked, self._foreign = 0.0, False  # when it was looked whose the clock is, and what was seen

    def stamps(self) -> topics.Topic:
        """Return the topic with the stamps of the samples: the less frequent one, if the same node publishes it."""
        slow = self._publishers(topics.JOINT_STATES)
        return (
            topics.JOINT_STATES
            if slow and slow == self._publishers(topics.MEASUREMENT)
            else topics.MEASUREMENT
        )

    def clock_is_foreign(self) -> bool | None:
        """Return whether samples are published, and the clock only by nodes that publish none; None if not known."""
        now = time.monotonic()
        if now - self._looked > _WHOSE_TIME:
            clocks, samples = self._publishers(topics.CLOCK), self._publishers(topics.MEASUREMENT)
            if any(_UNKNOWN in name for name in clocks | samples):
                return None
            self._looked, self._foreign = now, bool(clocks and samples) and not clocks & samples
        return self._foreign

    def _publishers(self, topic: topics.Topic) -> set[str]:
        """Return the nodes that publish a topic, by their full names."""
        found = self._node.get_publishers_info_by_topic(topic.relative)
        return {f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in found}


#: Interval of the checks whether the wheel follows [ns].
LOOK_PERIOD_NS = 10_000_000


class WheelWatch:
    """Compares the wheel with its setpoints, by the joint states or the samples.

    Parameters
    ----------
    tracking : callable
        Returns what tells whether the wheel follows, as the node's parameters say now.
    asked : callable
        Returns the setpoint that a reading of a time [ns] is to follow (`Tracking.observe`); None where there is none.
    """

    def __init__(
        self, tracking: Callable[[], Tracking], asked: Callable[[int], Sequence[float] | None]
    ) -> None:
        self._new, self._asked = tracking, asked
        self.begin()

    @property
    def lost(self) -> str:
        """Setpoint and reading, in one line, once the wheel has not followed for too long; else empty."""
        return self._tracking.lost

    def begin(self) -> None:
        """Start again, for another plan or other bounds."""
        self._tracking = self._new()
        self._due = 0  # time from which on it is looked again [ns]

    def is_due(self, now: int) -> bool:
        """Return whether the next check is due at `now` [ns]; before, a sample need not be unpacked."""
        return now >= self._due

    def sample(self, raw: bytes) -> bool:
        """Check a sample; return whether the wheel has just been lost."""
        with contextlib.suppress(ValueError):  # from a node that is not of this bench
            stamp, _, tilt_x, tilt_y, _, spin_rate, *_ = wire.MEASUREMENT.unpack(raw)
            return self._look(stamp, tilt_x, tilt_y, spin_rate)
        return False

    def joints(self, raw: bytes) -> bool:
        """Check a message of joint states; return whether the wheel has just been lost."""
        try:
            stamp = wire.stamp(raw)
        except ValueError:
            return False
        if not self.is_due(stamp):
            return False
        try:
            message = deserialize_message(raw, JointState)
        except Exception:  # of damaged bytes; rclpy passes on whatever its type support raises
            return False
        place, speed = (
            dict(zip(message.name, values, strict=False)) for values in (message.position, message.velocity)
        )
        tilt_x, tilt_y, spin = topics.JOINTS
        if tilt_x in place and tilt_y in place and spin in speed:  # else they are of another machine
            return self._look(stamp, place[tilt_x], place[tilt_y], speed[spin])
        return False

    def _look(self, stamp: int, tilt_x: float, tilt_y: float, spin_rate: float) -> bool:
        asked = self._asked(stamp)
        if asked is None:
            self._tracking = self._new()
        self._due = stamp + LOOK_PERIOD_NS
        return (
            asked is not None
            and math.isfinite(tilt_x + tilt_y + spin_rate)
            and self._tracking.observe(stamp, tilt_x, tilt_y, spin_rate, asked)
        )
