"""The shell that every node of the bench shares.

A node derives from `BenchNode`, lists its parameters in one place, fills in the hooks it needs and is started
by `run_node`::

    class TickNode(BenchNode):
        '''Says tick.'''

        NODE_NAME = "tick"
        PARAMETERS = (
            Param("period", 1.0, "Time between two ticks [s, wall clock]", low=0.01, high=60.0),
            Param("word", "tick", "What to say", choices=("tick", "tock")),
        )

        def configure(self) -> None:
            self._word = self.parameter("word")

        def activate(self) -> None:
            self._timer = self.wall_timer(self.parameter("period"), self._tick)

        def deactivate(self) -> None:
            self.destroy_timer(self._timer)

        def diagnose(self) -> Diagnosis:
            return Diagnosis("ticking", values={"ticks": self._ticks})

    def main() -> int:
        return run_node(TickNode)

What this gives each node:

* the lifecycle of a managed node; with the parameter ``autostart`` (true unless set otherwise) it
  configures and activates itself, so that no lifecycle manager is needed. The parameters can be set from
  outside until the node is configured, and are fixed from then on;
* parameters with type, range and description. A bad value, an unreadable file or any other `InputError` of
  a hook ends an automatically started node with one line on stderr and exit code 2; under a lifecycle
  manager the transition fails, with the same line in the log, and can be tried again;
* a clean end on Ctrl-C (however often it arrives), SIGTERM and SIGHUP: the hooks `deactivate` and `cleanup`
  run, the exit code is 0;
* `BenchNode.fault`: ends the process with a named fault, logged, published on ``/diagnostics``, exit code 3;
* ``/diagnostics`` once per second of wall time, from `BenchNode.diagnose`, with the state of the lifecycle and the
  process id;
* ``--help`` with the table of the parameters.
"""

from __future__ import annotations

import contextlib
import enum
import math
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from typing import Any, ClassVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter as RosParameter
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from rclpy.utilities import remove_ros_args

from gyrowheel_sim import topics
from gyrowheel_sim.errors import InputError

#: Environment variable with the process id of the process that a node ends with (see `BenchNode`).
PARENT_VARIABLE = "GYROWHEEL_PARENT"

_LAST_CALLBACKS = 50
_KINDS: dict[type, str] = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


class ExitCode(enum.IntEnum):
    """Exit codes of a node's process."""

    OK = 0
    CRASH = 1
    BAD_INPUT = 2
    FAULT = 3


class Fault(RuntimeError):
    """A condition in which a node cannot go on.

    Parameters
    ----------
    name : str
        Name that scripts can rely on, such as ``controller_silent``.
    message : str
        One line for people.
    """

    def __init__(self, name: str, message: str) -> None:
        super().__init__(f"{name}: {message}")
        self.name = name
        self.message = message


@dataclass(frozen=True)
class Param:
    """The declaration of one node parameter.

    Attributes
    ----------
    name : str
        Name.
    default : bool, int, float or str
        Value where none is given; its type is the type of the parameter. A whole number given for a float is
        taken as one.
    description : str
        One line, with the unit.
    low, high : float, optional
        Smallest and largest value of a number.
    choices : tuple of str
        The allowed values of a text; empty: any text.
    """

    name: str
    default: bool | int | float | str
    description: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()

    @property
    def allowed(self) -> str:
        """What values are allowed, in words."""
        if self.choices:
            return ", ".join(self.choices)
        kind = _KINDS[type(self.default)]
        if self.low is None and self.high is None:
            return kind
        if self.high is None:
            return f"{kind} >= {self.low:g}"
        if self.low is None:
            return f"{kind} <= {self.high:g}"
        return f"{kind} {self.low:g} .. {self.high:g}"

    def check(self, value: Any) -> Any:
        """Return `value` in the type of the parameter.

        Raises
        ------
        InputError
            If it is of another type or out of range.
        """
        kind = type(self.default)
        if kind is float and type(value) is int:
            value = float(value)
        good = type(value) is kind
        if good and kind in (int, float):
            above = self.low is None or value >= self.low
            below = self.high is None or value <= self.high
            good = math.isfinite(value) and above and below
        if good and self.choices:
            good = value in self.choices
        if not good:
            raise InputError(f"parameter {self.name}: {value!r} is not allowed; allowed: {self.allowed}")
        return value

    def descriptor(self) -> ParameterDescriptor:
        """Return the ROS descriptor (description, range)."""
        descriptor = ParameterDescriptor(description=self.description)
        if self.choices:
            descriptor.additional_constraints = f"one of: {self.allowed}"
        if self.low is not None or self.high is not None:
            if isinstance(self.default, float):
                descriptor.floating_point_range = [
                    FloatingPointRange(
                        from_value=-sys.float_info.max if self.low is None else float(self.low),
                        to_value=sys.float_info.max if self.high is None else float(self.high),
                    )
                ]
            else:
                descriptor.integer_range = [
                    IntegerRange(
                        from_value=-(2**63) if self.low is None else int(self.low),
                        to_value=2**63 - 1 if self.high is None else int(self.high),
                    )
                ]
        return descriptor


AUTOSTART = Param("autostart", True, "Configure and activate itself at start, without a lifecycle manager")


@dataclass
class Diagnosis:
    """What a node says of itself on ``/diagnostics``.

    Attributes
    ----------
    message : str
        One line.
    values : mapping of str to object
        Named values, published as text.
    level : bytes
        Level of `diagnostic_msgs.msg.DiagnosticStatus`: ``OK``, ``WARN`` or ``ERROR``.
    """

    message: str = "running"
    values: Mapping[str, object] = field(default_factory=dict)
    level: bytes = DiagnosticStatus.OK


class BenchNode(LifecycleNode):
    """Base class of the nodes: see the module's description for how to derive from it.

    The hooks `configure`, `activate`, `deactivate` and `cleanup` are called on the transitions of the
    lifecycle; at the end of the process an active node is deactivated and cleaned up. A hook that cannot do
    its work raises `InputError` (bad input of the user) or `Fault`. In callbacks use `fault`, which needs
    no exception.

    Where the environment variable of `PARENT_VARIABLE` names a process, the node ends itself within a
    second of the end of that process, provided that it was started by it: no node outlives a starter that
    was killed.
    """

    NODE_NAME: ClassVar[str]
    PARAMETERS: ClassVar[tuple[Param, ...]] = ()
    #: How long the node goes on taking messages after it was told to end [s].
    LINGER: ClassVar[float] = 0.0

    def __init__(self) -> None:
        # Declared from the command line first: this is how a node learns of values whose type or name is
        # wrong.
        super().__init__(self.NODE_NAME, automatically_declare_parameters_from_overrides=True)
        self._service_change_state.callback = self._change_state(self._service_change_state.callback)
        self.stopping = False
        self.failure: BaseException | None = None
        #: In transitions that no lifecycle manager asked for, so that none can act on their failure.
        self._unattended = False
        self._params = {param.name: param for param in (AUTOSTART, *self.PARAMETERS)}
        self._declare()
        self.add_on_set_parameters_callback(self._check_change)
        self._diagnostics = self.publisher(topics.DIAGNOSTICS)
        self._wall_clock = Clock(clock_type=ClockType.SYSTEM_TIME)
        self._parent = int(os.environ.get(PARENT_VARIABLE) or 0)
        self.wall_timer(1.0, self._every_second)

    # ---- for the derived class

    def configure(self) -> None:
        """Read parameters and files, create publishers and subscriptions."""

    def activate(self) -> None:
        """Begin to work."""

    def deactivate(self) -> None:
        """Stop working; `activate` may follow."""

    def cleanup(self) -> None:
        """Give back what `configure` took."""

    def diagnose(self) -> Diagnosis:
        """Return the state for ``/diagnostics``; called once per second while the node is active."""
        return Diagnosis()

    def parameter(self, name: str) -> Any:
        """Return the value of a declared parameter, in its declared type."""
        return self.get_parameter(name).value

    def publisher(self, topic: topics.Topic) -> Publisher:
        """Create a publisher; its `publish` takes a message or the bytes of one."""
        return self.create_publisher(topic.message_class, topic.name, topic.qos)

    def subscription(
        self, topic: topics.Topic, callback: Callable[[Any], None], *, raw: bool = False
    ) -> Subscription:
        """Create a subscription; with `raw` the callback is given the bytes of the message."""
        return self.create_subscription(topic.message_class, topic.name, callback, topic.qos, raw=raw)

    def deliver(self, *publishers: Publisher, timeout: float = 1.0) -> bool:
        """Wait until every reader has what was published; before publishers are destroyed.

        Parameters
        ----------
        *publishers : Publisher
            Publishers of this node.
        timeout : float
            How long to wait at most [s].

        Returns
        -------
        bool
            Whether every reader has acknowledged.
        """
        end = time.monotonic() + timeout
        return all(
            p.wait_for_all_acked(Duration(seconds=max(end - time.monotonic(), 0.0))) for p in publishers
        )

    def wall_timer(self, period: float, callback: Callable[[], None]) -> Timer:
        """Create a timer on the computer's own clock, whatever ``use_sim_time`` says.

        Parameters
        ----------
        period : float
            Time between two calls [s].
        callback : callable
            Called without arguments.
        """
        return self.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def stop(self) -> None:
        """End the process, exit code 0, after the current callback."""
        self.stopping = True

    def fault(self, name: str, message: str) -> None:
        """End the process after the current callback with a named fault; the first fault counts.

        Parameters
        ----------
        name : str
            Name that scripts can rely on.
        message : str
            One line for people.
        """
        if self.failure is None:
            self.failure = Fault(name, message)
            self.stopping = True

    @property
    def state(self) -> str:
        """State of the lifecycle: ``unconfigured``, ``inactive``, ``active`` or ``finalized``."""
        return str(self._state_machine.current_state[1])

    # ---- lifecycle

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run the hook `configure`."""
        return self._transition(self.configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run the hook `activate`."""
        return self._transition(self.activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run the hook `deactivate`."""
        return self._transition(self.deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run the hook `cleanup`."""
        return self._transition(self.cleanup)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run the hooks that an orderly end needs; the process ends after it."""
        hooks = {"active": (self.deactivate, self.cleanup), "inactive": (self.cleanup,)}.get(state.label, ())
        results = [self._transition(hook) for hook in hooks]
        self.stopping = True
        return next(
            (result for result in results if result != TransitionCallbackReturn.SUCCESS),
            TransitionCallbackReturn.SUCCESS,
        )

    def _change_state(self, handle: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Return `handle` such that a transition which the current state has not is refused, not a crash."""

        def handle_safely(request: Any, response: Any) -> Any:
            try:
                return handle(request, response)
            except rclpy_implementation.RCLError as error:
                self.get_logger().warning(f"state {self.state}: {str(error).split(', at ')[0]}")
                response.success = False
                return response

        return handle_safely

    def _transition(self, hook: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            hook()
        except InputError as error:
            if self._unattended:
                self.failure = self.failure or error
            else:
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # the caller in rclpy would swallow it without a word
            self.failure = self.failure or error
            self.stopping = True
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def start(self) -> None:
        """Configure and activate the node.

        Raises
        ------
        InputError, Fault or another exception
            What a hook raised.
        """
        self._unattended = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            trigger()
            if self.failure is not None:
                raise self.failure
        self._unattended = False
        self._publish_diagnosis(self.diagnose())

    def finish(self, executor: Executor) -> None:
        """Publish the last diagnosis, or why the node failed, and bring the lifecycle to its end.

        Between the hooks `deactivate` and `cleanup` a few callbacks are served, so that a client of the
        node gets the answers that `deactivate` has prepared.
        """
        if self.failure is not None:
            text = str(self.failure) or type(self.failure).__name__
            values = {"fault": self.failure.name} if isinstance(self.failure, Fault) else {}
            self._publish_diagnosis(Diagnosis(text, values, DiagnosticStatus.ERROR))
        elif self.state == "active":
            self._publish_diagnosis(self.diagnose())
        self.deliver(self._diagnostics, timeout=1.0)
        self._unattended = True
        if self.state == "active":
            self.trigger_deactivate()
            for _ in range(_LAST_CALLBACKS):
                executor.spin_once(timeout_sec=0.0)
        if self.state in ("unconfigured", "inactive", "active"):
            self.trigger_shutdown()

    # ---- parameters

    def _declare(self) -> None:
        given = {
            name: parameter.value
            for name, parameter in self.get_parameters_by_prefix("").items()
            if name in self._params or not self._declared_by_ros(name)
        }
        for name in given:
            self.undeclare_parameter(name)
        unknown = sorted(set(given) - set(self._params))
        if unknown:
            self.get_logger().warning(
                f"no such parameter: {', '.join(unknown)}; this node has: {', '.join(sorted(self._params))}"
            )
        for name, param in self._params.items():
            value = param.check(given.get(name, param.default))
            self.declare_parameter(name, value, param.descriptor(), ignore_override=True)

    @staticmethod
    def _declared_by_ros(name: str) -> bool:
        return name in ("use_sim_time", "start_type_description_service") or name.startswith("qos_overrides.")

    def _check_change(self, parameters: list[RosParameter]) -> SetParametersResult:
        for parameter in parameters:
            param = self._params.get(parameter.name)
            if param is None:
                continue
            if self.state != "unconfigured":
                reason = f"parameter {param.name} is fixed once the node is configured"
                return SetParametersResult(successful=False, reason=reason)
            try:
                param.check(parameter.value)
            except InputError as error:
                return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    # ---- once per second

    def _every_second(self) -> None:
        if self._parent and os.getppid() != self._parent:
            self.stop()
        active = self.state == "active"
        self._publish_diagnosis(
            self.diagnose() if active else Diagnosis(self.state, level=DiagnosticStatus.WARN)
        )

    def _publish_diagnosis(self, diagnosis: Diagnosis) -> None:
        values = {**diagnosis.values, "state": self.state, "pid": os.getpid()}
        status = DiagnosticStatus(
            level=diagnosis.level,
            name=self.get_name(),
            message=diagnosis.message,
            hardware_id="gyrowheel",
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._wall_clock.now().to_msg()
        self._diagnostics.publish(message)


def prepare_environment() -> None:
    """Set what the middleware reads from the environment, unless the user has set it; before `rclpy.init`.

    Discovery stays on this computer, with the settings of ``config/fastdds.xml``.
    """
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST":
        profiles = resources.files("gyrowheel_sim").joinpath("config/fastdds.xml")
        os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(profiles))


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


class StopSignals:
    """Notes SIGINT, SIGTERM and SIGHUP instead of letting them end the process.

    Repeated signals change nothing: a terminal sends Ctrl-C to a starter and to its nodes, so that a node
    may get it twice, the second time in the middle of its cleaning up.
    """

    def __init__(self) -> None:
        self.received = False
        self._node: BenchNode | None = None
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._handle)

    def attach(self, node: BenchNode) -> None:
        """Stop `node` at a signal, also at one that came before."""
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
    except Exception as error:  # rclpy gives a class of its own to each way in which arguments can be wrong
        # what follows " Error: " are places in the source of rcl
        reason = " ".join(str(error).split()).split(" Error: ")[0]
        raise InputError(f"ROS arguments: {reason}") from None
    try:
        if unknown:
            raise InputError(f"unknown argument {unknown[0]!r}; set parameters by --ros-args -p NAME:=VALUE")
        yield
    finally:
        rclpy.try_shutdown()


def run_node(node_class: type[BenchNode], arguments: Sequence[str] | None = None) -> int:
    """Run a node until it is told to end; the whole of a node's ``main``.

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
    try:
        with _ros(arguments):
            failure = _run(node_class, signals)
    except InputError as error:
        failure = error
    if failure is None:
        return ExitCode.OK
    if isinstance(failure, InputError | Fault):
        print(f"{node_class.NODE_NAME}: {failure}", file=sys.stderr, flush=True)
        return ExitCode.FAULT if isinstance(failure, Fault) else ExitCode.BAD_INPUT
    traceback.print_exception(failure)
    return ExitCode.CRASH


def _run(node_class: type[BenchNode], signals: StopSignals) -> BaseException | None:
    """Run the node inside an initialised rclpy; return why it failed, or None."""
    node = node_class()
    executor = make_executor()
    executor.add_node(node)
    signals.attach(node)
    try:
        if node.parameter("autostart") and not node.stopping:
            node.start()
        while not node.stopping:
            executor.spin_once(timeout_sec=0.1)
        end = time.monotonic() + node.LINGER
        while node.failure is None and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.02)
    except Exception as error:
        node.failure = node.failure or error
    if isinstance(node.failure, Fault):
        node.get_logger().fatal(str(node.failure))
    node.finish(executor)
    executor.shutdown()
    node.destroy_node()
    return node.failure
