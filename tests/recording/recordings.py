"""Small recordings for the tests of reading and writing them: numbers that nothing can mistake for each other."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from rich.console import RenderableType
from rosbags.rosbag2 import CompressionFormat, StoragePlugin, Writer

from gyrowheel.show.layout import plain_text
from gyrowheel_core import topics, wire
from gyrowheel_recording.bags import RecordingWriter
from gyrowheel_recording.bags.columns import column_dtype, typestore
from gyrowheel_sim.environment import Environment, to_json

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
        "drag_estimates": [(k * 10_000_000, _estimate(k, rng)) for k in range(3)],
    }


def _estimate(k, rng):
    row = wire.DRAG_ESTIMATE.array(1)
    wire.DRAG_ESTIMATE.set_stamps(row, k * 10_000_000)
    for name in wire.DRAG_ESTIMATE.fields:
        row[name] = rng.normal(size=row[name].shape)
    row["segment"], row["settled"], row["calibrated"] = k, True, True
    return row.tobytes()


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


def assert_same(left, right):
    assert left.dtype == right.dtype
    for name in left.dtype.names:
        np.testing.assert_array_equal(left[name], right[name])


def assert_holds(recording, run):
    """Check that a recording holds exactly what a run gave."""
    np.testing.assert_array_equal(recording.readings.array, run["measurement"])
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


def assert_counting(recording, count=50):
    """Check that the samples are those of `measurements` and `objects`."""
    assert recording.readings.array.tolist() == [[float(k + i) for i in range(11)] for k in range(count)]
    assert recording.measurement["sequence"].tolist() == list(range(count))
    assert recording.measurement["stamp_ns"].tolist() == [k * PERIOD_NS for k in range(count)]


def shown(page: Iterable[RenderableType]) -> str:
    """Return a page as the terminal shows it, a single space between words."""
    return " ".join(plain_text(page, width=200).split())
