"""Messages that wait in the middleware until a node asks for them."""

from __future__ import annotations

from collections.abc import Iterator

from rclpy.subscription import Subscription

from gyrowheel_core.topics import Topic


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
