"""Helpers of launch files: checked arguments, and nodes that end with the launch."""

from __future__ import annotations

import difflib
import os
import shutil
from collections.abc import Collection, Mapping
from typing import Any

from gyrowheel_bringup.graph.nodes import text_rule
from gyrowheel_core import namespaces
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PARENT_VARIABLE

_NEAR = 0.85  # likeness of a misspelt argument
_YES, _NO = ("true", "1", "yes", "on"), ("false", "0", "no", "off")


def typed(context: Any) -> list[str]:
    """Return the names of the arguments that were typed; a launch file that includes this one sets further ones."""
    return [word.partition(":=")[0] for word in getattr(context, "argv", ()) if ":=" in word]


def require_known(given: Collection[str], known: Collection[str]) -> None:
    """Refuse an argument of a launch file that resembles a known one: launch takes any name and ignores it.

    Others may belong to a launch file that includes this one.

    Raises
    ------
    InputError
        If a name is misspelt: without its plan a bench would run for ever.
    """
    for name in given:
        if name not in known and (
            near := difflib.get_close_matches(name[:60], list(known), n=1, cutoff=_NEAR)
        ):
            raise InputError(f"{name}: no such argument; did you mean {near[0]}?")


def flag(name: str, text: str) -> bool:
    """Return an argument of a launch file as a flag.

    Raises
    ------
    InputError
        If it is neither yes nor no: a misspelt word must not start another bench than the intended one.
    """
    word = text.strip().lower()
    if word not in (*_YES, *_NO):
        raise InputError(f"{name}: {text!r} is not allowed; allowed: true, false")
    return word in _YES


def number(name: str, text: str) -> float:
    """Return an argument of a launch file as a number.

    Raises
    ------
    InputError
        If it is not a number.
    """
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{name}: {text!r} is not allowed; allowed: a number") from None


def without(name: str, text: str, nodes: Collection[str]) -> list[str]:
    """Return the nodes to start, without those that an argument of a launch file excludes.

    Raises
    ------
    InputError
        If it names an unknown node.
    """
    left_out = text.replace(",", " ").split()
    for node in left_out:
        if node not in nodes:
            raise InputError(f"{name}: {node!r}: no such node; allowed: {', '.join(nodes)}")
    return [node for node in nodes if node not in left_out]


def namespace_of(text: str, pushed: str = "") -> str:
    """Return the namespace of a launch file's nodes: empty for the root, else such as ``/lab/bench2``.

    `text`: the argument; `pushed`: the namespace into which the file is included (``PushRosNamespace``); a
    relative one is within it. Raises InputError if it is no namespace of ROS.
    """
    own = namespaces.checked(text)
    return own if text.startswith("/") else namespaces.of_node(pushed) + own


def parameter_options(parameters: Mapping[str, object]) -> dict[str, Any]:
    """Return the options with which launch passes parameters to a node, each in its type.

    Texts go on the command line, in quotes: launch writes them into a file without quotes, where ROS reads 3e32 as a
    number.
    """
    texts = {name: value for name, value in parameters.items() if isinstance(value, str)}
    others = {name: value for name, value in parameters.items() if name not in texts}
    rules = [rule for name, text in texts.items() for rule in ("-p", text_rule(name, text))]
    return {"parameters": [others] if others else [], "ros_arguments": rules}


def ends_with_launch(namespace: str) -> dict[str, Any]:
    """Return the options for a node of this project, so that it ends however the launch ends."""
    parent = {PARENT_VARIABLE: str(os.getpid())}
    return {"output": "screen", "additional_env": parent, "namespace": namespace}


def ends_too() -> str | None:
    """Return the prefix of the command of a foreign program with which the kernel ends it with the launch.

    None where the system has no `setpriv`.
    """
    return "setpriv --pdeathsig TERM" if shutil.which("setpriv") else None
