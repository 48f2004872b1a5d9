"""The node ``foxglove`` as a process that lasts as long as a block."""

from __future__ import annotations

import contextlib
import subprocess
import time
from collections.abc import Iterator, Sequence

from gyrowheel_bringup.graph import GraphError
from gyrowheel_bringup.graph.processes import node_process
from gyrowheel_bringup.graph.shared_memory import remove_dead
from gyrowheel_core import namespaces
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import ExitCode, prepare_environment
from gyrowheel_core.origin_guard import web_origins

_START = 60.0  # [s]


@contextlib.contextmanager
def foxglove(port: int, origins: Sequence[str] = (), *, namespace: str = "") -> Iterator[str]:
    """Run the node `foxglove` next to the graph, and yield the address to open in the viewer.

    Parameters
    ----------
    port : int
        Port on this computer.
    origins : sequence of str
        Web pages that are accepted besides those of this computer, such as ``https://app.foxglove.dev``.
    namespace : str
        Namespace of the bench to show, such as ``/bench2``; empty: the root.

    Raises
    ------
    InputError
        If foxglove-sdk is not installed, the port cannot be opened, or an origin is not one.
    GraphError
        If the node fails otherwise.
    """
    prepare_environment()
    remove_dead()
    arguments = ["-p", f"port:={port}"]
    if allowed := web_origins(" ".join(origins)):
        arguments += ["-p", f"origins:='{' '.join(allowed)}'"]
    if moved := namespaces.checked(namespace):
        arguments += ["-r", f"__ns:={moved}"]
    with node_process(
        ("gyrowheel_bringup", "foxglove_node"), arguments, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as process:
        yield _address(process)


def _address(process: subprocess.Popen[str]) -> str:
    """Return the address that a starting node logs."""
    assert process.stderr is not None
    end = time.monotonic() + _START
    said = ""
    while time.monotonic() < end:
        line = process.stderr.readline()
        if not line:
            last = said.strip().rpartition("\n")[2].removeprefix("foxglove: ")
            if process.wait() == ExitCode.BAD_INPUT:
                raise InputError(last)
            raise GraphError(
                "node_died", f"foxglove: exit code {process.returncode}", node="foxglove", report=said
            )
        said += line
        if "ws://" in line:
            return "ws://" + line.partition("ws://")[2].split()[0]
    raise GraphError("start_timeout", f"foxglove: not ready after {_START:g} s", node="foxglove", report=said)
