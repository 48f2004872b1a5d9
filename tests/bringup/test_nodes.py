"""Controller, estimator and recorder alone, each as a process, and what all nodes do: parameters, lifecycle."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from gyrowheel_core import topics, wire

from .helpers import PATIENCE, Bystander, NodeProcess

pytestmark = pytest.mark.graph

Start = Callable[..., NodeProcess]
LEAD_NS = 100_000_000
LEAVING = """
import sys
import rclpy
from gyrowheel_analysis.nodes.drag_estimator import DragEstimatorNode
from gyrowheel_control.nodes.conductor import ConductorNode
from gyrowheel_control.nodes.controller import ControllerNode
from gyrowheel_control.nodes.joint_commands import JointCommandsNode
from gyrowheel_core.node import make_executor, prepare_environment
from gyrowheel_recording.nodes.recorder import RecorderNode
from gyrowheel_sim.plant.node import PlantNode

prepare_environment()
rclpy.init(domain_id=int(sys.argv[1]))
observer = rclpy.create_node("observer")
kept = []
for kind in PlantNode, ControllerNode, ConductorNode, JointCommandsNode, DragEstimatorNode, RecorderNode:
    node, executor = kind(), make_executor()
    executor.add_node(node)
    node.start()
    print(observer.get_node_names())
    node.finish(executor)
    node.take_apart(executor)
    node.destroy_node()
    kept.append(node)
print(observer.get_node_names())
"""


def test_bad_parameters_end_a_node_with_one_line(start_node: Start):
    nodes = {
        "parameter lead: 99.0 is not allowed; allowed: a number 0.02 .. 10": start_node(
            "conductor", lead=99.0
        ),
        "bench 'no/such.yaml'": start_node("conductor", bench="no/such.yaml"),
        "no/such.json": start_node("plant", scenario_file="no/such.json"),
    }
    for line, node in nodes.items():
        assert node.process.wait(PATIENCE) == 2
        assert line in node.output
        assert node.output.count("\n") == 1
        assert "Traceback" not in node.output


def test_a_node_that_is_destroyed_leaves_the_graph(domain: int):
    """What stays in the middleware has threads that run into the exit of the process."""
    done = subprocess.run(
        [sys.executable, "-c", LEAVING, str(domain)],
        capture_output=True,
        text=True,
        check=True,
        timeout=PATIENCE,
    )
    nodes = ["plant", "controller", "conductor", "joint_commands", "drag_estimator", "recorder"]
    assert done.stdout.splitlines() == [*(f"['observer', '{name}']" for name in nodes), "['observer']"]


def test_a_lifecycle_manager_can_run_a_node(bystander: Bystander, start_node: Start):
    conductor = start_node("conductor", autostart="false")
    calls = {
        name: bystander.node.create_client(kind, f"/conductor/{name}")
        for name, kind in (
            ("get_state", GetState),
            ("change_state", ChangeState),
            ("set_parameters", SetParameters),
        )
    }

    def call(name: str, request: Any) -> Any:
        return bystander.call(calls[name], request)

    def change(label: str) -> bool:
        return bool(call("change_state", ChangeState.Request(transition=Transition(label=label))).success)

    def set_parameter(name: str, value: Any) -> Any:
        parameter = Parameter(name, value=value).to_parameter_msg()
        return call("set_parameters", SetParameters.Request(parameters=[parameter])).results[0]

    def state() -> str:
        return str(call("get_state", GetState.Request()).current_state.label)

    assert state() == "unconfigured"
    assert not set_parameter("lead", 99.0).successful
    assert set_parameter("bench", "no/such.yaml").successful
    assert not change("configure")  # said in the log; the node goes on
    assert state() == "unconfigured"
    assert set_parameter("bench", "gyrowheel").successful
    assert change("configure")
    assert change("activate")
    assert state() == "active"
    assert "fixed" in set_parameter("lead", 1.0).reason
    for label in ("deactivate", "cleanup", "configure", "activate", "deactivate"):
        assert change(label)
    assert not change("deactivate")  # not from here
    assert not change("no_such_transition")
    assert state() == "inactive"
    assert conductor.interrupt() == 0
    assert "bench 'no/such.yaml'" in conductor.output
    assert "Traceback" not in conductor.output


def test_an_inactive_estimator_leaves_samples_out(bystander: Bystander, start_node: Start):
    start_node("drag_estimator")
    samples, setpoints = bystander.publisher(topics.MEASUREMENT), bystander.publisher(topics.SETPOINT)
    change = bystander.node.create_client(ChangeState, "/drag_estimator/change_state")
    period = 500_000

    def send(first: int) -> None:
        """Send two hundred samples, and the setpoint that comes after them; return when they have arrived."""
        for number in range(first, first + 200):
            samples.publish(wire.MEASUREMENT.pack(number * period, number, *[0.0] * 11))
        setpoints.publish(wire.SETPOINT.pack((first + 200) * period, 0, 0, *[0.0] * 6))
        assert samples.wait_for_all_acked()
        assert setpoints.wait_for_all_acked()

    def trigger(label: str) -> None:
        assert bystander.call(change, ChangeState.Request(transition=Transition(label=label))).success

    bystander.spin_until(lambda: bystander.values("drag_estimator").get("state") == "active")
    for ready in (samples.get_subscription_count, setpoints.get_subscription_count, change.service_is_ready):
        bystander.spin_until(ready)
    send(0)
    bystander.spin_until(lambda: bystander.values("drag_estimator").get("samples") == "200")
    trigger("deactivate")
    send(200)
    trigger("activate")
    send(400)
    bystander.spin_until(lambda: bystander.values("drag_estimator").get("first_sample") == "400")
    bystander.spin_until(lambda: bystander.values("drag_estimator").get("samples") == "200")
    assert bystander.values("drag_estimator")["missing_samples"] == "0"


def test_gains_and_limits_change_while_a_node_works(bystander: Bystander, start_node: Start):
    start_node("controller")
    bystander.spin_until(lambda: bystander.values("controller").get("state") == "active")
    client = bystander.node.create_client(SetParameters, "/controller/set_parameters")

    def set_parameter(name: str, value: Any) -> Any:
        parameter = Parameter(name, value=value).to_parameter_msg()
        return bystander.call(client, SetParameters.Request(parameters=[parameter])).results[0]

    assert bystander.values("controller")["tilt_limit_deg"] == "3"
    assert set_parameter("tilt_bandwidth", 10.0).successful
    assert "out of range Min: 0.0, Max: 60.0" in set_parameter("tilt_bandwidth", 1e3).reason
    assert set_parameter("tilt_limit", math.radians(4.0)).successful
    bystander.spin_until(lambda: bystander.values("controller").get("tilt_limit_deg") == "4")
    refused = set_parameter("tilt_limit", math.radians(4.9))
    assert refused.reason.endswith("too near to the hard stop at 5.00 deg; allowed: up to 4.75 deg")
    assert "fixed" in set_parameter("bench", "dtg").reason


def test_setpoints_are_limited_or_refused_and_a_deactivated_controller_lets_go(
    bystander: Bystander, start_node: Start
):
    commands: list[tuple[Any, ...]] = []
    controller = start_node("controller", wait_for_subscribers=1)
    samples, setpoints = bystander.publisher(topics.MEASUREMENT), bystander.publisher(topics.SETPOINT)
    bystander.listen(topics.COMMAND, lambda raw: commands.append(wire.COMMAND.unpack(raw)), raw=True)
    bystander.spin_until(lambda: samples.get_subscription_count() and setpoints.get_subscription_count())
    bystander.spin_until(lambda: bystander.said("controller") == "waiting for a sample")

    def answer(sequence: int, tilt: float, *, reading: float = 0.0) -> None:
        now = sequence * 500_000
        setpoints.publish(wire.SETPOINT.pack(now, 0, 1, tilt, 0.0, 0.0, 0.0, 200.0, 0.0))
        samples.publish(wire.MEASUREMENT.pack(now, sequence, reading, 0.0, 0.0, 200.0, *[0.0] * 7))

    answer(0, 0.01)
    bystander.spin_until(lambda: len(commands) == 1)
    answer(10, math.radians(20.0))
    bystander.spin_until(lambda: len(commands) == 2)
    answer(20, 0.01, reading=math.nan)
    bystander.spin_until(lambda: bystander.values("controller").get("refused_samples") == "1")
    answer(30, math.nan)  # its sample waits for another setpoint
    bystander.spin_until(lambda: bystander.values("controller").get("refused_setpoints") == "1")
    assert bystander.values("controller")["limited_setpoints"] == "1"
    assert "input_refused" in bystander.diagnoses["controller"].message
    controller.process.send_signal(2)
    bystander.spin_until(lambda: len(commands) == 3)
    assert controller.process.wait(PATIENCE) == 0
    assert [command[1] for command in commands] == [0, 10, 30]
    assert commands[-1][2:] == (0.0, 0.0, commands[1][4])


def test_without_setpoints_the_controller_holds_and_comes_to_rest(bystander: Bystander, start_node: Start):
    start_node("controller", wait_for_subscribers=1)
    answers: list[tuple[Any, ...]] = []
    bystander.listen(topics.COMMAND, lambda raw: answers.append(wire.COMMAND.unpack(raw)), raw=True)
    samples, setpoints = bystander.publisher(topics.MEASUREMENT), bystander.publisher(topics.SETPOINT)
    bystander.spin_until(lambda: bystander.said("controller") == "waiting for a sample")
    bystander.spin_until(lambda: samples.get_subscription_count() and setpoints.get_subscription_count())
    sent = 0

    def all_answered() -> bool:
        return bool(answers) and answers[-1][1] == sent - 1

    def send(seconds: float, spin: float, asked: float | None = None) -> None:
        """Send a sample every 5 ms of bench time, and with it a setpoint if a spin rate is asked for."""
        nonlocal sent
        for _ in range(round(seconds / 0.005)):
            stamp = sent * 5_000_000
            if asked is not None:
                setpoints.publish(wire.SETPOINT.pack(stamp, 0, 1, 0.0, 0.0, 0.0, 0.0, asked, 0.0))
            samples.publish(
                wire.MEASUREMENT.pack(stamp, sent, 0.0, 0.0, 0.0, spin, *[0.0] * 4, *[293.0] * 2, 1e5)
            )
            sent += 1
            if asked is not None:  # in the same order there as here
                bystander.spin_until(all_answered)
        bystander.spin_until(all_answered)

    send(0.1, 200.0, asked=200.0)
    answered = len(answers)
    held = answers[-1][4]
    send(1.0, 200.0)
    # the first one waits for its setpoint until the next one comes; then every one is answered
    assert len(answers) == answered + 199
    assert answers[-1][4] == pytest.approx(held, rel=0.02)
    bystander.spin_until(lambda: bystander.said("controller").startswith("setpoint_lost: "))
    assert bystander.diagnoses["controller"].level == DiagnosticStatus.WARN
    send(1.0, 200.0)
    assert answers[-1][4] < 0.5 * held  # the wheel still turns, and is to come to rest
    send(0.1, 200.0, asked=200.0)
    bystander.spin_until(lambda: bystander.said("controller") == "running")


def test_samples_of_another_frame_are_told(bystander: Bystander, start_node: Start):
    start_node("controller")
    samples = bystander.publisher(topics.MEASUREMENT)
    bystander.listen(topics.COMMAND, lambda _: None, raw=True)
    bystander.spin_until(lambda: bystander.said("controller") == "waiting for a sample")
    bystander.spin_until(samples.get_subscription_count)
    sample = wire.MEASUREMENT.pack(0, 0, *[0.0] * 11)
    samples.publish(sample.replace(b"case\0", b"base\0"))
    wanted = "input_refused: gyrowheel_msgs/msg/Measurement: frame_id is not 'case'"
    bystander.spin_until(lambda: bystander.said("controller") == wanted)
    assert bystander.diagnoses["controller"].level == DiagnosticStatus.WARN


def test_the_recorder_tells_of_a_stall_at_once(bystander: Bystander, start_node: Start, tmp_path: Path):
    """A shorter one that comes right after does not hide it."""
    said: list[str] = []
    bystander.listen(
        topics.DIAGNOSTICS,
        lambda message: said.extend(status.message for status in message.status if status.name == "recorder"),
    )
    recorder = start_node("recorder", directory=tmp_path / "run")
    samples = bystander.publisher(topics.MEASUREMENT)
    bystander.spin_until(samples.get_subscription_count)
    stamp, stalls = 0, {100: 295_000_000, 110: 4_000_000}
    for number in range(200):
        stamp += 500_000 + stalls.get(number, 0)
        samples.publish(wire.MEASUREMENT.pack(stamp, number, *[0.0] * 11))
    bystander.spin_until(lambda: bystander.values("recorder").get("stalls") == "2")
    assert "recording; the bench stood still 0.295 s at 0.0 s" in said
    assert recorder.interrupt() == 0
