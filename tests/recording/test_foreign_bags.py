"""Bags that others have written: other writers, storages, compressions and types."""

from __future__ import annotations

import mcap.writer
import pytest
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from gyrowheel_core import wire
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.bags.columns import definition, typestore

from .recordings import assert_counting, foreign, measurements, objects


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
