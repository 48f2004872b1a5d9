"""What the conductor sees of the wheel: whether it follows, whoever controls it."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from gyrowheel_control.loops.reference import Tracking
from gyrowheel_core import topics, wire

#: How often it is looked whether the wheel follows [ns].
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
        """What was asked and what there is, in one line, once the wheel has been off for too long; else empty."""
        return self._tracking.lost

    def begin(self) -> None:
        """Forget what was seen: another plan begins, or what counts as following is another."""
        self._tracking = self._new()
        self._due = 0  # time from which on it is looked again [ns]

    def is_due(self, now: int) -> bool:
        """Return whether it is time to look [ns]; in between a sample needs not be unpacked."""
        return now >= self._due

    def sample(self, raw: bytes) -> bool:
        """Look at a sample; return whether the wheel has just been lost."""
        with contextlib.suppress(ValueError):  # from a node that is not of this bench
            stamp, _, tilt_x, tilt_y, _, spin_rate, *_ = wire.MEASUREMENT.unpack(raw)
            return self._look(stamp, tilt_x, tilt_y, spin_rate)
        return False

    def joints(self, raw: bytes) -> bool:
        """Look at a message of the joint states; return whether the wheel has just been lost."""
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
