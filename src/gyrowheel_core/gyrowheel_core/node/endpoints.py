"""Topics and requests of a node: publishers of those it reads, new readers, messages that wait, lost answers."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from rclpy.event_handler import QoSSubscriptionEventType, UnsupportedEventTypeError
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription

from gyrowheel_core.topics import Topic

_UNKNOWN: Final = "_NODE_NAME_UNKNOWN_"  # of rclpy, until the name of a node has arrived
_MOMENT: Final = 0.05  # [s]
_PARTICIPANT: Final = 24  # digits of a GID that publishers of one participant share
#: Name of a publisher whose node is not known.
NAMELESS: Final = "an unknown node"
#: Period of repeating the missed message until the time advances [s]: at first the readers may not know the sender.
REPEAT_PERIOD = 1.0


@dataclass
class _Seen:
    """Publishers of one topic as seen so far."""

    topic: Topic
    subscription: Subscription
    name: str  # of the topic, full
    matches: Any  # counts the publishers that this reader was connected to; None if unsupported
    nodes: dict[str, str] = field(default_factory=dict)  # name of the node by the GID of its publisher
    present: set[str] = field(default_factory=set)  # at the last look
    several: float | None = None  # since when there is more than one [s, monotonic]
    crowd: dict[str, None] = field(default_factory=dict)  # those that were there at the same time as another
    matched: int = 0  # publishers that this reader was connected to in all
    arrived: int = 0  # those of them that a look has found

    def count_matches(self) -> bool:
        """Take over how many publishers there were in all; return whether one has come or gone."""
        status = None if self.matches is None else self.matches.take_event()
        if status is None:
            return False
        self.matched = max(self.matched, status.total_count)
        return bool(status.total_count_change or status.current_count_change)

    @property
    def missed(self) -> int:
        """Publishers that were gone before they were seen."""
        return max(self.matched - self.arrived, 0)


class PublisherWatch:
    """Watches the publishers of the topics that a node reads.

    A topic of the bench has one publisher. With a second one the origin of a message is unknown: the middleware does
    not report it. A publisher that is gone before the next look shows in the number of publishers that the reader was
    connected to.

    `node`: the node that reads.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._seen: dict[str, _Seen] = {}

    def add(self, topic: Topic, subscription: Subscription) -> None:
        """Watch the publishers of a topic by a new subscription to it."""
        matches = None
        with contextlib.suppress(UnsupportedEventTypeError):
            # asked now and then, not served by an executor: the events executor crashes over an event of a subscription
            # that was destroyed
            matches = rclpy_implementation.EventHandle(
                subscription.handle, QoSSubscriptionEventType.RCL_SUBSCRIPTION_MATCHED
            )
        self._seen[topic.name] = _Seen(topic, subscription, subscription.topic_name, matches)

    def remove(self, subscription: Subscription) -> None:
        """Stop watching a subscription that is about to be destroyed; its publishers are kept."""
        for seen in self._seen.values():
            if seen.subscription is subscription and seen.matches is not None:
                self._look(seen)
                seen.matches.destroy_when_not_in_use()  # else it would keep the reader alive
                seen.matches = None

    def look(self) -> None:
        """Update topics whose publishers have changed or are not known yet; cheap for the others."""
        for seen in self._seen.values():
            changed = self._node.count_publishers(seen.name) != len(seen.present)
            unsure = seen.missed or seen.several is not None or NAMELESS in seen.nodes.values()
            if seen.count_matches() or changed or unsure:
                self._look(seen)

    def publishers(self, topic: Topic) -> list[tuple[str, str]]:
        """Return the publishers that a topic has had, in order: GID in hexadecimal digits, and name of the node."""
        seen = self._seen.get(topic.name)
        if seen is None:
            return []
        self._look(seen)
        return list(seen.nodes.items())

    def surplus(self) -> dict[str, str]:
        """Return the publishers of each topic that had more than one at the same time."""
        found = {}
        for seen in self._seen.values():
            if seen.topic.shared or not (seen.crowd or (seen.missed and seen.nodes)):
                continue
            who = [seen.nodes[gid] for gid in seen.crowd or seen.nodes]
            who += [f"{seen.missed} more that came and went"] if seen.missed else []
            found[seen.name] = ", ".join(who)
        return found

    def _look(self, seen: _Seen) -> None:
        present = set()
        for info in self._node.get_publishers_info_by_topic(seen.name):
            gid = bytes(info.endpoint_gid).hex()
            present.add(gid)
            if seen.nodes.get(gid, NAMELESS) == NAMELESS:
                seen.nodes[gid] = _full_name(info.node_namespace, info.node_name)
        seen.arrived += len(present - seen.present)
        seen.present = present
        if _nodes(present, seen.nodes) < 2:
            seen.several = None
            return
        # one that takes the place of another may be known a moment before the other is known to have left
        now = time.monotonic()
        seen.several = seen.several or now
        if now - seen.several >= _MOMENT:
            seen.crowd |= dict.fromkeys(gid for gid in seen.nodes if gid in present)


def _nodes(present: Collection[str], names: Mapping[str, str]) -> int:
    """Return the number of nodes of some publishers: a node that is configured again has a second publisher."""
    by_participant: dict[str, set[str]] = {}
    for gid in present:
        by_participant.setdefault(gid[:_PARTICIPANT], set()).add(names[gid])
    return sum(max(len(found - {NAMELESS}), 1) for found in by_participant.values())


def _full_name(namespace: str, name: str) -> str:
    return NAMELESS if _UNKNOWN in name else f"{namespace.rstrip('/')}/{name}"


class Newcomers:
    """Detects new readers of a topic since the time of the bench last advanced.

    Parameters
    ----------
    node : Node
        The node that publishes the topic.
    topic : Topic
        The topic.
    """

    def __init__(self, node: Node, topic: Topic) -> None:
        self._node, self._name = node, topic.relative
        self._known: frozenset[bytes] | None = None  # before the first message nobody has missed one
        self._seen: frozenset[bytes] = frozenset()
        self._sent = 0.0

    def begin(self) -> None:
        """Note the readers at the first message; later calls do nothing."""
        if self._known is None:
            self._known = self._seen = self._there()

    def look(self, *, goes_on: bool, now: float) -> bool:
        """Return whether to send the missed message now; to be called a few times a second.

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
            # a reader that has come since the last call may have missed the message before it
            self._known, self._seen = self._seen, there
            return False
        if not there - self._known or now - self._sent < REPEAT_PERIOD:
            return False
        self._sent = now
        return True

    def _there(self) -> frozenset[bytes]:
        readers = self._node.get_subscriptions_info_by_topic(self._name)
        return frozenset(bytes(reader.endpoint_gid) for reader in readers)


class Inbox:
    """The messages of one topic that have arrived, as bytes, until they are taken.

    For a node that need not answer at once: waking it for every message takes several times as long as taking the
    message. The depth of the subscription limits the waiting messages; beyond it the oldest are lost.

    Parameters
    ----------
    topic : Topic
        The topic.
    subscription : Subscription
        A subscription to it that no executor serves (see `BenchNode.inbox`).

    Attributes
    ----------
    topic : Topic
        As given.
    subscription : Subscription
        As given.
    number : int or None
        Sequence number that the publisher gave the last message taken; None where the middleware
        does not report it.
    """

    def __init__(self, topic: Topic, subscription: Subscription) -> None:
        self.topic = topic
        self.subscription = subscription
        self.number: int | None = None

    def take(self, most: int | None = None) -> Iterator[bytes]:
        """Take the messages in the order of arrival.

        Parameters
        ----------
        most : int, optional
            How many at most; all there are where it is not given.

        Yields
        ------
        bytes
            One message.
        """
        handle, kind = self.subscription.handle, self.subscription.msg_type
        count = 0
        while most is None or count < most:
            taken = handle.take_message(kind, True)
            if taken is None:
                return
            count += 1
            self.number = taken[1].get("publication_sequence_number")
            yield taken[0]


#: Time of silence after which a request is made again [s].
ASK_AGAIN = 2.0


class RepeatedRequest:
    """A request that is repeated if no answer comes.

    The answer of a node that does not know its client yet is lost, and so may be one whose sender or receiver shares
    memory with a process that was killed.

    Parameters
    ----------
    ask : callable
        Makes the request and returns the future of its answer; called at once, and again after `ASK_AGAIN`.
    """

    def __init__(self, ask: Callable[[], Any]) -> None:
        self._ask = ask
        self._futures = [ask()]
        self._asked = time.monotonic()

    @property
    def times(self) -> int:
        """Number of requests."""
        return len(self._futures)

    def answer(self, heard: float = 0.0) -> Any:
        """Return the answer, None until it comes; to be called repeatedly.

        Parameters
        ----------
        heard : float
            Time of the last sign that the answer is still to come [s, by `time.monotonic`].
        """
        found = self._chosen([future.result() for future in self._futures if future.done()])
        if found is None and time.monotonic() - max(self._asked, heard) > ASK_AGAIN:
            self._futures.append(self._ask())
            self._asked = time.monotonic()
        return found

    def _chosen(self, answers: list[Any]) -> Any:
        """Return the valid one of the answers so far; None to wait for another."""
        return answers[0] if answers else None
