"""The order in which a recording is given back, and its pace."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import RecordingWriter
from gyrowheel_recording.bags.columns import typestore
from gyrowheel_recording.bags.playback import Message, Pace, Tape, parse_names

PERIOD_NS = 500_000
N = 4_000  # samples: 2 s
SETPOINT_NS = 5_000_000
START_NS = 7_000_000_000


def sample(k: int) -> bytes:
    return wire.MEASUREMENT.pack(START_NS + k * PERIOD_NS, k, *[0.1 * k] * 11)


def setpoint(stamp_ns: int) -> bytes:
    return wire.SETPOINT.pack(stamp_ns, stamp_ns // 1_000_000_000, 1, *[0.0] * 6)


def diagnostics(k: int) -> bytes:
    return b"\0\1\0\0" + k.to_bytes(4, "little") + bytes(12)


def content() -> list[tuple[topics.Topic, int, bytes]]:
    """Return the messages of a recording in the order in which a recorder would have got them."""
    result = [(topics.BENCH, START_NS, wire.pack_text("the bench"))]
    result += [
        (topics.SETPOINT, START_NS + k * SETPOINT_NS, setpoint(START_NS + k * SETPOINT_NS))
        for k in range(420)
    ]
    for k in range(N):
        stamp = START_NS + k * PERIOD_NS
        result.append((topics.MEASUREMENT, stamp, sample(k)))
        result.append((topics.COMMAND, stamp, wire.COMMAND.pack(stamp, k, 0.0, 0.0, 0.1 * k)))
        if k == 2500:
            result.append((topics.ENVIRONMENT, stamp, wire.pack_text("[]")))
    return result


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("replay") / "run"
    with RecordingWriter(path) as writer:
        for topic, stamp, data in content():
            writer.write(topic, data, stamp)
    return path


def given_back(path: Path, **options: object) -> list[Message]:
    with Tape(path, **options) as tape:  # type: ignore[arg-type]
        return list(tape.messages())


def of(messages: list[Message], topic: topics.Topic) -> list[bytes]:
    return [data for _, name, data in messages if name == topic]


def test_replay_yields_every_message_once_unchanged(recording: Path) -> None:
    messages = given_back(recording)
    wanted = content()
    assert len(messages) == len(wanted)
    for topic in (topics.MEASUREMENT, topics.COMMAND, topics.SETPOINT, topics.BENCH, topics.ENVIRONMENT):
        assert of(messages, topic) == [data for t, _, data in wanted if t == topic]
    due = [time for time, _, _ in messages]
    assert due == sorted(due)


def test_setpoints_are_replayed_ahead_of_their_samples(recording: Path) -> None:
    for lead in (0.0, 0.25):
        latest = -1
        for due, topic, data in given_back(recording, setpoint_lead=lead):
            if topic == topics.SETPOINT:
                latest = wire.SETPOINT.unpack(data)[0]
                assert due == max(latest - round(lead * 1e9), START_NS)
            elif topic == topics.MEASUREMENT and due < START_NS + 2_000_000_000 - lead * 1e9:
                assert latest >= due - SETPOINT_NS + round(lead * 1e9)


def test_range_begins_with_latched_messages_and_last_setpoint(recording: Path) -> None:
    with Tape(recording, start=1.5, end=1.75) as tape:
        messages = list(tape.messages())
        assert (tape.start, tape.duration) == (1.5, 0.25)
    start = START_NS + 1_500_000_000
    assert messages[0] == (start, topics.BENCH, wire.pack_text("the bench"))
    assert messages[1] == (start, topics.ENVIRONMENT, wire.pack_text("[]"))
    assert messages[2] == (start, topics.SETPOINT, setpoint(start - SETPOINT_NS))
    assert of(messages, topics.MEASUREMENT) == [sample(k) for k in range(3000, 3501)]
    assert of(messages, topics.SETPOINT)[1:] == [setpoint(start + k * SETPOINT_NS) for k in range(51)]


def test_topics_can_be_chosen_and_left_out(recording: Path) -> None:
    assert {t for _, t, _ in given_back(recording, only=["/gyrowheel/command"])} == {topics.COMMAND}
    rest = {t for _, t, _ in given_back(recording, without=["/gyrowheel/command", "/gyrowheel/bench"])}
    assert rest == {topics.MEASUREMENT, topics.SETPOINT, topics.ENVIRONMENT}
    assert parse_names("/a, /b /c,") == ("/a", "/b", "/c")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            {"only": ["/gyrowheel/comand"]},
            ("no messages on '/gyrowheel/comand'", "there are: /gyrowheel/bench"),
        ),
        ({"without": ["/x"]}, ("no messages on '/x'",)),
        ({"only": ["/gyrowheel/bench"], "without": ["/gyrowheel/bench"]}, ("no topic is left",)),
        ({"start": 3.0}, ("nothing from 3 s on", "2.0")),
        ({"start": 1.0, "end": 1.0}, ("the end must lie behind the start",)),
        ({"start": math.nan}, ("the end must lie behind the start",)),
    ],
)
def test_missing_topics_and_ranges_are_refused(
    recording: Path, options: dict[str, object], words: tuple[str, ...]
) -> None:
    with pytest.raises(InputError) as caught:
        given_back(recording, **options)
    assert str(recording) in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_a_damaged_recording_is_refused_before_replay_starts(recording: Path, tmp_path: Path) -> None:
    whole = bytearray((recording / "run_0.mcap").read_bytes())
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "metadata.yaml").write_bytes((recording / "metadata.yaml").read_bytes())
    for place in np.random.default_rng(1).integers(100, len(whole) - 100, 20):
        damaged = whole.copy()
        damaged[place] ^= 0x10
        (folder / "run_0.mcap").write_bytes(damaged)
        try:
            assert given_back(folder) == given_back(recording)  # in what nobody looks at
        except InputError as error:
            assert str(folder) in str(error)  # noqa: PT017
    (folder / "metadata.yaml").unlink()
    with pytest.raises(InputError, match="not completed"):
        given_back(folder)


@pytest.mark.parametrize(
    ("storage", "compression"),
    [
        (StoragePlugin.SQLITE3, None),
        (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
        (StoragePlugin.SQLITE3, CompressionMode.FILE),
        (StoragePlugin.MCAP, None),
        (StoragePlugin.MCAP, CompressionMode.MESSAGE),
        (StoragePlugin.MCAP, CompressionMode.FILE),
        (StoragePlugin.MCAP, CompressionMode.STORAGE),
    ],
)
def test_bags_of_other_writers_are_replayed(
    tmp_path: Path,
    storage: StoragePlugin,
    compression: CompressionMode | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Written by rosbags, in any storage, with a topic that the bench does not have; nothing is written to the disk."""
    store = typestore()
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=storage)
    if compression is not None:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    text = get_typestore(Stores.ROS2_JAZZY).types["std_msgs/msg/String"]
    note = bytes(store.serialize_cdr(text(data="hello"), "std_msgs/msg/String"))
    with writer:
        samples = writer.add_connection(
            topics.MEASUREMENT.name, topics.MEASUREMENT.type_name, typestore=store
        )
        notes = writer.add_connection("/notes", "std_msgs/msg/String", typestore=store)
        for k in range(50):
            writer.write(samples, START_NS + k * PERIOD_NS, sample(k))
        writer.write(notes, START_NS + 7 * PERIOD_NS, note)
    monkeypatch.setattr("tempfile.tempdir", "/proc/no/such/place")
    messages = given_back(tmp_path / "bag")
    assert of(messages, topics.MEASUREMENT) == [sample(k) for k in range(50)]
    others = [
        (due, topic.name, topic.type_name, data) for due, topic, data in messages if topic.name == "/notes"
    ]
    assert others == [(START_NS + 7 * PERIOD_NS, "/notes", "std_msgs/msg/String", note)]
    assert len(given_back(tmp_path / "bag", start=0.01)) == 30


def test_a_topic_of_another_type_is_refused(tmp_path: Path) -> None:
    store = typestore()
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(topics.MEASUREMENT.name, "std_msgs/msg/String", typestore=store)
        writer.write(connection, 5, wire.pack_text("hello"))
    with pytest.raises(
        InputError, match=r"/gyrowheel/measurement: type std_msgs/msg/String; allowed: gyrowheel_msgs"
    ):
        given_back(tmp_path / "bag")


def test_the_reader_sees_the_same_selection(recording: Path) -> None:
    with Reader(recording) as reader:
        plain = sorted((time, connection.topic, bytes(data)) for connection, time, data in reader.messages())
    mine = given_back(recording, setpoint_lead=0.0)
    assert sorted((due, topic.name, data) for due, topic, data in mine) == plain


# --- pace


def test_pace_without_a_limit_and_at_standstill() -> None:
    pace = Pace(0.0, 100, paused=True)
    assert pace.limit(1.0) == 100
    pace.go(150)
    assert pace.limit(1.0) == math.inf
    pace.hold(170)
    assert pace.limit(99.0) == 170
    for rate in (-1.0, math.nan, math.inf):
        with pytest.raises(InputError, match="rate"):
            Pace(rate, 0)


@given(
    rate=st.floats(0.01, 100.0),
    events=st.lists(st.tuples(st.floats(0.0, 10.0), st.sampled_from(["hold", "go"])), max_size=12),
)
def test_pace_advances_only_while_running(rate: float, events: list[tuple[float, str]]) -> None:
    """Whatever is held and let go, the position is the rate times the time for which it went."""
    pace = Pace(rate, 0)
    now = went = 0.0
    going = True
    assert pace.limit(now) == 0
    for wait, event in events:
        now += wait
        went += wait * going
        position = pace.limit(now)
        assert position == pytest.approx(went * rate * 1e9, rel=1e-9, abs=20.0)
        getattr(pace, event)(int(position))
        going = event == "go"
        assert pace.limit(now) == int(position)
