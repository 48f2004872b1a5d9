"""Start of a node's process, alone or as a fork of a launcher that several nodes share.

``python3 -P -m gyrowheel_core.start_node MODULE ARGUMENTS`` runs the ``main`` of a module.

``python3 -P -m gyrowheel_core.start_node --together REQUEST`` starts several nodes. Importing takes most of a node's
start, so a launcher imports once what they share, and each node is a fork of it that imports the rest. The launcher
does not import rclpy, whose library starts threads when it is loaded: a fork has none of the threads of its parent.
(OpenBLAS ends its own threads before a fork, and starts them again after it.)
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import json
import os
import select
import signal
import sys
import threading
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, TypedDict

from gyrowheel_core.errors import InputError
from gyrowheel_core.surroundings import begin, require_ros

#: Environment variable with the process id of the process that a node ends with (see `gyrowheel_core.node.BenchNode`).
PARENT_VARIABLE = "GYROWHEEL_PARENT"
_BAD_INPUT = 2  # as in `gyrowheel_core.node.ExitCode`, which needs rclpy


class NodeRequest(TypedDict):
    """A node to be started: module, arguments, and the file that its output is written to."""

    module: str
    arguments: list[str]
    log: str


def command(shared: str, nodes: Sequence[NodeRequest]) -> list[str]:
    """Return the command of a launcher for several nodes.

    It writes a line ``PID`` for each node, in order, and a line ``PID CODE`` when one ends, with the exit code of
    `subprocess`. It ends with the last node, or when its standard input is closed; the nodes end with it.

    Parameters
    ----------
    shared : str
        Module that it imports before the nodes; it must neither import rclpy nor start threads.
    nodes : sequence of NodeRequest
        The nodes.
    """
    request = json.dumps({"shared": shared, "nodes": [*nodes]})
    return ["python3", "-P", "-m", "gyrowheel_core.start_node", "--together", request]


def main() -> int:
    """Run what the arguments of this process name."""
    if len(sys.argv) < 2:
        sys.stderr.write("usage: python3 -m gyrowheel_core.start_node MODULE ARGUMENTS\n")
        return 2
    first = sys.argv.pop(1)
    return _start_together(json.loads(sys.argv[1])) if first == "--together" else _run(first)


def _run(module: str) -> int:
    """Import a module and run its ``main``.

    What a node imports it uses until it ends: nothing is collected during the import, which takes a tenth of its start,
    and the garbage collector ignores all of that afterwards. SIGINT during the import ends the process at once.
    """
    try:
        begin()
        require_ros()
    except InputError as error:
        sys.stderr.write(f"{module}: {error}\n")
        return _BAD_INPUT
    # not where the parent has it ignored
    interruptible = signal.getsignal(signal.SIGINT) in (signal.default_int_handler, signal.SIG_DFL)
    if interruptible:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    gc.disable()
    run = import_module(module).main
    gc.freeze()
    gc.enable()
    if interruptible and signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    code: int = run()
    return code


def _start_together(request: Mapping[str, Any]) -> int:
    os.environ[PARENT_VARIABLE] = str(os.getpid())
    begin()
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # until the node handles it
    gc.disable()
    import_module(request["shared"])
    if "rclpy" in sys.modules or threading.active_count() > 1:
        raise RuntimeError(
            f"{request['shared']} imports rclpy or starts threads: no node can be forked safely"
        )
    gc.freeze()
    for node in request["nodes"]:
        pid = os.fork()
        if pid == 0:
            return _become(node)
        _report(str(pid))
    threading.Thread(target=_end_with_starter, args=(os.getppid(),), daemon=True).start()
    for _ in request["nodes"]:
        pid, status = os.wait()
        _report(f"{pid} {os.waitstatus_to_exitcode(status)}")
    return 0


def _report(line: str) -> None:
    with contextlib.suppress(BrokenPipeError):
        os.write(1, f"{line}\n".encode())


def _end_with_starter(starter: int) -> None:
    while os.getppid() == starter and not select.select([0], [], [], 1.0)[0]:
        pass
    os._exit(1)


def _become(node: NodeRequest) -> int:
    """Run a node in this process, which has just been forked."""
    os.setsid()  # a Ctrl-C of the terminal is for the starter alone
    for path, flags, descriptors in (
        (os.devnull, os.O_RDONLY, (0,)),
        (node["log"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, (1, 2)),
    ):
        opened = os.open(path, flags, 0o666)
        for descriptor in descriptors:
            os.dup2(opened, descriptor)
        os.close(opened)
    sys.argv = [sys.argv[0], *node["arguments"]]
    _show_as(["python3", "-P", "-m", "gyrowheel_core.start_node", node["module"], *node["arguments"]])
    return _run(node["module"])


def _show_as(words: Sequence[str]) -> None:
    """Have ``ps`` show the command line that the node has when it is started alone, shorter than the launcher's."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        fields = Path("/proc/self/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        begin, end = int(fields[45]), int(fields[46])  # of the memory of the command line
        text = b"\0".join(os.fsencode(word) for word in words)[: max(end - begin - 1, 0)]
        if begin:
            ctypes.memmove(begin, text.ljust(end - begin, b"\0"), end - begin)


if __name__ == "__main__":
    raise SystemExit(main())
