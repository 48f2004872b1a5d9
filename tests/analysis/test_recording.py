"""Recordings: what is written is what is read, and what is damaged is refused."""

from __future__ import annotations

import contextlib
import json
import os
import random
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import mcap.records
import mcap.writer
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from gyrowheel_analysis.recording import Recording, RecordingWriter, info, write_run
from gyrowheel_analysis.recording.columns import column_dtype
from gyrowheel_analysis.recording.definitions import definition, typestore
from gyrowheel_analysis.recording.mcap_reader import read_mcap
from gyrowheel_analysis.recording.mcap_writer import Block, McapWriter
from gyrowheel_sim import topics, wire
from gyrowheel_sim.environment import Environment, to_json
from gyrowheel_sim.errors import InputError

PERIOD_NS = 500_000
ENVIRONMENT = [Environment(), Environment(time=0.05, rig="inverted", yaw=0.3)]


def make_run(samples=300, seed=1):
    """Return arguments for `write_run`: random numbers, which nothing can mistake for each other."""
    rng = np.random.default_rng(seed)
    setpoints = np.zeros(max(samples // 10, 1), column_dtype(wire.SETPOINT))
    setpoints["stamp_ns"] = np.arange(len(setpoints)) * 5_000_000
    setpoints["segment"] = np.arange(len(setpoints)) // 8
    setpoints["phase"] = np.arange(len(setpoints)) % 8 > 2
    for name in wire.SETPOINT.fields:
        setpoints[name] = rng.normal(size=len(setpoints))
    return {
        "measurement": rng.normal(size=(samples, 11)),
        "command": rng.normal(size=(samples, 3)),
        "setpoints": setpoints,
        "environment": to_json(ENVIRONMENT),
        "bench": "a bench, with ü",
        "sample_period": PERIOD_NS * 1e-9,
        "drag_estimates": [
            (k * 10_000_000, wire.DRAG_ESTIMATE.pack(k * 10_000_000, k, True, *rng.normal(size=25)))
            for k in range(3)
        ],
    }


@pytest.fixture(scope="session")
def run():
    return make_run()


@pytest.fixture(scope="session")
def directory(run, tmp_path_factory):
    return write_run(tmp_path_factory.mktemp("recording") / "run", **run)


def measurements(count=50, start=0):
    """Return serialized measurements, sample k made of the numbers k, k + 1, ..."""
    return [
        wire.MEASUREMENT.pack(k * PERIOD_NS, k, *(float(k + i) for i in range(11)))
        for k in range(start, start + count)
    ]


def record(path, messages, *, chunk_size=1000):
    """Write serialized measurements in the order given."""
    with RecordingWriter(path, chunk_size=chunk_size) as writer:
        for message in messages:
            writer.write(topics.MEASUREMENT, message, wire.stamp(message))
    return path


def assert_same(left, right):
    assert left.dtype == right.dtype
    for name in left.dtype.names:
        np.testing.assert_array_equal(left[name], right[name])


def assert_holds(recording, run):
    """Check that a recording holds exactly what a run gave."""
    np.testing.assert_array_equal(recording.readings, run["measurement"])
    np.testing.assert_array_equal(recording.measurement["sequence"], np.arange(len(run["measurement"])))
    np.testing.assert_array_equal(
        recording.measurement["stamp_ns"], PERIOD_NS * np.arange(len(run["measurement"]))
    )
    for column, name in enumerate(wire.COMMAND.fields):
        np.testing.assert_array_equal(recording.command[name], run["command"][:, column])
    np.testing.assert_array_equal(recording.command["measurement_sequence"], np.arange(len(run["command"])))
    assert_same(recording.setpoint, run["setpoints"])
    assert recording.environment == ENVIRONMENT
    assert recording.bench_text == run["bench"]
    estimates = [wire.DRAG_ESTIMATE.unpack(data) for _, data in run["drag_estimates"]]
    for row, (stamp, segment, settled, duration, *_, last) in zip(
        recording.drag_estimate, estimates, strict=True
    ):
        assert (row["stamp_ns"], row["segment"], row["settled"]) == (stamp, segment, settled)
        assert (row["duration"], row["residual"][2]) == (duration, last)


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


def test_one_by_one_or_as_columns_is_the_same(run, directory, tmp_path):
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
def test_any_messages_come_back(blocks, chunk_size, one_by_one, tmp_path_factory):
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
        messages = [
            bytes(m) for piece in topic.pieces for m in (piece if isinstance(piece, list) else piece.filled)
        ]
        key = (lambda pair: pair) if not one_by_one else (lambda pair: 0)  # one by one the order stays
        assert sorted(zip(times, messages, strict=True), key=key) == sorted(pairs, key=key)


def test_analysis_of_recordings_needs_no_ros(directory):
    code = (
        "import sys; from gyrowheel_analysis.recording import Recording\n"
        f"assert len(Recording.open({str(directory)!r}).measurement) == 300\n"
        "assert not {'rclpy', 'gyrowheel_msgs'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


# ---- bags that others have written


def foreign(
    path, messages, *, type_name="gyrowheel_msgs/msg/Measurement", store=None, compression=None, plugin=None
):
    """Write a bag with rosbags; messages are (time, bytes)."""
    writer = Writer(path, version=9, storage_plugin=plugin or StoragePlugin.MCAP)
    if compression:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(topics.MEASUREMENT.name, type_name, typestore=store or typestore())
        for time, data in messages:
            writer.write(connection, time, data)
    return path


def objects(store, frame_id="case", type_name="gyrowheel_msgs/msg/Measurement", count=50):
    """Return measurements as message objects of rosbags."""
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    kind = store.types[type_name]
    for k in range(count):
        fields = {name: float(k + i) for i, name in enumerate(wire.MEASUREMENT.fields)}
        extra = {"comment": "x" * k} if "comment" in kind.__annotations__ else {}
        stamp = time(sec=0, nanosec=k * PERIOD_NS)
        yield kind(header=header(stamp=stamp, frame_id=frame_id), sequence=k, **fields, **extra)


def assert_counting(recording, count=50):
    """Check that the samples are those of `measurements` and `objects`."""
    assert recording.readings.tolist() == [[float(k + i) for i in range(11)] for k in range(count)]
    assert recording.measurement["sequence"].tolist() == list(range(count))
    assert recording.measurement["stamp_ns"].tolist() == [k * PERIOD_NS for k in range(count)]


@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize("compression", [None, CompressionMode.MESSAGE, CompressionMode.FILE])
@pytest.mark.parametrize("frame_id", ["case", "", "some other frame"])
def test_bags_of_other_writers(tmp_path, plugin, compression, frame_id):
    store = typestore()
    messages = [
        (1_700_000_000_000_000_000 + k, bytes(store.serialize_cdr(m, m.__msgtype__)))
        for k, m in enumerate(objects(store, frame_id))
    ]
    path = foreign(tmp_path / "bag", messages, plugin=plugin, compression=compression)
    assert_counting(Recording.open(path))
    file = next(file for file in path.iterdir() if file.name != "metadata.yaml")
    if compression is None:
        assert_counting(Recording.open(file))


def test_storage_compressed_by_chunk(tmp_path):
    messages = [(k, data) for k, data in enumerate(measurements())]
    assert_counting(Recording.open(foreign(tmp_path / "bag", messages, compression=CompressionMode.STORAGE)))


def test_big_endian(tmp_path):
    store = typestore()
    messages = [
        (k, bytes(store.serialize_cdr(m, m.__msgtype__, little_endian=False)))
        for k, m in enumerate(objects(store))
    ]
    assert_counting(Recording.open(foreign(tmp_path / "bag", messages)))


@pytest.mark.parametrize("change", ["swapped", "more", "renamed"])
def test_types_that_only_look_alike(tmp_path, change):
    """Definitions of the same name or size: the fields count, not their places."""
    text = definition("gyrowheel_msgs/msg/Measurement").text
    type_name = "gyrowheel_msgs/msg/Measurement"
    if change == "swapped":
        text = text.replace("float64 tilt_x ", "float64 swap ").replace("float64 tilt_y ", "float64 tilt_x ")
        text = text.replace("float64 swap ", "float64 tilt_y ")
    elif change == "more":
        text = text.replace("uint64 sequence ", "string comment\nuint64 sequence ")
    else:
        type_name = "lab_msgs/msg/Sample"
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, type_name))
    messages = [
        (k, bytes(store.serialize_cdr(m, type_name))) for k, m in enumerate(objects(store, "case", type_name))
    ]
    path = foreign(tmp_path / "bag", messages, type_name=type_name, store=store)
    assert_counting(Recording.open(path))


def test_type_without_the_fields(tmp_path):
    data = wire.pack_text("hello")
    path = foreign(tmp_path / "bag", [(0, data)], type_name="std_msgs/msg/String")
    with pytest.raises(
        InputError, match=r"bag: /gyrowheel/measurement: messages of type std_msgs/msg/String do"
    ):
        Recording.open(path)


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("index", [True, False])
@pytest.mark.parametrize("compression", list(mcap.writer.CompressionType))
def test_files_of_the_mcap_library(tmp_path, chunked, index, compression):
    """With or without chunks, index, compression, and with another topic between."""
    path = tmp_path / "file.mcap"
    writer = mcap.writer.Writer(
        str(path),
        chunk_size=1000,
        compression=compression,
        use_chunking=chunked,
        index_types=mcap.writer.IndexType.ALL if index else mcap.writer.IndexType.NONE,
    )
    writer.start(profile="ros2")
    text = definition("gyrowheel_msgs/msg/Measurement").text
    schema = writer.register_schema("gyrowheel_msgs/msg/Measurement", "ros2msg", text.encode())
    channel = writer.register_channel("/gyrowheel/measurement", "cdr", schema)
    other = writer.register_channel("/other", "cdr", 0)
    for k, data in enumerate(measurements()):
        writer.add_message(other, k, bytes(k), k)
        writer.add_message(channel, k, data, k)
    writer.finish()
    recording = Recording.open(path)
    assert_counting(recording)
    assert recording.topics == {"/gyrowheel/measurement": 50, "/other": 50}


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
    assert recording.readings[:, 0].tolist() == kept
    integrity = recording.integrity()
    lost = [first + k for first, count in integrity.gaps for k in range(count)]
    assert lost == sorted(dropped)
    assert integrity.missing == len(dropped)
    assert integrity.duplicates == len(doubled - dropped)
    assert integrity.samples == len(kept)
    assert integrity.out_of_order == sum(k < max(arrived[:i]) for i, k in enumerate(arrived) if i)
    assert integrity.complete == (not dropped)


def test_numbers_that_are_none_are_counted_and_kept(tmp_path):
    messages = measurements(5)
    messages[2] = wire.MEASUREMENT.pack(2 * PERIOD_NS, 2, float("nan"), *[0.0] * 9, float("inf"))
    recording = Recording.open(record(tmp_path / "bag", [*messages, messages[2]]))
    assert (recording.integrity().not_finite, recording.integrity().duplicates) == (1, 1)
    assert np.isnan(recording.readings[2, 0])
    assert json.loads(info(tmp_path / "bag").to_json())["integrity"]["not_finite"] == 1


@pytest.mark.parametrize(
    "others",
    [
        [wire.MEASUREMENT.pack(3 * PERIOD_NS, 3, *[9.0] * 11)],
        [wire.MEASUREMENT.pack(7 * PERIOD_NS, 2, *[0.0] * 11)],
        [wire.MEASUREMENT.pack(PERIOD_NS + 1, 9, *[0.0] * 11)],
    ],
    ids=["same sample, other readings", "sequence goes back", "stamp goes back"],
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


def test_later_plan_replaces_what_it_overlaps(tmp_path):
    first = [Environment(), Environment(time=2.0, yaw=1.0), Environment(time=4.0, yaw=2.0)]
    second = [Environment(time=3.0, rig="inverted"), Environment(time=5.0, preheat=10.0)]
    assert environment_of(tmp_path / "bag", [(0, first), (3, second)]) == first[:2] + second


def test_environment_counts_from_the_start_of_the_recording(tmp_path):
    plan = [Environment(), Environment(time=0.5, yaw=1.0), Environment(time=1.5, yaw=2.0)]
    got = environment_of(tmp_path / "bag", [(0, plan)], first=2000)  # which is at 1 s
    assert got == [Environment(yaw=1.0), Environment(time=0.5, yaw=2.0)]


def test_environment_unknown_or_wrong(tmp_path):
    assert Recording.open(record(tmp_path / "bag", measurements(3))).environment == []
    with RecordingWriter(tmp_path / "bad") as writer:
        writer.write(topics.ENVIRONMENT, wire.pack_text('[{"rig": "sideways"}]'), 0)
        writer.write(topics.MEASUREMENT, measurements(1)[0], 0)
    with pytest.raises(InputError, match=r"bad: /gyrowheel/environment: environment.rig: 'sideways'"):
        Recording.open(tmp_path / "bad")


# ---- damage


def copy(directory, path):
    shutil.copytree(directory, path)
    return path, next(path.glob("*.mcap"))


def opened_or_refused(path):
    """Return the recording, or the error that says in one line which file is bad."""
    result: Recording | InputError
    try:
        result = Recording.open(path)
    except InputError as error:
        result = error
    assert isinstance(result, Recording) or re.fullmatch(rf"{path}.*: .+", str(result))
    return result


def test_truncated_file_is_refused(directory, tmp_path):
    path, file = copy(directory, tmp_path / "cut")
    data = file.read_bytes()
    sizes = random.Random(2).sample(range(len(data)), 60)
    for size in [*sizes, 0, 1, 8, 40, len(data) - 1, len(data) - 8, len(data) - 37]:
        file.write_bytes(data[:size])
        with pytest.raises(InputError, match=rf"^{file}: [^\n]*$"):
            Recording.open(path)


def test_every_flipped_bit_is_noticed(directory, tmp_path):
    path, file = copy(directory, tmp_path / "flipped")
    data = file.read_bytes()
    places = random.Random(3).sample(range(len(data)), 150)
    for place in [*places, *range(0, 40, 3), *range(len(data) - 60, len(data))]:
        damaged = bytearray(data)
        damaged[place] ^= 1 << (place % 8)
        file.write_bytes(damaged)
        with pytest.raises(InputError, match=rf"^{file}: [^\n]*$"):
            Recording.open(path)


def test_file_without_checksums_is_refused_or_read(tmp_path):
    """Without checksums a changed reading cannot be noticed; nothing else may come of it."""
    path = foreign(tmp_path / "bag", [(k, data) for k, data in enumerate(measurements())])
    file = next(path.glob("*.mcap"))
    data = file.read_bytes()
    for place in random.Random(4).sample(range(len(data)), 150):
        damaged = bytearray(data)
        damaged[place] ^= 1 << (place % 8)
        file.write_bytes(damaged)
        got = opened_or_refused(path)
        assert isinstance(got, InputError) or len(got.measurement) == 50


def test_damaged_database_is_refused_or_read(tmp_path):
    messages = [(k, data) for k, data in enumerate(measurements())]
    path = foreign(tmp_path / "bag", messages, plugin=StoragePlugin.SQLITE3)
    file = next(path.glob("*.db3"))
    data = file.read_bytes()
    for size in random.Random(5).sample(range(len(data)), 30):
        file.write_bytes(data[:size])
        got = opened_or_refused(path)
        if isinstance(got, Recording):
            assert_counting(got)


def test_database_whose_tables_are_described_in_no_text(tmp_path):
    messages = [(k, data) for k, data in enumerate(measurements())]
    path = foreign(tmp_path / "bag", messages, plugin=StoragePlugin.SQLITE3)
    file = next(path.glob("*.db3"))
    data = file.read_bytes()
    assert b"CREATE TABLE messages" in data
    file.write_bytes(data.replace(b"CREATE TABLE messages", b"CREATE TABL\xbf messages"))
    with pytest.raises(InputError, match=rf"^{file}: damaged: [^\n]*$"):
        Recording.open(path)


def test_damaged_metadata_is_refused_or_changes_nothing(run, directory, tmp_path):
    path, _ = copy(directory, tmp_path / "metadata")
    file = path / "metadata.yaml"
    data = file.read_bytes()
    rng = random.Random(6)
    variants = [data[:size] for size in rng.sample(range(len(data)), 25)]
    for place in rng.sample(range(len(data)), 50):
        variants.append(data[:place] + bytes([data[place] ^ 1 << (place % 8)]) + data[place + 1 :])
    for variant in variants:
        file.write_bytes(variant)
        got = opened_or_refused(path)
        if isinstance(got, Recording):
            assert_holds(got, run)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "not the metadata of a recording"),
        ("just text", "not the metadata of a recording"),
        ("a: [", "not valid YAML"),
        ("other: {}", "rosbag2_bagfile_information: missing"),
        ("rosbag2_bagfile_information: {}", "relative_file_paths: missing"),
        (
            "rosbag2_bagfile_information:\n  {relative_file_paths: [gone.mcap], message_count: 1,"
            " storage_identifier: mcap}",
            r"gone.mcap: cannot be read: No such file",
        ),
        (
            "rosbag2_bagfile_information:\n  {relative_file_paths: [], message_count: 7,"
            " storage_identifier: mcap}",
            "metadata.yaml counts 7 messages, but the files hold 0",
        ),
        (
            "rosbag2_bagfile_information:\n  {relative_file_paths: [], message_count: 7,"
            " storage_identifier: tape}",
            "cannot be read: ",
        ),
    ],
)
def test_wrong_metadata(tmp_path, text, what):
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(InputError, match=what):
        Recording.open(tmp_path)


def test_what_is_no_recording(directory, tmp_path):
    with pytest.raises(InputError, match="nowhere: no such recording"):
        Recording.open(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"no metadata.yaml: this is no recording"):
        Recording.open(tmp_path)
    path, file = copy(directory, tmp_path / "begun")
    (path / "metadata.yaml").unlink()
    with pytest.raises(InputError, match=r"begun: no metadata.yaml: the recording was not completed"):
        Recording.open(path)
    assert len(Recording.open(file).measurement) == 300
    for name, content in {"a.mcap": b"", "b.mcap": b"x" * 100, "c.db3": b"x" * 100, "d.csv": b"1,2"}.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=rf"{name}: [^\n]+$"):
            Recording.open(tmp_path / name)


def test_without_measurements(tmp_path):
    with RecordingWriter(tmp_path / "empty"):
        pass
    with pytest.raises(
        InputError, match=r"empty: no messages on /gyrowheel/measurement; there are: none at all"
    ):
        Recording.open(tmp_path / "empty")
    with RecordingWriter(tmp_path / "bench") as writer:
        writer.write(topics.BENCH, wire.pack_text("a bench"), 0)
    with pytest.raises(InputError, match="there are: /gyrowheel/bench"):
        Recording.open(tmp_path / "bench")


# ---- writing that goes wrong


def test_existing_directories(tmp_path, run):
    (tmp_path / "empty").mkdir()
    assert_holds(Recording.open(write_run(tmp_path / "empty", **run)), run)
    before = {file: file.read_bytes() for file in (tmp_path / "empty").iterdir()}
    with pytest.raises(InputError, match="empty: exists; a recording needs a new directory"):
        write_run(tmp_path / "empty", **run)
    assert before == {file: file.read_bytes() for file in (tmp_path / "empty").iterdir()}
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file: exists"):
        RecordingWriter(tmp_path / "file")
    with pytest.raises(InputError, match=r"cannot be written: Not a directory"):
        RecordingWriter(tmp_path / "file" / "below")


def test_interrupted_recording_does_not_look_complete(tmp_path):
    def interrupted():
        yield from measurements(100)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record(tmp_path / "bag", interrupted())
    assert not (tmp_path / "bag" / "metadata.yaml").exists()
    for path in (tmp_path / "bag", tmp_path / "bag" / "bag_0.mcap"):
        with pytest.raises(InputError, match="the recording was not completed"):
            Recording.open(path)


def test_whole_chunks_survive_a_killed_process(tmp_path):
    """What is on the disk while the writer is still at it."""
    writer = RecordingWriter(tmp_path / "bag", chunk_size=4096)
    for data in measurements(1000):
        writer.write(topics.MEASUREMENT, data, wire.stamp(data))
    count = 0
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream, contextlib.suppress(EndOfFile):
        for item in StreamReader(stream).records:
            count += isinstance(item, mcap.records.Message)
    assert 1000 > count > 1000 - 4096 / 155 - 1
    writer.close()
    assert len(Recording.open(tmp_path / "bag").measurement) == 1000


def test_nothing_is_left_of_a_run_that_cannot_be_written(tmp_path, run):
    bad = {**run, "drag_estimates": [(-5, b"x")]}
    with pytest.raises(ValueError, match="log times must ascend from 0"):
        write_run(tmp_path / "new", **bad)
    assert not (tmp_path / "new").exists()
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="log times must ascend from 0"):
        write_run(tmp_path / "empty", **bad)
    assert list((tmp_path / "empty").iterdir()) == []


def test_full_disk(tmp_path, run):
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full")
    writer = RecordingWriter(tmp_path / "bag")
    writer._mcap._file = open("/dev/full", "wb", buffering=0)  # noqa: SIM115
    writer.write(topics.MEASUREMENT, measurements()[0], 0)
    with pytest.raises(InputError, match="bag: cannot be written: No space left on device"):
        writer.flush()
    writer.abort()


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
    assert json.loads(got.to_json())["holds"][1]["spin_rate"] == 50 * np.pi
    text = got.render()
    for part in (
        "0.20 s, 400 samples at 2000.0 Hz",
        "samples: all there",
        "spin rate 1500 .. 3000 rpm, tilt 0 .. 5 deg",
        "2 holds in 2 segments",
        "at 1500, 3000 rpm",
        "tilted by 5 deg",
        "rig upright, inverted",
        "/gyrowheel/measurement    400",
    ):
        assert part in text


def test_info_of_few_samples_with_gaps(tmp_path):
    messages = measurements(10)
    del messages[4:6]
    got = info(record(tmp_path / "bag", messages))
    assert got.rate == pytest.approx(2000.0)
    assert (got.integrity.missing, got.integrity.gaps) == (2, ((4, 2),))
    assert "samples: 2 missing" in got.render()
    assert got.holds == ()
    one = info(record(tmp_path / "one", messages[:1]))
    assert (one.rate, one.duration) == (0.0, 0.0)
