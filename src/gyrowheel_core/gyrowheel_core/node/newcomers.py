"""Readers of a topic that came while the time of the bench stood: they have missed what it waits for."""

from __future__ import annotations

from rclpy.node import Node

from gyrowheel_core.topics import Topic

#: How often what they have missed is sent again, until the time goes on [s]: the first time they may not know the
#: sender yet.
REPEAT_PERIOD = 1.0


class Newcomers:
    """Knows whether a topic has got readers since the time of the bench last went on.

    Parameters
    ----------
    node : Node
        The node that publishes the topic.
    topic : Topic
        The topic.
    """

    def __init__(self, node: Node, topic: Topic) -> None:
        self._node, self._name = node, topic.relative
        self._known: frozenset[bytes] | None = None  # before anything was sent nobody has missed it
        self._seen: frozenset[bytes] = frozenset()
        self._sent = 0.0

    def begin(self) -> None:
        """Note who is there as the first message is sent; later calls do nothing."""
        if self._known is None:
            self._known = self._seen = self._there()

    def look(self, *, goes_on: bool, now: float) -> bool:
        """Return whether what they have missed is to be sent now; to be called a few times a second.

        Parameters
        ----------
        goes_on : bool
            Whether the time of the bench has gone on since the last call.
        now : float
            Time of a monotonic clock [s].
        """
        if self._known is None:
            return False
        there = self._there()
        if goes_on:
            # one that has come since the last call may have missed what came before it
            self._known, self._seen = self._seen, there
            return False
        if not there - self._known or now - self._sent < REPEAT_PERIOD:
            return False
        self._sent = now
        return True

    def _there(self) -> frozenset[bytes]:
        readers = self._node.get_subscriptions_info_by_topic(self._name)
        return frozenset(bytes(reader.endpoint_gid) for reader in readers)
