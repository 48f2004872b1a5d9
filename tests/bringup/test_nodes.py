"""Each node alone, as a process: its parameters, its faults, its part of the protocol."""

from __future__ import annotations

import json
import math
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time as Stamp
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from gyrowheel_msgs.action import RunPlan
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import topics, wire
from gyrowheel_core.units import RPM
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import from_json, to_json

from .helpers import LONG_PLAN, PATIENCE, SHORT_PLAN, Beat, Bystander, NodeProcess, odd_bench

pytestmark = pytest.mark.graph

Start = Callable[..., NodeProcess]
LEAD_NS = 100_000_000


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
        bystander.spin_until(calls[name].service_is_ready)
        future = calls[name].call_async(request)
        bystander.spin_until(future.done)
        return future.result()

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
        answer = change.call_async(ChangeState.Request(transition=Transition(label=label)))
        bystander.spin_until(answer.done)
        assert answer.result().success

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
    bystander.spin_until(client.service_is_ready)

    def set_parameter(name: str, value: Any) -> Any:
        parameter = Parameter(name, value=value).to_parameter_msg()
        future = client.call_async(SetParameters.Request(parameters=[parameter]))
        bystander.spin_until(future.done)
        return future.result().results[0]

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


class Answers:
    """Takes samples and sends the commands that a test wants."""

    def __init__(self, bystander: Bystander) -> None:
        self.samples: list[int] = []
        self.commands = bystander.publisher(topics.COMMAND)
        bystander.listen(topics.MEASUREMENT, self._on_sample, raw=True)
        bystander.spin_until(lambda: self.samples and self.commands.get_subscription_count())

    def send(self, x: float, y: float, motor: float, *, sequence: int | None = None) -> None:
        answered = self.samples[-1] if sequence is None else sequence
        self.commands.publish(wire.COMMAND.pack(answered * 500_000, answered, x, y, motor))

    def _on_sample(self, raw: bytes) -> None:
        self.samples.append(wire.MEASUREMENT.unpack(raw)[1])


def test_a_command_that_is_not_finite_is_a_named_fault(bystander: Bystander, start_node: Start):
    plant = start_node("plant", initial_spin_rate=200.0)
    answers = Answers(bystander)
    answers.send(0.0, math.nan, 5.0)
    bystander.spin_until(lambda: bystander.values("plant").get("fault") == "command_not_finite")
    assert bystander.diagnoses["plant"].level == DiagnosticStatus.ERROR
    assert plant.process.wait(PATIENCE) == 3
    last = plant.output.strip().rpartition("\n")[2]
    assert last.startswith("plant: command_not_finite: command for sample 0:")
    assert "Traceback" not in plant.output
    assert answers.samples == [0]


def test_plant_publishes_and_counts(bystander: Bystander, start_node: Start):
    heard: dict[str, list[Any]] = {}
    for topic in (topics.CLOCK, topics.JOINT_STATES, topics.BENCH, topics.TRUTH):
        bystander.listen(topic, heard.setdefault(topic.name, []).append)
    start_node("plant", initial_spin_rate=200.0, command_timeout=3600.0, publish_truth="true")
    answers = Answers(bystander)
    for sequence in range(100):
        answers.send(0.0, 0.0, 5.0)
        bystander.spin_until(lambda wanted=sequence + 1: answers.samples[-1] == wanted)  # type: ignore[misc]
    answers.send(0.0, 0.0, 5.0, sequence=99)  # once more
    answers.send(0.0, 0.0, 5.0, sequence=107)  # of a sample to come
    answers.send(1e6, 0.0, 5.0)  # beyond the limit of the coils
    bystander.spin_until(lambda: answers.samples[-1] == 101)

    bystander.spin_until(lambda: len(heard["/clock"]) == 6 and len(heard["/gyrowheel/truth"]) == 6)
    assert [m.clock.nanosec for m in heard["/clock"]] == [10_000_000 * k for k in range(6)]
    truth = [json.loads(m.data) for m in heard["/gyrowheel/truth"]]
    assert [t["time"] for t in truth] == pytest.approx([0.01 * k for k in range(6)])
    assert truth[0]["spin_rate"] == 200.0
    assert json.loads(heard["/gyrowheel/bench"][0].data)["name"] == Bench.load().name
    bystander.spin_until(lambda: len(heard["/joint_states"]) == 4)  # 60 Hz
    assert list(heard["/joint_states"][0].name) == ["tilt_x", "tilt_y", "spin"]

    bystander.spin_until(lambda: bystander.values("plant").get("commands") == "101")
    assert bystander.values("plant")["ignored_commands"] == "2"
    assert bystander.values("plant")["saturated_commands"] == "1"
    assert answers.samples == list(range(102))


def test_a_clock_that_is_told_again_does_not_go_back(bystander: Bystander, start_node: Start, tmp_path: Path):
    clocks: list[int] = []
    bystander.listen(topics.CLOCK, lambda raw: clocks.append(wire.CLOCK.unpack(raw)[0]), raw=True)
    start_node("plant", bench=odd_bench(tmp_path), command_timeout=20.0)
    answers = Answers(bystander)
    for wanted in range(1, 37):
        answers.send(0.0, 0.0, 0.0)
        bystander.spin_until(lambda wanted=wanted: answers.samples[-1] == wanted)  # type: ignore[misc]
    bystander.spin_until(lambda: clocks.count(10_200_000) >= 3)
    assert clocks == sorted(clocks)


def test_the_rate_of_the_joint_states_changes_at_once(bystander: Bystander, start_node: Start):
    stamps: list[int] = []
    bystander.listen(topics.JOINT_STATES, lambda message: stamps.append(message.header.stamp.nanosec))
    start_node("plant", command_timeout=3600.0, joint_state_rate=100_000.0)  # at most every sample has one
    answers = Answers(bystander)
    client = bystander.node.create_client(SetParameters, "/plant/set_parameters")
    bystander.spin_until(client.service_is_ready)

    def set_rate(rate: float) -> None:
        parameter = Parameter("joint_state_rate", value=rate).to_parameter_msg()
        future = client.call_async(SetParameters.Request(parameters=[parameter]))
        bystander.spin_until(future.done)
        assert future.result().results[0].successful

    def go_on(until: int) -> None:
        for wanted in range(answers.samples[-1] + 1, until + 1):
            answers.send(0.0, 0.0, 0.0)
            bystander.spin_until(lambda wanted=wanted: answers.samples[-1] == wanted)  # type: ignore[misc]

    go_on(20)
    bystander.spin_until(lambda: stamps and stamps[-1] == 10_000_000)
    set_rate(0.1)
    go_on(40)
    set_rate(2000.0)
    go_on(60)
    bystander.spin_until(lambda: stamps[-1] == 30_000_000)
    assert stamps[-21:] == [10_500_000, *range(20_500_000, 30_000_001, 500_000)]


def test_commands_that_cannot_reach_the_plant_are_named(bystander: Bystander, start_node: Start):
    """Best effort, as sensor data is sent, does not match a reader that wants each message."""
    bystander.node.create_publisher(
        topics.COMMAND.message_class, topics.COMMAND.name, qos_profile_sensor_data
    )
    start_node("plant", wait_for_subscribers=0)
    wanted = "waiting for a publisher of commands (bystander: best effort, and reliable is needed)"
    bystander.spin_until(lambda: bystander.said("plant") == wanted)


def test_a_plant_that_waits_tells_what_came_instead(bystander: Bystander, start_node: Start):
    """In lock-step nothing goes on without an answer to sample 0, and a wrong number looks like silence."""
    start_node("plant")
    answers = Answers(bystander)
    answers.send(0.0, 0.0, 5.0, sequence=1)
    wanted = "waiting for the first command: 1 came, and none answers the sample that waits"
    bystander.spin_until(lambda: bystander.said("plant") == wanted)
    assert bystander.diagnoses["plant"].level == DiagnosticStatus.WARN


def test_a_silent_controller_is_named(bystander: Bystander, start_node: Start):
    plant = start_node("plant", command_timeout=0.2)
    answers = Answers(bystander)
    answers.send(0.0, 0.0, 5.0)
    bystander.spin_until(lambda: bystander.values("plant").get("fault") == "controller_silent")
    assert plant.process.wait(PATIENCE) == 3
    assert "plant: controller_silent: no command for 0.2 s after sample 1" in plant.output
    assert answers.samples == [0, 1]


#: Real time: delays of a busy machine that are nothing to this test [s].
PATIENT = {"watchdog": 60.0, "oldest_command": 10.0}


def test_in_real_time_samples_come_unasked_and_the_guard_names_what_it_sees(
    bystander: Bystander, start_node: Start
):
    stamps: list[tuple[int, int]] = []
    bystander.listen(
        topics.MEASUREMENT, lambda raw: stamps.append(wire.MEASUREMENT.unpack(raw)[:2]), raw=True
    )
    plant = start_node(
        "plant",
        initial_spin_rate=200.0,
        clock="realtime",
        spin_down_rate=2000.0,
        **PATIENT | {"watchdog": 1.0},
    )
    commands = bystander.publisher(topics.COMMAND)
    bystander.spin_until(lambda: len(stamps) > 200 and commands.get_subscription_count())
    numbers = np.array(stamps)
    assert np.all(np.diff(numbers[:, 1]) == 1)
    assert np.diff(numbers[:, 0]).min() == 500_000  # longer only where the machine let the bench stand still
    assert abs(stamps[0][0] * 1e-9 - time.time()) < PATIENCE
    assert bystander.node.count_publishers("/clock") == 0
    assert bystander.values("plant").get("guard", "waiting") == "waiting"

    commands.publish(wire.COMMAND.pack(*stamps[-1], 0.1, 0.0, 7.0))
    bystander.spin_until(lambda: bystander.values("plant").get("guard") == "controller_lost")
    status = bystander.diagnoses["plant"]
    assert status.level == DiagnosticStatus.ERROR
    assert status.hardware_id == "gyrowheel"
    bystander.spin_until(lambda: bystander.values("plant").get("outputs") == "off")
    assert plant.interrupt() == 0  # a trip is a state, not the end of the node
    assert "controller_lost: no valid command for 2000 samples" in plant.output
    assert "Traceback" not in plant.output


def test_in_real_time_a_bad_line_is_counted_and_the_last_command_acts(
    bystander: Bystander, start_node: Start
):
    """Commands of which some are lost, come twice, in the wrong order or spoilt: each kind is counted, to one."""
    samples: list[tuple[Any, ...]] = []
    bystander.listen(topics.MEASUREMENT, lambda raw: samples.append(wire.MEASUREMENT.unpack(raw)), raw=True)
    start_node("plant", initial_spin_rate=200.0, clock="realtime", **PATIENT)
    commands = bystander.publisher(topics.COMMAND)
    bystander.spin_until(lambda: samples and commands.get_subscription_count())

    def send(answered: int, y: float = 0.0, motor: float = 6.0) -> None:
        commands.publish(wire.COMMAND.pack(answered * 500_000, answered, 0.2, y, motor))

    first = None
    for _ in range(12):
        heard = len(samples)
        bystander.spin_until(lambda heard=heard: len(samples) > heard + 5)  # type: ignore[misc]
        n = samples[-1][1]
        first = n - 4 if first is None else first
        send(n - 4)
        send(n - 4)  # twice
        send(n - 2)  # that of n - 3 is lost
        send(n - 3)  # it comes after all, too late
        send(n - 1, y=math.nan)
        send(n, motor=-1e6)

    def values() -> dict[str, int]:
        told = bystander.values("plant")
        return {name: int(text) for name, text in told.items() if text.isdecimal()}

    bystander.spin_until(lambda: values().get("refused_out_of_range") == 12)
    told = values()
    assert (told["refused_stale"], told["refused_not_finite"], told["refused_ahead"]) == (24, 12, 0)
    # all the samples that no command answered, from the first one answered to the last
    assert told["missing_commands"] == n - first + 1 - 12 * 4
    assert told["held_samples"] >= 12
    # the last command that was valid still acts
    heard = len(samples)
    bystander.spin_until(lambda: len(samples) > heard + 400)
    column = 2 + list(wire.MEASUREMENT.fields).index("motor_voltage")
    assert np.mean([row[column] for row in samples[-200:]]) == pytest.approx(6.0, abs=0.1)


def test_in_real_time_a_stall_is_told_and_the_stamps_stay_true(bystander: Bystander, start_node: Start):
    stamps: list[tuple[int, int]] = []
    delays: list[float] = []

    def note(raw: bytes) -> None:
        stamps.append(wire.MEASUREMENT.unpack(raw)[:2])
        delays.append(time.time() - stamps[-1][0] * 1e-9)

    told: list[tuple[float, float]] = []

    def hear(message: Any) -> None:
        for status in message.status:
            found = re.fullmatch(r"stood_still: ([\d.]+) s at ([\d.]+) s", status.message)
            if found:
                assert status.level == DiagnosticStatus.WARN
                told.append((float(found[1]), float(found[2])))

    bystander.listen(topics.MEASUREMENT, note, raw=True)
    bystander.listen(topics.DIAGNOSTICS, hear)
    plant = start_node("plant", clock="realtime", wait_for_subscribers=1)
    bystander.spin_until(lambda: len(stamps) > 1000)
    plant.process.send_signal(signal.SIGSTOP)
    time.sleep(3.0)  # far longer than what a busy machine takes from the plant in between
    stopped = len(stamps)
    plant.process.send_signal(signal.SIGCONT)
    bystander.spin_until(lambda: any(length > 2.5 for length, _ in told))
    bystander.spin_until(lambda: len(stamps) > stopped + 1000)
    # the stamps are those of the clock again: they are not three seconds behind
    bystander.spin_until(lambda: delays[-1] < 1.5)
    assert min(delays) > -1e-3
    numbers = np.array(stamps)
    assert np.all(np.diff(numbers[:, 1]) == 1)
    steps = np.diff(numbers[:, 0]) - 500_000
    assert steps.min() >= 0
    gap = int(np.argmax(steps))
    length, at = max(told)
    assert length == pytest.approx(steps[gap] * 1e-9, abs=0.005)
    assert at == pytest.approx((numbers[gap, 0] - numbers[0, 0]) * 1e-9, abs=0.1)


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
        request = RunPlan.Goal(plan=plan)
        future = self.action.send_goal_async(
            request, feedback_callback=lambda m: self.feedback.append(m.feedback)
        )
        self.bystander.spin_until(future.done)
        return future.result()

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
    beat = Beat(0.005)

    def goes_on() -> bool:
        nonlocal now
        if beat():
            now += 10_000_000
            samples.publish(wire.MEASUREMENT.pack(now, now // 10_000_000, *[0.0] * 11))
            client.clock.publish(wire.CLOCK.pack(now - begin))  # its own time goes on, too
        stamps = [setpoint[0] for setpoint in client.setpoints]
        return future.done() or (bool(stamps) and stamps[-1] > stamps[0] + wire.SECOND)

    bystander.spin_until(goes_on)
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
    beat = Beat(0.005)

    def goes_on() -> bool:
        nonlocal now
        if not beat():
            return bool(future.done())
        now += 50_000_000
        samples.publish(wire.MEASUREMENT.pack(now, now // 50_000_000, *[0.0] * 11))
        said = DiagnosticStatus(
            name="plant", hardware_id="gyrowheel", values=[KeyValue(key="guard", value=guard)]
        )
        diagnostics.publish(DiagnosticArray(status=[said]))
        return bool(future.done())

    assert plan.duration < 4.0
    future = client.ask(SHORT_PLAN).get_result_async()
    bystander.spin_until(goes_on)
    result = future.result().result
    assert (result.success, result.message[:27]) == (False, "aborted: controller_silent:")
    guard = "normal"
    future = client.ask(SHORT_PLAN).get_result_async()
    bystander.spin_until(goes_on)
    assert future.result().result.success
    stamps = [setpoint[0] for setpoint in client.setpoints]
    assert stamps == list(range(stamps[0], stamps[-1] + 1, 5_000_000))


@pytest.mark.parametrize("by", [topics.JOINT_STATES, topics.MEASUREMENT], ids=["joint_states", "samples"])
def test_a_wheel_that_does_not_follow_ends_the_plan_whoever_controls_it(
    bystander: Bystander, start_node: Start, by: topics.Topic
):
    """The rotor stays at 3438 rpm, where 1000 are asked for, and then follows."""
    shown = bystander.publisher(by)
    start_node("conductor", lead=LEAD_NS * 1e-9, controller="none")
    client = Client(bystander)
    if by is topics.MEASUREMENT:  # without a clock: the samples tell the time
        bystander.node.destroy_publisher(client.clock)
    plan = "schema: 1\nname: still\nsegments:\n  - {spin_rpm: 1000, tilt_deg: [0, 0], hold_s: 5}\n"
    now, spin = 0, 360.0
    beat = Beat(0.005)

    def goes_on() -> bool:
        nonlocal now
        if not beat():
            return bool(future.done())
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
        return bool(future.done())

    future = client.ask(plan).get_result_async()
    bystander.spin_until(goes_on)
    result = future.result().result
    assert not result.success
    told = "tracking_lost: the wheel does not follow: asked 0.00 deg and 1000 rpm, got 0.00 deg and 3438 rpm"
    assert result.message == f"aborted: {told} for 3 s"
    bystander.spin_until(lambda: bystander.values("conductor").get("guard") == "tracking_lost")
    assert bystander.diagnoses["conductor"].level == DiagnosticStatus.ERROR
    spin = 1000.0 * RPM
    future = client.ask(plan).get_result_async()
    bystander.spin_until(goes_on)
    assert future.result().result.success, future.result().result.message
