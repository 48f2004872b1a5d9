"""The node ``plan_client``: sends one plan to the conductor, logs its progress, and ends with it.

For launch files, which only start processes and notice their end: exit code 0 after a completed plan, else 3, with the
reason in the last line.
"""

from __future__ import annotations

import time
from typing import Any

from gyrowheel_msgs.action import RunPlan
from rclpy.action import ActionClient

from gyrowheel_bringup.graph.plan_run import PlanRequest, fault_of
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.node import BenchNode, NodeStatus, Param, RepeatedRequest, run_node


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
