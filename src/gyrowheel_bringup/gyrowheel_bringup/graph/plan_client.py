"""A plan sent to a conductor by the action: its progress and its end, from this process or a node."""

from __future__ import annotations

import contextlib
import re
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gyrowheel_msgs.action import RunPlan
from gyrowheel_msgs.srv import StartRecording, StopRecording
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from unique_identifier_msgs.msg import UUID

from gyrowheel_bringup.graph.local_node import executor_of, local_node
from gyrowheel_bringup.graph.nodes import EXECUTABLES
from gyrowheel_bringup.graph.results import GraphError, Progress
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import BenchNode, NodeStatus, Param, RepeatedRequest, prepare_environment, run_node
from gyrowheel_recording.nodes.recorder import already_recording

_APPEAR = 20.0  # time in which a bench that runs must show [s]
_ANSWER = 60.0  # time for an answer, and between two signs of progress [s]
_FINISH = 120.0  # time for the recorder to complete its files [s]


class PlanRequest(RepeatedRequest):
    """A plan sent to a conductor; the answer is the goal, accepted or refused.

    rclpy's action server begins no goal whose acceptance it cannot send, so a conductor that does not answer is asked
    again, under another identifier. Feedback shows that a plan runs although its acceptance was lost.

    `plans`: client of the conductor, which is ready; `goal`: the plan; `report`: called with the feedback of
    the plan.
    """

    def __init__(self, plans: ActionClient, goal: RunPlan.Goal, report: Callable[[Any], None]) -> None:
        self._heard: ClientGoalHandle | None = None

        def ask() -> Any:
            identifier = UUID(uuid=list(uuid.uuid4().bytes))

            def hear(message: Any) -> None:
                if self._heard is None:
                    accepted = RunPlan.Impl.SendGoalService.Response(accepted=True)
                    self._heard = ClientGoalHandle(plans, identifier, accepted)
                report(message)

            return plans.send_goal_async(goal, feedback_callback=hear, goal_uuid=identifier)

        super().__init__(ask)

    def _chosen(self, answers: list[Any]) -> Any:
        accepted = next((goal for goal in answers if goal.accepted), self._heard)
        # while it runs the plan of an earlier request, it refuses the same plan
        return accepted or (answers[-1] if len(answers) == self.times else None)


def run_plan(
    plans: ActionClient,
    plan: Plan,
    *,
    spin: Callable[[], None],
    stalled: Callable[[str], GraphError],
    patience: float,
    progress: Callable[[Progress], None] | None = None,
    ended: Callable[[], bool] | None = None,
) -> RunPlan.Result | None:
    """Run a plan on a conductor and return its result; None if `ended` returned true before.

    Parameters
    ----------
    plans : ActionClient
        Client of the conductor, which is ready.
    plan : Plan
        The plan.
    spin : callable
        Serves the node of the client for a moment; what it raises ends the wait, not the plan.
    stalled : callable
        Returns the error to raise; called with what does not come.
    patience : float
        Longest time between two signs of progress [s].
    progress : callable, optional
        Called at each change of segment and each second of the bench; what it raises ends the plan, too.
    ended : callable, optional
        Polled for whether to end: then the bench stops the plan and holds where it is.

    Raises
    ------
    GraphError
        If the plan is refused, or makes no progress.
    """
    last = time.monotonic()
    raised: list[BaseException] = []
    is_running = True

    def report(message: Any) -> None:
        nonlocal last
        last = time.monotonic()
        f = message.feedback
        if progress is None or raised or not is_running:
            return
        try:
            progress(Progress(f.segment, f.segments, f.label, f.elapsed, f.duration))
        except BaseException as error:  # the executor would end the process for it
            raised.append(error)

    def wait(look: Callable[[], Any], what: str, *, to_the_end: bool = False) -> Any:
        """Return what `look` finds; None once the plan is to end, unless `to_the_end`."""
        began = time.monotonic()
        while (found := look()) is None:
            spin()
            if not to_the_end and (raised or (ended is not None and ended())):
                return None
            if time.monotonic() - (began if to_the_end else last) > patience:
                raise stalled(what)
        return found

    try:
        request = PlanRequest(plans, RunPlan.Goal(plan=plan.to_yaml()), report)
        goal = wait(request.answer, "the conductor does not answer", to_the_end=True)
        if not goal.accepted:
            raise GraphError("plan_refused", "the conductor refused the plan: it is executing another one")
        result = RepeatedRequest(goal.get_result_async)
        found = wait(lambda: result.answer(last), f"plan {plan.name} makes no progress for {patience:g} s")
        if found is None:
            goal.cancel_goal_async()
            wait(lambda: result.answer(last), "the conductor does not end the plan", to_the_end=True)
            if raised:
                raise raised[0]
            return None
        return found.result
    finally:
        is_running = False


def fault_of(message: str) -> str:
    """Return the name of the fault that ended a plan: of a guard, or of the conductor.

    Parameters
    ----------
    message : str
        Of the result, such as ``aborted: plant: tilt_stop: tilt 5.02 deg, hard stop at 5.00 deg; ...``.

    Returns
    -------
    str
        Such as ``tilt_stop``; ``plan_aborted`` where the message names no fault.
    """
    if not message.startswith("aborted: "):
        return "plan_aborted"
    named = (word for word in message.split(": ")[1:-1] if word not in EXECUTABLES)
    name = next(named, "")
    return name if re.fullmatch(r"[a-z_]+", name) else "plan_aborted"


class _Asking:
    """A node that makes requests to a bench, one after another."""

    def __init__(self, namespace: str, domain: int | None, closing: contextlib.ExitStack) -> None:
        prepare_environment()
        self._node = local_node("asking", namespace, domain, closing)
        self._executor = executor_of(self._node, closing)
        self._where = namespace or "the root namespace"
        self.plans = ActionClient(self._node, RunPlan, "gyrowheel/run_plan")
        closing.callback(self.plans.destroy)
        self.start = self._node.create_client(StartRecording, "gyrowheel/recorder/start")
        self.stop = self._node.create_client(StopRecording, "gyrowheel/recorder/stop")

    def spin(self) -> None:
        """Serve the node for a moment."""
        self._executor.spin_once(timeout_sec=0.05)

    def stalled(self, what: str) -> GraphError:
        """Return the error that something does not come."""
        return GraphError("stalled", f"the bench in {self._where}: {what}")

    def until(self, done: Callable[[], bool], end: float, what: str) -> None:
        """Serve the node until `done` returns true; GraphError at the `end` [s of the monotonic clock]."""
        while not done():
            if time.monotonic() > end:
                raise self.stalled(what)
            self.spin()

    def call(self, client: Any, request: Any, what: str, seconds: float = _ANSWER) -> Any:
        """Return the answer of a service."""
        began = time.monotonic()
        self.until(client.service_is_ready, began + _APPEAR, f"no {what}")
        asked = RepeatedRequest(lambda: client.call_async(request))
        self.until(lambda: asked.answer() is not None, began + seconds, f"no answer of the {what}")
        return asked.answer()


def run_and_record(
    plan: Plan,
    record: Path | None,
    *,
    namespace: str = "",
    domain: int | None = None,
    progress: Callable[[Progress], None] | None = None,
    ended: Callable[[], bool] | None = None,
) -> bool:
    """Run and record a plan on a bench that runs already; afterwards it goes on as before.

    Parameters
    ----------
    plan : Plan
        The plan.
    record : Path or None
        New directory for the recording; None: without one.
    namespace : str
        Namespace of the bench; empty: the root.
    domain : int, optional
        ROS domain; by default that of the environment.
    progress : callable, optional
        Called at each change of segment and each second of the bench; what it raises ends the plan, too.
    ended : callable, optional
        Polled for whether to end: then the bench stops the plan and holds where it is.

    Returns
    -------
    bool
        Whether the plan went to its end.

    Raises
    ------
    InputError
        If the recorder of the bench records already, or cannot write there.
    GraphError
        If no bench answers, it refuses or aborts the plan, or makes no progress.
    """
    with contextlib.ExitStack() as closing:
        asking = _Asking(namespace, domain, closing)
        began = time.monotonic()
        asking.until(asking.plans.server_is_ready, began + _APPEAR, "no conductor")
        if record is not None:
            directory = str(record.absolute())
            answer = asking.call(asking.start, StartRecording.Request(directory=directory), "recorder")
            # its answer to a repeated request: the folder is new, so no other recording is in it
            if not answer.success and answer.message != already_recording(directory):
                raise InputError(f"recorder of the bench: {answer.message}")
            closing.callback(asking.call, asking.stop, StopRecording.Request(), "recorder", _FINISH)
        result = run_plan(
            asking.plans,
            plan,
            spin=asking.spin,
            stalled=asking.stalled,
            patience=_ANSWER,
            progress=progress,
            ended=ended,
        )
        if result is None:
            return False
        if not result.success:
            raise GraphError("plan_aborted", f"plan {plan.name}: {result.message}", node="conductor")
        return True


class PlanClientNode(BenchNode):
    """Sends a test plan to the conductor, and ends with it."""

    NODE_NAME = "plan_client"
    PARAMETERS = (Param("plan", "quick", "Test plan: shipped name, also with @settings, or path of a file"),)

    def configure(self) -> None:
        """Read the plan."""
        self._plan = Plan.load(self.parameter("plan"))
        self._client = ActionClient(self, RunPlan, "gyrowheel/run_plan")
        self._label = ""
        self._request: PlanRequest | None = None
        self._result: RepeatedRequest | None = None  # once the plan is accepted
        self._heard = 0.0  # when there was a sign of the plan [s of the monotonic clock]

    def activate(self) -> None:
        """Ask for the plan as soon as there is a conductor."""
        self._looking = self.wall_timer(0.1, self._look)

    def deactivate(self) -> None:
        """Stop polling; a plan in progress goes on."""
        self.destroy_timer(self._looking)

    def cleanup(self) -> None:
        """Destroy the client of the action."""
        self._client.destroy()

    def diagnose(self) -> NodeStatus:
        """Return the current segment."""
        return NodeStatus(
            self._label or ("plan sent" if self._request is not None else "waiting for a conductor")
        )

    def _look(self) -> None:
        """Ask for the plan and for its result, and look for the answers."""
        if self._result is not None:
            if (found := self._result.answer(self._heard)) is not None:
                self._end(found.result)
        elif self._request is not None:
            if (goal := self._request.answer()) is None:
                return
            if goal.accepted:
                self._result = RepeatedRequest(goal.get_result_async)
            else:
                self.fault(
                    "plan_refused",
                    "the conductor refused the plan: it is executing another one, or not active",
                )
        elif self._client.server_is_ready():
            # a shipped plan by its name: the conductor brings it within the limits of its bench
            text = self.parameter("plan") if self._plan.written_for else self._plan.to_yaml()
            self._request = PlanRequest(self._client, RunPlan.Goal(plan=text), self._on_feedback)

    def _on_feedback(self, message: Any) -> None:
        self._heard = time.monotonic()
        feedback = message.feedback
        label = f"segment {feedback.segment + 1} of {feedback.segments}: {feedback.label}"
        if label != self._label:
            self._label = label
            self.get_logger().info(f"plan {self._plan.name}: {feedback.elapsed:.0f} s, {label}")

    def _end(self, result: RunPlan.Result) -> None:
        if result.success:
            self.get_logger().info(result.message)
            self.stop()
        else:
            self.fault(fault_of(result.message), result.message)


def main() -> int:
    """Run the node."""
    return run_node(PlanClientNode)
