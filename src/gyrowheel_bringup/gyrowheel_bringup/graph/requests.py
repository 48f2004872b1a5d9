"""A plan for a bench that runs already: its conductor walks it, its recorder records it; the bench goes on."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gyrowheel_msgs.action import RunPlan
from gyrowheel_msgs.srv import StartRecording, StopRecording
from rclpy.action import ActionClient

from gyrowheel_bringup.graph.own_node import own_node
from gyrowheel_bringup.graph.plan_run import walked
from gyrowheel_bringup.graph.results import GraphError, Progress
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import RepeatedRequest, prepare_environment
from gyrowheel_recording.nodes.recorder import already_recording

_APPEAR = 20.0  # time in which a bench that runs must show [s]
_ANSWER = 60.0  # time for an answer, and between two signs of progress [s]
_FINISH = 120.0  # time for the recorder to complete its files [s]


class _Asking:
    """A node that asks a bench for things, one after another."""

    def __init__(self, namespace: str, domain: int | None, closing: contextlib.ExitStack) -> None:
        prepare_environment()
        self._node, self._executor = own_node("asking", namespace, domain, closing)
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
        """Serve the node until something is so; GraphError at the `end` [s of the monotonic clock]."""
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


def walk(
    plan: Plan,
    record: Path,
    *,
    namespace: str = "",
    domain: int | None = None,
    progress: Callable[[Progress], None] | None = None,
    ended: Callable[[], bool] | None = None,
) -> bool:
    """Have a running bench walk a plan and record it; afterwards it goes on as before.

    Parameters
    ----------
    plan : Plan
        The plan.
    record : Path
        New directory for the recording.
    namespace : str
        Namespace of the bench; empty: the root.
    domain : int, optional
        ROS domain; by default that of the environment.
    progress : callable, optional
        Called at each change of segment and each second of the bench; what it raises ends the plan, too.
    ended : callable, optional
        Asked all along whether to end: then the bench stops the plan and holds where it is.

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
        asking.until(asking.plans.server_is_ready, began + _APPEAR, "no conductor, which walks plans")
        directory = str(record.absolute())
        answer = asking.call(asking.start, StartRecording.Request(directory=directory), "recorder")
        # so it answers where it was asked again: the folder is new, nobody else has it recorded into
        if not answer.success and answer.message != already_recording(directory):
            raise InputError(f"recorder of the bench: {answer.message}")
        try:
            return _walked(asking, plan, progress, ended)
        finally:
            asking.call(asking.stop, StopRecording.Request(), "recorder", _FINISH)


def _walked(
    asking: _Asking,
    plan: Plan,
    progress: Callable[[Progress], None] | None,
    ended: Callable[[], bool] | None,
) -> bool:
    result = walked(
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
