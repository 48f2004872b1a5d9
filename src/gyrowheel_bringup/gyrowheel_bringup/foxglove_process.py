"""The node ``foxglove`` as a process that lasts as long as a block."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence

from gyrowheel_bringup.graph import GraphError, find_executable
from gyrowheel_bringup.graph.shared_memory import remove_dead
from gyrowheel_core import namespaces
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PARENT_VARIABLE, ExitCode, prepare_environment
from gyrowheel_core.origin_guard import web_origins

_START = 60.0  # [s]


@contextlib.contextmanager
def foxglove(port: int, origins: Sequence[str] = (), *, namespace: str = "") -> Iterator[str]:
    """Run the node `foxglove` beside the graph; give the address to open in the viewer.

    Parameters
    ----------
    port : int
        Port on this computer.
    origins : sequence of str
        Web pages that may read besides those of this computer, such as ``https://app.foxglove.dev``.
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
    command = [
        str(find_executable("gyrowheel_bringup", "foxglove_node")),
        "--ros-args",
        "-p",
        f"port:={port}",
    ]
    if allowed := web_origins(" ".join(origins)):
        command += ["-p", f"origins:='{' '.join(allowed)}'"]
    if moved := namespaces.checked(namespace):
        command += ["-r", f"__ns:={moved}"]
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        env=os.environ | {PARENT_VARIABLE: str(os.getpid())},
        start_new_session=True,  # a Ctrl-C of the terminal is for this process alone
    )
    try:
        yield _address(process)
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        # keeps reading, so that the process does not block on its output
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.communicate(timeout=20.0)
        if process.poll() is None:
            process.kill()
            process.communicate()


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
