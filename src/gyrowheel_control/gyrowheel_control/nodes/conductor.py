"""The node ``conductor``: runs test plans on request of the action ``/gyrowheel/run_plan``.

It publishes the setpoints of a plan ahead of the bench's time, and before them the changes that the operator makes on
the rig. That time comes from ``/clock`` where one is published, as by the plant in lock-step; elsewhere from the stamps
of the samples, or of the less frequent joint states if the same node publishes both. A clock of a node that publishes
no samples, such as a simulation next to a bench in real time, is ignored. A plan starts at the time of its request,
thus at 0 in a lock-step graph that has just started.

A plan that starts where a setpoint is held begins with a ramp from there, whatever start it states.

A plan ends early, with the reason, when the clock jumps or stands, when a node of the bench reports an error (such as
a tripped guard), or when the wheel does not follow: whichever node controls it, the joint states, or the samples where
there are none, show whether it reaches a constant setpoint (`Tracking`). The last setpoint is then held. If the
conductor itself is deactivated, the controller does so and brings the wheel to rest. The conductor sets the tilt limit
of a plan in the controller before the plan starts.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from gyrowheel_msgs.action import RunPlan
from numpy.typing import NDArray
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.subscription import Subscription
from std_msgs.msg import String

from gyrowheel_control.loops.supervision import Tracking, plan_tilt_limit, tilt_limit
from gyrowheel_control.nodes.bench_exchange import (
    SETPOINT_PERIOD_NS,
    ControllerLimit,
    SetpointStream,
    TimeSources,
    WheelWatch,
    at_rest,
    final_hold,
)
from gyrowheel_control.plans.adaptation import plan_for, plan_from_hold
from gyrowheel_control.plans.plan import RAMP, Plan
from gyrowheel_core import namespaces, topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PRIORITY, BenchNode, Newcomers, NodeStatus, Param, run_node
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import to_json

#: Relative, as all names are: they move with the namespace of the node.
ACTION = "gyrowheel/run_plan"
#: Plans start and end at whole multiples of this, at which the plant publishes the clock [ns].
CLOCK_PERIOD_NS = 10_000_000
POLL_PERIOD = 0.05
#: Time for which a goal waits for subscribers of the setpoints [s].
MATCHING_TIMEOUT = 120.0
#: Time for which a publisher of the clock is awaited before the samples give the time [s].
CLOCK_TIMEOUT = 0.5
#: Silence after which an existing clock of another node counts as standing at 0 [s].
CLOCK_SILENCE = 2.5
#: Time for which a plan in real time continues without any command [ns].
COMMANDLESS_NS = 5_000_000_000
#: A step of the clock beyond this is a jump [ns].
JUMP_NS = 1_000_000_000
#: Name of the guard.
TRACKING_LOST = "tracking_lost"


def leap(step: int, passed: int) -> str:
    """Return the named reason why the time went on by a `step` at once, `passed` after it was last told [ns].

    A clock that is set leaps between two samples; where nothing came for as long as the step, nobody set it.
    """
    if passed < step // 2:
        return "clock_jump: the time went"
    return (
        f"stood_still: no sample came for {passed * 1e-9:.1f} s, as the computer was too busy for a bench in real time "
        "or plant or conductor was stopped: the time went"
    )


@dataclass
class Walk:
    """A plan in progress."""

    #: The goal of the action, its plan, and the setpoints of the plan.
    goal: ServerGoalHandle
    plan: Plan
    setpoints: NDArray[Any]
    tilt_limit: float  # tilt limit of the plan [rad]
    waits_for: str = "somebody who listens to the setpoints"  # the condition that is missing before the start
    start_ns: int | None = None  # time of the start [ns]; None before it
    deadline: float = 0.0  # time up to which subscribers may appear, by `time.monotonic` [s]
    timeless: float | None = None  # time since which only the bench's time is missing, by the same clock [s]
    told: tuple[int, int] = (-1, -1)  # segment and second of the last feedback


class PlanServer(ActionServer):
    """Action server whose goals are processed by callbacks of the node instead of one callback for the whole goal.

    ``goal.execute()`` marks a goal as executing; ``notify_execute(goal, callback)`` ends it with the result of the
    callback. The events executor would poll a coroutine that waits for the end of a plan without a pause.
    """

    def notify_execute(
        self, goal_handle: ServerGoalHandle, execute_callback: Callable[..., Any] | None
    ) -> None:
        """Run `execute_callback` if there is one."""
        if execute_callback is not None:
            super().notify_execute(goal_handle, execute_callback)


class ConductorNode(BenchNode):
    """Runs test plans: takes the action /gyrowheel/run_plan, publishes setpoints."""

    NODE_NAME = "conductor"
    PARAMETERS = (
        Param("bench", "gyrowheel", "Bench whose limits bind the plans: shipped name, or path of a file"),
        Param("machine", "", "Name of the machine on the rig, for the environment; empty: unknown"),
        Param("hold_after_plan", True, "After a plan go on publishing its last setpoint"),
        Param("lead", 0.5, "How far the setpoints run ahead of the clock [s]", low=0.02, high=10.0),
        Param(
            "clock_timeout",
            20.0,
            "How long the time of the bench may stand during a plan [s, wall clock]",
            low=0.1,
            high=3600.0,
        ),
        Param("wait_for_subscribers", 1, "Subscribers needed for the first setpoint", low=0, high=100),
        Param(
            "tilt_limit",
            0.0,
            "Largest tilt of plans that do not say that they need more [rad]; 0: three fifths of the bench's hard stop",
            low=0.0,
            high=1.0,
            live=True,
        ),
        Param(
            "controller",
            "controller",
            "Node that is given the tilt limit of each plan; none: no node has a limit to be set",
        ),
        Param(
            "tracking_tilt",
            math.radians(0.5),
            "Tilt error that ends a plan where it lasts although the setpoint stands still [rad]",
            low=1e-6,
            high=1.0,
            live=True,
        ),
        Param("tracking_spin", 20.0, "The same for the spin rate [rad/s]", low=1e-3, high=2000.0, live=True),
        Param("tracking_time", 3.0, "How long such an error may last [s]", low=0.01, high=600.0, live=True),
        PRIORITY,
    )

    def configure(self) -> None:
        """Read the bench, create topics and action."""
        self._bench = Bench.load(self.parameter("bench"))
        self._tilt_limit = self._limit(self.parameter("tilt_limit"))
        self._lead_ns = round(self.parameter("lead") * 1e9)
        self._now = 0  # time of the bench [ns]
        self._time_known = False
        self._advanced_ns = 0  # time of the last report of progress [ns, monotonic clock]
        self._standing = 0.0  # for how long the time of the bench has stood [s, wall clock]
        self._moved = True  # whether it has advanced since the last poll
        self._polled = time.monotonic()
        # as last reported by the plant: it was heard of; it is inactive; its controller has left and another may come;
        # no command has come yet, in real time
        self._plant_seen = self._plant_stopped = self._released = self._commandless = False
        self._samples: Subscription | None = None  # gives the time where there is no clock
        self._samples_due = 0  # time from which on the next sample does [ns]
        self._time_sources = TimeSources(self)
        self._walk: Walk | None = None
        self._held: NDArray[Any] | None = None  # one setpoint, published after the plan
        self._wheel = WheelWatch(self._tracking, self._asked)
        self._setpoints = self.publisher(topics.SETPOINT)
        self._stream = SetpointStream(self._setpoints.publish)
        self._newcomers = Newcomers(self, topics.SETPOINT)
        self._environment = self.publisher(topics.ENVIRONMENT)
        self._inputs = [
            self.subscription(topics.CLOCK, self._on_clock, raw=True),
            self.subscription(topics.DIAGNOSTICS, self._on_diagnostics),
            self.subscription(topics.JOINT_STATES, self._on_joints, raw=True),
        ]
        controller = self.parameter("controller")
        self._controller = namespaces.local_name(controller.strip("/"), self.namespace)
        self._controller_limit = (
            ControllerLimit(self, controller, self._on_poll) if controller not in ("", "none") else None
        )
        self._server = PlanServer(
            self,
            RunPlan,
            ACTION,
            execute_callback=self._begin,  # required, never called: `_begin` is called on acceptance
            goal_callback=self._on_goal,
            handle_accepted_callback=self._begin,
            cancel_callback=lambda _: (
                CancelResponse.ACCEPT
            ),  # noticed by `_on_poll`, also while the clock stands
        )

    def activate(self) -> None:
        """Accept plans."""
        self.prioritise()
        self._poll = self.wall_timer(POLL_PERIOD, self._on_poll)

    def deactivate(self) -> None:
        """End the plan in progress and accept no more."""
        self.destroy_timer(self._poll)
        self._finish("aborted: the conductor was stopped")
        self._held = None
        self.deliver(self._setpoints)

    def cleanup(self) -> None:
        """Destroy topics and action."""
        self._server.destroy()
        for subscription in (*self._inputs, self._samples):
            if subscription is not None:
                self.destroy_subscription(subscription)
        if self._controller_limit is not None:
            self._controller_limit.destroy()
        self.destroy_publisher(self._setpoints)
        self.destroy_publisher(self._environment)

    def check_tuning(self, values: Mapping[str, Any]) -> None:
        """Refuse a tilt limit beyond that of the bench."""
        self._limit(values["tilt_limit"])

    def tune(self) -> None:
        """Adopt the tilt limit, for the next plan, and the bounds of tracking."""
        self._tilt_limit = self._limit(self.parameter("tilt_limit"))
        self._wheel.begin()

    def diagnose(self) -> NodeStatus:
        """Return the plan in progress, and whether the wheel follows."""
        walk = self._walk
        values = {
            "simulated_time": f"{self._now * 1e-9:.3f}",
            "time_from": "samples" if self._samples is not None else "clock",
            "tilt_limit_deg": f"{math.degrees(walk.tilt_limit if walk else self._tilt_limit):g}",
        }
        if self._wheel.lost:
            values["guard"] = TRACKING_LOST
            return NodeStatus(f"{TRACKING_LOST}: {self._wheel.lost}", values, DiagnosticStatus.ERROR)
        if walk is None:
            return NodeStatus("holding" if self._held is not None else "waiting for a plan", values)
        values["plan"] = walk.plan.name
        if walk.start_ns is None:
            return NodeStatus(f"waiting for {walk.waits_for}", values)
        return NodeStatus(f"walking plan {walk.plan.name}", values)

    # ---- the action, and the start of a plan

    def _on_goal(self, request: RunPlan.Goal) -> GoalResponse:
        if self.state != "active" or self._walk is not None:
            self.get_logger().warning("plan refused: another one is in progress, or the node is not active")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _begin(self, goal: ServerGoalHandle) -> None:
        goal.execute()
        try:
            plan = plan_for(goal.request.plan, self._bench)
            if self._held is not None:
                at = {name: float(self._held[name][0]) for name in wire.SETPOINT.fields}
                tilt = complex(at["tilt_x"], at["tilt_y"])
                plan = plan_from_hold(plan, self._bench, tilt, at["spin_rate"])
            limit = plan_tilt_limit(plan, self._bench, self._tilt_limit)
            setpoints = plan.setpoints()
        except InputError as error:
            self._conclude(goal, RunPlan.Result(success=False, message=str(error)))
            return
        if len(setpoints) * SETPOINT_PERIOD_NS % CLOCK_PERIOD_NS:
            setpoints = np.concatenate([setpoints, final_hold(setpoints, plan)])
        self._walk = Walk(goal, plan, setpoints, limit, deadline=time.monotonic() + MATCHING_TIMEOUT)
        if self._controller_limit is not None:
            self._controller_limit.begin(plan.name, limit)
        self._on_poll()

    def _on_poll(self) -> None:
        # a process that was itself suspended has received nothing: a long pause counts as a short one
        now = time.monotonic()
        self._standing += min(now - self._polled, 2 * POLL_PERIOD)
        self._polled = now
        if self._newcomers.look(goes_on=self._moved, now=now):
            self._resend()
        self._moved = False
        walk, patience = self._walk, self.parameter("clock_timeout")
        if walk is None:
            return
        if walk.goal.is_cancel_requested:
            self._hold_here(walk)
            self._finish("cancelled")
        elif walk.start_ns is None:
            try:
                self._start_if_ready(walk, now)
            except InputError as error:
                self._finish(str(error))
        elif self._standing > patience:
            why = (
                "the plant is not active"
                if self._plant_stopped
                else "nobody answers its last sample, or it is gone"
            )
            self._abort(
                f"clock_stands: the time of the bench has stood at {self._now * 1e-9:.3f} s for {patience:g} s: {why}"
            )

    def _start_if_ready(self, walk: Walk, now: float) -> None:
        """Start a plan if nothing is missing; InputError once something has been missing for too long."""
        needed = self.parameter("wait_for_subscribers")
        listeners = self._setpoints.get_subscription_count()
        rigs = self._environment.get_subscription_count()
        if listeners < needed or rigs < needed:
            if time.monotonic() > walk.deadline:
                raise InputError(
                    f"nobody listens: after {MATCHING_TIMEOUT:g} s {topics.SETPOINT.name} has {listeners} of "
                    f"{needed} subscribers, {topics.ENVIRONMENT.name} has {rigs}"
                )
        elif self._controller_limit is not None and not self._controller_limit.is_set(self._tilt_limit):
            walk.waits_for = "the controller to take the tilt limit"
        elif not self._find_time(walk):
            walk.waits_for = "the time of the bench"
            walk.timeless = walk.timeless or now
            # a silent clock counts as standing at 0 before that
            if now - walk.timeless > max(self.parameter("clock_timeout"), 2.0 * CLOCK_SILENCE):
                raise InputError(
                    "aborted: clock_stands: nobody tells the time of the bench: neither a clock, nor samples"
                )
        else:
            self._start(walk)

    def _limit(self, wanted: float) -> float:
        return tilt_limit(self._bench, wanted, "parameter tilt_limit")

    def _find_time(self, walk: Walk) -> bool:
        """Return whether there is a time to start from: that of the clock, or else of the samples."""
        waited = time.monotonic() - walk.deadline + MATCHING_TIMEOUT
        if self._samples is None:
            foreign = self._time_sources.clock_is_foreign()
            if foreign is None:
                return False
            if foreign:
                self._time_known, self._now = False, 0
                self._samples = self._time_of_samples()
        if self._time_known:
            return True
        if self._samples is None and self.count_publishers(topics.CLOCK.relative):
            # our plant repeats the time while it stands; another clock that is silent stands at 0
            return waited > (self.parameter("clock_timeout") if self._plant_seen else CLOCK_SILENCE)
        if self._samples is None and waited > CLOCK_TIMEOUT:
            self._samples = self._time_of_samples()
        return False

    def _time_of_samples(self) -> Subscription:
        """Subscribe to the stamps that give the time in the place of a clock."""
        topic = self._time_sources.stamps()
        heard = self._on_sample if topic is topics.MEASUREMENT else self._on_stamp
        return self.subscription(topic, heard, raw=True)

    def _start(self, walk: Walk) -> None:
        start = self._now if self._held is None else max(self._now, self._stream.next)
        start += -start % CLOCK_PERIOD_NS
        if self._held is not None:
            self._stream.hold(self._held, start)
            self._held = None
        machine = self.parameter("machine")
        events = [
            replace(event, time=event.time + start * 1e-9, machine=machine)
            for event in walk.plan.environment()
        ]
        self._environment.publish(String(data=to_json(events)))
        # The plant must have them before the command that the first setpoint causes.
        self.deliver(self._environment)
        walk.start_ns = self._stream.next = start
        self._wheel.begin()
        self._newcomers.begin()
        self._standing = 0.0
        self.get_logger().info(f"plan {walk.plan.name}: {walk.plan.duration:g} s from {start * 1e-9:g} s on")
        self._continue(walk)

    def _abort(self, reason: str) -> None:
        """End the plan in progress early, and hold its last setpoint."""
        if self._walk is not None:
            self._hold_here(self._walk)
        self._finish(f"aborted: {reason}")

    def _finish(self, message: str = "") -> None:
        """End the plan in progress; without a message it was completed."""
        walk, self._walk = self._walk, None
        if walk is None:
            return
        elapsed = 0.0 if walk.start_ns is None else (self._now - walk.start_ns) * 1e-9
        result = RunPlan.Result(
            success=not message,
            message=message or f"plan {walk.plan.name} completed",
            segments=sum(segment.end <= elapsed + 1e-9 for segment in walk.plan.segments),
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

    # ---- inputs

    def _on_clock(self, raw: bytes) -> None:
        try:
            now = wire.CLOCK.unpack(raw)[0]
        except ValueError:  # from a node of another bench
            return
        if self._samples is None or self._time_sources.clock_is_foreign() is False:
            self._advance(now)

    def _on_sample(self, raw: bytes) -> None:
        """Take the time from a sample, and check tracking by it if nothing else shows the wheel."""
        self._on_stamp(raw)
        if self._wheel.is_due(self._now) and self._wheel.sample(raw):
            self._lose()

    def _on_joints(self, raw: bytes) -> None:
        if self._wheel.joints(raw):
            self._lose()

    def _on_stamp(self, raw: bytes) -> None:
        try:
            now = wire.stamp(raw)
        except ValueError:
            return
        if not self._now <= now < self._samples_due:
            self._samples_due = now - now % CLOCK_PERIOD_NS + CLOCK_PERIOD_NS
            self._advance(now)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        """End a plan when a node of the bench reports that it has failed."""
        for status in message.status:
            name = namespaces.local_name(status.name, self.namespace)
            if namespaces.is_of_another(status.hardware_id, self.namespace) or name == self.get_name():
                continue
            if name == "plant":
                self._note_plant(status)
            # such as a tripped guard: the wheel is no longer where the plan has it
            names = {pair.key for pair in status.values}
            ended = "fault" in names and name in ("plant", self._controller)
            if status.level == DiagnosticStatus.ERROR and ("guard" in names or ended):
                self._abort(f"{name}: {status.message}")

    def _note_plant(self, status: DiagnosticStatus) -> None:
        """Note the state of the plant; end a plan in real time without commands: its time would run to its end."""
        guard = next((pair.value for pair in status.values if pair.key == "guard"), "")
        self._plant_seen = True
        self._plant_stopped = status.level == DiagnosticStatus.WARN and status.message == "inactive"
        self._released = guard == "released"
        self._commandless = guard == "waiting" and self._samples is not None  # in lock-step the time stands
        walk = self._walk
        if (
            self._commandless
            and walk is not None
            and walk.start_ns is not None
            and self._now - walk.start_ns > COMMANDLESS_NS
        ):
            self._abort("controller_silent: no command has come since the plan began")

    def _lose(self) -> None:
        """End the plan because the wheel does not follow it."""
        self._abort(f"{TRACKING_LOST}: {self._wheel.lost}")
        self.announce()

    def _asked(self, stamp: int) -> list[float] | None:
        """Return the setpoint in force for a reading at a time [ns]; None where there is none."""
        walk, rows, row = self._walk, self._held, 0
        if walk is not None and walk.start_ns is not None:
            rows = walk.setpoints
            row = min((stamp - walk.start_ns) // SETPOINT_PERIOD_NS, len(rows) - 1)
        if rows is None or row < 0 or self._released or self._commandless or self._plant_stopped:
            return None
        return [float(rows[name][row]) for name in wire.SETPOINT.fields]

    def _tracking(self) -> Tracking:
        return Tracking(*(self.parameter(f"tracking_{name}") for name in ("tilt", "spin", "time")))

    # ---- setpoints

    def _advance(self, now: int) -> None:
        """Advance to the time `now` [ns]."""
        walk, step, ahead = self._walk, now - self._now, now + self._lead_ns
        running = walk is not None and walk.start_ns is not None
        before, self._advanced_ns = self._advanced_ns, time.monotonic_ns()
        if step < 0 or (step > JUMP_NS and running):
            self._jump(now, self._advanced_ns - before)
        else:
            self._time_known = True
            if step:
                self._standing, self._moved = 0.0, True
            self._now = now
            if walk is not None and walk.start_ns is not None:
                if now < walk.start_ns + len(walk.setpoints) * SETPOINT_PERIOD_NS:
                    self._continue(walk)
                elif self._commandless and self.parameter("hold_after_plan"):
                    # the next diagnosis will show whether a command has come
                    self._stream.hold(final_hold(walk.setpoints, walk.plan), ahead)
                else:
                    hold = self.parameter("hold_after_plan")
                    self._held = final_hold(walk.setpoints, walk.plan) if hold else None
                    self._finish()
        if self._held is not None:
            self._stream.hold(self._held, ahead)

    def _jump(self, now: int, passed: int) -> None:
        """End the plan in progress because the time has jumped to `now` [ns], `passed` after it was last told."""
        back, walk = now < self._now, self._walk
        before, then = self._now, f"from {self._now * 1e-9:.3f} s to {now * 1e-9:.3f} s"
        if not back and walk is not None:
            self._hold_here(walk)  # the setpoints that were published have passed
            self._stream.next = now - now % SETPOINT_PERIOD_NS
        else:
            self._held = None
        self._now, self._standing = now, 0.0
        self._wheel.begin()
        if back:
            reason = "the simulated time went back, the plant was started again"
            self._finish(f"aborted: clock_jump: {reason} ({then})")
        elif self._plant_stopped:
            self._finish(f"aborted: plant_stopped: the plant was not active, and the time went {then}")
        else:
            self._finish(f"aborted: {leap(now - before, passed)} {then}")

    def _continue(self, walk: Walk) -> None:
        """Publish the setpoints up to `lead` ahead of the clock, and report progress to the client."""
        assert walk.start_ns is not None
        if self._released and self._samples is not None:  # in lock-step the time itself waits
            self._wait(walk)
            return
        first = (self._stream.next - walk.start_ns) // SETPOINT_PERIOD_NS
        last = (self._now + self._lead_ns - walk.start_ns) // SETPOINT_PERIOD_NS
        self._stream.send(walk.setpoints[first : max(last, first + 1)])
        if last > len(walk.setpoints) and self.parameter("hold_after_plan"):
            # also ahead of the clock: in real time the bench passes the end before this node is told
            self._stream.hold(final_hold(walk.setpoints, walk.plan), self._now + self._lead_ns)
        row = (self._now - walk.start_ns) // SETPOINT_PERIOD_NS
        segment = int(walk.setpoints["segment"][max(row, 0)])
        elapsed = max(self._now - walk.start_ns, 0) * 1e-9
        if (segment, int(elapsed)) != walk.told:
            walk.told = segment, int(elapsed)
            walk.goal.publish_feedback(
                RunPlan.Feedback(
                    segment=segment,
                    segments=len(walk.plan.segments),
                    label=walk.plan.segments[segment].label,
                    elapsed=elapsed,
                    duration=walk.plan.duration,
                )
            )

    def _wait(self, walk: Walk) -> None:
        """Repeat the last setpoint, marked as a ramp so that nothing is measured there, and delay the rest."""
        assert walk.start_ns is not None
        row = min(max((self._stream.next - walk.start_ns) // SETPOINT_PERIOD_NS, 1), len(walk.setpoints)) - 1
        still = at_rest(walk.setpoints[row : row + 1])
        still["phase"] = RAMP
        before = self._stream.next
        self._stream.hold(still, self._now + self._lead_ns)
        walk.start_ns += self._stream.next - before

    def _resend(self) -> None:
        """Repeat the setpoint in force, and those to come, for nodes that have appeared while the time stands."""
        after, since = self._stream.next, self._now - self._now % SETPOINT_PERIOD_NS
        walk, held = self._walk, self._held
        if walk is not None and walk.start_ns is not None:
            since = max(since, walk.start_ns)
            first, last = ((t - walk.start_ns) // SETPOINT_PERIOD_NS for t in (since, after))
            self._stream.resend(walk.setpoints[first:last], since)
        elif held is not None:
            self._stream.resend(np.repeat(held, max((after - since) // SETPOINT_PERIOD_NS, 0)), since)

    def _hold_here(self, walk: Walk) -> None:
        """Hold the last published setpoint of a plan that ends early."""
        if walk.start_ns is None or not self.parameter("hold_after_plan"):
            return
        published = (self._stream.next - walk.start_ns) // SETPOINT_PERIOD_NS
        if published >= len(walk.setpoints):
            self._held = final_hold(walk.setpoints, walk.plan)
        else:
            self._held = at_rest(walk.setpoints[published - 1 : published])


def main() -> int:
    """Run the node."""
    return run_node(ConductorNode)
