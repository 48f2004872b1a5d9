"""A plan sent to a conductor by the action, its progress, and its end."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from typing import Any

from gyrowheel_msgs.action import RunPlan
from rclpy.action import ActionClient

from gyrowheel_bringup.graph.nodes import EXECUTABLES
from gyrowheel_bringup.graph.results import GraphError, Progress
from gyrowheel_control.plans.plan import Plan

#: Time without progress after which the result is asked for again [s]: an answer may be lost where the conductor did
#: not know this client yet.
ASK_AGAIN = 5.0


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

    def wait(
        first: Any, what: str, *, again: Callable[[], Any] | None = None, to_the_end: bool = False
    ) -> Any:
        """Return the answer that `first` brings, or another one asked for by `again`.

        None once the plan is to end, unless the end is what is waited for.
        """
        futures, began = [first], time.monotonic()
        asked = began
        while not (done := next((f for f in futures if f.done()), None)):
            spin()
            if not to_the_end and (raised or (ended is not None and ended())):
                return None
            now = time.monotonic()
            if now - (began if to_the_end else last) > patience:
                raise stalled(what)
            if again is not None and now - max(asked, last) > ASK_AGAIN:
                futures.append(again())
                asked = now
        return done.result()

    try:
        request = RunPlan.Goal(plan=plan.to_yaml())
        answer = plans.send_goal_async(request, feedback_callback=report)
        goal = wait(answer, "the conductor does not answer", to_the_end=True)
        if not goal.accepted:
            raise GraphError("plan_refused", "the conductor refused the plan: it is executing another one")
        coming = goal.get_result_async()
        found = wait(
            coming, f"plan {plan.name} makes no progress for {patience:g} s", again=goal.get_result_async
        )
        if found is None:
            goal.cancel_goal_async()
            wait(coming, "the conductor does not end the plan", again=goal.get_result_async, to_the_end=True)
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
