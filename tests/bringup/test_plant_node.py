"""The plant alone, as a process, in lock-step and in real time."""

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
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data

from gyrowheel_core import topics, wire
from gyrowheel_sim.bench import Bench

from .helpers import PATIENCE, Bystander, NodeProcess, odd_bench

pytestmark = pytest.mark.graph

Start = Callable[..., NodeProcess]
LEAD_NS = 100_000_000


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

    def set_rate(rate: float) -> None:
        parameter = Parameter("joint_state_rate", value=rate).to_parameter_msg()
        answer = bystander.call(client, SetParameters.Request(parameters=[parameter]))
        assert answer.results[0].successful

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
