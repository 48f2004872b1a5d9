"""The node ``conductor``: walks test plans on request of the action ``/gyrowheel/run_plan``.

It publishes the setpoints of a plan ahead of the time of the bench, and before them what the operator changes
on the rig. That time comes from ``/clock`` where somebody publishes it, as the plant does in lock-step. Elsewhere it
comes from the stamps of the samples, or of the joint states where the same node publishes these, which are few; a clock
of somebody who publishes no samples, such as a simulation beside a bench in real time, is left alone. A plan starts at
the time at which it was asked for, so at 0 in a lock-step graph that was just started.

A plan ends early, and says why, when the clock jumps or stands, a node of the bench reports an error, such as a
guard that has tripped, or the wheel does not follow: whoever controls it, the joint states, or where there are none the
samples, show whether it comes to a setpoint that stands still (`Tracking`). The last setpoint is then held. Where the
conductor itself is deactivated, the controller does so, and brings the wheel to rest. The tilt limit that a plan needs
is set in the controller before it starts.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from gyrowheel_msgs.action import RunPlan
from numpy.typing import NDArray
from rclpy.action import CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.subscription import Subscription
from std_msgs.msg import String

from gyrowheel_control.loops.supervision import Tracking, plan_tilt_limit, tilt_limit
from gyrowheel_control.nodes.bench_observer import TimeSources, WheelWatch
from gyrowheel_control.nodes.controller_limit import ControllerLimit
from gyrowheel_control.nodes.plan_server import PlanServer
from gyrowheel_control.plans.adaptation import plan_for
from gyrowheel_control.plans.plan import HOLD, RAMP, SETPOINT_PERIOD, Plan
from gyrowheel_core import namespaces, topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PRIORITY, BenchNode, Diagnosis, Newcomers, Param, run_node
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import to_json

#: Relative, as all names are: they move with the namespace of the node.
ACTION = "gyrowheel/run_plan"
SETPOINT_PERIOD_NS = round(SETPOINT_PERIOD * 1e9)
#: Plans start and end at whole multiples of this, at which the plant publishes the clock [ns].
CLOCK_PERIOD_NS = 10_000_000
POLL_PERIOD = 0.05
#: How long a goal waits for somebody who listens to the setpoints [s].
MATCHING_TIMEOUT = 120.0
#: How long a publisher of the clock is looked for before the samples tell the time [s].
CLOCK_TIMEOUT = 0.5
#: How long a clock of somebody else that is there may be silent before it counts as standing at 0 [s].
CLOCK_SILENCE = 2.5
#: How long in real time a plan goes on without any command [ns].
COMMANDLESS_NS = 5_000_000_000
#: A step of the clock beyond this is a jump [ns].
JUMP_NS = 1_000_000_000
#: Name of the guard.
TRACKING_LOST = "tracking_lost"
_MOTION = ("tilt_rate_x", "tilt_rate_y", "spin_acceleration")


@dataclass
class Walk:
    """A plan on its way."""

    goal: ServerGoalHandle
    plan: Plan
    setpoints: NDArray[Any]
    tilt_limit: float  # [rad]
    waits_for: str = "somebody who listens to the setpoints"
    start_ns: int | None = None  # set once somebody listens
    deadline: float = 0.0  # for that, by the clock of `time.monotonic`
    timeless: float | None = (
        None  # since when nothing but the time of the bench is missing, by the same clock
    )
    told: tuple[int, int] = (-1, -1)  # segment and second of the last feedback


class ConductorNode(BenchNode):
    """Walks test plans: takes the action /gyrowheel/run_plan, publishes setpoints."""

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
        self._told_time = False  # whether it is known
        self._standing = 0.0  # for how long it has not gone on [s, wall clock]
        self._polled = time.monotonic()
        self._released = (
            False  # whether the plant said that the controller has left, and another one may come
        )
        self._commandless = False  # whether the plant said, in real time, that no command has come yet
        self._plant_seen = False  # whether one has said anything
        self._plant_stopped = False  # whether the plant said that it is not active
        self._samples: Subscription | None = None  # tell the time where there is no clock
        self._time_sources = TimeSources(self)
        self._samples_due = 0  # time from which on the next sample does [ns]
        self._walk: Walk | None = None
        self._held: NDArray[Any] | None = None  # one setpoint, published after the plan
        self._next = 0  # stamp of the next setpoint to publish [ns]
        self._moved = True  # whether the time has gone on since the last poll
        self._wheel = WheelWatch(self._tracking, self._asked)
        self._setpoints = self.publisher(topics.SETPOINT)
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
            cancel_callback=self._on_cancel,
        )

    def activate(self) -> None:
        """Accept plans."""
        self.prioritise()
        self._poll = self.wall_timer(POLL_PERIOD, self._on_poll)

    def deactivate(self) -> None:
        """End a plan that is on its way and accept no more."""
        self.destroy_timer(self._poll)
        self._finish("aborted: the conductor was stopped")
        self._held = None
        self.deliver(self._setpoints)

    def cleanup(self) -> None:
        """Give up topics and action."""
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
        """Take over the tilt limit, for the next plan, and what counts as not following."""
        self._tilt_limit = self._limit(self.parameter("tilt_limit"))
        self._wheel.begin()

    def diagnose(self) -> Diagnosis:
        """Return what is being walked."""
        limit = self._tilt_limit if self._walk is None else self._walk.tilt_limit
        values = {
            "simulated_time": f"{self._now * 1e-9:.3f}",
            "time_from": "samples" if self._samples is not None else "clock",
            "tilt_limit_deg": f"{math.degrees(limit):g}",
        }
        if self._wheel.lost:
            values["guard"] = TRACKING_LOST
            return Diagnosis(f"{TRACKING_LOST}: {self._wheel.lost}", values, DiagnosticStatus.ERROR)
        if self._walk is None:
            return Diagnosis("holding" if self._held is not None else "waiting for a plan", values)
        values["plan"] = self._walk.plan.name
        if self._walk.start_ns is None:
            return Diagnosis(f"waiting for {self._walk.waits_for}", values)
        return Diagnosis(f"walking plan {self._walk.plan.name}", values)

    # ---- action

    def _on_goal(self, request: RunPlan.Goal) -> GoalResponse:
        if self.state != "active" or self._walk is not None:
            self.get_logger().warning(
                "a plan is refused: another one is on its way, or the node is not active"
            )
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        return CancelResponse.ACCEPT  # noticed in _on_poll, also while the clock is stopped

    def _begin(self, goal: ServerGoalHandle) -> None:
        goal.execute()
        try:
            plan = plan_for(goal.request.plan, self._bench)
            limit = plan_tilt_limit(plan, self._bench, self._tilt_limit)
            setpoints = plan.setpoints()
        except InputError as error:
            self._conclude(goal, RunPlan.Result(success=False, message=str(error)))
            return
        if len(setpoints) * SETPOINT_PERIOD_NS % CLOCK_PERIOD_NS:
            setpoints = np.concatenate([setpoints, self._after(setpoints, plan)])
        self._walk = Walk(goal, plan, setpoints, limit, deadline=time.monotonic() + MATCHING_TIMEOUT)
        if self._controller_limit is not None:
            self._controller_limit.begin(plan.name, limit)
        self._on_poll()

    def _on_poll(self) -> None:
        # a process that was stopped itself has heard nothing: long pauses count as a short one
        now = time.monotonic()
        self._standing += min(now - self._polled, 2 * POLL_PERIOD)
        self._polled = now
        if self._newcomers.look(goes_on=self._moved, now=now):
            self._publish_again()
        self._moved = False
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
            if listeners >= needed and rigs >= needed:
                try:
                    limited = self._controller_limit is None or self._controller_limit.is_set(
                        self._tilt_limit
                    )
                except InputError as error:
                    self._finish(str(error))
                    return
                if not limited:
                    walk.waits_for = "the controller to take the tilt limit"
                elif not self._time_is_known(walk):
                    walk.waits_for = "the time of the bench"
                    walk.timeless = walk.timeless or now
                    # a clock that is silent is taken to stand at 0 sooner than that
                    if now - walk.timeless > max(self.parameter("clock_timeout"), 2.0 * CLOCK_SILENCE):
                        self._finish(
                            "aborted: clock_stands: nobody tells the time of the bench: neither a clock, nor samples"
                        )
                else:
                    self._start(walk)
            elif time.monotonic() > walk.deadline:
                self._finish(
                    f"nobody listens: after {MATCHING_TIMEOUT:g} s {topics.SETPOINT.name} has {listeners} of "
                    f"{needed} subscribers, {topics.ENVIRONMENT.name} has {rigs}"
                )
        elif self._standing > self.parameter("clock_timeout"):
            why = (
                "the plant is not active"
                if self._plant_stopped
                else "nobody answers its last sample, or it is gone"
            )
            self._hold_here(walk)
            self._finish(
                f"aborted: clock_stands: the time of the bench has stood at {self._now * 1e-9:.3f} s for "
                f"{self.parameter('clock_timeout'):g} s: {why}"
            )

    def _limit(self, wanted: float) -> float:
        return tilt_limit(self._bench, wanted, "parameter tilt_limit")

    def _time_is_known(self, walk: Walk) -> bool:
        """Return whether there is a time to start from: that of the clock, or else of the samples."""
        waited = time.monotonic() - walk.deadline + MATCHING_TIMEOUT
        if self._samples is None:
            foreign = self._time_sources.clock_is_foreign()
            if foreign is None:
                return False
            if foreign:
                self._told_time, self._now = False, 0
                self._samples = self._time_of_samples()
        if self._told_time:
            return True
        if self._samples is None and self.count_publishers(topics.CLOCK.relative):
            # our plant says the time again and again while it stands; another clock that is silent stands at 0
            return waited > (self.parameter("clock_timeout") if self._plant_seen else CLOCK_SILENCE)
        if self._samples is None and waited > CLOCK_TIMEOUT:
            self._samples = self._time_of_samples()
        return False

    def _time_of_samples(self) -> Subscription:
        """Return what tells the time from now on, in the place of a clock."""
        topic = self._time_sources.stamps()
        heard = self._on_sample if topic is topics.MEASUREMENT else self._on_stamp
        return self.subscription(topic, heard, raw=True)

    def _start(self, walk: Walk) -> None:
        start = self._now if self._held is None else max(self._now, self._next)
        start += -start % CLOCK_PERIOD_NS
        if self._held is not None:
            self._publish_held(self._held, start)
            self._held = None
        machine = self.parameter("machine")
        events = [
            replace(event, time=event.time + start * 1e-9, machine=machine)
            for event in walk.plan.environment()
        ]
        self._environment.publish(String(data=to_json(events)))
        # The plant must have them before the command that the first setpoint brings about.
        self.deliver(self._environment)
        walk.start_ns = self._next = start
        self._wheel.begin()
        self._newcomers.begin()
        self._standing = 0.0
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
        try:
            now = wire.CLOCK.unpack(raw)[0]
        except ValueError:  # from a node that is not of this bench
            return
        if self._samples is None or self._time_sources.clock_is_foreign() is False:
            self._advance(now)

    def _on_sample(self, raw: bytes) -> None:
        """Take the time from a sample, and look at it if nothing else shows whether the wheel follows."""
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
        """End a plan when a node of the bench says that it has failed."""
        for status in message.status:
            if namespaces.is_of_another(status.hardware_id, self.namespace):
                continue
            name = namespaces.local_name(status.name, self.namespace)
            if name == self.get_name():
                continue
            if name == "plant":
                self._plant_seen = True
                self._plant_stopped = status.level == DiagnosticStatus.WARN and status.message == "inactive"
                guard = next((pair.value for pair in status.values if pair.key == "guard"), "")
                self._released = guard == "released"
                self._note_commands(waiting=guard == "waiting")
            # such as a guard that has tripped: the wheel no longer is where the plan has it
            names = {pair.key for pair in status.values}
            ended = "fault" in names and name in ("plant", self._controller)
            if status.level == DiagnosticStatus.ERROR and ("guard" in names or ended):
                if self._walk is not None:
                    self._hold_here(self._walk)
                self._finish(f"aborted: {name}: {status.message}")

    def _note_commands(self, *, waiting: bool) -> None:
        """End a plan in real time that no command answers: the time would go on to its end without the wheel."""
        walk = self._walk
        self._commandless = waiting and self._samples is not None  # in lock-step the time stands
        if not self._commandless or walk is None or walk.start_ns is None:
            return
        if self._now - walk.start_ns > COMMANDLESS_NS:
            self._hold_here(walk)
            self._finish("aborted: controller_silent: no command has come since the plan began")

    def _lose(self) -> None:
        """End the plan because the wheel does not follow it."""
        if self._walk is not None:
            self._hold_here(self._walk)
        self._finish(f"aborted: {TRACKING_LOST}: {self._wheel.lost}")
        self.announce()

    def _asked(self, stamp: int) -> list[float] | None:
        """Return the setpoint that a reading of a time [ns] is to follow; None where there is none."""
        walk, rows, row = self._walk, self._held, 0
        if walk is not None and walk.start_ns is not None:
            rows = walk.setpoints
            row = min((stamp - walk.start_ns) // SETPOINT_PERIOD_NS, len(rows) - 1)
        if rows is None or row < 0 or self._released or self._commandless or self._plant_stopped:
            return None
        return [float(rows[name][row]) for name in wire.SETPOINT.fields]

    def _tracking(self) -> Tracking:
        return Tracking(*(self.parameter(f"tracking_{name}") for name in ("tilt", "spin", "time")))

    def _advance(self, now: int) -> None:
        """Go on to the time `now` [ns]."""
        walk, step = self._walk, now - self._now
        if step < 0 or (step > JUMP_NS and walk is not None and walk.start_ns is not None):
            then = f"from {self._now * 1e-9:.3f} s to {now * 1e-9:.3f} s"
            if step > 0 and walk is not None:
                self._hold_here(walk)  # nothing else would: the setpoints that were published are over
                self._next = now - now % SETPOINT_PERIOD_NS
            else:
                self._held = None
            self._now, self._standing = now, 0.0
            self._wheel.begin()
            if step < 0:
                reason = "the simulated time went back, the plant was started again"
                self._finish(f"aborted: clock_jump: {reason} ({then})")
            elif self._plant_stopped:
                self._finish(f"aborted: plant_stopped: the plant was not active, and the time went {then}")
            else:
                self._finish(f"aborted: clock_jump: the time went {then}")
            if self._held is not None:
                self._publish_held(self._held, now + self._lead_ns)
            return
        self._told_time = True
        if step:
            self._standing, self._moved = 0.0, True
        self._now = now
        if walk is not None and walk.start_ns is not None:
            if now < walk.start_ns + len(walk.setpoints) * SETPOINT_PERIOD_NS:
                self._go_on(walk)
            elif self._commandless and self.parameter("hold_after_plan"):
                # it is known by the next diagnosis whether a command has come
                self._publish_held(self._after(walk.setpoints, walk.plan), now + self._lead_ns)
            else:
                self._held = (
                    self._after(walk.setpoints, walk.plan) if self.parameter("hold_after_plan") else None
                )
                self._finish()
        if self._held is not None:
            self._publish_held(self._held, now + self._lead_ns)

    def _go_on(self, walk: Walk) -> None:
        """Publish the setpoints up to `lead` ahead of the clock, and tell the client about progress."""
        assert walk.start_ns is not None
        if self._released and self._samples is not None:  # in lock-step the time itself waits
            self._wait(walk)
            return
        first = (self._next - walk.start_ns) // SETPOINT_PERIOD_NS
        last = (self._now + self._lead_ns - walk.start_ns) // SETPOINT_PERIOD_NS
        self._publish_rows(walk.setpoints[first : max(last, first + 1)])
        if last > len(walk.setpoints) and self.parameter("hold_after_plan"):
            # ahead of the clock too: in real time the bench is past the end before this node hears of it
            self._publish_held(self._after(walk.setpoints, walk.plan), self._now + self._lead_ns)
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

    def _wait(self, walk: Walk) -> None:
        """Publish the last setpoint again, as one that is not to be measured at, and move what follows."""
        assert walk.start_ns is not None
        row = min(max((self._next - walk.start_ns) // SETPOINT_PERIOD_NS, 1), len(walk.setpoints)) - 1
        still = self._still(walk.setpoints[row : row + 1])
        still["phase"] = RAMP
        count = max((self._now + self._lead_ns - self._next) // SETPOINT_PERIOD_NS, 0)
        self._publish_rows(np.repeat(still, count))
        walk.start_ns += count * SETPOINT_PERIOD_NS

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

    def _publish_again(self) -> None:
        """Publish the setpoint in force, and those to come, for nodes that have come while the time stands."""
        after = self._next
        since = self._now - self._now % SETPOINT_PERIOD_NS
        rows = self._held
        if self._walk is not None and self._walk.start_ns is not None:
            since = max(since, self._walk.start_ns)
            first, last = ((t - self._walk.start_ns) // SETPOINT_PERIOD_NS for t in (since, after))
            rows = self._walk.setpoints[first:last]
        elif rows is not None:
            rows = np.repeat(rows, max((after - since) // SETPOINT_PERIOD_NS, 0))
        if rows is not None and len(rows):
            self._next = since
            self._publish_rows(rows)

    def _publish_held(self, held: NDArray[Any], until: int) -> None:
        """Publish the setpoint that is held up to, not including, the stamp `until` [ns]."""
        count = (until - self._next) // SETPOINT_PERIOD_NS
        if count > 0:
            self._publish_rows(np.repeat(held, count))

    def _hold_here(self, walk: Walk) -> None:
        """Hold the last setpoint that was published of a plan that ends early."""
        if walk.start_ns is None or not self.parameter("hold_after_plan"):
            return
        published = (self._next - walk.start_ns) // SETPOINT_PERIOD_NS
        if published >= len(walk.setpoints):
            self._held = self._after(walk.setpoints, walk.plan)
        else:
            self._held = self._still(walk.setpoints[published - 1 : published])

    def _after(self, setpoints: NDArray[Any], plan: Plan) -> NDArray[Any]:
        """Return the setpoint that holds what a plan ends with."""
        held = self._still(setpoints[-1:])
        held["spin_rate"] = plan.segments[-1].spin_end
        return held

    @staticmethod
    def _still(setpoint: NDArray[Any]) -> NDArray[Any]:
        """Return a copy of one setpoint, shape (1,), with zero rates."""
        held = setpoint.copy()
        held["phase"] = HOLD
        for name in _MOTION:
            held[name] = 0.0
        return held


def main() -> int:
    """Run the node."""
    return run_node(ConductorNode)
