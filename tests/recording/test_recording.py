"""Recordings: what is written is what is read, and what their summary says of them."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from pathlib import Path
from typing import Any

import mcap.records
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

from gyrowheel.recordings.page import info_page
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.readings import READINGS
from gyrowheel_recording.bags import Recording, RecordingWriter, info, write_run
from gyrowheel_recording.bags.columns import column_dtype, definition
from gyrowheel_recording.bags.mcap.reader import read_mcap
from gyrowheel_recording.bags.mcap.writer import Block, McapWriter
from gyrowheel_sim.environment import Environment, to_json

from .recordings import ENVIRONMENT, PERIOD_NS, assert_holds, make_run, measurements, record, shown

# ---- what is written is what is read


def test_run_comes_back_exactly(run, directory):
    recording = Recording.open(directory)
    assert_holds(recording, run)
    assert recording.name == "run"
    assert recording.path == directory
    assert recording.duration == pytest.approx(299 * 0.0005)
    np.testing.assert_allclose(recording.time, np.arange(300) * 0.0005)
    assert recording.topics == {
        "/gyrowheel/bench": 1,
        "/gyrowheel/command": 300,
        "/gyrowheel/drag_estimate": 3,
        "/gyrowheel/environment": 1,
        "/gyrowheel/measurement": 300,
        "/gyrowheel/setpoint": 30,
    }
    assert recording.integrity().complete
    assert recording.integrity().samples == 300


def test_rosbags_reads_the_same(run, directory):
    values: dict[str, list[Any]] = {}
    with AnyReader([directory]) as reader:  # this compares the type hashes with the definitions too
        assert reader.message_count == 635
        assert reader.duration == 299 * PERIOD_NS + 1
        times = []
        for connection, time, data in reader.messages():
            values.setdefault(connection.topic, []).append(reader.deserialize(data, connection.msgtype))
            times.append(time)
        qos = {c.topic: c.ext.offered_qos_profiles[0] for c in reader.connections}  # type: ignore[union-attr]
    assert times == sorted(times)
    read = np.array(
        [[getattr(m, f) for f in wire.MEASUREMENT.fields] for m in values["/gyrowheel/measurement"]]
    )
    np.testing.assert_array_equal(read, run["measurement"])
    read = np.array([[getattr(m, f) for f in wire.COMMAND.fields] for m in values["/gyrowheel/command"]])
    np.testing.assert_array_equal(read, run["command"])
    first = values["/gyrowheel/measurement"][3]
    assert (first.sequence, first.header.stamp.nanosec, first.header.frame_id) == (3, 1_500_000, "case")
    assert qos["/gyrowheel/bench"].durability.name == "TRANSIENT_LOCAL"
    assert qos["/gyrowheel/measurement"].reliability.name == "RELIABLE"


def test_mcap_library_reads_the_same_with_checksums(directory):
    (file,) = directory.glob("*.mcap")
    with file.open("rb") as stream:
        records = list(StreamReader(stream, validate_crcs=True).records)
    messages = [record for record in records if isinstance(record, mcap.records.Message)]
    assert [m.log_time for m in messages] == sorted(m.log_time for m in messages)
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(messages) == len(list(reader.iter_messages()))
        assert {c.topic: c.metadata["topic_type_hash"] for c in summary.channels.values()} == {
            topic.name: definition(topic.type_name).type_hash
            for topic in topics.TOPICS
            if topic.name in {c.topic for c in summary.channels.values()}
        }
        (metadata,) = reader.iter_metadata()
        assert "message_count: 635" in metadata.metadata["serialized_metadata"]


def test_type_hashes_are_those_that_ros_generates():
    """The type descriptions that rosidl installs beside the messages."""
    for topic in topics.TOPICS:
        package, kind, name = topic.type_name.split("/")
        file = Path(sys.prefix, "share", package, kind, f"{name}.json")
        hashes = {
            entry["type_name"]: entry["hash_string"] for entry in json.loads(file.read_text())["type_hashes"]
        }
        assert definition(topic.type_name).type_hash == hashes[topic.type_name]


def test_definition_has_units_and_contained_types():
    text = definition("gyrowheel_msgs/msg/Measurement").text
    assert "[rad/s]" in text
    assert text.count("=" * 80 + "\n") == 2
    assert "MSG: std_msgs/Header" in text
    assert "MSG: builtin_interfaces/Time" in text
    with pytest.raises(InputError, match="message type 'no_msgs/msg/Thing': unknown"):
        definition("no_msgs/msg/Thing")


def test_messages_written_singly_or_as_columns_are_identical(run, directory, tmp_path):
    """A recorder that is given the messages one by one, with small chunks and in several files."""
    with (
        AnyReader([directory]) as reader,
        RecordingWriter(tmp_path / "other", chunk_size=2000) as writer,
    ):
        by_name = {topic.name: topic for topic in topics.TOPICS}
        for number, (connection, time, data) in enumerate(reader.messages()):
            if number in (200, 400, 401):
                writer.split()
            writer.write(by_name[connection.topic], data, time)
            if number % 100 == 0:
                writer.flush()
    assert len(list((tmp_path / "other").glob("other_*.mcap"))) == 4
    assert_holds(Recording.open(tmp_path / "other"), run)
    with AnyReader([tmp_path / "other"]) as reader:
        assert len(list(reader.messages())) == 635


@settings(max_examples=30, deadline=None)
@given(
    blocks=st.lists(
        st.tuples(st.integers(0, 2), st.lists(st.integers(0, 50), max_size=40), st.integers(1, 30)),
        max_size=5,
    ),
    chunk_size=st.integers(1, 3000),
    one_by_one=st.booleans(),
)
def test_any_messages_are_read_back(blocks, chunk_size, one_by_one, tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "file.mcap"
    writer = McapWriter(path, chunk_size=chunk_size)
    channels = [writer.add_channel(f"/t{k}", "std_msgs/msg/String", "string data", {}) for k in range(3)]
    expected: dict[str, list[tuple[int, bytes]]] = {f"/t{k}": [] for k in range(3)}
    random_bytes = random.Random(1)
    given_blocks = []
    for k, times, size in blocks:
        messages = [random_bytes.randbytes(size) for _ in times]
        pairs = list(zip(sorted(times), messages, strict=True))
        expected[f"/t{k}"] += pairs
        if one_by_one:
            for time, message in pairs:
                writer.append(channels[k], time, message)
        else:
            data = np.frombuffer(b"".join(messages), f"V{size}")
            given_blocks.append(Block(channels[k], np.array(sorted(times), dtype=np.int64), data))
    if not one_by_one:
        writer.append_blocks(given_blocks)
    writer.finish("")
    found = {topic.name: topic for topic in read_mcap(path, dict.fromkeys(expected))}
    for name, pairs in expected.items():
        topic = found[name]
        assert topic.count == len(pairs)
        times = [int(time) for piece in topic.times for time in piece]
        messages = [bytes(m) for piece in topic.pieces for m in piece]
        key = (lambda pair: pair) if not one_by_one else (lambda pair: 0)  # one by one the order stays
        assert sorted(zip(times, messages, strict=True), key=key) == sorted(pairs, key=key)


def test_analysis_of_recordings_needs_no_ros(directory):
    code = (
        "import sys; from gyrowheel_recording.bags import Recording\n"
        f"assert len(Recording.open({str(directory)!r}).measurement) == 300\n"
        "assert not {'rclpy', 'gyrowheel_msgs'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


# ---- samples that are missing, late or there twice


@given(
    order=st.permutations(range(12)),
    dropped=st.sets(st.integers(1, 10)),
    doubled=st.sets(st.integers(0, 11)),
)
@settings(max_examples=30, deadline=None)
def test_integrity(order, dropped, doubled, tmp_path_factory):
    messages = measurements(12)
    arrived = [k for k in order if k not in dropped]
    arrived += sorted(doubled - dropped)
    recording = Recording.open(
        record(tmp_path_factory.mktemp("order") / "bag", [messages[k] for k in arrived], chunk_size=200)
    )
    kept = sorted(set(range(12)) - dropped)
    assert recording.measurement["sequence"].tolist() == kept
    assert recording.readings.tilt_x.tolist() == kept
    integrity = recording.integrity()
    lost = [first + k for first, count in integrity.gaps for k in range(count)]
    assert lost == sorted(dropped)
    assert integrity.missing == len(dropped)
    assert integrity.duplicates == len(doubled - dropped)
    assert integrity.samples == len(kept)
    assert integrity.out_of_order == sum(k < max(arrived[:i]) for i, k in enumerate(arrived) if i)
    assert integrity.complete == (not dropped)


def test_duplicates_are_dropped_anywhere_and_with_any_padding(tmp_path):
    """A row of a setpoint has three bytes that are no field's; all of it was written twice, one after the other."""
    with RecordingWriter(tmp_path / "bag") as writer:
        for message in measurements(5):
            writer.write(topics.MEASUREMENT, message, wire.stamp(message))
        for k in [*range(1000), *range(1000)]:
            message = wire.SETPOINT.pack(k * 5_000_000, 1, 1, *[1.0] * 6)
            writer.write(topics.SETPOINT, message, wire.stamp(message))
    assert Recording.open(tmp_path / "bag").setpoint["stamp_ns"].tolist() == [
        k * 5_000_000 for k in range(1000)
    ]


def test_values_that_are_not_finite_are_counted_and_kept(tmp_path):
    messages = measurements(5)
    messages[2] = wire.MEASUREMENT.pack(2 * PERIOD_NS, 2, float("nan"), *[0.0] * 9, float("inf"))
    recording = Recording.open(record(tmp_path / "bag", [*messages, messages[2]]))
    assert (recording.integrity().not_finite, recording.integrity().duplicates) == (1, 1)
    assert np.isnan(recording.readings.tilt_x[2])
    assert info(tmp_path / "bag").integrity.not_finite == 1
    assert recording.extremes == {}


@pytest.mark.parametrize("samples", [1, 256, 257, 20_000], ids="{} samples".format)
def test_extremes_are_those_of_every_256_samples_also_where_samples_are_late(tmp_path, samples):
    run = make_run(samples)
    write_run(tmp_path / "bag", **run)
    recording = Recording.open(tmp_path / "bag")
    late = Recording.open(record(tmp_path / "late", random.Random(1).sample(measurements(600), 600)))
    for own in (recording, late):
        parts = np.array_split(own.measurement, range(256, len(own.measurement), 256))
        for name in READINGS:
            ends = [[part[name].min() for part in parts], [part[name].max() for part in parts]]
            np.testing.assert_array_equal(own.extremes[name], ends)


def test_one_value_beyond_all_readings_is_found_among_many_samples(tmp_path):
    run = make_run(20_000)
    run["measurement"][12_345, 3] = -2e12
    write_run(tmp_path / "bag", **run)
    recording = Recording.open(tmp_path / "bag")
    assert recording.integrity().not_finite == 1
    assert np.flatnonzero(np.isnan(recording.readings.array[:, 3])).tolist() == [12_345]


@pytest.mark.parametrize(
    "others",
    [
        [wire.MEASUREMENT.pack(3 * PERIOD_NS, 3, *[9.0] * 11)],
        [wire.MEASUREMENT.pack(7 * PERIOD_NS, 2, *[0.0] * 11)],
        [wire.MEASUREMENT.pack(PERIOD_NS + 1, 9, *[0.0] * 11)],
        [wire.MEASUREMENT.pack((5 + k) * PERIOD_NS, (65535 + k) % 65536, *[0.0] * 11) for k in range(2)],
    ],
    ids=["same sample, other readings", "sequence goes back", "stamp goes back", "a counter of 16 bits"],
)
def test_two_runs_in_one_recording_are_refused(tmp_path, others):
    path = record(tmp_path / "bag", measurements(5) + others)
    with pytest.raises(InputError, match=r"bag: /gyrowheel/measurement: sequence \d+ at .* both must ascend"):
        Recording.open(path)


# ---- environments


def environment_of(path, plans, *, first=0):
    with RecordingWriter(path) as writer:
        for stamp, plan in plans:
            writer.write(topics.ENVIRONMENT, wire.pack_text(to_json(plan)), stamp)
        for data in measurements(10, start=first):
            writer.write(topics.MEASUREMENT, data, wire.stamp(data))
    return Recording.open(path).environment


def test_later_plan_replaces_the_overlap(tmp_path):
    first = [Environment(), Environment(time=2.0, yaw=1.0), Environment(time=4.0, yaw=2.0)]
    second = [Environment(time=3.0, rig="inverted"), Environment(time=5.0, preheat=10.0)]
    assert environment_of(tmp_path / "bag", [(0, first), (3, second)]) == first[:2] + second


def test_environment_counts_from_the_start_of_the_recording(tmp_path):
    plan = [Environment(), Environment(time=0.5, yaw=1.0), Environment(time=1.5, yaw=2.0)]
    got = environment_of(tmp_path / "bag", [(0, plan)], first=2000)  # which is at 1 s
    assert got == [Environment(yaw=1.0), Environment(time=0.5, yaw=2.0)]


def test_unknown_or_invalid_environment(tmp_path):
    assert Recording.open(record(tmp_path / "bag", measurements(3))).environment == []
    with RecordingWriter(tmp_path / "bad") as writer:
        writer.write(topics.ENVIRONMENT, wire.pack_text('[{"rig": "sideways"}]'), 0)
        writer.write(topics.MEASUREMENT, measurements(1)[0], 0)
    with pytest.raises(InputError, match=r"bad: /gyrowheel/environment: environment.rig: 'sideways'"):
        Recording.open(tmp_path / "bad")


# ---- info


def test_info(tmp_path, run):
    setpoints = np.zeros(40, column_dtype(wire.SETPOINT))
    setpoints["stamp_ns"] = np.arange(40) * 5_000_000
    setpoints["segment"] = np.arange(40) // 20
    setpoints["phase"] = np.arange(40) % 20 >= 10
    setpoints["spin_rate"] = np.where(np.arange(40) < 20, 100 * np.pi, 50 * np.pi)
    setpoints["tilt_x"] = np.radians(3.0)
    setpoints["tilt_y"] = np.radians(-4.0)
    measurement = np.zeros((400, 11))
    measurement[:, 0] = np.linspace(0.0, np.radians(5.0), 400)
    measurement[:, 3] = np.linspace(50 * np.pi, 100 * np.pi, 400)
    path = write_run(
        tmp_path / "run",
        measurement,
        run["command"],
        setpoints,
        to_json(ENVIRONMENT),
        "",
        sample_period=0.0005,
    )
    got = info(path)
    assert got.duration == pytest.approx(399 * 0.0005)
    assert got.rate == pytest.approx(2000.0)
    assert got.size == sum(file.stat().st_size for file in path.iterdir())
    holds = [(hold.segment, hold.start, hold.duration) for hold in got.holds]
    np.testing.assert_allclose(holds, [(0, 0.05, 0.05), (1, 0.15, 0.05)])
    assert got.segments == 2
    assert got.spin_rate == (50 * np.pi, 100 * np.pi)
    assert got.rigs == ("upright", "inverted")
    assert got.holds[1].spin_rate == 50 * np.pi
    text = shown(info_page(got))
    for part in (
        "duration 0.20 s, 400 samples at 2000.0 Hz",
        "samples complete",
        "spin rate 1500 .. 3000 rpm tilt 0 .. 5 deg",
        "holds 2 in 2 segments",
        "speeds 1500, 3000 rpm",
        "tilts 5 deg",
        "bench not stated",
        "rig upright, inverted",
        "/gyrowheel/measurement 400",
    ):
        assert part in text


def test_info_of_few_samples_with_gaps(tmp_path):
    messages = measurements(10)
    del messages[4:6]
    got = info(record(tmp_path / "bag", messages))
    assert got.rate == pytest.approx(2000.0)
    assert (got.integrity.missing, got.integrity.gaps) == (2, ((4, 2),))
    assert "samples 2 missing (by sequence number: 2 from 4)" in shown(info_page(got))
    assert got.holds == ()
    one = info(record(tmp_path / "one", messages[:1]))
    assert (one.rate, one.duration) == (0.0, 0.0)
