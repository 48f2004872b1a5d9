"""Who could tell a node the time of the bench: a clock, or the stamps of samples or joint states."""

from __future__ import annotations

import time

from rclpy.node import Node

from gyrowheel_core import topics

#: How long it stays known whose the clock is [s].
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
        """Return the topic that tells the time of the samples: one of few messages, if the same node publishes it."""
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
