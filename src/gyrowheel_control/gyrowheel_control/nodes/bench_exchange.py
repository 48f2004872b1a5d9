"""What the conductor exchanges with the bench: its time, whether the wheel follows, tilt limit and setpoints."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from gyrowheel_control.loops.supervision import Tracking
from gyrowheel_control.plans.plan import HOLD, SETPOINT_PERIOD, Plan
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import BenchNode, RepeatedRequest

#: Time for which the publishers of the clock are remembered [s].
_WHOSE_TIME = 1.0
#: In the name of a node, until it has arrived.
_UNKNOWN = "UNKNOWN"


class TimeSources:
    """The nodes that publish the clock, the samples and the joint states.

    `node`: the node that needs the time.
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

    `tracking`: returns what tells whether the wheel follows, as the node's parameters say now; `asked`:
    returns the setpoint that a reading of a time [ns] is to follow (`Tracking.observe`); None where there is
    none.
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


#: Time for which the controller that takes the limit may be missing [s].
LIMIT_TIMEOUT = 10.0


class ControllerLimit:
    """Sets the tilt limit of each plan in the controller.

    `node`: the node that asks; `controller`: name of the node with the parameter ``tilt_limit``; `answered`:
    called when the controller has answered.
    """

    def __init__(self, node: BenchNode, controller: str, answered: Callable[[], None]) -> None:
        self._node = node
        self._controller = controller
        self._answered = answered
        self._client = node.create_client(SetParameters, f"{controller.rstrip('/')}/set_parameters")
        self._plan, self._limit = "", 0.0
        self._since = 0.0  # by the clock of `time.monotonic`
        self._asked: RepeatedRequest | None = None

    def begin(self, plan: str, limit: float) -> None:
        """Set the limit [rad] of a plan, which is named in errors, from now on."""
        self._plan, self._limit = plan, limit
        self._since, self._asked = time.monotonic(), None

    def is_set(self, usual: float) -> bool:
        """Return whether the plan may start.

        `usual`: limit up to which a controller need not be there [rad]: there may be another one, with its
        own limits. Raises InputError if the controller does not come, or refuses the limit.
        """
        if self._asked is None:
            if not self._client.service_is_ready():
                if self._limit <= usual:
                    return True
                if time.monotonic() > self._since + LIMIT_TIMEOUT:
                    raise InputError(
                        f"plan {self._plan} needs a tilt limit of {math.degrees(self._limit):.2f} deg, "
                        f"and there is no node '{self._controller}' to set it in"
                    )
                return False
            self._asked = RepeatedRequest(self._ask)
        answer = self._asked.answer()
        if answer is None:
            return False
        (result,) = answer.results
        if not result.successful:
            raise InputError(f"plan {self._plan}: the controller refuses its tilt limit: {result.reason}")
        return True

    def destroy(self) -> None:
        """Destroy the client."""
        self._node.destroy_client(self._client)

    def _ask(self) -> Any:
        wanted = Parameter("tilt_limit", value=self._limit).to_parameter_msg()
        future = self._client.call_async(SetParameters.Request(parameters=[wanted]))
        future.add_done_callback(lambda _: self._answered())
        return future


SETPOINT_PERIOD_NS = round(SETPOINT_PERIOD * 1e9)
_MOTION = ("tilt_rate_x", "tilt_rate_y", "spin_acceleration")


def at_rest(setpoint: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of one setpoint, shape (1,), as a hold with zero rates."""
    held = setpoint.copy()
    held["phase"] = HOLD
    for name in _MOTION:
        held[name] = 0.0
    return held


def final_hold(setpoints: NDArray[Any], plan: Plan) -> NDArray[Any]:
    """Return the setpoint, shape (1,), that holds the final state of a plan."""
    held = at_rest(setpoints[-1:])
    held["spin_rate"] = plan.segments[-1].spin_end
    return held


class SetpointStream:
    """Publishes setpoints, one each `SETPOINT_PERIOD`.

    `publish`: publishes one message, as bytes.
    """

    def __init__(self, publish: Callable[[bytes], None]) -> None:
        self._publish = publish
        self.next = 0  # stamp of the next setpoint [ns]

    def send(self, rows: NDArray[Any]) -> None:
        """Publish setpoints, the first of them at the next stamp."""
        messages = wire.SETPOINT.array(len(rows))
        wire.SETPOINT.set_stamps(messages, self.next + np.arange(len(rows)) * SETPOINT_PERIOD_NS)
        for name in (*wire.SETPOINT.integers, *wire.SETPOINT.fields):
            messages[name] = rows[name]
        data, size = messages.tobytes(), wire.SETPOINT.size
        for place in range(0, len(data), size):
            self._publish(data[place : place + size])
        self.next += len(rows) * SETPOINT_PERIOD_NS

    def hold(self, setpoint: NDArray[Any], until: int) -> None:
        """Publish one setpoint, shape (1,), again and again up to, not including, a stamp [ns]."""
        count = (until - self.next) // SETPOINT_PERIOD_NS
        if count > 0:
            self.send(np.repeat(setpoint, count))

    def resend(self, rows: NDArray[Any], since: int) -> None:
        """Publish setpoints that were published before, the first of them at the stamp `since` [ns]."""
        if len(rows):
            self.next = since
            self.send(rows)
