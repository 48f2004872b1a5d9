"""Writing recordings where something goes wrong: directories that exist, interruptions, a full disk."""

from __future__ import annotations

import contextlib
import itertools
import os

import mcap.records
import numpy as np
import pytest
from mcap.exceptions import EndOfFile
from mcap.stream_reader import StreamReader

from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording, RecordingWriter, salvage, write_run

from .recordings import PERIOD_NS, assert_holds, make_run, measurements, record


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


def test_failed_write_leaves_no_files(tmp_path, run):
    bad = {**run, "drag_estimates": [(-5, b"x")]}
    with pytest.raises(ValueError, match="log times must ascend from 0"):
        write_run(tmp_path / "new", **bad)
    assert not (tmp_path / "new").exists()
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="log times must ascend from 0"):
        write_run(tmp_path / "empty", **bad)
    assert list((tmp_path / "empty").iterdir()) == []


def test_no_chunk_is_longer_than_a_quarter_of_a_second(tmp_path):
    """Whole columns go into chunks as short as those of the recorder, so that a damaged place costs as little."""
    run = make_run(4000)
    assert_holds(Recording.open(write_run(tmp_path / "run", **run)), run)
    with (tmp_path / "run" / "run_0.mcap").open("rb") as stream:
        reader = StreamReader(stream, emit_chunks=True)
        spans = [
            item.message_end_time - item.message_start_time
            for item in reader.records
            if isinstance(item, mcap.records.Chunk)
        ]
    assert len(spans) >= 8
    assert max(spans) <= 0.25e9


def test_long_run_is_written_in_the_order_of_time(tmp_path):
    """Hours are written span by span."""
    run = make_run(300_000)
    stamps = np.arange(300_000) * PERIOD_NS + np.random.default_rng(2).integers(0, PERIOD_NS, 300_000)
    path = write_run(tmp_path / "run", **run, stamps=stamps)
    read = Recording.open(path).measurement
    assert np.array_equal(read["sequence"], np.arange(300_000))
    assert np.array_equal(read["stamp_ns"], stamps)
    assert np.array_equal(read["tilt_x"], run["measurement"][:, 0])
    with (path / "run_0.mcap").open("rb") as stream:
        chunks = [
            (item.message_start_time, item.message_end_time)
            for item in StreamReader(stream, emit_chunks=True).records
            if isinstance(item, mcap.records.Chunk)
        ]
    assert all(after[0] >= before[1] for before, after in itertools.pairwise(chunks))


@pytest.mark.slow
def test_salvage_restores_everything_before_any_cut(tmp_path):
    """Of a recording that was written in one go: all but a quarter of a second, and never nothing."""
    run = make_run(20_000)
    data = (write_run(tmp_path / "run", **run) / "run_0.mcap").read_bytes()
    for number, size in enumerate(len(data) * k // 40 for k in (1, 2, 3, 7, 13, 22, 31, 39)):
        file = tmp_path / f"cut{number}.mcap"
        file.write_bytes(data[:size])
        kept = Recording.open(salvage(file, tmp_path / f"saved{number}").target).measurement
        part = size / len(data) * run["sample_period"] * len(run["measurement"])
        assert (
            len(kept) * run["sample_period"] >= part - 0.25 - 0.02 * part
        )  # the index at the end takes its share
        assert kept["sequence"].tolist() == list(range(len(kept)))


def test_full_disk(tmp_path, run, monkeypatch):
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full")
    writer = RecordingWriter(tmp_path / "bag")
    writer._mcap._file = open("/dev/full", "wb", buffering=0)  # noqa: SIM115
    monkeypatch.setattr(writer._mcap, "require_length", lambda: None)  # /dev/full has none
    writer.write(topics.MEASUREMENT, measurements()[0], 0)
    with pytest.raises(InputError, match="bag: cannot be written: No space left on device"):
        writer.flush()
    writer.abort()
