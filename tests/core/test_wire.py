"""The fixed layouts against the serializers of ROS and of rosbags."""

from __future__ import annotations

import functools
import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore

from gyrowheel_core import topics, wire

TOPICS = [topic for topic in topics.TOPICS if topic.layout]
BY_NAME = pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
RANGES = {"uint8": 2**8 - 1, "uint32": 2**32 - 1, "uint64": 2**64 - 1}


def elements(kind):
    """Return a strategy for the values that one field packs, as a list."""
    one = {"bool": st.booleans(), "float64": st.floats()}.get(kind.removesuffix("[3]"))
    one = st.integers(0, RANGES[kind]) if one is None else one
    size = 3 if kind.endswith("[3]") else 1
    return st.lists(one, min_size=size, max_size=size)


@functools.cache
def values(layout):
    """Return a strategy for the values of all fields after the header, by name, in order."""
    names = [name for name in layout.declaration if name not in ("sec", "nanosec", "frame_id")]
    entries = st.tuples(*(elements(layout.declaration[name]) for name in names))
    return entries.map(lambda entry: dict(zip(names, entry, strict=True)))


STAMPS = st.integers(0, 2**31 * wire.SECOND - 1)


def flat(given_values):
    return [value for entry in given_values.values() for value in entry]


def same(left, right):
    """Return whether two values are equal, what is no number included."""
    return left == right or (math.isnan(left) and math.isnan(right))


def message(topic, stamp, given_values):
    """Return the message object that ROS would be given."""
    result = topic.message_class()
    time = result.clock if topic is topics.CLOCK else result.header.stamp
    time.sec, time.nanosec = divmod(stamp, wire.SECOND)
    if topic is not topics.CLOCK:
        result.header.frame_id = wire.FRAME_ID
    for name, entry in given_values.items():
        setattr(result, name, entry if len(entry) > 1 else entry[0])
    return result


@BY_NAME
@settings(max_examples=40, deadline=None)
@given(data=st.data(), stamp=STAMPS)
def test_ros_reads_what_is_packed_and_the_reverse(topic, data, stamp):
    entry = data.draw(values(topic.layout))
    packed = topic.layout.pack(stamp, *flat(entry))
    expected = message(topic, stamp, entry)
    assert repr(deserialize_message(packed, topic.message_class)) == repr(
        expected
    )  # nan is not equal to itself

    serialized = bytes(serialize_message(expected))
    assert len(serialized) == topic.layout.size
    got = topic.layout.unpack(serialized)
    assert got[0] == stamp
    assert all(map(same, got[1:], flat(entry)))
    assert wire.stamp(serialized) == stamp


@BY_NAME
@settings(max_examples=20, deadline=None)
@given(data=st.data(), stamps=st.lists(STAMPS, min_size=1, max_size=4))
def test_array_is_the_packed_messages(topic, data, stamps):
    layout = topic.layout
    entries = [data.draw(values(layout)) for _ in stamps]
    array = layout.array(len(stamps))
    layout.set_stamps(array, stamps)
    for name in (*layout.integers, *layout.fields):
        column = [entry[name] for entry in entries]
        array[name] = column if len(column[0]) > 1 else [one for (one,) in column]
    expected = b"".join(
        layout.pack(stamp, *flat(entry)) for stamp, entry in zip(stamps, entries, strict=True)
    )
    # compared by fields: of what is not a number the bits may differ
    read = np.frombuffer(expected, layout.dtype)
    assert len(array.tobytes()) == len(expected)
    for name in layout.dtype.names:
        np.testing.assert_array_equal(array[name], read[name])
    assert layout.matches(read).all()
    assert layout.stamps(read).tolist() == stamps


@BY_NAME
def test_rosbags_reads_what_is_packed(topic):
    from gyrowheel_recording.bags.columns import typestore

    layout = topic.layout
    numbers = iter(float(k) + 0.5 for k in range(60))
    values: list[float] = []
    for name in layout.names:
        count = 3 if layout.declaration[name].endswith("[3]") else 1
        values += [1] if name in layout.integers else [next(numbers) for _ in range(count)]
    given = iter(values)
    packed = layout.pack(7_000_000_009, *values)
    decoded = typestore().deserialize_cdr(packed, layout.type_name)
    for name in layout.names:
        expected = [next(given) for _ in range(3 if layout.declaration[name].endswith("[3]") else 1)]
        assert list(np.atleast_1d(getattr(decoded, name))) == expected


@BY_NAME
def test_declaration_is_that_of_the_message_definition(topic):
    layout = topic.layout
    fields = layout.declaration.items()
    expected = {name: kind.replace("float64", "double").replace("bool", "boolean") for name, kind in fields}
    defined = topic.message_class.get_fields_and_field_types()
    header = defined.pop("header", None) or defined.pop("clock")
    assert header == ("builtin_interfaces/Time" if topic is topics.CLOCK else "std_msgs/Header")
    names = layout.names
    assert list(defined.items()) == [(name, expected[name]) for name in names]


@BY_NAME
def test_messages_of_another_layout_are_refused(topic):
    layout = topic.layout
    good = layout.array(1).tobytes()
    assert layout.unpack(good)[0] == 0
    for bad in (good[:-1], good + b"\0", b""):
        with pytest.raises(
            ValueError, match=rf"{layout.type_name}: \d+ bytes; this layout has {layout.size}"
        ):
            layout.unpack(bad)
    with pytest.raises(ValueError, match="encapsulation 00000000"):
        layout.unpack(bytes(4) + good[4:])
    with pytest.raises(ValueError, match="within a second"):
        layout.unpack(good[:8] + struct.pack("<I", 10**9) + good[12:])
    bad_arrays = [layout.array(1) for _ in range(2)]
    bad_arrays[0]["encapsulation"] = b"\x00\x00\x00\x00"
    bad_arrays[1]["nanosec"] = 10**9
    assert not any(layout.matches(array).any() for array in bad_arrays)
    if "frame_id" in layout.declaration:
        other = good.replace(b"case\0", b"cage\0")
        with pytest.raises(ValueError, match="frame_id is not 'case'"):
            layout.unpack(other)
        assert not layout.matches(np.frombuffer(other, layout.dtype)).any()


def test_values_that_do_not_fit_are_refused():
    for bad in ([1.0, 2.0], [1, 1.0, 2.0, 3.0, 4.0], [-1, 1.0, 2.0, 3.0], [2**64, 1.0, 2.0, 3.0]):
        with pytest.raises(ValueError, match="gyrowheel_msgs/msg/Command: cannot be packed"):
            wire.COMMAND.pack(0, *bad)
    with pytest.raises(ValueError, match="cannot be packed"):
        wire.COMMAND.pack(2**31 * wire.SECOND, 1, 1.0, 2.0, 3.0)


def test_padding_is_ignored():
    data = bytearray(wire.COMMAND.pack(5, 6, 1.0, 2.0, 3.0))
    end = data.index(b"case\0") + 5
    data[end : end + 3] = b"\xff\xff\xff"  # the ROS serializer leaves there what was in memory
    assert wire.COMMAND.unpack(bytes(data)) == (5, 6, 1.0, 2.0, 3.0)


@given(text=st.text())
def test_a_text_is_packed_and_unpacked(text):
    store = get_typestore(Stores.ROS2_JAZZY)
    decoded: Any = store.deserialize_cdr(wire.pack_text(text), "std_msgs/msg/String")
    assert decoded.data == text
    assert wire.unpack_text(wire.pack_text(text)) == text


@pytest.mark.parametrize("bad", [b"", b"\0\1\0\0", wire.pack_text("abc")[:-1], b"\0\0\0\0\0\0\0\1\0"])
def test_a_damaged_text_is_refused(bad):
    with pytest.raises(ValueError, match="std_msgs/msg/String"):
        wire.unpack_text(bad)


def test_a_message_without_a_stamp_is_refused():
    for bad in (b"", b"\0\1\0\0", bytes(12), struct.pack("<4siI", b"\0\1\0\0", -1, 0)):
        with pytest.raises(ValueError, match="stamp"):
            wire.stamp(bad)


def test_topics_are_those_of_their_types():
    for topic in topics.TOPICS:
        package, kind, name = topic.type_name.split("/")
        assert topic.message_class.__name__ == name
        assert topic.message_class.__module__.startswith(f"{package}.{kind}.")
        assert topic.qos.depth == topic.depth
    assert topics.BENCH.qos.durability.name == topics.ENVIRONMENT.qos.durability.name == "TRANSIENT_LOCAL"
    assert {topic.qos.reliability.name for topic in topics.TOPICS} == {"RELIABLE"}
