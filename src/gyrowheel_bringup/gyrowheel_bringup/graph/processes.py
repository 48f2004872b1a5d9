"""The processes of a graph: start, supervision, end, and the reason for each end."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from gyrowheel_bringup.graph.nodes import (
    EXECUTABLES,
    MODULES,
    SHARED_MODULE,
    find_executable,
    write_parameters,
)
from gyrowheel_bringup.graph.results import GraphError
from gyrowheel_bringup.graph.shared_memory import used_by
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PARENT_VARIABLE, TORN, ExitCode
from gyrowheel_core.start_node import NodeRequest, command

_STOP_TIMEOUT = 20.0  # time for a node to end before it is killed [s]
_TRACE_TIMEOUT = 1.0  # time to log where it hangs [s]
_TRACED = 0.2  # longer than a tracer of system calls, such as strace, stops a process for one [s]
_UNLOCKED = 2.0  # by then Fast DDS has replaced shared memory that a killed process had locked [s]
#: Nodes that wait for each other's messages: only one of them runs at a time.
_LOOP = ("plant", "controller")


@dataclass
class Child:
    """A node's process."""

    name: str
    pid: int
    log: Path
    returncode: int | None = None  # as that of `subprocess.Popen`
    expected: bool = False  # whether it was asked to end
    stopped: bool = False  # whether it was stopped by a signal when it was asked to end
    hung: bool = False  # whether it did not end when it was asked to
    shown: int = 0  # bytes of its log that were shown so far
    memory: set[str] = field(default_factory=set)  # shared memory that it was found to use

    def signal(self, number: int) -> None:
        """Send a signal to the process, unless it has ended."""
        if self.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def note_memory(self) -> None:
        """Note which shared memory of the middleware the process uses, to remove it if it is killed."""
        self.memory |= used_by(self.pid)

    def show_log(self) -> None:
        """Copy to stderr what the process has written since the last call."""
        with contextlib.suppress(OSError), self.log.open("rb") as log:
            log.seek(self.shown)
            new = log.read()
            self.shown += len(new)
            sys.stderr.write(new.decode("utf-8", errors="replace"))

    @property
    def last_words(self) -> str:
        """The last lines that the process wrote to stderr."""
        with contextlib.suppress(OSError):
            return self.log.read_text(encoding="utf-8", errors="replace")[-4000:].strip()
        return ""

    @property
    def ended_well(self) -> bool:
        """Whether the process ended well; SIGINT ends it until the node handles signals."""
        code = self.returncode
        if self.stopped:
            return False
        return code == 0 or (self.expected and (code == -signal.SIGINT or code in TORN))

    @property
    def ending(self) -> str:
        """End of the process in words."""
        code = self.returncode
        if self.stopped:
            return "stopped by a signal, such as SIGSTOP, and not continued"
        if self.hung:
            return f"did not end within {_STOP_TIMEOUT:g} s, and was killed"
        if code is not None and code < 0:
            return f"killed by {signal.Signals(-code).name}"
        if code == 0:
            return "was shut down while the bench ran"
        return f"exit code {code}"


def is_stopped(pid: int) -> bool:
    """Return whether a process is stopped by a signal or a debugger; a tracer of system calls stops it for a moment."""
    end = time.monotonic() + _TRACED
    while (state := _state(pid)) == b"t" and time.monotonic() < end:
        time.sleep(0.001)
    return state in (b"T", b"t")


def _state(pid: int) -> bytes:
    """Return the letter of a process's state, as `ps` shows it; empty where it is not known."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[0]
    return b""


class Processes:
    """The processes of the nodes of a graph, forks of one launcher (`gyrowheel_core.start_node`).

    `work`: folder for their parameters and logs; `domain_id`: ROS domain; None: that of the environment.
    `namespace`: namespace of the nodes: empty for the root, else such as ``/bench2``; `show_logs`: whether
    `show` copies their logs to stderr.
    """

    def __init__(self, work: Path, *, domain_id: int | None, namespace: str, show_logs: bool) -> None:
        self._work = work
        self._namespace = namespace
        self._show_logs = show_logs
        self._environment = os.environ | {
            "ROS_LOG_DIR": str(work / "log"),
            # as the executables of the nodes have it
            "PATH": os.pathsep.join((f"{sys.prefix}/bin", os.environ.get("PATH", os.defpath))),
        }
        if domain_id is not None:
            self._environment["ROS_DOMAIN_ID"] = str(domain_id)
        self.children: dict[str, Child] = {}  # the processes, by the names of their nodes
        self._launcher: subprocess.Popen[bytes] | None = None
        self._reported = b""  # by the launcher, up to the end of the last line

    def start(
        self, parameters: Mapping[str, Mapping[str, object]], renamed: Mapping[str, Mapping[str, str]]
    ) -> dict[str, int]:
        """Start nodes and return their process ids.

        `parameters`: their parameters: {node: {parameter: value}}; `renamed`: other names of topics and
        services: {node: {name: other name}}. Raises InputError if an executable is not installed. Raises
        GraphError if the launcher fails.
        """
        requests = [self._request(name, parameters[name], renamed.get(name, {})) for name in parameters]
        log = self._work / "launcher.log"
        with log.open("wb") as output:
            self._launcher = subprocess.Popen(
                command(SHARED_MODULE, requests),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=output,
                env=self._environment,
                start_new_session=True,  # a Ctrl-C of the terminal is for this process alone
            )
        assert self._launcher.stdout is not None
        for name, request in zip(parameters, requests, strict=True):
            line = self._launcher.stdout.readline()
            if not line:
                report = log.read_text(encoding="utf-8", errors="replace").strip()
                raise GraphError("node_died", "the launcher of the nodes has ended", report=report)
            self.children[name] = Child(name, int(line), Path(request["log"]))
        return {name: child.pid for name, child in self.children.items()}

    def _request(
        self, name: str, parameters: Mapping[str, object], renamed: Mapping[str, str]
    ) -> NodeRequest:
        find_executable(*EXECUTABLES[name])
        file = self._work / f"{name}.yaml"
        write_parameters(file, parameters, f"{self._namespace}/{name}")
        rules = [f"__ns:={self._namespace}"] if self._namespace else []
        rules += [f"{old}:={new}" for old, new in renamed.items()]
        arguments = ["--ros-args", "--params-file", str(file)]
        arguments += [argument for rule in rules for argument in ("-r", rule)]
        return {"module": MODULES[name], "arguments": arguments, "log": str(self._work / f"{name}.log")}

    def _look(self, timeout: float = 0.0) -> None:
        """Note which processes have ended; wait up to a time [s] for the next one to end."""
        if self._launcher is None or self._launcher.stdout is None:
            return
        output = self._launcher.stdout.fileno()
        while select.select([output], [], [], timeout)[0]:
            timeout = 0.0
            data = os.read(output, 4096)
            *lines, self._reported = (self._reported + data).split(b"\n")
            codes = {int(pid): int(code) for pid, code in (line.split() for line in lines)}
            for child in self.children.values():
                child.returncode = codes.get(child.pid, child.returncode)
            if not data:  # without its launcher a node ends itself
                for child in self.children.values():
                    if child.returncode is None:
                        child.returncode = -signal.SIGKILL
                return

    def runs(self, name: str) -> bool:
        """Return whether the process of a node was started and has not ended."""
        self._look()
        return name in self.children and self.children[name].returncode is None

    def ended(self) -> list[Child]:
        """Return the processes that have ended."""
        self._look()
        return [child for child in self.children.values() if child.returncode is not None]

    def show(self) -> None:
        """Copy to stderr what the nodes have logged since the last call, if `show_logs` is set."""
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
        self._look()
        for child in self.children.values():
            if child.returncode is None:
                child.expected, child.stopped = True, is_stopped(child.pid)
                child.signal(signal.SIGINT)
                child.signal(signal.SIGCONT)  # one that was stopped ends, too, and completes its files
        self._wait(_STOP_TIMEOUT)
        for child in self.children.values():
            child.hung = child.returncode is None
            child.signal(signal.SIGQUIT)  # a node that hangs logs where it does
        self._wait(_TRACE_TIMEOUT)
        self._kill()

    def _kill(self) -> None:
        for child in self.children.values():
            child.signal(signal.SIGKILL)
        self._wait(_STOP_TIMEOUT)

    def _wait(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while len(self.ended()) < len(self.children) and (rest := end - time.monotonic()) > 0.0:
            self._look(rest)

    def clear(self) -> set[str]:
        """Kill what still runs, and clear the list; return the shared memory that killed processes may have left.

        A process may have been killed while it held a lock on shared memory. After a second Fast DDS replaces that
        memory, which would crash a process that closes its node at this moment: so wait for it.
        """
        self._kill()
        self.show()
        crashed = [child for child in self.children.values() if child.returncode in TORN]
        killed = [child for child in self.children.values() if (child.returncode or 0) < 0]
        self.children.clear()
        if self._launcher is not None:
            with self._launcher:  # closes its input, at which it ends, and waits for it
                self._launcher = None
        if killed:
            time.sleep(_UNLOCKED)
        return {name for child in (*killed, *crashed) for name in child.memory}


def _failure(children: Collection[Child]) -> Exception:
    """Return the error why nodes ended; a fault that a node names takes precedence."""
    ranks = (ExitCode.BAD_INPUT, ExitCode.FAULT)
    first = min(children, key=lambda c: (*ranks, c.returncode or 0).index(c.returncode))
    # the message already contains the end of a single node
    heads = [f"{c.name}: {c.ending}\n" if len(children) > 1 else "" for c in children]
    report = "\n".join(head + c.last_words for head, c in zip(heads, children, strict=True))
    line = first.last_words.rpartition("\n")[2].removeprefix(f"{first.name}: ")
    if first.returncode == ExitCode.BAD_INPUT:
        return InputError(line or f"{first.name}: {first.ending}")
    if first.returncode == ExitCode.FAULT:
        return GraphError(line.partition(":")[0], f"{first.name}: {line}", node=first.name, report=report)
    return GraphError("node_died", f"{first.name}: {first.ending}", node=first.name, report=report)


def share_core(pids: Mapping[str, int], number: int) -> None:
    """Place the nodes of the loop on one core, and all others on the rest.

    To wake a process on another core takes longer than on the same core, on virtual machines much longer, and two cores
    of which one waits for the other gain nothing. With a single core, or without such control, nothing changes.

    `pids`: process id of each node; `number`: number of the graph, which chooses the core, counted cyclically
    from the first allowed one: other graphs should have other numbers.
    """
    if not hasattr(os, "sched_setaffinity"):
        return
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) < 2 or not all(name in pids for name in _LOOP):
        return
    shared = cores[number % len(cores)]
    for name, pid in pids.items():
        own = {shared} if name in _LOOP else set(cores) - {shared}
        for thread in _threads(pid):
            with contextlib.suppress(OSError):  # the process has just ended, or the system does not allow it
                os.sched_setaffinity(thread, own)


def _threads(pid: int) -> list[int]:
    try:
        return [int(name) for name in os.listdir(f"/proc/{pid}/task")]
    except OSError:  # the node has just ended
        return []


@contextlib.contextmanager
def node_process(
    executable: tuple[str, str],
    arguments: Sequence[str],
    *,
    stdout: IO[bytes] | int | None = None,
    stderr: IO[bytes] | int | None = None,
) -> Iterator[subprocess.Popen[str]]:
    """Run a single node for the time of the block.

    `executable`: its package and executable; `arguments`: its arguments of ROS; `stdout`, `stderr`: as
    `subprocess.Popen` takes them. Raises InputError if the executable is not installed.
    """
    process = subprocess.Popen(
        [str(find_executable(*executable)), "--ros-args", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=stderr,
        text=True,
        errors="replace",
        env=os.environ | {PARENT_VARIABLE: str(os.getpid())},
        start_new_session=True,  # a Ctrl-C of the terminal is for this process alone
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        # keeps reading, so that the process does not block on its output
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.communicate(timeout=_STOP_TIMEOUT)
        if process.poll() is None:
            process.kill()
            process.communicate()
