"""A node as a process: its environment, signals, exit codes, and the loop that runs it."""

from __future__ import annotations

import contextlib
import ctypes
import enum
import faulthandler
import gc
import inspect
import signal
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from typing import Final

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from gyrowheel_core.errors import InputError, one_line, printable
from gyrowheel_core.node.base import LET_GO, BenchNode, Fault
from gyrowheel_core.node.parameters import AUTOSTART
from gyrowheel_core.node.priority import prioritise
from gyrowheel_core.surroundings import prepare_environment

_ANSWER = 0.3  # how long a node that was shut down stays, so that its answer arrives [s]


#: Exit codes of a node whose work was done, and whose middleware crashed or hung in its shutdown.
TORN: Final = frozenset({int(signal.SIGSEGV), int(signal.SIGABRT), int(signal.SIGALRM)})
#: How long a node whose work is done may take to release what it acquired, less than `up` waits for its end [s].
CLEANED_UP = 15
DESTROYED = 5  # how long the middleware may take after that [s]


class ExitCode(enum.IntEnum):
    """Exit codes of a node's process: those of the command line, in which 1 is a finding."""

    OK = 0
    BAD_INPUT = 2
    FAULT = 3
    CRASH = 70


def make_executor(context: Context | None = None) -> Executor:
    """Return the fastest executor that this rclpy has, in the default context if none is given.

    Call its ``spin_once`` with a time-out in a loop: the waits of the events executor without one cannot be
    interrupted by signals.
    """
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:  # rclpy before 7.1.4
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def spin(node: Node, *, priority: int = 0) -> None:
    """Spin a user-defined node with the fastest executor, until Ctrl-C, SIGTERM or the shutdown of its context.

    Then the node is destroyed: what is left of it in Fast DDS has threads that may crash the exit of the process.
    For a node that does not derive from `BenchNode`; `run_node` is for those that do. ``rclpy.spin`` does not keep up
    with the samples of the bench.

    Parameters
    ----------
    node : Node
        The node, in a context that was initialised with rclpy's own signal handlers.
    priority : int
        Real-time priority of the process (SCHED_FIFO), 1 .. 99, where the system allows it; else a warning is
        logged. 0: no change. The nodes of the bench that keep pace with wall-clock time have 10.
    """
    executor = make_executor(node.context)
    executor.add_node(node)
    prioritise(node, priority)
    _prepare_for_pace()
    try:
        with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
            while node.context.ok():
                executor.spin_once(timeout_sec=0.1)
    finally:
        executor.shutdown()
        time.sleep(LET_GO)
        node.destroy_node()


def _prepare_for_pace() -> None:
    """Do in advance what would cost samples later."""
    # the first line of rclpy's logger takes a tenth of a second: it looks for its caller among all modules
    inspect.getframeinfo(sys._getframe())
    # objects made so far are permanent: collecting among them again and again takes longer than a sample
    gc.collect()
    gc.freeze()


class StopSignals:
    """Notes SIGINT, SIGTERM and SIGHUP; they do not end the process.

    Repeated signals change nothing: a terminal sends Ctrl-C to a starter and to its nodes, so that a node
    may get it twice, the second time in the middle of its cleaning up.
    """

    def __init__(self) -> None:
        self.received = False
        self._node: BenchNode | None = None
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._handle)

    def attach(self, node: BenchNode) -> None:
        """Stop `node` at a signal, even at one that came earlier."""
        self._node = node
        if self.received:
            node.stop()

    def _handle(self, number: int, frame: object) -> None:
        self.received = True
        if self._node is not None:
            self._node.stop()


def parameter_help(node_class: type[BenchNode]) -> str:
    """Return the text that ``--help`` prints: what the node does and its parameters."""
    lines = [
        (node_class.__doc__ or node_class.NODE_NAME).strip().splitlines()[0],
        "",
        f"node {node_class.NODE_NAME}; set parameters by --ros-args -p NAME:=VALUE",
        "",
    ]
    for param in (AUTOSTART, *node_class.PARAMETERS):
        lines.append(f"  {param.name} (default {param.default!r}; {param.allowed})")
        lines.append(f"      {param.description}")
    return "\n".join(lines)


@contextlib.contextmanager
def _ros(arguments: Sequence[str]) -> Iterator[None]:
    prepare_environment()
    try:
        unknown = remove_ros_args(["program", *arguments])[1:]
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy raises a different class for each kind of wrong argument
        # what follows " Error: " are places in the source of rcl
        reason = one_line(error).split(" Error: ")[0]
        raise InputError(f"ROS arguments: {reason}") from None
    try:
        if unknown:
            raise InputError(f"unknown argument {unknown[0]!r}; set parameters by --ros-args -p NAME:=VALUE")
        yield
    finally:
        rclpy.try_shutdown()


def run_node(node_class: type[BenchNode], arguments: Sequence[str] | None = None) -> int:
    """Run a node until it is asked to end: the ``main`` of a node.

    Parameters
    ----------
    node_class : type
        The node's class.
    arguments : sequence of str, optional
        Arguments of the command line after the program's name; those of the process where not given.

    Returns
    -------
    int
        Exit code for the process (`ExitCode`). Whatever is not 0 has been explained on stderr: bad input
        and faults in a last line ``NODE: MESSAGE`` and ``NODE: FAULT_NAME: MESSAGE``, a crash by its
        traceback.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    if "--help" in arguments or "-h" in arguments:
        print(parameter_help(node_class))
        return ExitCode.OK
    signals = StopSignals()
    # where it hangs can be asked for: by Ctrl-\, and by `up` before it kills
    with contextlib.suppress(AttributeError, ValueError, RuntimeError):  # where stderr is no file
        faulthandler.register(signal.SIGQUIT, chain=True)
    try:
        with _ros(arguments):
            failure = _run(node_class, signals)
    except InputError as error:
        failure = error
    finally:
        signal.alarm(0)  # the shutdown is complete
    if failure is None:
        return ExitCode.OK
    if isinstance(failure, InputError | Fault):
        print(f"{node_class.NODE_NAME}: {printable(str(failure))}", file=sys.stderr, flush=True)
        return ExitCode.FAULT if isinstance(failure, Fault) else ExitCode.BAD_INPUT
    traceback.print_exception(failure)
    return ExitCode.CRASH


def _end_quietly_at(*signals: int, seconds: int) -> None:
    """End with the number of a signal as exit code instead of a crash; send SIGALRM after a time."""
    system = ctypes.CDLL(None)
    for number in signals:
        system.signal(number, system._exit)  # which is called with the number
    signal.alarm(seconds)


def _run(node_class: type[BenchNode], signals: StopSignals) -> BaseException | None:
    """Run the node inside an initialised rclpy; return why it failed, or None."""
    node = node_class()
    executor = make_executor()
    executor.add_node(node)
    signals.attach(node)
    try:
        if node.parameter("autostart") and not node.stopping:
            node.start()
        _prepare_for_pace()
        while not node.stopping:
            executor.spin_once(timeout_sec=node.patience())
            node.pace()
        # an answer that has just been sent is lost with its sender
        end = time.monotonic() + max(node.LINGER, _ANSWER if node.shut_down else 0.0)
        while node.failure is None and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.02)
    except Exception as error:
        node.failure = node.failure or error
    if isinstance(node.failure, Fault):
        node.get_logger().fatal(str(node.failure))
    node.finish(executor)
    _end_quietly_at(signal.SIGALRM, seconds=CLEANED_UP)
    node.take_apart(executor)
    faulthandler.disable()  # which rclpy has enabled: at the end of Python it would undo what follows
    _end_quietly_at(*TORN, seconds=DESTROYED)
    node.destroy_node()
    return node.failure
