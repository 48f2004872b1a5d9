"""Readings of a bench from messages of other types: their alignment, and the node in a graph."""

from __future__ import annotations

import math
import os
import re
import subprocess
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
import yaml
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped
from gyrowheel_msgs.msg import Command
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Header

import gyrowheel as gw
from gyrowheel_bringup.graph import find_executable
from gyrowheel_core import topics
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import prepare_environment
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mapping.live import LiveReadings, Sample
from gyrowheel_recording.mapping.map_file import READINGS, ColumnMap

from ..bringup.helpers import end_process, wait_for
from ..domains import next_domain

PAGE = Path(__file__).resolve().parents[2] / "docs" / "your_hardware.md"
MS = 1_000_000
#: Samples by which it is ahead of the bridge at most.
AHEAD = 4_000


def header(stamp: int, frame: str = "") -> Header:
    return Header(stamp=Time(sec=stamp // 1_000_000_000, nanosec=stamp % 1_000_000_000), frame_id=frame)


def joints(stamp: int, row: Any, *, names: tuple[str, ...] = ("spin", "tilt_y", "tilt_x")) -> JointState:
    places = {"tilt_x": row["tilt_x"], "tilt_y": row["tilt_y"], "spin": row["spin_angle"]}
    rates = {"tilt_x": 0.0, "tilt_y": 0.0, "spin": row["spin_rate"]}
    return JointState(
        header=header(stamp),
        name=list(names),
        position=[float(places[own]) for own in names],
        velocity=[float(rates[own]) for own in names],
    )


def page_map() -> dict[str, Any]:
    """Return the map of the page."""
    (text,) = re.findall(r"```yaml\n# rig.map.yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    content: dict[str, Any] = yaml.safe_load(text)
    return content


def live(**changes: Any) -> LiveReadings:
    content = page_map() | {"bench": "gyrowheel"} | changes
    return LiveReadings(ColumnMap.from_mapping(content, "rig.map.yaml"), patience=0.05)


ROW = {"tilt_x": 0.01, "tilt_y": -0.02, "spin_angle": 1.0, "spin_rate": 300.0}


def taken(
    found: LiveReadings, *, samples: int = 60, skip: tuple[int, ...] = (), late: int = 0
) -> list[Sample]:
    """Return the samples of messages at 1 kHz; the drive comes `late` [ns], the air once."""
    result: list[Sample] = []
    found.take("/air", Temperature(header=header(MS), temperature=20.0), MS)
    for k in range(samples):
        stamp = (k + 2) * MS
        if k in skip:
            continue
        found.take("/joint_states", joints(stamp, ROW | {"spin_angle": 0.3 * k}), stamp)
        command = Command(header=header(stamp), coil_voltage_x=1.0, coil_voltage_y=2.0, motor_voltage=3.0)
        found.take("/amplifier", command, stamp)
        if k % 2 == 0:
            drive = Vector3Stamped(header=header(stamp + late))
            drive.vector.x = 500.0 + k
            found.take("/drive", drive, stamp)
        result += found.take_samples()
    return result


def column(samples: list[Sample], name: str) -> np.ndarray:
    return np.array([sample.readings[list(READINGS).index(name)] for sample in samples])


def test_readings_of_other_topics_are_interpolated_to_the_samples() -> None:
    found = live()
    samples = taken(found)
    assert [sample.stamp for sample in samples] == [k * MS for k in range(len(samples))]
    assert [sample.number for sample in samples] == list(range(len(samples)))
    assert len(samples) >= 58
    assert column(samples, "motor_current") == pytest.approx(0.5 + 1e-3 * np.arange(len(samples)), abs=1e-12)
    assert column(samples, "spin_angle") == pytest.approx(np.mod(0.3 * np.arange(len(samples)), 2 * math.pi))
    assert set(column(samples, "coil_voltage_y")) == {2.0}
    assert set(column(samples, "air_temperature")) == {293.15}
    assert set(column(samples, "air_pressure")) == {101300.0}
    assert np.isnan(column(samples, "coil_temperature")).all()  # not in the map
    assert (found.samples, found.lost, found.missing_readings) == (len(samples), 0, 0)


def test_lost_samples_are_counted_and_numbered() -> None:
    found = live()
    samples = taken(found, skip=(30, 31))
    assert found.lost == 2
    assert np.diff([sample.number for sample in samples]).max() == 3


def test_a_topic_that_falls_silent_is_missing_and_holds_nothing_up() -> None:
    found = live(
        columns=page_map()["columns"] | {"coil_voltage_y": {"column": "/other.vector.x", "unit": "V"}}
    )
    samples = taken(found, samples=100)
    assert len(samples) > 40  # those that are older than the patience
    assert np.isnan(column(samples, "coil_voltage_y")).all()
    assert np.isfinite(column(samples, "coil_voltage_x")).all()
    assert found.missing_readings == len(samples)


def test_a_clock_that_starts_at_power_on_is_moved_to_that_of_the_samples() -> None:
    samples = taken(live(), late=-3_600_000 * MS)
    assert column(samples, "motor_current") == pytest.approx(0.5 + 1e-3 * np.arange(len(samples)), abs=1e-12)


def test_readings_out_of_range_are_missing_and_the_first_is_named() -> None:
    columns = page_map()["columns"] | {
        "tilt_x": {"column": "/joint_states.position.tilt_x", "unit": "rad", "scale": 100}
    }
    found = live(columns=columns)
    samples = taken(found)
    assert np.isnan(column(samples, "tilt_x")).all()
    assert found.out_of_range >= len(samples)
    assert found.why == "tilt_x: 1 rad; allowed: -0.2 .. 0.2"


def test_samples_that_do_not_ascend_are_dropped_and_counted() -> None:
    found = live()
    taken(found, samples=40)
    found.take("/joint_states", joints(5 * MS, ROW), 5 * MS)
    assert found.not_ascending == 1


def test_an_unknown_field_or_a_second_frame_is_an_error_that_names_it() -> None:
    found = live()
    with pytest.raises(
        InputError, match=r"/joint_states: its messages have no field \.position\.tilt_y; there are: "
    ):
        found.take("/joint_states", joints(MS, ROW, names=("tilt_x", "spin")), MS)
    drive = [Vector3Stamped(header=header(MS, frame)) for frame in ("left", "right")]
    found.take("/drive", drive[0], MS)
    with pytest.raises(InputError, match=r"/drive: .* of several frames; allowed: /drive@left, /drive@right"):
        found.take("/drive", drive[1], MS)


def test_a_frame_of_a_topic_can_be_chosen() -> None:
    columns = page_map()["columns"] | {"motor_current": {"column": "/drive@right.vector.x", "unit": "mA"}}
    found = live(columns=columns)
    for frame, value in (("left", 1.0), ("right", 2.0)):
        message = Vector3Stamped(header=header(MS, frame))
        message.vector.x = value
        found.take("/drive", message, MS)
    assert list(found.feeds["/drive"].values["motor_current"]) == [2e-3]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time": None, "rate": 1000}, "rate: is not possible live"),
        ({"every": 2}, "every: is not possible live"),
        ({"time": {"column": "/joint_states.velocity.spin", "unit": "s"}}, "allowed: the stamps of a topic"),
        (
            {"sequence": {"column": "/drive.vector.y"}},
            "sequence.column: is of /drive; allowed: of /joint_states",
        ),
    ],
)
def test_what_needs_the_whole_recording_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        live(**changes)


# ---- the node


class Rig(SimpleNamespace):
    """A bench that publishes its readings in types of other packages."""

    def __init__(self, domain: int) -> None:
        prepare_environment()
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("rig", context=self.context)
        reliable = QoSProfile(depth=10_000)
        kinds = {"joint_states": JointState, "amplifier": Command, "drive": Vector3Stamped}
        self.out = {
            name: self.node.create_publisher(kind, f"/{name}", reliable) for name, kind in kinds.items()
        }
        topic = topics.DIAGNOSTICS
        self.node.create_subscription(topic.message_class, topic.name, self.note, topic.qos)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.published = self.recorded = 0
        self.air = self.node.create_publisher(Temperature, "/air", qos_profile_sensor_data)

    def note(self, message: DiagnosticArray) -> None:
        for status in message.status:
            count = max((int(own.value) for own in status.values if own.key == "samples"), default=0)
            if status.name.endswith("bridge"):
                self.published = count
            elif status.name.endswith("recorder"):
                self.recorded = count

    def wait_until_published(self, count: int, *, air: bool = False) -> None:
        def enough() -> bool:
            self.executor.spin_once(timeout_sec=0.1)
            if air:  # a thermometer goes on, and messages of a best effort are lost where the bridge is busy
                self.publish_air(self.last + 100_000_000, self.celsius)
            return self.published >= count

        wait_for(enough)

    def publish_air(self, stamp: int, celsius: float) -> None:
        self.last, self.celsius = stamp, celsius
        self.air.publish(Temperature(header=header(stamp), temperature=celsius))

    def play(self, rows: np.ndarray) -> None:
        """Publish the readings of a recording, no more than the bridge can keep ahead of its samples.

        Slowly until the recorder has some: the first ones are lost while the nodes are still finding each other.
        """
        needed = {"joint_states": 2}  # the recorder listens, too
        wait_for(lambda: all(p.get_subscription_count() >= needed.get(n, 1) for n, p in self.out.items()))
        wait_for(self.air.get_subscription_count)
        for k, row in enumerate(rows):
            stamp = 1_790_000_000_000_000_000 + int(row["stamp_ns"])
            if k % 100 == 0:
                self.wait_until_published(k - AHEAD)
                self.publish_air(stamp, float(row["air_temperature"]) - 273.15)
            if not self.recorded and k % 10 == 0:
                self.executor.spin_once(timeout_sec=0.1)
            self.out["joint_states"].publish(joints(stamp, row))
            x, y, motor = (float(row[name]) for name in ("coil_voltage_x", "coil_voltage_y", "motor_voltage"))
            self.out["amplifier"].publish(
                Command(header=header(stamp), coil_voltage_x=x, coil_voltage_y=y, motor_voltage=motor)
            )
            drive = Vector3Stamped(header=header(stamp))
            drive.vector.x = 1e3 * float(row["motor_current"])
            self.out["drive"].publish(drive)
        # the last ones wait for others
        self.wait_until_published(len(rows) - 2, air=True)

    def close(self) -> None:
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.mark.graph
@pytest.mark.slow
@pytest.mark.parametrize(
    "samples",
    [
        6_000,
        pytest.param(16_000, marks=pytest.mark.study),
    ],  # enough for a verdict, which is that of the samples
    ids=["recorded", "diagnosed"],
)
def test_a_bench_with_topics_of_other_types_is_recorded_and_diagnosed(samples: int, tmp_path: Path) -> None:
    text = resources.files("gyrowheel_sim").joinpath("config/bench.yaml").read_text(encoding="utf-8")
    usual = "sample_period: {value: 5.0e-4"
    assert usual in text
    (tmp_path / "rig.yaml").write_text(text.replace(usual, "sample_period: {value: 1.0e-3"), encoding="utf-8")
    content = page_map() | {"bench": str(tmp_path / "rig.yaml")}
    (tmp_path / "rig.map.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    run = gw.simulate("check", effects=["aero_cross"], machine=6, bench=tmp_path / "rig.yaml")
    rows = run.data.measurement[:samples]
    domain = next_domain()
    commands = [line.split(" --ros-args ") for line in page_commands()]
    nodes = [
        subprocess.Popen(
            [str(find_executable(*command.split()[2:])), "--ros-args", *options.split()],
            cwd=tmp_path,
            env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
        )
        for command, options in commands
    ]
    rig = Rig(domain)
    try:
        wait_for(lambda: rig.node.count_subscribers("/gyrowheel/measurement"))
        rig.play(rows)
    finally:
        for node in nodes:
            end_process(node)
        rig.close()
    assert [node.returncode for node in nodes] == [0, 0]
    mine = Recording.open(tmp_path / "runs/mine")
    recorded = len(mine.measurement)
    assert (mine.integrity().samples, mine.integrity().missing) == (recorded, 0)
    lost = int(np.flatnonzero(rows["spin_angle"] == mine.measurement["spin_angle"][0])[0])  # before it began
    assert len(rows) - lost - 2 <= recorded <= len(rows) - lost
    assert lost < 2_000
    for name in (
        "stamp_ns",
        "tilt_x",
        "spin_angle",
        "spin_rate",
        "coil_voltage_y",
        "motor_current",
    ):
        was, own = rows[name][lost:][:recorded], mine.measurement[name]
        if name == "stamp_ns":
            was, own = np.diff(was), np.diff(own)
        assert own == pytest.approx(was, rel=1e-12, abs=1e-12), name
    assert gw.Recording.open(tmp_path / "runs/mine").info.bench == run.info.bench
    if samples < 16_000:
        return
    verdict = gw.diagnose(tmp_path / "runs/mine", gw.Model(tmp_path / "rig.yaml"))
    assert {effect.name for effect in verdict.effects} == {"aero_cross"}


def page_commands() -> list[str]:
    """Return the commands of the page that start the nodes."""
    return re.findall(
        r"^gyrowheel run gyrowheel_recording .*$", PAGE.read_text(encoding="utf-8"), re.MULTILINE
    )
