"""The node ``plan_client``: asks the conductor to walk one plan, tells its progress, and ends with it.

For a launch file, which can start processes and notice their end and nothing else: exit code 0 where the plan went to
its end, 3 where it did not, with the reason in the last line.
"""

from __future__ import annotations

import time
from typing import Any

from gyrowheel_msgs.action import RunPlan
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle

from gyrowheel_bringup.graph.walking import ASK_AGAIN, PlanRequest, fault_of
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.node import BenchNode, Diagnosis, Param, run_node


class PlanClientNode(BenchNode):
    """Asks the conductor to walk a test plan, and ends with it."""

    NODE_NAME = "plan_client"
    PARAMETERS = (Param("plan", "quick", "Test plan: shipped name, also with @settings, or path of a file"),)

    def configure(self) -> None:
        """Read the plan."""
        self._plan = Plan.load(self.parameter("plan"))
        self._client = ActionClient(self, RunPlan, "gyrowheel/run_plan")
        self._label = ""
        self._request: PlanRequest | None = None
        self._handle: ClientGoalHandle | None = None
        self._heard = 0.0  # when there was a sign of the plan [s of the monotonic clock]

    def activate(self) -> None:
        """Ask for the plan as soon as there is a conductor."""
        self._waiting = self.wall_timer(0.1, self._ask)
        self._missing = self.wall_timer(ASK_AGAIN, self._ask_again)

    def deactivate(self) -> None:
        """Ask for nothing any more; a plan on its way goes on."""
        self.destroy_timer(self._waiting)
        self.destroy_timer(self._missing)

    def cleanup(self) -> None:
        """Give up the action."""
        self._client.destroy()

    def diagnose(self) -> Diagnosis:
        """Return what is being walked."""
        return Diagnosis(
            self._label or ("plan sent" if self._request is not None else "waiting for a conductor")
        )

    def _ask(self) -> None:
        """Ask for the plan, and look for the answer."""
        if self._request is None:
            if self._client.server_is_ready():
                # a shipped plan by its name: the conductor brings it within the limits of its bench
                text = self.parameter("plan") if self._plan.written_for else self._plan.to_yaml()
                self._request = PlanRequest(self._client, RunPlan.Goal(plan=text), self._on_feedback)
        elif self._handle is None and (handle := self._request.answer()) is not None:
            self.destroy_timer(self._waiting)
            if handle.accepted:
                self._handle, self._heard = handle, time.monotonic()
                handle.get_result_async().add_done_callback(self._on_result)
            else:
                self.fault(
                    "plan_refused",
                    "the conductor refused the plan: it is executing another one, or not active",
                )

    def _ask_again(self) -> None:
        """Ask for the result once more where nothing is heard: the first answer may be lost."""
        if self._handle is not None and time.monotonic() - self._heard > ASK_AGAIN:
            self._handle.get_result_async().add_done_callback(self._on_result)

    def _on_feedback(self, message: Any) -> None:
        self._heard = time.monotonic()
        feedback = message.feedback
        label = f"segment {feedback.segment + 1} of {feedback.segments}: {feedback.label}"
        if label != self._label:
            self._label = label
            self.get_logger().info(f"plan {self._plan.name}: {feedback.elapsed:.0f} s, {label}")

    def _on_result(self, future: Any) -> None:
        if self._handle is None:  # another answer came before
            return
        self._handle = None
        result = future.result().result
        if result.success:
            self.get_logger().info(result.message)
            self.stop()
            return
        self.fault(fault_of(result.message), result.message)


def main() -> int:
    """Run the node."""
    return run_node(PlanClientNode)
