"""The node of this process in a graph: status messages of the nodes, and requests to them."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Collection
from typing import Any, NoReturn

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from gyrowheel_msgs.action import RunPlan
from gyrowheel_msgs.msg import DragEstimate
from gyrowheel_msgs.srv import StopRecording
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.action import ActionClient

from gyrowheel_analysis.drag.estimate import Estimate
from gyrowheel_bringup.graph.foreign_nodes import Strangers
from gyrowheel_bringup.graph.local_node import executor_of, local_node
from gyrowheel_bringup.graph.plan_client import fault_of, run_plan
from gyrowheel_bringup.graph.processes import Processes
from gyrowheel_bringup.graph.results import GraphError, Progress
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import namespaces, topics
from gyrowheel_core.node import PRIORITY, RepeatedRequest, is_refused
from gyrowheel_recording.nodes.recorder import ENDED, TAKE_PERIOD

_SETTLE_TIMEOUT = 30.0  # time for a node to take what was sent to it [s]
_FINISH_TIMEOUT = 120.0  # time for the recorder to complete its files [s]
_EXPLAIN = 3.0  # time for a node to end, or to report why a plan was aborted [s]
_WIND_DOWN = 60.0  # time to stop the motor [s]
_AT_REST = 30.0  # spin rate of a wheel that the controller has brought to rest [rpm]
_ACTIVATE = 10.0  # time for a node to report that it is active [s]
_NOTICED = 2.0 * TAKE_PERIOD  # after a plan, the recorder has seen by then how it ended [s]
_NAMED = 3.0  # time for the name of a node to arrive after its publisher; it is sent once a second [s]
_LAST = 0.1  # time to take what has arrived [s]


class Link:
    """A node in this process that talks to the nodes of a graph.

    Parameters
    ----------
    names : collection of str
        The nodes of the graph.
    processes : Processes
        Their processes.
    domain_id : int or None
        ROS domain; None: that of the environment.
    namespace : str
        Namespace of the nodes.
    renamed : bool
        Whether some nodes have other names of topics.
    on_trouble : callable or None
        Called with the name of a node and one line when it reports a warning or an error; once for each kind.
    """

    def __init__(
        self,
        names: Collection[str],
        processes: Processes,
        *,
        domain_id: int | None,
        namespace: str,
        renamed: bool,
        on_trouble: Callable[[str, str], None] | None,
    ) -> None:
        self._names, self._processes, self._namespace = names, processes, namespace
        self._on_trouble = on_trouble
        #: Whether nodes with the same names that are not of this graph are still searched.
        self.starting = True
        self.active: set[str] = set()  # nodes that have reported that they are active
        #: Nodes with the same names that are not of this graph, and their process ids.
        self.strangers: dict[str, str] = {}
        self.values: dict[str, dict[str, str]] = {}  # values of the last status of each active node
        self.estimates: list[Estimate] = []  # drag estimates so far
        self._said: dict[str, str] = {}  # message of the last status
        self._told: dict[str, float] = {}  # when it was sent [s of the system's clock]
        self._walked = 0.0  # when the last plan ended [s of the system's clock]
        self._states: dict[str, str] = {}  # state of the lifecycle, in it
        self._troubles: set[tuple[str, str]] = set()
        self._alarm: GraphError | None = None  # guards that have tripped
        self._closing = contextlib.ExitStack()
        self._node = node = local_node("graph", namespace, domain_id, self._closing)
        self._executor = executor_of(node, self._closing)
        # renamed topics have unknown publishers
        self._others = Strangers(node, () if renamed else names, namespace)
        topic = topics.DIAGNOSTICS
        node.create_subscription(DiagnosticArray, topic.relative, self._on_diagnostics, topic.qos)
        if "drag_estimator" in names:
            topic = topics.DRAG_ESTIMATE
            node.create_subscription(DragEstimate, topic.relative, self._on_estimate, topic.qos, raw=True)
        self._changes = {
            name: node.create_client(ChangeState, f"{name}/change_state")
            for name in ("plant", "drag_estimator")
        }
        self._stop_recording = node.create_client(StopRecording, "gyrowheel/recorder/stop")
        self._plans = ActionClient(node, RunPlan, "gyrowheel/run_plan")
        self._closing.callback(self._plans.destroy)

    def close(self) -> None:
        """Destroy the node; a second call does nothing."""
        self._closing.close()

    @property
    def domain(self) -> int:
        """The ROS domain."""
        return int(self._node.context.get_domain_id())

    def states(self, names: Collection[str] = ()) -> str:
        """Return the last messages of some nodes in one line; by default of all that have sent one."""
        shown = names or sorted(self._said)
        return "; ".join(f"{name}: {self._said.get(name, 'silent')}" for name in shown)

    def spin(self, seconds: float = 0.05) -> None:
        """Serve the node for a moment; raise if a node of the graph has ended, or a guard has tripped."""
        end = time.monotonic() + seconds
        while (rest := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=rest)
        self._processes.show()
        self._others.look()
        self._processes.require_running()
        if self._alarm is not None:
            raise self._alarm

    def look_for_strangers(self) -> None:
        """Note nodes of the bench in this namespace that are not of this graph."""
        seen = self._node.get_node_names_and_namespaces()
        for name in self._names:  # one that was left out is somebody's own
            if seen.count((name, self._namespace or "/")) > 1:
                self.strangers.setdefault(name, "unknown")

    def others(self) -> str:
        """Return foreign publishers of the topics of the bench in one line; empty if there are none."""
        return self._others.text()

    def await_names(self) -> None:
        """Wait a moment for names of others that have not arrived yet."""
        end = time.monotonic() + _NAMED
        while self._others.nameless and time.monotonic() < end:
            self.spin()

    # ---- a plan

    def require_active(self, *, recorded: bool) -> None:
        """Raise if a node of the graph is not active, and does not report within a moment that it is.

        With `recorded` the recorder must record, too, by its status after the last plan: it may have ended because the
        plant was restarted, which ends a recording.
        """
        end = time.monotonic() + _ACTIVATE
        while True:
            fault, idle = "not_active", [n for n in self._names if self._states.get(n) != "active"]
            values = self.values.get("recorder", {})
            old = self._told.get("recorder", 0.0) <= self._walked + _NOTICED
            if not idle and recorded and (old or "directory" not in values):
                fault, idle = "not_recorded", ["recorder"]
            if not idle:
                return
            if time.monotonic() > end or (fault == "not_recorded" and ENDED in values and not old):
                raise GraphError(fault, f"no plan can run: {self.states(idle)}; start the graph again")
            self.spin()

    def run(
        self, plan: Plan, progress: Callable[[Progress], None] | None, *, stall_timeout: float
    ) -> RunPlan.Result:
        """Send a plan to the conductor and wait for its end.

        Raises GraphError if no conductor is there, it refuses or aborts the plan, the plan makes no progress,
        or a node fails.
        """
        end = time.monotonic() + stall_timeout
        while not self._plans.server_is_ready():
            if time.monotonic() > end:
                raise GraphError("stalled", f"no node offers the action that runs plans ({self.states()})")
            self.spin()
        try:
            result = run_plan(
                self._plans,
                plan,
                spin=self.spin,
                stalled=lambda what: GraphError("stalled", f"{what} ({self.states()})"),
                patience=stall_timeout,
                progress=progress,
            )
        finally:
            self._walked = time.time()
        assert result is not None  # nothing else ends it
        if not result.success:
            self._explain(plan, result.message)
        return result

    def _explain(self, plan: Plan, message: str) -> NoReturn:
        """Raise the error why a plan was aborted: that of a node, if there is one."""
        end = time.monotonic() + _EXPLAIN
        while "aborted" in message and "clock_jump" not in message and time.monotonic() < end:
            self.spin()
        raise GraphError(fault_of(message), f"plan {plan.name}: {message}", node="conductor")

    # ---- ending

    def await_samples(self, count: int) -> None:
        """Wait until the recorder has a number of samples, where no node of the graph can confirm delivery."""
        end = time.monotonic() + _SETTLE_TIMEOUT
        while int(self.values.get("recorder", {}).get("samples", 0)) < count and time.monotonic() < end:
            self.spin()

    def wind_down(self) -> None:
        """In real time with a broken loop, wait until the wheel is at rest, and so record it.

        Where the plant's guard has tripped or the controller has ended, the guard stops the motor; where the conductor
        has ended, the controller brings the wheel to rest. After any other end the loop is whole: nobody stops it.
        """
        ended = {child.name for child in self._processes.ended()}
        tripped = "controller" in ended or (self._alarm is not None and self._alarm.node == "plant")
        if not (tripped or "conductor" in ended) or "plant" not in self.active:
            return
        now, end = time.time(), time.monotonic() + _WIND_DOWN
        while self._processes.runs("plant") and time.monotonic() < end:
            # the last status is up to a second old, and older ones may still wait
            values = self.values.get("plant", {}) if self._told.get("plant", 0.0) > now else {}
            # before the first command nothing is lost, and the motor keeps turning
            if values.get("outputs") == "off" or values.get("guard") in ("waiting", "stopped"):
                return
            if not tripped and abs(float(values.get("spin_rate_rpm", "inf"))) < _AT_REST:
                return
            self._executor.spin_once(timeout_sec=0.05)

    def settle(self, *, recorded: bool) -> None:
        """End the flow of messages, so that every node has received what was sent to it.

        A node answers a service after it has taken all earlier messages: the plant stops, the estimator publishes its
        last estimate, then the recorder completes its files.
        """
        deactivate = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
        for name in ("plant", "drag_estimator"):
            self._call(name, self._changes[name], deactivate, timeout=_SETTLE_TIMEOUT)
        # the last estimates were delivered before the answer, but wait to be taken
        end = time.monotonic() + _LAST
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.01)
        if recorded:
            self._call("recorder", self._stop_recording, StopRecording.Request(), timeout=_FINISH_TIMEOUT)

    def _call(self, name: str, client: Any, request: Any, *, timeout: float) -> Any:
        """Call a service of a node; return None if the node has ended or does not answer in time."""
        if name not in self._processes.children or not client.service_is_ready():
            return None
        asked, end = RepeatedRequest(lambda: client.call_async(request)), time.monotonic() + timeout
        while (answer := asked.answer()) is None:
            self._executor.spin_once(timeout_sec=0.05)
            if not self._processes.runs(name) or time.monotonic() > end:
                return None
        return answer

    # ---- hearing

    def _on_estimate(self, data: bytes) -> None:
        # other bytes come from a foreign node, which is reported as such
        with contextlib.suppress(ValueError):
            self.estimates.append(Estimate.from_bytes(data))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name = namespaces.local_name(status.name, self._namespace)
            if name not in self._names or namespaces.is_of_another(status.hardware_id, self._namespace):
                continue
            values = {pair.key: pair.value for pair in status.values}
            child = self._processes.children.get(name)
            if child is None or values.get("pid") != str(child.pid):
                if self.starting:  # later ones are refused by their own graph
                    self.strangers[name] = values.get("pid", "unknown")
                continue
            self._said[name], self._states[name] = status.message, values["state"]
            self._told[name] = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
            child.note_memory()
            if values["state"] == "active":
                self.active.add(name)
                self.values[name] = values
                self._others.note(values)
                self._note_trouble(name, status, values)
                if status.level == DiagnosticStatus.ERROR and "guard" in values and self._alarm is None:
                    self._alarm = GraphError(values["guard"], f"{name}: {status.message}", node=name)

    def _note_trouble(self, name: str, status: DiagnosticStatus, values: dict[str, str]) -> None:
        """Pass on the warnings and errors of a node, each kind once."""
        if is_refused(values):  # to one as to all
            self._pass_on(name, ("", PRIORITY.name), f"real-time priority {values[PRIORITY.name]}")
        if status.level != DiagnosticStatus.OK:
            self._pass_on(name, (name, status.message.partition(":")[0]), status.message)

    def _pass_on(self, name: str, trouble: tuple[str, str], text: str) -> None:
        if trouble not in self._troubles and self._on_trouble is not None:
            self._troubles.add(trouble)
            self._on_trouble(name, text)
