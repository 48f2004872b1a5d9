"""The base class of the nodes: lifecycle, parameters, diagnostics, faults."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter as RosParameter
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from gyrowheel_core import namespaces, topics
from gyrowheel_core.errors import InputError
from gyrowheel_core.node.endpoints import Inbox, PublisherWatch
from gyrowheel_core.node.parameters import AUTOSTART, Param
from gyrowheel_core.node.priority import PRIORITY, prioritise
from gyrowheel_core.start_node import PARENT_VARIABLE

#: Value of a status: topics with more than one publisher, and their publishers.
SURPLUS = "surplus_publishers"
#: Value of a status: the topic without which the node cannot go on.
WAITS_FOR = "waits_for"
#: Level of a `NodeStatus` for a warning.
WARN: bytes = DiagnosticStatus.WARN

_LAST_CALLBACKS = 50
_LOOK = 0.1  # period of looking at the publishers [s]
#: Longest wait for a message before other work is looked for [s].
_PATIENCE = 0.1
#: Time for the executor and for messages in transit to release a subscription [s].
LET_GO = 0.05


def _unused(_: Any) -> None:
    """Replace the callback of a subscription that no executor serves."""


class Fault(RuntimeError):
    """A condition in which a node cannot go on.

    `name`: name that scripts can rely on, such as ``controller_silent``; `message`: one line for people.
    """

    def __init__(self, name: str, message: str) -> None:
        super().__init__(f"{name}: {message}")
        self.name = name
        self.message = message


@dataclass
class NodeStatus:
    """Status of a node, as published on ``/diagnostics``."""

    message: str = "running"  # one line
    values: Mapping[str, object] = field(default_factory=dict)  # named values, published as text
    #: Level of `diagnostic_msgs.msg.DiagnosticStatus`: ``OK``, ``WARN`` or ``ERROR``.
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
    #: How long the node goes on taking messages after the request to end [s].
    LINGER: ClassVar[float] = 0.0

    def __init__(self) -> None:
        # Declared from the command line first: only so does the node see values of a wrong type or name.
        self._inboxes: list[Inbox] = []
        self._leaving: list[tuple[float, Any]] = []  # subscriptions to be destroyed, and when
        #: Who publishes what this node reads.
        self.watch = PublisherWatch(self)
        self._surplus: dict[str, str] = {}  # as last published
        self._granted: dict[str, str] = {}  # priority and memory, if requested
        super().__init__(self.NODE_NAME, automatically_declare_parameters_from_overrides=True)
        self._service_change_state.callback = self._change_state(self._service_change_state.callback)
        self._service_get_state.callback = self._answer_when_drained(self._service_get_state.callback)
        self.stopping = False
        #: Whether a client of the lifecycle service requested the end, and waits for the answer.
        self.shut_down = False
        self.failure: BaseException | None = None
        #: True in transitions that no lifecycle manager requested, so that none can act on a failure.
        self._unattended = False
        self._params = {param.name: param for param in (AUTOSTART, *self.PARAMETERS)}
        self._declare()
        self.add_on_set_parameters_callback(self._check_change)
        self.add_post_set_parameters_callback(self._on_change)
        self._diagnostics = self.publisher(topics.DIAGNOSTICS)
        self._wall_clock = Clock(clock_type=ClockType.SYSTEM_TIME)
        self._parent = int(os.environ.get(PARENT_VARIABLE) or 0)
        self.wall_timer(1.0, self._every_second)
        self.wall_timer(_LOOK, self._look_at_publishers)

    # ---- for the derived class

    def configure(self) -> None:
        """Read parameters and files, create publishers and subscriptions."""

    def activate(self) -> None:
        """Begin to work."""

    def deactivate(self) -> None:
        """Stop working; `activate` may follow."""

    def cleanup(self) -> None:
        """Release what `configure` acquired."""

    def diagnose(self) -> NodeStatus:
        """Return the status for ``/diagnostics``; called once per second while the node is active."""
        return NodeStatus()

    def drain(self) -> None:
        """Process the messages in the inboxes.

        Called before the state of the lifecycle is reported: the answer means that the node has processed all messages
        that it was sent before.
        """

    def check_tuning(self, values: Mapping[str, Any]) -> None:
        """Refuse live parameters that contradict the configuration of the node.

        Parameters
        ----------
        values : mapping of str to object
            The live parameters, those about to be set with their new values; each is within its range.

        Raises
        ------
        InputError
            With the reason.
        """

    def tune(self) -> None:
        """Apply live parameters that were changed after `configure`."""

    def parameter(self, name: str) -> Any:
        """Return the value of a declared parameter, in its declared type."""
        return self.get_parameter(name).value

    def publisher(self, topic: topics.Topic) -> Publisher:
        """Create a publisher; its `publish` takes a message or the bytes of one."""
        return self.create_publisher(topic.message_class, topic.relative, topic.qos)

    def subscription(
        self, topic: topics.Topic, callback: Callable[[Any], None], *, raw: bool = False
    ) -> Subscription:
        """Create a subscription; with `raw` the callback is given the bytes of the message."""
        result = self.create_subscription(topic.message_class, topic.relative, callback, topic.qos, raw=raw)
        self.watch.add(topic, result)
        return result

    def destroy_subscription(self, subscription: Subscription) -> bool:
        """Destroy a subscription, a moment after the executor has let go of it.

        Fast DDS crashes where a reader is destroyed while it delivers a message.
        """
        self.watch.remove(subscription)
        subscription.handle.__enter__()  # in use: it is not destroyed yet
        self._leaving.append((time.monotonic() + LET_GO, subscription.handle))
        return super().destroy_subscription(subscription)

    def _release(self) -> None:
        """Release the subscriptions that were destroyed a moment ago."""
        now = time.monotonic()
        while self._leaving and self._leaving[0][0] <= now:
            self._leaving.pop(0)[1].__exit__(None, None, None)

    def destroy_node(self) -> None:
        """Destroy the node with all subscriptions, including those that its hooks have destroyed."""
        for _, handle in self._leaving:
            handle.__exit__(None, None, None)
        self._leaving.clear()
        for subscription in list(super().subscriptions):
            self.watch.remove(subscription)
        super().destroy_node()
        # rclpy forgets the state machine, which keeps the node in the middleware alive: the threads of Fast DDS would
        # still run while the exit of the process destroys what they use, and now and then corrupt its memory
        self._state_machine.destroy_when_not_in_use()

    def inbox(self, topic: topics.Topic, *, room: int = 0) -> Inbox:
        """Create a subscription whose messages wait until they are taken; close it by `close_inbox`.

        Parameters
        ----------
        topic : Topic
            The topic.
        room : int
            Smallest number of messages that may wait, where the depth of the topic is less.
        """
        asked = replace(topic, depth=max(topic.depth, room))
        inbox = Inbox(topic, self.subscription(asked, _unused, raw=True))
        self._inboxes.append(inbox)
        return inbox

    def close_inbox(self, inbox: Inbox) -> None:
        """Close an inbox and drop the messages left in it."""
        self._inboxes.remove(inbox)
        self.destroy_subscription(inbox.subscription)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Subscriptions that an executor serves; those of inboxes are not among them."""
        waiting = [inbox.subscription for inbox in self._inboxes]
        return (found for found in super().subscriptions if found not in waiting)

    def deliver(self, *publishers: Publisher, timeout: float = 1.0) -> bool:
        """Wait until every reader has received what was published, before publishers are destroyed.

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
        """Create a timer on wall-clock time, regardless of ``use_sim_time``.

        Parameters
        ----------
        period : float
            Time between two calls [s].
        callback : callable
            Called without arguments.
        """
        return self.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def patience(self) -> float:
        """Return how long `pace` need not be called [s]."""
        return _PATIENCE

    def pace(self) -> None:
        """Do the work that is due; called after every callback, and when `patience` is over.

        For work at a fixed pace: a timer of the middleware has its own thread, and wakes two threads for every call.
        """

    def prioritise(self) -> None:
        """Set the priority of the parameter `PRIORITY`, and warn if the system refuses it."""
        self._granted = prioritise(self, self.parameter(PRIORITY.name))

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
    def namespace(self) -> str:
        """Namespace of the node: empty for the root, else such as ``/bench2``."""
        return namespaces.of_node(self.get_namespace())

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
        """Publish the last status and run the hook `deactivate`."""
        self._publish_last()
        return self._transition(self.deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run the hook `cleanup`."""
        return self._transition(self.cleanup)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run the hooks of an orderly shutdown; then the process ends."""
        if state.label == "active":
            self._publish_last()
        hooks = {"active": (self.deactivate, self.cleanup), "inactive": (self.cleanup,)}.get(state.label, ())
        results = [self._transition(hook) for hook in hooks]
        self.stopping, self.shut_down = True, True
        return next(
            (result for result in results if result != TransitionCallbackReturn.SUCCESS),
            TransitionCallbackReturn.SUCCESS,
        )

    def _change_state(self, handle: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Return `handle` with a refusal, not a crash, for a transition that the current state does not have."""

        def handle_safely(request: Any, response: Any) -> Any:
            try:
                return handle(request, response)
            except rclpy_implementation.RCLError as error:
                self.get_logger().warning(f"state {self.state}: {str(error).split(', at ')[0]}")
                response.success = False
                return response

        return handle_safely

    def _answer_when_drained(self, handle: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        def answer(request: Any, response: Any) -> Any:
            self.drain()
            return handle(request, response)

        return answer

    def _transition(self, hook: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            hook()
        except InputError as error:
            if self._unattended:
                self.failure = self.failure or error
            else:
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # the caller in rclpy would drop it silently
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
        self._publish_status(self.diagnose())

    def finish(self, executor: Executor) -> None:
        """Publish the last status, or the reason of the failure, and end the work of the node.

        After the hook `deactivate` a few callbacks are served, so that a client of the node gets the answers that
        `deactivate` has prepared. `take_apart` and `destroy_node` remain.
        """
        if self.failure is not None:
            text = str(self.failure) or type(self.failure).__name__
            values = {"fault": self.failure.name} if isinstance(self.failure, Fault) else {}
            self._publish_status(NodeStatus(text, values, DiagnosticStatus.ERROR))
            self.deliver(self._diagnostics, timeout=1.0)
        self._unattended = True
        if self.state == "active":
            self.trigger_deactivate()
            for _ in range(_LAST_CALLBACKS):
                executor.spin_once(timeout_sec=0.0)

    def take_apart(self, executor: Executor) -> None:
        """Shut down the executor, and end the lifecycle by the hook `cleanup`; the work of the node has ended."""
        executor.shutdown()
        time.sleep(LET_GO)
        if self.state in ("unconfigured", "inactive", "active"):
            self.trigger_shutdown()

    def _publish_last(self) -> None:
        """Publish the last status of an active node before it is deactivated; a failure was published already."""
        if self.failure is None:
            self._publish_status(self.diagnose())
            self.deliver(self._diagnostics, timeout=1.0)

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
        values = {name: self.parameter(name) for name, param in self._params.items() if param.live}
        try:
            for parameter in parameters:
                param = self._params.get(parameter.name)
                if param is None:
                    continue
                if not param.live and self.state != "unconfigured":
                    raise InputError(f"parameter {param.name} is fixed once the node is configured")
                checked = param.check(parameter.value)
                if param.live:
                    values[param.name] = checked
            if self.state in ("inactive", "active"):
                self.check_tuning(values)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _on_change(self, parameters: list[RosParameter]) -> None:
        changed = [p for p in parameters if p.name in self._params]
        if changed and self.state in ("inactive", "active"):
            self.tune()
            text = ", ".join(f"{p.name} = {p.value}" for p in changed)
            self.get_logger().info(f"changed: {text}")

    # ---- once per second

    def announce(self) -> None:
        """Publish the status at once, after a change of state."""
        active = self.state == "active"
        self._publish_status(
            self.diagnose() if active else NodeStatus(self.state, level=DiagnosticStatus.WARN)
        )

    def _every_second(self) -> None:
        if self._parent and os.getppid() != self._parent:
            self.stop()
        self.announce()

    def _look_at_publishers(self) -> None:
        """Report a second publisher of a topic at once: it may be gone before the next status."""
        self.watch.look()
        self._release()
        if (surplus := self.watch.surplus()) != self._surplus:
            self._surplus = surplus
            self.announce()

    def _publish_status(self, status: NodeStatus) -> None:
        values = {**status.values, **self._granted, "state": self.state, "pid": os.getpid()}
        level, text = status.level, status.message
        self.watch.look()
        if surplus := self.watch.surplus():
            values[SURPLUS] = "; ".join(f"{topic}: {who}" for topic, who in surplus.items())
            level, text = max(level, WARN), f"{text}; several publishers of {values[SURPLUS]}"
        published = DiagnosticStatus(
            level=level,
            name=namespaces.status_name(self.namespace, self.get_name()),
            message=text,
            hardware_id=namespaces.hardware_id(self.namespace),
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[published])
        message.header.stamp = self._wall_clock.now().to_msg()
        self._diagnostics.publish(message)
