"""The processes of a graph: started together, watched, ended together, each end explained."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Collection, Mapping
from pathlib import Path

from gyrowheel_bringup.graph.children import Child
from gyrowheel_bringup.graph.nodes import EXECUTABLES, find_executable
from gyrowheel_bringup.graph.parameter_file import write_parameters
from gyrowheel_bringup.graph.results import GraphError
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PARENT_VARIABLE, TORN, ExitCode

_STOP_TIMEOUT = 20.0  # time for a node to end by itself [s]
_UNLOCKED = 2.0  # by then Fast DDS has replaced shared memory that a killed process had locked [s]


class Processes:
    """The processes of the nodes of a graph.

    Parameters
    ----------
    work : Path
        Folder for their parameters and logs.
    domain_id : int or None
        ROS domain; None: that of the environment.
    namespace : str
        Namespace of the nodes: empty for the root, else such as ``/bench2``.
    show_logs : bool
        Whether `show` copies their logs to stderr.

    Attributes
    ----------
    children : dict of str to Child
        The processes, by the names of their nodes.
    """

    def __init__(self, work: Path, *, domain_id: int | None, namespace: str, show_logs: bool) -> None:
        self._work = work
        self._namespace = namespace
        self._show_logs = show_logs
        self._environment = os.environ | {
            PARENT_VARIABLE: str(os.getpid()),
            "ROS_LOG_DIR": str(work / "log"),
        }
        if domain_id is not None:
            self._environment["ROS_DOMAIN_ID"] = str(domain_id)
        self.children: dict[str, Child] = {}

    def start(self, name: str, parameters: Mapping[str, object], renamed: Mapping[str, str]) -> int:
        """Start a node and return its process id.

        Parameters
        ----------
        name : str
            Name of the node.
        parameters : mapping
            Its parameters.
        renamed : mapping
            Other names of topics and services: {name: other name}.

        Raises
        ------
        InputError
            If its executable is not installed.
        """
        file, log = self._work / f"{name}.yaml", self._work / f"{name}.log"
        write_parameters(file, parameters, f"{self._namespace}/{name}")
        rules = [f"__ns:={self._namespace}"] if self._namespace else []
        rules += [f"{old}:={new}" for old, new in renamed.items()]
        with log.open("wb") as output:
            process = subprocess.Popen(
                [
                    str(find_executable(*EXECUTABLES[name])),
                    "--ros-args",
                    "--params-file",
                    str(file),
                    *(argument for rule in rules for argument in ("-r", rule)),
                ],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                env=self._environment,
                start_new_session=True,  # a Ctrl-C of the terminal is for this process alone
            )
        self.children[name] = Child(name, process, log)
        return process.pid

    def runs(self, name: str) -> bool:
        """Return whether the process of a node was started and has not ended."""
        return name in self.children and self.children[name].process.poll() is None

    def ended(self) -> list[Child]:
        """Return the processes that have ended."""
        return [child for child in self.children.values() if child.process.poll() is not None]

    def show(self) -> None:
        """Copy to stderr what the nodes have logged since the last call, if that is wanted."""
        if self._show_logs:
            for child in self.children.values():
                child.show_log()

    def require_running(self) -> None:
        """Raise the error of a node that has ended without being asked to."""
        if ended := [child for child in self.ended() if not child.expected]:
            raise _failure(ended)

    def failure(self) -> Exception | None:
        """Return the error of the nodes that did not end well; None if all did."""
        failed = [child for child in self.children.values() if not child.ended_well]
        return _failure(failed) if failed else None

    def stop(self) -> None:
        """Ask the nodes to end, wait for them, and kill those that do not."""
        for child in self.children.values():
            if child.process.poll() is None:
                child.expected = True
                child.process.send_signal(signal.SIGINT)
        end = time.monotonic() + _STOP_TIMEOUT
        for child in self.children.values():
            try:
                child.process.wait(max(end - time.monotonic(), 0.1))
            except subprocess.TimeoutExpired:
                child.process.kill()
                child.process.wait()

    def clear(self) -> set[str]:
        """Kill what still runs, and forget all; return the shared memory that killed ones may have left.

        A process may have been killed while it held a lock on shared memory. After a second Fast DDS replaces that
        memory, under the feet of whoever is closing its node at this moment: that is waited for.
        """
        for child in self.children.values():
            if child.process.poll() is None:
                child.process.kill()
                child.process.wait()
        self.show()
        crashed = [child for child in self.children.values() if child.process.returncode in TORN]
        killed = [child for child in self.children.values() if (child.process.returncode or 0) < 0]
        self.children.clear()
        if killed:
            time.sleep(_UNLOCKED)
        return {name for child in (*killed, *crashed) for name in child.memory}


def _failure(children: Collection[Child]) -> Exception:
    """Return the error why nodes ended; a fault that a node names takes precedence."""
    ranks = (ExitCode.BAD_INPUT, ExitCode.FAULT)
    first = min(children, key=lambda c: (*ranks, c.process.returncode).index(c.process.returncode))
    # how a single node ended is told by the message
    heads = [f"{c.name}: {c.ending}\n" if len(children) > 1 else "" for c in children]
    report = "\n".join(head + c.last_words for head, c in zip(heads, children, strict=True))
    line = first.last_words.rpartition("\n")[2].removeprefix(f"{first.name}: ")
    if first.process.returncode == ExitCode.BAD_INPUT:
        return InputError(line or f"{first.name}: {first.ending}")
    if first.process.returncode == ExitCode.FAULT:
        return GraphError(line.partition(":")[0], f"{first.name}: {line}", node=first.name, report=report)
    return GraphError("node_died", f"{first.name}: {first.ending}", node=first.name, report=report)
