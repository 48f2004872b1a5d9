"""A node of this process that talks to a bench, beside whatever else the process does with ROS."""

from __future__ import annotations

import contextlib
import os

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from gyrowheel_core.node import make_executor


def own_node(
    name: str, namespace: str, domain: int | None, closing: contextlib.ExitStack
) -> tuple[Node, Executor]:
    """Return a node in a context of its own, and the executor that serves it.

    Parameters
    ----------
    name : str
        What the node does; the number of the process follows it.
    namespace : str
        Namespace of the node.
    domain : int or None
        ROS domain; None: that of the environment.
    closing : ExitStack
        Takes what gives all of them up.
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
    executor = make_executor(context)
    closing.callback(executor.shutdown)
    executor.add_node(node)
    return node, executor
