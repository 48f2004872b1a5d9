"""Nodes of this process that talk to benches or listen to them, next to whatever else the process does with ROS."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Collection, Iterator, Sequence

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from gyrowheel_core import topics
from gyrowheel_core.node import Inbox, make_executor, prepare_environment
from gyrowheel_core.topics import Topic

_MOST = 32  # namespaces that are listened to


def local_node(name: str, namespace: str, domain: int | None, closing: contextlib.ExitStack) -> Node:
    """Return a node in its own context.

    Parameters
    ----------
    name : str
        What the node does; the number of the process follows it.
    namespace : str
        Namespace of the node.
    domain : int or None
        ROS domain; None: that of the environment.
    closing : ExitStack
        Destroys node and context.
    """
    context = Context()
    rclpy.init(
        args=["--ros-args", "--disable-external-lib-logs"],
        context=context,
        domain_id=domain,
        signal_handler_options=SignalHandlerOptions.NO,
    )
    closing.callback(context.try_shutdown)
    node = Node(
        f"{name}_{os.getpid()}",
        context=context,
        namespace=namespace,
        use_global_arguments=False,
        enable_rosout=False,
    )
    closing.callback(node.destroy_node)
    return node


def executor_of(node: Node, closing: contextlib.ExitStack) -> Executor:
    """Return an executor that serves a node until `closing` ends it."""
    executor = make_executor(node.context)
    closing.callback(executor.shutdown)
    executor.add_node(node)
    return executor


class Listener:
    """Receives some topics in all namespaces in which they are published.

    Parameters
    ----------
    node : Node
        The node that listens; no executor serves it.
    wanted : sequence of Topic
        The topics.
    """

    def __init__(self, node: Node, wanted: Sequence[Topic]) -> None:
        self._node, self._topics = node, wanted
        self._inboxes: dict[str, list[Inbox]] = {}
        self._followed: dict[str, Inbox] = {}

    def look(self) -> set[str]:
        """Subscribe to benches that have come since the last call; return the namespaces that have one now."""
        there = dict(self._node.get_topic_names_and_types())
        found = {
            name.removesuffix(topic.name)
            for topic in (*self._topics, topics.MEASUREMENT)
            for name, types in there.items()
            if name.endswith(topic.name) and topic.type_name in types and self._node.count_publishers(name)
        }
        for namespace in sorted(found - self._inboxes.keys())[: _MOST - len(self._inboxes)]:
            self._inboxes[namespace] = [self._inbox(topic, namespace) for topic in self._topics]
        return found & self._inboxes.keys()

    def follow(self, topic: Topic, namespaces: Collection[str]) -> None:
        """Receive one more topic of some benches, and of no others any more."""
        for namespace in self._followed.keys() - set(namespaces):
            self._node.destroy_subscription(self._followed.pop(namespace).subscription)
        for namespace in set(namespaces) - self._followed.keys():
            self._followed[namespace] = self._inbox(topic, namespace)

    def _inbox(self, topic: Topic, namespace: str) -> Inbox:
        """Return a new subscription."""
        name = topic.within(namespace)
        return Inbox(
            topic,
            self._node.create_subscription(
                topic.message_class, name, lambda message: None, topic.qos, raw=True
            ),
        )

    def messages(self) -> Iterator[tuple[str, Topic, bytes]]:
        """Take the messages that have arrived: namespace of the bench, topic, and serialized message."""
        for namespace, inboxes in self._inboxes.items():
            more = self._followed.get(namespace)
            for inbox in inboxes if more is None else (*inboxes, more):
                for data in inbox.take():
                    yield namespace, inbox.topic, data


@contextlib.contextmanager
def listening(name: str, wanted: Sequence[Topic], domain: int | None = None) -> Iterator[Listener]:
    """Listen to topics in all namespaces for the time of the block.

    Parameters
    ----------
    name : str
        Name of the node that listens.
    wanted : sequence of Topic
        The topics.
    domain : int, optional
        ROS domain; by default that of the environment.

    Yields
    ------
    Listener
        Subscriptions, benches and messages.
    """
    prepare_environment()
    with contextlib.ExitStack() as closing:
        node = local_node(name, "", domain, closing)
        yield Listener(node, wanted)
