"""The conductor alone, as a process: plans, the time that they go by, and what ends them."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest
import rclpy
from builtin_interfaces.msg import Time as Stamp
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from gyrowheel_msgs.action import RunPlan
from rclpy.action import ActionClient
from rclpy.node import Node
from sensor_msgs.msg import JointState

from gyrowheel_bringup.graph.plan_client import PlanRequest, run_plan
from gyrowheel_bringup.graph.results import GraphError
from gyrowheel_control.plans.plan import HOLD, RAMP, SETPOINT_PERIOD, Plan
from gyrowheel_core import topics, wire
from gyrowheel_core.node import endpoints
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.environment import from_json, to_json

from .helpers import LONG_PLAN, PATIENCE, SHORT_PLAN, Bystander, NodeProcess, end_process

pytestmark = pytest.mark.graph

Start = Callable[..., NodeProcess]
LEAD_NS = 100_000_000


class Client:
    """Asks the conductor for plans, and moves the clock by hand."""

    def __init__(self, bystander: Bystander, *, clock: Node | None = None) -> None:
        self.bystander = bystander
        self.setpoints: list[tuple[Any, ...]] = []
        self.environments: list[str] = []
        self.feedback: list[Any] = []
        topic = topics.CLOCK
        self.clock = (clock or bystander.node).create_publisher(topic.message_class, topic.name, topic.qos)
        bystander.listen(
            topics.SETPOINT, lambda raw: self.setpoints.append(wire.SETPOINT.unpack(raw)), raw=True
        )
        bystander.listen(topics.ENVIRONMENT, lambda message: self.environments.append(message.data))
        self.action = ActionClient(bystander.node, RunPlan, "/gyrowheel/run_plan")
        bystander.spin_until(lambda: self.action.server_is_ready() and self.clock.get_subscription_count())

    def ask(self, plan: str) -> Any:
        """Return the goal handle."""
        request = PlanRequest(
            self.action, RunPlan.Goal(plan=plan), lambda message: self.feedback.append(message.feedback)
        )
        return self.bystander.spin_until(request.answer)

    def result(self, goal: Any) -> Any:
        future = goal.get_result_async()
        self.bystander.spin_until(future.done)
        return future.result().result

    def move_clock(self, start: int, stop: int) -> None:
        """Publish the clock every 10 ms [ns]; the setpoints follow."""
        for now in range(start, stop + 1, 10_000_000):
            self.clock.publish(wire.CLOCK.pack(now))
            while self.setpoints[-1][0] < now + LEAD_NS - 5_000_000:
                count = len(self.setpoints)
                self.bystander.spin_until(lambda count=count: len(self.setpoints) > count)  # type: ignore[misc]


def test_conductor_walks_holds_and_refuses(bystander: Bystander, start_node: Start):
    conductor = start_node("conductor", lead=LEAD_NS * 1e-9)
    client = Client(bystander)

    goal = client.ask("no_such_plan")
    assert "plan 'no_such_plan': no such shipped plan or file" in client.result(goal).message
    result = client.result(client.ask(SHORT_PLAN.replace("[1.0, 0.5]", "[80.0, 0.5]")))
    assert not result.success
    assert "tilt 80.00 deg is beyond the bench; allowed: up to" in result.message
    assert not client.setpoints

    plan = Plan.load(SHORT_PLAN)
    rows = plan.setpoints()
    goal = client.ask(SHORT_PLAN)
    assert goal.accepted
    bystander.spin_until(lambda: len(client.setpoints) == LEAD_NS // 5_000_000)
    assert client.environments == [to_json(plan.environment())]
    assert not client.ask("quick").accepted  # one at a time
    end = len(rows) * 5_000_000
    client.move_clock(0, end - 10_000_000)  # what is held afterwards is known before the end, too
    assert not client.setpoints[-1][0] < end
    client.move_clock(end, end)
    result = client.result(goal)
    assert result.success
    assert (result.segments, result.duration) == (len(plan.segments), pytest.approx(plan.duration))
    assert [tuple(s) for s in client.setpoints[: len(rows)]] == [tuple(row) for row in rows.tolist()]
    assert {f.label for f in client.feedback} == {"level", "tilted", "faster", "cone"}

    # it holds the last state, and the next plan follows without a gap
    bystander.spin_until(lambda: client.setpoints[-1][0] == end + LEAD_NS - 5_000_000)
    held = client.setpoints[-1]
    assert held[5:7] == (0.0, 0.0)
    count = len(client.setpoints)
    goal = client.ask(LONG_PLAN)
    bystander.spin_until(lambda: len(client.setpoints) > count)
    assert client.setpoints[count][0] == held[0] + 5_000_000
    start = client.setpoints[count][0] * 1e-9
    assert from_json(client.environments[-1])[0].time == pytest.approx(start)

    # cancelled: it goes on holding, also while the clock stands still
    cancelling = goal.cancel_goal_async()
    bystander.spin_until(cancelling.done)
    result = client.result(goal)
    assert (result.success, result.message) == (False, "cancelled")
    client.move_clock(end, end + 200_000_000)
    stamps = [s[0] for s in client.setpoints]
    assert stamps == list(range(0, stamps[-1] + 1, 5_000_000))

    # a plan on its way is answered when the node is told to end
    goal = client.ask(LONG_PLAN)
    future = goal.get_result_async()
    bystander.spin_until(lambda: len(client.setpoints) > len(stamps))
    conductor.process.send_signal(2)
    bystander.spin_until(future.done)
    assert "the conductor was stopped" in future.result().result.message
    assert conductor.process.wait(PATIENCE) == 0


def test_a_plan_that_starts_where_a_tilt_is_held_moves_from_there(bystander: Bystander, start_node: Start):
    start_node("conductor", lead=LEAD_NS * 1e-9)
    client = Client(bystander)
    goal = client.ask(SHORT_PLAN)
    bystander.spin_until(lambda: client.setpoints)
    end = round(Plan.load(SHORT_PLAN).duration * 1e9)
    client.move_clock(0, end)
    assert client.result(goal).success
    bystander.spin_until(lambda: client.setpoints[-1][0] == end + LEAD_NS - 5_000_000)
    held = client.setpoints[-1]
    assert abs(complex(held[3], held[4])) > 0.5 * DEG

    client.ask(LONG_PLAN)
    client.move_clock(end, end + 600_000_000)
    after = [s for s in client.setpoints if s[0] >= held[0]]
    assert after[-1][2:] == (HOLD, 0.0, 0.0, 0.0, 0.0, pytest.approx(2000.0 * RPM), 0.0)
    tilts = [complex(s[3], s[4]) for s in after]
    steps = [abs(b - a) for a, b in pairwise(tilts)]
    assert max(steps) <= 8.0 * DEG * SETPOINT_PERIOD * (1.0 + 1e-9)  # the rate of the plan
    speeds = [s[7] for s in after]
    steps = [abs(b - a) for a, b in pairwise(speeds)]
    assert max(steps) <= 1000.0 * RPM * SETPOINT_PERIOD * (1.0 + 1e-9)
    # the rate in a message times the period is the change to the next message
    for now, then in pairwise(after):
        if now[2] == RAMP and then[2] == RAMP:
            assert then[3] - now[3] == pytest.approx(now[5] * SETPOINT_PERIOD, abs=1e-12)


def test_a_plan_ends_where_the_time_stands_or_jumps_and_its_setpoint_is_held(
    bystander: Bystander, start_node: Start
):
    start_node("conductor", lead=LEAD_NS * 1e-9, clock_timeout=1.5)
    client = Client(bystander)
    goal = client.ask(LONG_PLAN)
    bystander.spin_until(lambda: client.setpoints)
    client.move_clock(0, 200_000_000)
    result = client.result(goal)
    assert not result.success
    # at 0.2 s; on a busy machine it may have stood before that
    assert re.fullmatch(
        r"aborted: clock_stands: the time of the bench has stood at 0\.[012]\d\d s for 1\.5 s: "
        "nobody answers its last sample, or it is gone",
        result.message,
    )
    client.move_clock(210_000_000, 300_000_000)  # it holds
    stamps = [s[0] for s in client.setpoints]
    assert stamps == list(range(0, stamps[-1] + 1, 5_000_000))

    goal = client.ask(LONG_PLAN)
    bystander.spin_until(lambda: client.setpoints[-1][0] > stamps[-1])
    late = 5_000_000_000
    client.clock.publish(wire.CLOCK.pack(late))
    assert client.result(goal).message.startswith(
        "aborted: clock_jump: the time went from 0.300 s to 5.000 s"
    )
    bystander.spin_until(lambda: client.setpoints[-1][0] == late + LEAD_NS - 5_000_000)
    last = client.setpoints[-1]
    assert (last[2], last[5:7], last[8]) == (1, (0.0, 0.0), 0.0)


#: A conductor that loses its first answer to a plan: it cannot be sent, or nobody gets it.
FORGETFUL = """
import sys
from rclpy.impl.implementation_singleton import rclpy_implementation as middleware
from gyrowheel_control.nodes.conductor import main

send, how, lost = middleware.ActionServer.send_goal_response, sys.argv.pop(1), []

def lose(*answer):
    if lost:
        return send(*answer)
    lost.append(answer)
    if how == "unsent":
        raise middleware.RCLError("client will not receive response")

middleware.ActionServer.send_goal_response = lose
raise SystemExit(main())
"""


@pytest.mark.parametrize("how", ["unsent", "lost"])
def test_a_plan_is_walked_once_although_the_first_answer_to_it_is_lost(
    how: str, domain: int, bystander: Bystander, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(endpoints, "ASK_AGAIN", 0.5)
    process = subprocess.Popen(
        [
            *(sys.executable, "-c", FORGETFUL, how),
            *("--ros-args", "-p", "controller:=none", "-p", f"lead:={LEAD_NS * 1e-9}"),
        ],
        env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
    )
    try:
        client = Client(bystander)
        now = 0

        def spin() -> None:
            nonlocal now
            bystander.executor.spin_once(timeout_sec=0.005)
            if not client.setpoints or client.setpoints[-1][0] >= now + LEAD_NS - 5_000_000:
                now += 10_000_000 if client.setpoints else 0
                client.clock.publish(wire.CLOCK.pack(now))

        plan = Plan.load(SHORT_PLAN)
        result = run_plan(
            client.action,
            plan,
            spin=spin,
            stalled=lambda what: GraphError("stalled", what),
            patience=PATIENCE,
        )
        assert result is not None
        assert result.success, result.message
        rows = plan.setpoints()
        assert [tuple(s) for s in client.setpoints[: len(rows)]] == [tuple(row) for row in rows.tolist()]
        assert len(client.environments) == 1
    finally:
        end_process(process)


def test_a_plan_ends_where_nobody_tells_the_time(bystander: Bystander, start_node: Start):
    start_node("conductor", clock_timeout=1.0)
    client = Client(bystander)
    bystander.node.destroy_publisher(client.clock)
    message = client.result(client.ask(LONG_PLAN)).message
    assert message.startswith("aborted: clock_stands: nobody tells the time of the bench")
    assert not client.setpoints


def test_the_clock_of_somebody_else_is_left_alone_where_samples_tell_the_time(
    bystander: Bystander, start_node: Start
):
    """Such as that of a simulation in the same domain, beside a bench in real time."""
    other = rclpy.create_node("simulator", context=bystander.context, use_global_arguments=False)
    samples = bystander.publisher(topics.MEASUREMENT)
    start_node("conductor", lead=LEAD_NS * 1e-9)
    client = Client(bystander, clock=other)
    client.clock.publish(wire.CLOCK.pack(5_000_000_000))
    future = client.ask(LONG_PLAN).get_result_async()
    begin, now = 100_000_000_000, 100_000_000_000

    def publish() -> None:
        nonlocal now
        now += 10_000_000
        samples.publish(wire.MEASUREMENT.pack(now, now // 10_000_000, *[0.0] * 11))
        client.clock.publish(wire.CLOCK.pack(now - begin))  # its own time goes on, too

    def enough() -> bool:
        stamps = [setpoint[0] for setpoint in client.setpoints]
        return future.done() or (bool(stamps) and stamps[-1] > stamps[0] + wire.SECOND)

    bystander.spin_until(enough, publish=publish)
    assert not future.done()
    stamps = [setpoint[0] for setpoint in client.setpoints]
    assert begin < stamps[0] <= now
    assert stamps == list(range(stamps[0], stamps[-1] + 1, 5_000_000))
    other.destroy_node()


def test_in_real_time_a_plan_that_no_command_answers_is_no_success(bystander: Bystander, start_node: Start):
    """Before the first command the plant has nothing to hold, and its watchdog waits."""
    samples, diagnostics = bystander.publisher(topics.MEASUREMENT), bystander.publisher(topics.DIAGNOSTICS)
    start_node("conductor", lead=LEAD_NS * 1e-9)
    client = Client(bystander)
    bystander.node.destroy_publisher(client.clock)
    plan = Plan.load(SHORT_PLAN)
    now, guard = 100_000_000_000, "waiting"

    def publish() -> None:
        nonlocal now
        now += 50_000_000
        samples.publish(wire.MEASUREMENT.pack(now, now // 50_000_000, *[0.0] * 11))
        said = DiagnosticStatus(
            name="plant", hardware_id="gyrowheel", values=[KeyValue(key="guard", value=guard)]
        )
        diagnostics.publish(DiagnosticArray(status=[said]))

    assert plan.duration < 4.0
    future = client.ask(SHORT_PLAN).get_result_async()
    bystander.spin_until(future.done, publish=publish)
    result = future.result().result
    assert (result.success, result.message[:27]) == (False, "aborted: controller_silent:")
    guard = "normal"
    future = client.ask(SHORT_PLAN).get_result_async()
    bystander.spin_until(future.done, publish=publish)
    assert future.result().result.success
    stamps = [setpoint[0] for setpoint in client.setpoints]
    assert stamps == list(range(stamps[0], stamps[-1] + 1, 5_000_000))


@pytest.mark.parametrize("by", [topics.JOINT_STATES, topics.MEASUREMENT], ids=["joint_states", "samples"])
def test_a_wheel_that_does_not_follow_ends_the_plan_whoever_controls_it(
    bystander: Bystander, start_node: Start, by: topics.Topic
):
    """The rotor stays at 3438 rpm, where 1000 are asked for, and then follows."""
    shown = bystander.publisher(by)
    # the samples are heard only once a plan waits for the time: on a busy machine that takes its while
    start_node("conductor", lead=LEAD_NS * 1e-9, controller="none", clock_timeout=60.0)
    client = Client(bystander)
    if by is topics.MEASUREMENT:  # without a clock: the samples tell the time
        bystander.node.destroy_publisher(client.clock)
    plan = "schema: 1\nname: still\nsegments:\n  - {spin_rpm: 1000, tilt_deg: [0, 0], hold_s: 5}\n"
    now, spin = 0, 360.0

    def publish() -> None:
        nonlocal now
        now += 50_000_000
        if by is topics.MEASUREMENT:
            shown.publish(wire.MEASUREMENT.pack(now, now // 50_000_000, *[0.0] * 3, spin, *[0.0] * 7))
        else:
            client.clock.publish(wire.CLOCK.pack(now))
            arm = JointState(name=["elbow"], position=[0.5], velocity=[0.0])
            wheel = JointState(name=[*topics.JOINTS], position=[0.0] * 3, velocity=[0.0, 0.0, spin])
            for message in (arm, wheel):
                message.header.stamp = Stamp(sec=now // 10**9, nanosec=now % 10**9)
                shown.publish(message)

    future = client.ask(plan).get_result_async()
    bystander.spin_until(future.done, publish=publish)
    result = future.result().result
    assert not result.success
    told = "tracking_lost: the wheel does not follow: asked 0.00 deg and 1000 rpm, got 0.00 deg and 3438 rpm"
    assert result.message == f"aborted: {told} for 3 s"
    bystander.spin_until(lambda: bystander.values("conductor").get("guard") == "tracking_lost")
    assert bystander.diagnoses["conductor"].level == DiagnosticStatus.ERROR
    spin = 1000.0 * RPM
    future = client.ask(plan).get_result_async()
    bystander.spin_until(future.done, publish=publish)
    assert future.result().result.success, future.result().result.message
