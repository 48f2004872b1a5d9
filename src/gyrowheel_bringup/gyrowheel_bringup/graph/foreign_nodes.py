"""Nodes that are not of the graph: those of a bench that runs already, and publishers of the topics of this one."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Collection, Iterator, Mapping
from typing import Final

from rclpy.node import Node

from gyrowheel_bringup.graph.local_node import local_node
from gyrowheel_bringup.graph.nodes import EXECUTABLES
from gyrowheel_bringup.graph.shared_memory import remove_dead
from gyrowheel_core import topics
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import SURPLUS, prepare_environment
from gyrowheel_core.node.endpoints import NAMELESS
from gyrowheel_core.topics import Topic

#: The node that publishes a topic in the graph.
PUBLISHERS: Final[Mapping[Topic, str]] = {
    topics.MEASUREMENT: "plant",
    topics.JOINT_STATES: "plant",
    topics.CLOCK: "plant",
    topics.BENCH: "plant",
    topics.TRUTH: "plant",
    topics.COMMAND: "controller",
    topics.SETPOINT: "conductor",
    topics.ENVIRONMENT: "conductor",
    topics.DRAG_ESTIMATE: "drag_estimator",
}
_PERIOD: Final = 1.0  # between two looks [s]
#: How long to look for nodes [s]; on one computer they are found within some tenths of a second.
_LOOK = 2.0
#: How long a busy computer may take to find a node of this process [s].
_PATIENCE = 20.0


class Strangers:
    """Publishers of the topics of the graph that are not of the graph.

    Every node of the graph watches the topics that it reads and reports topics with several publishers in its status;
    the reports are collected here. A publisher of a topic that no node of the graph publishes is found by its name.

    `node`: a node of this process; `names`: the nodes of the graph; a topic whose own node is not among them
    may come from any node. `namespace`: namespace of the nodes of the graph.
    """

    def __init__(self, node: Node, names: Collection[str], namespace: str = "") -> None:
        self._node, self._namespace = node, namespace
        self._own = {topic: name for topic, name in PUBLISHERS.items() if name in names}
        self._mine = {topic.within(namespace): f"{namespace}/{name}" for topic, name in self._own.items()}
        self._found: dict[str, list[str]] = {}  # publishers by topic
        self._due = 0.0

    def note(self, values: Mapping[str, str]) -> None:
        """Note the surplus publishers in the status of a node of the graph."""
        for entry in filter(None, values.get(SURPLUS, "").split("; ")):
            topic, _, who = entry.partition(": ")
            others = who.split(", ")
            if (mine := self._mine.get(topic)) in others:
                others.remove(mine)  # once: a second node of that name is another
            before = self._found.get(topic, [])
            # of two nodes that report it, one may know a name that the other does not know yet
            is_less = NAMELESS in others and NAMELESS not in before and len(others) <= len(before)
            if others and not is_less:
                self._found[topic] = others

    def look(self) -> None:
        """Look for publishers by name; once a second, however often it is called."""
        if time.monotonic() < self._due:
            return
        self._due = time.monotonic() + _PERIOD
        for topic, own in self._own.items():
            mine, found = f"{self._namespace}/{own}", set(self._names(topic))
            if topic is topics.CLOCK and mine not in found:
                continue  # a bench in real time has no clock topic, and does not read one
            name = topic.within(self._namespace)
            before = self._found.get(name, [])
            new = sorted(found - {mine, *before})
            if new and (not before or NAMELESS in before):
                nameless = [NAMELESS] * (before.count(NAMELESS) - len(new))
                self._found[name] = [*(who for who in before if who != NAMELESS), *new, *nameless]

    def text(self) -> str:
        """Return topics and their foreign publishers in one line; empty if there are none."""
        return "; ".join(
            f"{topic} was also published by others: {', '.join(who)}" for topic, who in self._found.items()
        )

    @property
    def nameless(self) -> bool:
        """Whether one of them has no name yet, which arrives a moment after its publisher."""
        return any(NAMELESS in who for who in self._found.values())

    def _names(self, topic: Topic) -> Iterator[str]:
        for info in self._node.get_publishers_info_by_topic(topic.within(self._namespace)):
            if "UNKNOWN" not in info.node_name:  # its name is yet to come
                yield f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def require_free(
    names: Collection[str] = tuple(EXECUTABLES), *, namespace: str = "", seconds: float = _LOOK
) -> None:
    """Refuse to start a bench where another one runs in the same namespace of the same ROS domain.

    `names`: the nodes that are to be started; `namespace`: their namespace: empty for the root, else such as
    ``/bench2``; `seconds`: how long to look for them [s], from when a second node of this process was found:
    as long as that is not found, others may not be either. Raises InputError with the names of the nodes that
    are there.
    """
    prepare_environment()
    remove_dead()
    with contextlib.ExitStack() as closing:
        echo = local_node("echo", "", None, closing)
        node = local_node("look", "", None, closing)
        domain = node.context.get_domain_id()
        end = time.monotonic() + max(_PATIENCE, seconds)
        while not (found := _names_in(node, namespace) & set(names)) and time.monotonic() < end:
            if echo.get_name() in _names_in(node, ""):
                end = min(end, time.monotonic() + seconds)
            time.sleep(0.05)
    if found:
        where = f" in the namespace {namespace}" if namespace else ""
        raise InputError(
            f"ROS domain {domain} has a bench already{where} (nodes {', '.join(sorted(found))}): end it, or choose "
            "another namespace, or another ROS_DOMAIN_ID"
        )


def _names_in(node: Node, namespace: str) -> set[str]:
    """Return the names of the nodes in a namespace."""
    return {name for name, where in node.get_node_names_and_namespaces() if where == (namespace or "/")}
