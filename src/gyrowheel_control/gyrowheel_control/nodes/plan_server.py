"""The action server of the conductor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer
from rclpy.action.server import ServerGoalHandle


class PlanServer(ActionServer):
    """Action server whose goals are worked on by callbacks of the node instead of one for the whole goal.

    ``goal.execute()`` marks a goal as executing; ``notify_execute(goal, callback)`` ends it with what the
    callback returns. A coroutine that waits for the end of a plan would be polled by the events executor
    without a pause.
    """

    def notify_execute(
        self, goal_handle: ServerGoalHandle, execute_callback: Callable[..., Any] | None
    ) -> None:
        """Run `execute_callback` if there is one."""
        if execute_callback is not None:
            super().notify_execute(goal_handle, execute_callback)
