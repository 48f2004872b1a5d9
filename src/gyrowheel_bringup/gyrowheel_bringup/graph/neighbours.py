"""Whether a bench is already there, asked before anything is started."""

from __future__ import annotations

import os
import time
from collections.abc import Collection

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from gyrowheel_bringup.graph.nodes import EXECUTABLES
from gyrowheel_bringup.graph.shared_memory import remove_dead
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import prepare_environment

#: How long nodes are looked for [s]; on one computer they are found within some tenths of a second.
_LOOK = 2.0


def require_free(
    names: Collection[str] = tuple(EXECUTABLES), *, namespace: str = "", seconds: float = _LOOK
) -> None:
    """Refuse to start a bench beside another one in the same namespace of the same ROS domain.

    Parameters
    ----------
    names : collection of str
        The nodes that are to be started.
    namespace : str
        Their namespace: empty for the root, else such as ``/bench2``.
    seconds : float
        How long to look for them [s].

    Raises
    ------
    InputError
        With the names of the nodes that are there.
    """
    prepare_environment()
    remove_dead()
    context = Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = Node(f"look_{os.getpid()}", context=context, use_global_arguments=False, enable_rosout=False)
    try:
        end = time.monotonic() + seconds
        while not (found := _nodes(node, namespace) & set(names)) and time.monotonic() < end:
            time.sleep(0.05)
        domain = context.get_domain_id()
    finally:
        node.destroy_node()
        context.try_shutdown()
    if found:
        where = f" in the namespace {namespace}" if namespace else ""
        raise InputError(
            f"ROS domain {domain} has a bench already{where} (nodes {', '.join(sorted(found))}): end it, or choose "
            "another namespace, or another ROS_DOMAIN_ID"
        )


def _nodes(node: Node, namespace: str) -> set[str]:
    """Return the names of the nodes in a namespace."""
    return {name for name, where in node.get_node_names_and_namespaces() if where == (namespace or "/")}
