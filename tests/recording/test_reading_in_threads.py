"""Files that are read by several threads, in many batches, compiled or not: the same, refused in the same words."""

from __future__ import annotations

import itertools
import os
import random
import runpy
import shutil
import subprocess
import sys
import threading
import zlib
from pathlib import Path
from typing import Any

import mcap.writer
import numpy as np
import pytest

from gyrowheel_core import arrays, topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import LARGEST_VARIABLE
from gyrowheel_recording.bags import Recording, write_run
from gyrowheel_recording.bags import columns as recording_columns
from gyrowheel_recording.bags import mcap as bags_mcap
from gyrowheel_recording.bags.columns import columns, definition, wanted
from gyrowheel_recording.bags.mcap import batches, crc32, joined, joined_with, reader, records
from gyrowheel_recording.bags.mcap.batches import contents
from gyrowheel_recording.bags.mcap.reader import read_mcap

from ..fuzz.chunks import chunk, declarations, file, index, message
from .recordings import PERIOD_NS, assert_holds, make_run, measurements

SAMPLES = 2000
THREADS = (1, 2, 3, 4)
WAYS: list[dict[str, Any]] = [
    {"threads": threads, "compiled": compiled} for compiled in (False, True) for threads in (1, 2, 3, 4)
]
WANTED = {
    topics.MEASUREMENT.name: wanted(wire.MEASUREMENT),
    topics.COMMAND.name: wanted(wire.COMMAND),
    topics.SETPOINT.name: wanted(wire.SETPOINT),
    topics.BENCH.name: None,
}


@pytest.fixture(autouse=True)
def small_batches(monkeypatch):
    """Make batches so small that the files of the tests have dozens of them."""
    monkeypatch.setattr(batches, "SIZE", 20_000)
    monkeypatch.setattr(reader, "SIZE", 20_000)


@pytest.fixture(scope="module")
def run():
    return make_run(SAMPLES)


@pytest.fixture(scope="module")
def own(run, tmp_path_factory):
    """Return the file of a recording of ours: many small chunks."""
    folder = tmp_path_factory.mktemp("threads") / "run"
    write_run(folder, **run)
    return next(folder.glob("*.mcap"))


def foreign(path, messages, **kind):
    """Write measurements with the MCAP library, with another topic and a declaration in the middle."""
    writer = mcap.writer.Writer(str(path), chunk_size=3000, **kind)
    writer.start(profile="ros2")
    text = definition(wire.MEASUREMENT.type_name).text
    schema = writer.register_schema(wire.MEASUREMENT.type_name, "ros2msg", text.encode())
    channel = writer.register_channel(topics.MEASUREMENT.name, "cdr", schema)
    other = None
    for k, data in enumerate(messages):
        if k > 100:
            other = other or writer.register_channel("/other", "cdr", 0)
            writer.add_message(other, k, bytes(k % 50), k)
        writer.add_message(channel, k, data, k)
    writer.finish()
    return path


def read(path, way):
    """Return all that is read of a file, in a form that compares to the bit."""
    found = read_mcap(path, WANTED, **way)
    result = {}
    for topic in found:
        data = b"".join(b"".join(p) if isinstance(p, list) else p.tobytes() for p in topic.pieces)
        times = topic.times
        result[topic.name] = (
            topic.count,
            topic.unchecked,
            np.concatenate(times).tolist() if times else [],
            data,
        )
    return result


@pytest.mark.slow
def test_preloaded_loops_are_used_for_reading(own):
    """In a process of its own: what was loaded once stays."""
    code = f"""
from gyrowheel_recording.bags import load_loops
from gyrowheel_recording.bags.columns import wanted
from gyrowheel_recording.bags.mcap import loops, reader
from gyrowheel_core import topics
def loaded():
    return [len(loop.signatures) for loop in (loops.walk, loops.copied)]
load_loops()
before = loaded()
wanted = {{topic.name: wanted(topic.layout) for topic in (topics.MEASUREMENT, topics.COMMAND, topics.SETPOINT)}}
reader.read_mcap(__import__("pathlib").Path({str(own)!r}), wanted, compiled=True)
print(before, loaded())
"""
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said == "[1, 1] [1, 1]\n"


def test_recording_is_the_same_by_any_number_of_threads(own):
    first, *others = (read(own, way) for way in WAYS)
    assert first[topics.MEASUREMENT.name][0] == SAMPLES
    assert all(other == first for other in others)


def test_compiled_loops_alone_read_an_own_recording(own, monkeypatch):
    expected = read(own, {"compiled": True})

    def other(*_):
        raise AssertionError

    monkeypatch.setattr(records, "_entries", other)
    monkeypatch.setattr(recording_columns, "gathered", other)
    assert read(own, {"compiled": True}) == expected
    with pytest.raises(AssertionError):
        read(own, {"compiled": False})


@pytest.mark.parametrize("in_memory", [arrays.IN_MEMORY, 1000])
def test_recording_comes_back_exactly(own, run, in_memory, monkeypatch):
    """Also as rows that were laid out once: nothing is copied, in the memory or on disk."""
    monkeypatch.setattr(arrays, "IN_MEMORY", in_memory)
    monkeypatch.setattr(reader, "_threads", lambda size: 2)
    assert_holds(Recording.open(own.parent), run)
    (topic,) = (t for t in read_mcap(own, WANTED) if t.name == topics.MEASUREMENT.name)
    assert len(topic.pieces) > 10
    assert isinstance(topic.pieces[0], np.ndarray)
    block = topic.pieces[0].base
    rows = columns(topic, wire.MEASUREMENT, "")
    assert len(rows) == SAMPLES
    assert rows.base is block


@pytest.mark.parametrize(
    "kind",
    [
        {"compression": mcap.writer.CompressionType.ZSTD},
        {"compression": mcap.writer.CompressionType.LZ4},
        {"compression": mcap.writer.CompressionType.NONE, "enable_crcs": False},
        {"compression": mcap.writer.CompressionType.NONE, "index_types": mcap.writer.IndexType.NONE},
        {"use_chunking": False},
        {"use_chunking": False, "enable_data_crcs": True},
    ],
)
def test_files_of_other_writers_are_read_in_every_way(kind, tmp_path):
    path = foreign(tmp_path / "file.mcap", measurements(1000), **kind)
    first, *others = (read(path, way) for way in WAYS)
    assert all(other == first for other in others)
    count, unchecked, _, _ = first[topics.MEASUREMENT.name]
    unsure = kind.get("use_chunking") is False and not kind.get("enable_data_crcs")
    assert (count, unchecked) == (1000, 1000 if unsure or kind.get("enable_crcs") is False else 0)
    recording = Recording.open(path)
    assert recording.measurement["stamp_ns"].tolist() == [k * PERIOD_NS for k in range(1000)]
    assert recording.readings.array[-1].tolist() == [999.0 + i for i in range(11)]


def test_messages_of_another_form_keep_their_place(tmp_path):
    """Messages of another frame are decoded one by one, between those that are rows."""
    messages = measurements(1000)
    for k in (0, 3, 500, 999):
        messages[k] = messages[k].replace(b"case\0", b"cafe\0")
    path = foreign(tmp_path / "file.mcap", messages, compression=mcap.writer.CompressionType.NONE)
    for way in WAYS:
        (topic,) = (t for t in read_mcap(path, WANTED, **way) if t.name == topics.MEASUREMENT.name)
        assert {type(piece) for piece in topic.pieces} == {list, np.ndarray}
        rows = columns(topic, wire.MEASUREMENT, "")
        assert rows["sequence"].tolist() == list(range(1000))
        assert rows["air_pressure"].tolist() == [k + 10.0 for k in range(1000)]


@pytest.mark.parametrize(
    "stated", [{}, {1: 1, 2: 1}, {1: 10**18, 2: 10**18}, dict.fromkeys(range(9), SAMPLES)]
)
def test_wrong_counts_in_the_summary_cause_no_wrong_result(own, stated, monkeypatch):
    expected = read(own, WAYS[0])
    monkeypatch.setattr(reader, "_stated", lambda *_: stated)
    assert read(own, WAYS[1]) == expected


def test_stated_counts_are_read(own):
    size = own.stat().st_size
    with own.open("rb") as file:

        def part(place: int, length: int) -> bytes:
            return os.pread(file.fileno(), length, place)

        found = reader._stated(part, part(size - 37, 37), size)
    counts = {topic.name: topic.count for topic in read_mcap(own, {})}
    assert sorted(found.values()) == sorted(counts.values())


def test_chunk_larger_than_a_batch(run, tmp_path, monkeypatch):
    monkeypatch.setattr(batches, "SIZE", 100)
    write_run(tmp_path / "run", **make_run(300, seed=1))
    file = next((tmp_path / "run").glob("*.mcap"))
    first, *others = (read(file, way) for way in WAYS)
    assert first[topics.MEASUREMENT.name][0] == 300
    assert all(other == first for other in others)


def refused(path, threads, *, compiled=False):
    with pytest.raises(InputError) as error:
        read_mcap(path, WANTED, threads=threads, compiled=compiled)
    return str(error.value)


def test_damage_has_the_same_message_in_every_way_of_reading(own, tmp_path):
    """Also of a file that is damaged at several places: the first of them."""
    data = own.read_bytes()
    path = tmp_path / "damaged.mcap"
    rng = random.Random(7)
    for _ in range(12):
        damaged = bytearray(data)
        for place in rng.sample(range(len(data)), rng.choice((1, 1, 3))):
            damaged[place] ^= 1 << rng.randrange(8)
        path.write_bytes(damaged)
        said = refused(path, 1)
        assert refused(path, 3) == said
        assert refused(path, 3, compiled=True) == said


def test_time_beyond_the_signed_range_is_damage_in_every_way_of_reading(tmp_path):
    """The index has it as a number below zero, of the same bytes."""
    time, data = 2**63 + 5, measurements(1)[0]
    path = tmp_path / "signed.mcap"
    path.write_bytes(file([declarations(), chunk(message(1, time, data)), index(1, [(time, 0)])]))
    said = {refused(path, **way) for way in WAYS}
    assert len(said) == 1
    assert "and its index differ" in said.pop()


def test_damage_found_by_another_thread_is_reported(own, tmp_path, monkeypatch):
    """Who has the first batch waits until another one has failed in the second; no thread is left."""
    data = bytearray(own.read_bytes())
    data[30_000] ^= 1
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    said, failed, met = refused(path, 1), threading.Event(), {}

    def waiting(batch, **kind):
        met[batch.number] = threading.current_thread()
        if batch.number == 0:
            assert failed.wait(60.0)
        try:
            return contents(batch, **kind)
        except Exception:
            failed.set()
            raise

    monkeypatch.setattr(reader, "contents", waiting)
    before = threading.active_count()
    assert refused(path, 2) == said
    assert "the checksum of the chunk at byte" in said
    assert met[0] is not met[1]
    assert threading.active_count() == before


@pytest.mark.parametrize("threads", THREADS)
def test_file_truncated_while_it_is_read_is_refused(own, threads, tmp_path, monkeypatch):
    """It is refused; nothing of it is mapped into memory, where reading would end the program."""
    path = Path(shutil.copy(own, tmp_path / "cut.mcap"))

    def cut(batch, **kind):
        if batch.number == 3:
            os.truncate(path, batch.place)
        return contents(batch, **kind)

    monkeypatch.setattr(reader, "contents", cut)
    assert refused(path, threads) == f"{path}: the file has become shorter while it was read"


def test_limit_is_the_same_by_any_number_of_threads(own, monkeypatch):
    monkeypatch.setenv(LARGEST_VARIABLE, "0.0003")
    said = {refused(own, **way) for way in WAYS}
    assert len(said) == 1
    assert "needs 0.0003" in said.pop()


def test_errors_and_interrupts_of_threads_are_raised(own, monkeypatch):
    """Whichever thread they come in, no other thread goes on."""
    before = threading.active_count()
    for kind in (KeyboardInterrupt, ZeroDivisionError):

        def fail(batch, kind=kind, **_):
            raise kind

        monkeypatch.setattr(reader, "contents", fail)
        with pytest.raises(kind):
            read_mcap(own, WANTED, threads=3)
        assert threading.active_count() == before


def test_checksum_from_those_of_parts():
    """Whether they are long enough to be joined or not, side by side or apart."""
    rng = random.Random(2)
    for _ in range(20):
        data = memoryview(rng.randbytes(rng.randrange(1, 400_000)))
        ends = sorted(rng.randrange(len(data) + 1) for _ in range(6))
        spans = list(itertools.pairwise(ends))[:: rng.choice((1, 2))]
        known = [(a, b, zlib.crc32(data[a:b])) for a, b in spans]
        assert joined_with(data, known) == zlib.crc32(data)


def test_checksum_is_the_same_where_the_fast_library_is_not_installed(monkeypatch):
    data = random.Random(1).randbytes(100_003)
    assert crc32(memoryview(data)[3:], 5) == zlib.crc32(data[3:], 5)
    monkeypatch.setitem(sys.modules, "isal.isal_zlib", None)
    without = runpy.run_path(str(bags_mcap.__file__))
    assert without["crc32"] is zlib.crc32


def test_checksum_of_joined_parts():
    rng = random.Random(1)
    for size in (0, 1, 2, 255, 4096, 1 << 20):
        a, b = rng.randbytes(rng.randrange(100)), rng.randbytes(size)
        assert joined(zlib.crc32(a), zlib.crc32(b), size) == zlib.crc32(a + b)
    half = 1 << 34  # of zeros: longer than any batch, by the rule itself
    whole = joined(joined(7, 0, half), 0, half)
    assert joined(7, 0, 2 * half) == whole
