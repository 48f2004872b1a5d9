"""A plan sent to a conductor by the action, its progress, and its end."""

from __future__ import annotations

import re
import time
import uuid
from collections.abc import Callable
from typing import Any

from gyrowheel_msgs.action import RunPlan
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from unique_identifier_msgs.msg import UUID

from gyrowheel_bringup.graph.nodes import EXECUTABLES
from gyrowheel_bringup.graph.results import GraphError, Progress
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.node import RepeatedRequest


class PlanRequest(RepeatedRequest):
    """A plan that a conductor is asked to walk; the answer is the goal, accepted or refused.

    rclpy's action server begins no goal whose acceptance it cannot send, so a conductor that does not answer is asked
    anew, under another identifier. Feedback tells that a plan is walked although its acceptance was lost on the way.

    Parameters
    ----------
    plans : ActionClient
        Client of the conductor, which is ready.
    goal : RunPlan.Goal
        The plan.
    report : callable
        Called with the feedback of the plan.
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
        # while it walks what it was asked for before, it refuses the same plan
        return accepted or (answers[-1] if len(answers) == self.times else None)


def walked(
    plans: ActionClient,
    plan: Plan,
    *,
    spin: Callable[[], None],
    stalled: Callable[[str], GraphError],
    patience: float,
    progress: Callable[[Progress], None] | None = None,
    ended: Callable[[], bool] | None = None,
) -> RunPlan.Result | None:
    """Have a conductor walk a plan and return how it ended; None if `ended` said so before.

    Parameters
    ----------
    plans : ActionClient
        Client of the conductor, which is ready.
    plan : Plan
        The plan.
    spin : callable
        Serves the node of the client for a moment; what it raises ends the wait, not the plan.
    stalled : callable
        Given what does not come, returns the error to raise.
    patience : float
        Longest time between two signs of progress [s].
    progress : callable, optional
        Called at each change of segment and each second of the bench; what it raises ends the plan, too.
    ended : callable, optional
        Asked all along whether to end: then the bench stops the plan and holds where it is.

    Raises
    ------
    GraphError
        If the plan is refused, or makes no progress.
    """
    last = time.monotonic()
    raised: list[BaseException] = []
    walking = True

    def report(message: Any) -> None:
        nonlocal last
        last = time.monotonic()
        f = message.feedback
        if progress is None or raised or not walking:
            return
        try:
            progress(Progress(f.segment, f.segments, f.label, f.elapsed, f.duration))
        except BaseException as error:  # the executor would end the process for it
            raised.append(error)

    def wait(look: Callable[[], Any], what: str, *, to_the_end: bool = False) -> Any:
        """Return what `look` finds; None once the plan is to end, unless the end is what is waited for."""
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
        walking = False


def fault_of(message: str) -> str:
    """Return the name of the fault for which a conductor has ended a plan: that of a guard, or its own.

    Parameters
    ----------
    message : str
        Of the result, such as ``aborted: plant: tilt_stop: tilt 5.02 deg, hard stop at 5.00 deg; ...``.

    Returns
    -------
    str
        As ``tilt_stop``; ``plan_aborted`` where it names none.
    """
    if not message.startswith("aborted: "):
        return "plan_aborted"
    named = (word for word in message.split(": ")[1:-1] if word not in EXECUTABLES)
    name = next(named, "")
    return name if re.fullmatch(r"[a-z_]+", name) else "plan_aborted"
