"""What launch files need beside the actions of launch: arguments that are checked, nodes that end with the launch."""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection, Mapping
from typing import Any

from gyrowheel_bringup.graph.nodes import text_rule
from gyrowheel_core import namespaces
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PARENT_VARIABLE

_YES, _NO = ("true", "1", "yes", "on"), ("false", "0", "no", "off")


def flag(name: str, text: str) -> bool:
    """Return whether an argument of a launch file says yes.

    Raises
    ------
    InputError
        If it says neither yes nor no: a misspelt word must not start another bench than was asked for.
    """
    word = text.strip().lower()
    if word not in (*_YES, *_NO):
        raise InputError(f"{name}: {text!r} is not allowed; allowed: true, false")
    return word in _YES


def number(name: str, text: str) -> float:
    """Return the number that an argument of a launch file says.

    Raises
    ------
    InputError
        If it says none.
    """
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{name}: {text!r} is not allowed; allowed: a number") from None


def without(name: str, text: str, nodes: Collection[str]) -> list[str]:
    """Return the nodes that are left over where an argument of a launch file says which are not to be started.

    Raises
    ------
    InputError
        If it names a node that there is not.
    """
    left_out = text.replace(",", " ").split()
    for node in left_out:
        if node not in nodes:
            raise InputError(f"{name}: {node!r}: no such node; allowed: {', '.join(nodes)}")
    return [node for node in nodes if node not in left_out]


def namespace_of(text: str, pushed: str = "") -> str:
    """Return the namespace of a launch file's nodes: empty for the root, else such as ``/lab/bench2``.

    Parameters
    ----------
    text : str
        The argument.
    pushed : str
        The namespace into which the file is included (``PushRosNamespace``); a relative one is within it.

    Raises
    ------
    InputError
        If it is no namespace of ROS.
    """
    own = namespaces.checked(text)
    return own if text.startswith("/") else namespaces.of_node(pushed) + own


def parameter_options(parameters: Mapping[str, object]) -> dict[str, Any]:
    """Return the options with which launch gives a node its parameters, each with the type that it has here.

    Texts are given on the command line, in quotes: launch writes them into a file without, where ROS takes 3e32 for a
    number.
    """
    texts = {name: value for name, value in parameters.items() if isinstance(value, str)}
    others = {name: value for name, value in parameters.items() if name not in texts}
    rules = [rule for name, text in texts.items() for rule in ("-p", text_rule(name, text))]
    return {"parameters": [others] if others else [], "ros_arguments": rules}


def ends_with_launch(namespace: str) -> dict[str, Any]:
    """Return the options with which launch starts a node of this project: it ends however the launch ends."""
    parent = {PARENT_VARIABLE: str(os.getpid())}
    return {"output": "screen", "additional_env": parent, "namespace": namespace}


def ends_too() -> str | None:
    """Return what is put before a program that is not of this project, so that the kernel ends it with the launch.

    None where the system has nothing to ask the kernel with.
    """
    return "setpriv --pdeathsig TERM" if shutil.which("setpriv") else None
