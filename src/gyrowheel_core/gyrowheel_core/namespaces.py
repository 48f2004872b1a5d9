"""Namespaces of benches: with a namespace each, several benches share one ROS domain.

Nodes ask for topics, services and actions by relative names, so that ``-r __ns:=/bench2`` moves them all. Only
``/diagnostics`` has one name in every namespace, because aggregators look for it there; its messages carry the
namespace instead.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

from gyrowheel_core import topics
from gyrowheel_core.errors import InputError

_TOKEN: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_HARDWARE: Final = "gyrowheel"


def checked(text: str, what: str = "namespace") -> str:
    """Return a namespace in the form of this module: empty for the root, else such as ``/bench2``.

    Parameters
    ----------
    text : str
        The namespace, with or without the first slash.
    what : str
        Its name in an error.

    Raises
    ------
    InputError
        If it is not a namespace of ROS.
    """
    tokens = text.strip("/").split("/") if text.strip("/") else []
    if any("__" in token or not _TOKEN.fullmatch(token) for token in tokens) or text.startswith("//"):
        raise InputError(
            f"{what}: {text!r}; allowed: names of letters, digits and single _, separated by /, such as /bench2"
        )
    return "".join(f"/{token}" for token in tokens)


def of_node(namespace: str) -> str:
    """Return the namespace of a node in the form of this module, from that of rclpy: ``/`` for the root."""
    return namespace.rstrip("/")


def status_name(namespace: str, node: str) -> str:
    """Return the name of a node's status on ``/diagnostics``: viewers make a tree of it."""
    return f"{namespace}/{node}".lstrip("/")


def hardware_id(namespace: str) -> str:
    """Return the ``hardware_id`` of the nodes of a bench on ``/diagnostics``."""
    return f"{_HARDWARE}{namespace}"


def is_of_another(hardware: str, namespace: str) -> bool:
    """Return whether a status on ``/diagnostics`` is that of a bench in another namespace, by its ``hardware_id``."""
    return hardware != hardware_id(namespace) and (
        hardware == _HARDWARE or hardware.startswith(f"{_HARDWARE}/")
    )


def local_name(status: str, namespace: str) -> str:
    """Return the name of a status of this bench without the namespace."""
    return status.removeprefix(status_name(namespace, ""))


def found(names: Iterable[str]) -> list[str]:
    """Return the namespaces of the benches whose samples are among topics, in order."""
    end = topics.MEASUREMENT.name
    return sorted(name.removesuffix(end) for name in names if name.endswith(end))
