"""Listening to a running bench from beside its graph: raw messages come, nothing is sent."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence

import rclpy
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions

from gyrowheel_core.node import prepare_environment
from gyrowheel_core.node.inbox import Inbox
from gyrowheel_core.topics import Topic


@contextlib.contextmanager
def listening(name: str, topics: Sequence[Topic], domain: int | None = None) -> Iterator[list[Inbox]]:
    """Subscribe to topics for the time of the block, in a context of its own.

    Parameters
    ----------
    name : str
        Name of the node that listens.
    topics : sequence of Topic
        What is heard.
    domain : int, optional
        ROS domain; by default that of the environment.

    Yields
    ------
    list of Inbox
        What has arrived, one a topic, to be taken as serialized messages.
    """
    prepare_environment()
    context = Context()
    rclpy.init(context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(name, context=context, enable_rosout=False, start_parameter_services=False)
    try:
        yield [
            Inbox(
                topic,
                node.create_subscription(
                    topic.message_class, topic.name, lambda message: None, topic.qos, raw=True
                ),
            )
            for topic in topics
        ]
    finally:
        node.destroy_node()
        context.try_shutdown()
