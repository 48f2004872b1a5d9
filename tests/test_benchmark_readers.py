"""The readers that the benchmark compares give the same data, and damage is counted."""

from pathlib import Path

import numpy as np

from benchmarks.readers import by_ours, by_rosbags, fates, in_turn, messages
from gyrowheel_core import topics
from gyrowheel_recording.bags import RecordingWriter


def test_both_readers_give_what_was_written(tmp_path: Path) -> None:
    content = messages(0.1)
    with RecordingWriter(tmp_path / "run") as writer:
        for topic, stamp, data in in_turn(content):
            writer.write(topic, data, stamp)
    theirs, ours = by_rosbags(tmp_path / "run"), by_ours(tmp_path / "run")
    assert {name: len(rows) for name, rows in theirs.items()} == ours.topics
    for topic, rows in ((topics.MEASUREMENT, ours.measurement), (topics.COMMAND, ours.command)):
        assert topic.layout is not None
        written = content[topic.name]
        assert theirs[topic.name].tobytes() == written.tobytes()
        for name in (*topic.layout.integers, *topic.layout.fields):
            assert np.array_equal(rows[name], written[name])


def test_every_damaged_recording_is_counted_once() -> None:
    found = fates(12, 3)
    for fate in found.values():
        assert fate.refused + fate.exact + fate.wrong == 12
    assert found["ours"].wrong == 0
