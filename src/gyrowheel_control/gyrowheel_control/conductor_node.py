"""The node ``conductor``: walks test plans on request of the action ``/gyrowheel/run_plan``.

It publishes the setpoints of a plan ahead of the simulated clock, and before them what the operator changes
on the rig. A plan starts at the simulated time at which it was asked for, so at 0 in a graph that was just
started.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from gyrowheel_msgs.action import RunPlan
from numpy.typing import NDArray
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from std_msgs.msg import String

from gyrowheel_control.plans import HOLD, SETPOINT_PERIOD, Plan
from gyrowheel_sim import topics, wire
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import to_json
from gyrowheel_sim.errors import InputError
from gyrowheel_sim.node import BenchNode, Diagnosis, Param, run_node

ACTION = "/gyrowheel/run_plan"
SETPOINT_PERIOD_NS = round(SETPOINT_PERIOD * 1e9)
#: Plans start and end at whole multiples of this, at which the plant publishes the clock [ns].
CLOCK_PERIOD_NS = 10_000_000
#: How long a goal waits for somebody who listens to the setpoints [s].
MATCHING_TIMEOUT = 120.0
_MOTION = ("tilt_rate_x", "tilt_rate_y", "spin_acceleration")


@dataclass
class Walk:
    """A plan on its way."""

    goal: ServerGoalHandle
    plan: Plan
    setpoints: NDArray[Any]
    start_ns: int | None = None  # set once somebody listens
    deadline: float = 0.0  # for that, by the clock of `time.monotonic`
    told: tuple[int, int] = (-1, -1)  # segment and second of the last feedback


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


class ConductorNode(BenchNode):
    """Walks test plans: takes the action /gyrowheel/run_plan, publishes setpoints."""

    NODE_NAME = "conductor"
    PARAMETERS = (
        Param("bench", "gyrowheel", "Bench whose limits bind the plans: shipped name, or path of a file"),
        Param("hold_after_plan", True, "After a plan go on publishing its last setpoint"),
        Param("lead", 0.5, "How far the setpoints run ahead of the clock [s]", low=0.02, high=10.0),
        Param("wait_for_subscribers", 1, "Subscribers needed for the first setpoint", low=0, high=100),
    )

    def configure(self) -> None:
        """Read the bench, create topics and action."""
        self._bench = Bench.load(self.parameter("bench"))
        self._lead_ns = round(self.parameter("lead") * 1e9)
        self._now = 0  # simulated time [ns]
        self._walk: Walk | None = None
        self._reserved = False  # a goal was accepted and has not begun yet
        self._held: NDArray[Any] | None = None  # one setpoint, published after the plan
        self._next = 0  # stamp of the next setpoint to publish [ns]
        self._setpoints = self.publisher(topics.SETPOINT)
        self._environment = self.publisher(topics.ENVIRONMENT)
        self._input = self.subscription(topics.CLOCK, self._on_clock, raw=True)
        self._server = PlanServer(
            self,
            RunPlan,
            ACTION,
            execute_callback=self._begin,  # required, never called: `_begin` is called on acceptance
            goal_callback=self._on_goal,
            handle_accepted_callback=self._begin,
            cancel_callback=self._on_cancel,
        )

    def activate(self) -> None:
        """Accept plans."""
        self._poll = self.wall_timer(0.05, self._on_poll)

    def deactivate(self) -> None:
        """End a plan that is on its way and accept no more."""
        self.destroy_timer(self._poll)
        self._finish("aborted: the conductor was stopped")
        self._held = None
        self.deliver(self._setpoints)

    def cleanup(self) -> None:
        """Give up topics and action."""
        self._server.destroy()
        self.destroy_subscription(self._input)
        self.destroy_publisher(self._setpoints)
        self.destroy_publisher(self._environment)

    def diagnose(self) -> Diagnosis:
        """Return what is being walked."""
        values = {"simulated_time": f"{self._now * 1e-9:.3f}"}
        if self._walk is None:
            return Diagnosis("holding" if self._held is not None else "waiting for a plan", values)
        values["plan"] = self._walk.plan.name
        if self._walk.start_ns is None:
            return Diagnosis("waiting for somebody who listens to the setpoints", values)
        return Diagnosis(f"walking plan {self._walk.plan.name}", values)

    # ---- action

    def _on_goal(self, request: RunPlan.Goal) -> GoalResponse:
        if self.state != "active" or self._walk is not None or self._reserved:
            self.get_logger().warning(
                "a plan is refused: another one is on its way, or the node is not active"
            )
            return GoalResponse.REJECT
        self._reserved = True
        return GoalResponse.ACCEPT

    def _on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        return CancelResponse.ACCEPT  # noticed in _on_poll, also while the clock stands still

    def _begin(self, goal: ServerGoalHandle) -> None:
        self._reserved = False
        goal.execute()
        try:
            plan = Plan.load(goal.request.plan)
            plan.check(self._bench)
            setpoints = plan.setpoints()
        except InputError as error:
            self._conclude(goal, RunPlan.Result(success=False, message=str(error)))
            return
        if len(setpoints) * SETPOINT_PERIOD_NS % CLOCK_PERIOD_NS:
            setpoints = np.concatenate([setpoints, self._after(setpoints, plan)])
        self._walk = Walk(goal, plan, setpoints, deadline=time.monotonic() + MATCHING_TIMEOUT)
        self._on_poll()

    def _on_poll(self) -> None:
        walk = self._walk
        if walk is None:
            return
        if walk.goal.is_cancel_requested:
            self._hold_here(walk)
            self._finish("cancelled")
        elif walk.start_ns is None:
            needed = self.parameter("wait_for_subscribers")
            listeners = self._setpoints.get_subscription_count()
            rigs = self._environment.get_subscription_count()
            if listeners >= needed and rigs >= min(needed, 1):
                self._start(walk)
            elif time.monotonic() > walk.deadline:
                self._finish(
                    f"nobody listens: after {MATCHING_TIMEOUT:g} s {topics.SETPOINT.name} has {listeners} of "
                    f"{needed} subscribers, {topics.ENVIRONMENT.name} has {rigs} of {min(needed, 1)}"
                )

    def _start(self, walk: Walk) -> None:
        start = self._now if self._held is None else max(self._now, self._next)
        start += -start % CLOCK_PERIOD_NS
        if self._held is not None:
            self._publish_held(start)
            self._held = None
        events = [replace(event, time=event.time + start * 1e-9) for event in walk.plan.environment()]
        self._environment.publish(String(data=to_json(events)))
        # The plant must have them before the command that the first setpoint brings about.
        self.deliver(self._environment)
        walk.start_ns = self._next = start
        self.get_logger().info(f"plan {walk.plan.name}: {walk.plan.duration:g} s from {start * 1e-9:g} s on")
        self._go_on(walk)

    def _finish(self, message: str = "") -> None:
        """End the plan on its way; no message: it went to its end."""
        walk, self._walk = self._walk, None
        if walk is None:
            return
        elapsed = 0.0 if walk.start_ns is None else (self._now - walk.start_ns) * 1e-9
        done = sum(segment.end <= elapsed + 1e-9 for segment in walk.plan.segments)
        result = RunPlan.Result(
            success=not message,
            message=message or f"plan {walk.plan.name} completed",
            segments=done,
            duration=min(elapsed, walk.plan.duration),
        )
        self._conclude(walk.goal, result)

    def _conclude(self, goal: ServerGoalHandle, result: RunPlan.Result) -> None:
        self.get_logger().info(result.message)

        def end(goal: ServerGoalHandle) -> RunPlan.Result:
            if result.success:
                goal.succeed()
            elif goal.is_cancel_requested:
                goal.canceled()
            else:
                goal.abort()
            return result

        self._server.notify_execute(goal, end)

    # ---- setpoints

    def _on_clock(self, raw: bytes) -> None:
        (now,) = wire.CLOCK.unpack(raw)
        if now < self._now:
            self._now, self._held = now, None
            self._finish("aborted: the simulated time went back, the plant was started again")
            return
        self._now = now
        walk = self._walk
        if walk is not None and walk.start_ns is not None:
            if now >= walk.start_ns + len(walk.setpoints) * SETPOINT_PERIOD_NS:
                self._held = (
                    self._after(walk.setpoints, walk.plan) if self.parameter("hold_after_plan") else None
                )
                self._finish()
            else:
                self._go_on(walk)
        if self._held is not None:
            self._publish_held(now + self._lead_ns)

    def _go_on(self, walk: Walk) -> None:
        """Publish the setpoints up to `lead` ahead of the clock, and tell the client about progress."""
        assert walk.start_ns is not None
        first = (self._next - walk.start_ns) // SETPOINT_PERIOD_NS
        last = (self._now + self._lead_ns - walk.start_ns) // SETPOINT_PERIOD_NS
        self._publish_rows(walk.setpoints[first : max(last, first + 1)])
        row = (self._now - walk.start_ns) // SETPOINT_PERIOD_NS
        segment = int(walk.setpoints["segment"][max(row, 0)])
        elapsed = max(self._now - walk.start_ns, 0) * 1e-9
        told = (segment, int(elapsed))
        if told != walk.told:
            walk.told = told
            walk.goal.publish_feedback(
                RunPlan.Feedback(
                    segment=segment,
                    segments=len(walk.plan.segments),
                    label=walk.plan.segments[segment].label,
                    elapsed=elapsed,
                    duration=walk.plan.duration,
                )
            )

    def _publish_rows(self, rows: NDArray[Any]) -> None:
        """Publish setpoints, the first of them at the next stamp."""
        messages = wire.SETPOINT.array(len(rows))
        wire.SETPOINT.set_stamps(messages, self._next + np.arange(len(rows)) * SETPOINT_PERIOD_NS)
        for name in (*wire.SETPOINT.integers, *wire.SETPOINT.fields):
            messages[name] = rows[name]
        data, size = messages.tobytes(), wire.SETPOINT.size
        for place in range(0, len(data), size):
            self._setpoints.publish(data[place : place + size])
        self._next += len(rows) * SETPOINT_PERIOD_NS

    def _publish_held(self, until: int) -> None:
        """Publish the held setpoint up to, not including, the stamp `until` [ns]."""
        assert self._held is not None
        count = (until - self._next) // SETPOINT_PERIOD_NS
        if count > 0:
            self._publish_rows(np.repeat(self._held, count))

    def _hold_here(self, walk: Walk) -> None:
        """Hold the last setpoint that was published of a plan that ends early."""
        if walk.start_ns is None or not self.parameter("hold_after_plan"):
            return
        row = min((self._next - walk.start_ns) // SETPOINT_PERIOD_NS, len(walk.setpoints)) - 1
        self._held = self._still(walk.setpoints[row : row + 1])

    def _after(self, setpoints: NDArray[Any], plan: Plan) -> NDArray[Any]:
        """Return the setpoint that holds what a plan ends with."""
        held = self._still(setpoints[-1:])
        held["spin_rate"] = plan.segments[-1].spin_end
        return held

    @staticmethod
    def _still(setpoint: NDArray[Any]) -> NDArray[Any]:
        """Return a copy of one setpoint, shape (1,), that stands still."""
        held = setpoint.copy()
        held["phase"] = HOLD
        for name in _MOTION:
            held[name] = 0.0
        return held


def main() -> int:
    """Run the node."""
    return run_node(ConductorNode)
