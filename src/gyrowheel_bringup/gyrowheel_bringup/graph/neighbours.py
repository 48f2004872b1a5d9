"""Whether a bench is already there, asked before anything is started."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Collection

from rclpy.node import Node

from gyrowheel_bringup.graph.nodes import EXECUTABLES
from gyrowheel_bringup.graph.own_node import own_node
from gyrowheel_bringup.graph.shared_memory import remove_dead
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import prepare_environment

#: How long nodes are looked for [s]; on one computer they are found within some tenths of a second.
_LOOK = 2.0
#: How long a computer with other work may take to find a node of this process [s].
_PATIENCE = 20.0


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
        How long to look for them [s], from when a second node of this process was found: as long as that is not
        found, others may not be either.

    Raises
    ------
    InputError
        With the names of the nodes that are there.
    """
    prepare_environment()
    remove_dead()
    with contextlib.ExitStack() as closing:
        echo, _ = own_node("echo", "", None, closing)
        node, _ = own_node("look", "", None, closing)
        domain = node.context.get_domain_id()
        end = time.monotonic() + max(_PATIENCE, seconds)
        while not (found := _nodes(node, namespace) & set(names)) and time.monotonic() < end:
            if echo.get_name() in _nodes(node, ""):
                end = min(end, time.monotonic() + seconds)
            time.sleep(0.05)
    if found:
        where = f" in the namespace {namespace}" if namespace else ""
        raise InputError(
            f"ROS domain {domain} has a bench already{where} (nodes {', '.join(sorted(found))}): end it, or choose "
            "another namespace, or another ROS_DOMAIN_ID"
        )


def _nodes(node: Node, namespace: str) -> set[str]:
    """Return the names of the nodes in a namespace."""
    return {name for name, where in node.get_node_names_and_namespaces() if where == (namespace or "/")}
