"""A recording of the running bench, given back to nodes: complete, in order, at every pace, bit by bit."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rosbags.rosbag2 import Reader
from std_srvs.srv import SetBool, Trigger

from gyrowheel_bringup.graph import Graph, find_executable
from gyrowheel_core import topics, wire
from gyrowheel_core.node import PARENT_VARIABLE
from gyrowheel_recording.bags import RecordingWriter

from ..domains import next_domain
from ..shared import made_once
from .helpers import Bystander, NodeProcess, end_process

pytestmark = pytest.mark.graph

Start = Callable[..., NodeProcess]
#: Holds that are long enough for the drag estimator, two speeds, and ramps between them.
PLAN = """\
schema: 1
name: holds
hold_s: 0.8
segments:
  - {label: level, spin_rpm: 2000, tilt_deg: [0, 0]}
  - {label: tilted, tilt_deg: [1.0, 0.5]}
  - {label: faster, spin_rpm: 2100, tilt_deg: [1.0, -0.5], hold_s: 1.6, rig: inverted}
"""
STEP = "/gyrowheel/replay/step"
HIGH_RATE = (topics.MEASUREMENT, topics.COMMAND, topics.SETPOINT)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of a short plan, made by the running graph."""

    def run(folder: Path) -> Path:
        with Graph(PLAN, record=folder / "run", domain_id=next_domain()) as graph:
            graph.run()
        return folder / "run"

    return made_once(tmp_path_factory, "replay", run)


@pytest.fixture(scope="module")
def recorded(recording: Path) -> dict[str, list[bytes]]:
    """Return its messages by topic."""
    result: dict[str, list[bytes]] = defaultdict(list)
    with Reader(recording) as reader:
        for connection, _, data in reader.messages():
            result[connection.topic].append(bytes(data))
    return result


class Replay:
    """The node `replay` as a process, and what it gives back to the test."""

    def __init__(self, bystander: Bystander, domain: int, log: Path) -> None:
        self.bystander = bystander
        self.heard: dict[str, list[bytes]] = defaultdict(list)
        self.order: list[str] = []
        self._environment = os.environ | {"ROS_DOMAIN_ID": str(domain), PARENT_VARIABLE: str(os.getpid())}
        self._log = log
        self.process: subprocess.Popen[bytes] | None = None
        for topic in (*HIGH_RATE, topics.DRAG_ESTIMATE, topics.BENCH, topics.CLOCK, topics.JOINT_STATES):
            bystander.listen(topic, self._taker(topic.name), raw=True)

    def start(self, **parameters: object) -> Replay:
        arguments = [f"{name}:={value}" for name, value in parameters.items()]
        with self._log.open("wb") as output:
            self.process = subprocess.Popen(
                [
                    str(find_executable("gyrowheel_recording", "replay_node")),
                    "--ros-args",
                    *itertools.chain.from_iterable(("-p", text) for text in arguments),
                ],
                stdout=output,
                stderr=output,
                env=self._environment,
                start_new_session=True,
            )
        return self

    @property
    def output(self) -> str:
        return self._log.read_text()

    def end(self) -> int:
        """Wait for its end; return the exit code."""
        assert self.process is not None
        self.bystander.spin_until(lambda: self.process.poll() is not None)  # type: ignore[union-attr]
        quiet = 0  # what has been delivered and not yet taken
        while quiet < 50:
            count = len(self.order)
            self.bystander.executor.spin_once(timeout_sec=0.01)
            quiet = quiet + 1 if len(self.order) == count else 0
        return int(self.process.returncode)

    def samples(self) -> list[int]:
        """Return the sequence numbers of the samples heard."""
        return [wire.MEASUREMENT.unpack(data)[1] for data in self.heard[topics.MEASUREMENT.name]]

    def clock(self) -> list[int]:
        """Return the times heard on /clock [ns]."""
        return [wire.CLOCK.unpack(data)[0] for data in self.heard[topics.CLOCK.name]]

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Call a service."""
        return self.bystander.call(self.bystander.node.create_client(kind, name), request)

    def step(self, made: Callable[[], Any]) -> None:
        """Ask for a step, and wait until it is made; once, since asked again for a lost answer it would be two."""
        client = self.bystander.node.create_client(Trigger, STEP)
        self.bystander.spin_until(client.service_is_ready)
        asked = client.call_async(Trigger.Request())
        self.bystander.spin_until(made)
        assert not asked.done() or asked.result().success

    def _taker(self, name: str) -> Callable[[bytes], None]:
        def take(data: bytes) -> None:
            self.heard[name].append(bytes(data))
            self.order.append(name)

        return take


@pytest.fixture
def replay(bystander: Bystander, domain: int, tmp_path: Path) -> Iterator[Replay]:
    result = Replay(bystander, domain, tmp_path / "replay.log")
    yield result
    if result.process is not None:
        end_process(result.process)


@pytest.mark.parametrize("rate", [0.0, pytest.param(1.0, marks=pytest.mark.study)])
def test_everything_comes_back_bit_by_bit_at_every_pace(
    replay: Replay, recording: Path, recorded: dict[str, list[bytes]], rate: float
) -> None:
    replay.start(directory=recording, rate=rate, wait_for_subscribers=1)
    assert replay.end() == 0, replay.output
    for topic in (*HIGH_RATE, topics.DRAG_ESTIMATE, topics.BENCH):
        assert replay.heard[topic.name] == recorded[topic.name], topic.name
    # of /clock a slow reader may miss some, but never the newest
    clock = replay.clock()
    assert clock == sorted(set(clock))
    assert {time % 10_000_000 for time in clock} == {0}
    assert 0 <= (len(recorded[topics.MEASUREMENT.name]) - 1) * 500_000 - clock[-1] < 10_000_000


@pytest.mark.study  # test_drag_estimator.py has the same without nodes
def test_the_drag_estimator_says_the_same_as_when_the_test_ran(
    replay: Replay,
    bystander: Bystander,
    start_node: Start,
    recording: Path,
    recorded: dict[str, list[bytes]],
) -> None:
    """Bit by bit; the estimates that were recorded are left out of their own accord."""
    estimator = start_node("drag_estimator")
    bystander.spin_until(lambda: bystander.values("drag_estimator").get("state") == "active")
    replay.start(directory=recording, rate=3.0, wait_for_subscribers=2, wait=10.0, without="/diagnostics")
    assert replay.end() == 0, replay.output
    assert "/gyrowheel/drag_estimate is left out: published by /drag_estimator" in replay.output
    estimator.process.send_signal(signal.SIGINT)
    bystander.spin_until(estimator.ended)
    wanted = recorded[topics.DRAG_ESTIMATE.name]
    assert len(wanted) >= 3
    bystander.spin_until(lambda: len(replay.heard[topics.DRAG_ESTIMATE.name]) >= len(wanted))
    assert replay.heard[topics.DRAG_ESTIMATE.name] == wanted


def test_a_range_in_rounds(replay: Replay, recording: Path, recorded: dict[str, list[bytes]]) -> None:
    replay.start(directory=recording, rate=0.0, start=1.0, end=1.2, loop="true", wait_for_subscribers=1)
    replay.bystander.spin_until(lambda: len(replay.heard[topics.MEASUREMENT.name]) > 3 * 401)
    assert replay.process is not None
    replay.process.send_signal(signal.SIGINT)
    assert replay.end() == 0, replay.output
    samples, first = replay.samples(), 2000
    rounds = len(samples) // 401
    assert samples[: 401 * rounds] == rounds * list(range(first, first + 401))
    assert recorded[topics.BENCH.name][0] == replay.heard[topics.BENCH.name][0]
    # of /clock a slow reader may miss some: it goes up by whole ticks within the range, round after round
    clock = replay.clock()
    assert set(clock) <= set(range(1_000_000_000, 1_200_000_001, 10_000_000))
    assert 0 < sum(later < earlier for earlier, later in itertools.pairwise(clock)) <= rounds


def test_steps_pauses_and_live_parameters(replay: Replay, bystander: Bystander, recording: Path) -> None:
    """From sample to sample, then by a time, then on."""
    replay.start(directory=recording, paused="true", wait_for_subscribers=1, wait=0.5, stay="true")
    bystander.spin_until(lambda: getattr(bystander.diagnoses.get("replay"), "message", "") == "paused")
    assert replay.samples() == []
    for count in (1, 2, 3):
        replay.step(lambda count=count: len(replay.samples()) >= count)  # type: ignore[misc]
        assert replay.samples() == list(range(count))
    bystander.spin_until(lambda: replay.clock()[-1] == 2 * 500_000)

    def set_parameter(name: str, value: Any) -> Any:
        parameter = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        return replay.call(SetParameters, "/replay/set_parameters", request).results[0]

    assert set_parameter("step", 0.05).successful
    replay.step(lambda: replay.clock()[-1] == 51_000_000)
    bystander.spin_until(lambda: len(replay.samples()) >= 103)
    assert replay.samples() == list(range(103))
    assert not set_parameter("rate", -1.0).successful
    assert "fixed" in set_parameter("directory", "/elsewhere").reason
    assert set_parameter("rate", 0.0).successful
    assert replay.call(SetBool, "/gyrowheel/replay/pause", SetBool.Request(data=False)).success
    bystander.spin_until(lambda: bystander.said("replay") == "at the end")
    assert replay.samples() == list(range(replay.samples()[-1] + 1))
    assert not replay.call(Trigger, STEP, Trigger.Request()).success

    # a lifecycle manager can have it again from the beginning
    def change(label: str) -> bool:
        request = ChangeState.Request(transition=Transition(label=label))
        return bool(replay.call(ChangeState, "/replay/change_state", request).success)

    samples = len(replay.samples())
    for label in ("deactivate", "cleanup", "configure", "activate"):
        assert change(label)
    replay.step(lambda: len(replay.samples()) > samples)
    assert replay.samples()[samples] == 0
    assert replay.process is not None
    replay.process.send_signal(signal.SIGINT)
    replay.process.send_signal(signal.SIGINT)
    assert replay.end() == 0, replay.output
    assert "Traceback" not in replay.output


def test_joint_states_are_made_where_none_were_recorded(replay: Replay, recording: Path) -> None:
    replay.start(directory=recording, rate=0.0, wait_for_subscribers=1, without="/joint_states,/diagnostics")
    assert replay.end() == 0, replay.output
    stamps = [wire.stamp(data) for data in replay.heard[topics.JOINT_STATES.name]]
    steps = {b - a for a, b in itertools.pairwise(stamps)}
    assert len(stamps) > 50
    assert min(steps) >= 16_000_000  # 60 Hz, at the samples


def test_a_running_bench_is_left_alone(replay: Replay, bystander: Bystander, recording: Path) -> None:
    """Recorded commands must not reach a machine: where its topics are in use, nothing is given back."""
    publisher = bystander.publisher(topics.COMMAND)
    replay.start(directory=recording, topics="/gyrowheel/command", wait=10.0)
    assert replay.end() == 3
    last = replay.output.strip().rpartition("\n")[2]
    assert last.startswith("replay: bench_is_running: /gyrowheel/command is published by /bystander")
    assert replay.heard[topics.COMMAND.name] == []
    bystander.node.destroy_publisher(publisher)


@pytest.mark.parametrize(
    ("parameters", "line"),
    [
        ({}, "replay: parameter directory: missing"),
        ({"directory": "no/such"}, "replay: no/such: no such recording"),
        ({"directory": "no/such", "rate": -1.0}, "replay: parameter rate: -1.0 is not allowed"),
    ],
)
def test_bad_parameters_end_the_node_with_one_line(
    replay: Replay, parameters: dict[str, object], line: str
) -> None:
    assert replay.start(**parameters).end() == 2
    # the middleware logs what it could not get of memory that others of this computer have
    (said,) = (text for text in replay.output.splitlines() if "[RTPS_" not in text)
    assert said.startswith(line)


@pytest.mark.study  # test_up.py replays what it has recorded
def test_the_command_replays_and_estimates(
    recording: Path, recorded: dict[str, list[bytes]], tmp_path: Path
) -> None:
    result = tmp_path / "result.json"

    def call(*options: str) -> tuple[int, str, str]:
        """Return exit code, output and errors of a call in a process of its own."""
        command = [sys.executable, "-c", "from gyrowheel.cli.app import main; main()", "replay"]
        done = subprocess.run(
            [*command, str(recording), *options],
            env=os.environ | {"ROS_DOMAIN_ID": str(next_domain())},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        assert "Traceback" not in done.stderr
        return done.returncode, done.stdout, done.stderr

    code, out, err = call("--fast", "--estimate", "--json", str(result))
    assert code == 0, err
    assert "Drag estimates" in out
    said = json.loads(result.read_text())
    assert said["complete"]
    assert said["messages"]["/gyrowheel/measurement"] == len(recorded["/gyrowheel/measurement"])
    wanted = [wire.DRAG_ESTIMATE.unpack(data) for data in recorded[topics.DRAG_ESTIMATE.name]]
    assert [e["stamp"] for e in said["drag_estimates"]] == [row[0] / 1e9 for row in wanted]
    assert [e["dc_voltage"][0] for e in said["drag_estimates"]] == [row[7] for row in wanted]
    for options, word in (
        (["--rate", "0"], "--rate"),
        (["--from", "99"], "nothing from 99 s on"),
        (["--topic", "/x"], "no messages on '/x'"),
        (["--estimate", "--model", str(tmp_path / "none.yaml")], "none.yaml"),
    ):
        code, _, err = call(*options)
        assert (code, err.count("\n")) == (2, 1)
        assert word in err


def test_a_pause_of_decades_takes_no_time_as_fast_as_it_goes(tmp_path: Path) -> None:
    """A clock that was set from 1970 to today: /clock goes on behind it."""
    recording, pause = tmp_path / "run", 1_700_000_000 * wire.SECOND
    with RecordingWriter(recording) as writer:
        for k in range(400):
            stamp = k * 500_000 + (pause if k >= 200 else 0)
            writer.write(topics.MEASUREMENT, wire.MEASUREMENT.pack(stamp, k, *(0.0,) * 11), stamp)
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "from gyrowheel.cli.app import main; main()",
            "replay",
            str(recording),
            "--fast",
            "--json",
            "-",
        ],
        env=os.environ | {"ROS_DOMAIN_ID": str(next_domain())},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=True,
        timeout=100.0,
    )
    assert json.loads(done.stdout)["messages"]["/gyrowheel/measurement"] == 400
