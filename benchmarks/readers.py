"""Our MCAP reader and writer compared with the fastest use of rosbags: raw bytes and ``numpy.frombuffer``.

These figures decide whether the project keeps its own reader and writer: the time to open and to write a recording,
damage that is read as data, and the samples that are lost when the process is killed.
"""

from __future__ import annotations

import random
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mcap.writer import CompressionType
from mcap.writer import Writer as ForeignWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

from benchmarks.results import Bar, Figure, MeasurementError, Report
from benchmarks.source import PERIOD_NS
from benchmarks.timing import by_turns
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.topics import Topic
from gyrowheel_recording.bags import Recording, RecordingWriter, salvage
from gyrowheel_recording.bags.columns import definition, typestore
from tests.fuzz.damage import mutated

Fraction = Callable[[float], None]
Columns = dict[str, npt.NDArray[Any]]

SECONDS = 180.0  # length of the recording that is read
WRITTEN = 20.0  # length of the recording that is written message by message [s]
SMALL = 2.0  # length of the recording that is damaged [s]
DAMAGED = 400
ROUNDS = 3
_EVERY = 10  # samples per setpoint, as the conductor sends them
_TOPICS = (topics.MEASUREMENT, topics.COMMAND, topics.SETPOINT)
_CHUNK = 1 << 20  # bytes


def messages(seconds: float) -> Columns:
    """Return test messages: a smooth motion with noise, a command for every sample, and setpoints."""
    rng = np.random.default_rng(1)
    n = round(seconds * wire.SECOND / PERIOD_NS)
    stamps = np.arange(n) * PERIOD_NS
    found = {
        topic.name: topic.layout.array(len(stamps[:: _EVERY if topic == topics.SETPOINT else 1]))
        for topic in _TOPICS
        if topic.layout is not None
    }
    for topic in _TOPICS:
        rows, layout = found[topic.name], topic.layout
        assert layout is not None
        layout.set_stamps(rows, stamps[:: _EVERY if topic == topics.SETPOINT else 1])
        for k, name in enumerate(layout.fields):
            wave = np.sin(2e-3 * (k + 1) * np.arange(len(rows)))
            # with the resolution of a 16-bit converter, so that it compresses like a recording
            rows[name] = np.round((wave + 1e-3 * rng.normal(size=len(rows))) * 2**15) / 2**15
    found[topics.MEASUREMENT.name]["sequence"] = np.arange(n)
    found[topics.COMMAND.name]["measurement_sequence"] = np.arange(n)
    return found


def in_turn(content: Columns) -> Iterator[tuple[Topic, int, bytes]]:
    """Yield the messages one by one, as a recorder receives them."""
    stamps = {topic: topic.layout.stamps(content[topic.name]) for topic in _TOPICS if topic.layout}
    data = {topic: _pieces(content[topic.name]) for topic in _TOPICS}
    for k in range(len(stamps[topics.MEASUREMENT])):
        if k % _EVERY == 0:
            yield (
                topics.SETPOINT,
                int(stamps[topics.SETPOINT][k // _EVERY]),
                data[topics.SETPOINT][k // _EVERY],
            )
        for topic in (topics.MEASUREMENT, topics.COMMAND):
            yield topic, int(stamps[topic][k]), data[topic][k]


def _pieces(rows: npt.NDArray[Any]) -> list[bytes]:
    whole, size = rows.tobytes(), rows.dtype.itemsize
    return [whole[a : a + size] for a in range(0, len(whole), size)]


def by_rosbags(path: Path) -> Columns:
    """Read a recording with rosbags without deserializing messages: the fastest use of its interface."""
    raw: dict[str, list[bytes]] = {topic.name: [] for topic in _TOPICS}
    with Reader(path) as reader:
        take = {c.id: raw[c.topic].append for c in reader.connections if c.topic in raw}
        for connection, _, data in reader.messages([c for c in reader.connections if c.topic in raw]):
            take[connection.id](data)
    found = {}
    for topic in _TOPICS:
        assert topic.layout is not None
        rows = np.frombuffer(b"".join(raw[topic.name]), topic.layout.dtype)
        if not topic.layout.matches(rows).all():
            raise ValueError(f"{topic.name}: not the layout of the bench")
        found[topic.name] = rows
    return found


def by_ours(path: Path) -> Recording:
    """Read a recording as the program does: sorted, with checked sequence numbers."""
    return Recording.open(path)


def _write_ours(folder: Path, turns: list[tuple[Topic, int, bytes]]) -> RecordingWriter:
    writer = RecordingWriter(folder)
    for topic, stamp, data in turns:
        writer.write(topic, data, stamp)
    return writer


def _write_rosbags(folder: Path, turns: list[tuple[Topic, int, bytes]], *, compress: bool = False) -> Writer:
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    if compress:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    writer.open()
    connections = {
        topic: writer.add_connection(topic.name, topic.type_name, typestore=typestore()) for topic in _TOPICS
    }
    for topic, stamp, data in turns:
        writer.write(connections[topic], stamp, data)
    return writer


def _write_zstd(file: Path, content: Columns) -> None:
    """Write an MCAP file with chunks of 1 MB compressed by zstd."""
    with file.open("wb") as stream:
        writer = ForeignWriter(stream, chunk_size=_CHUNK, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        channels = {}
        for topic in _TOPICS:
            text = definition(topic.type_name).text.encode()
            schema = writer.register_schema(topic.type_name, "ros2msg", text)
            channels[topic] = writer.register_channel(topic.name, "cdr", schema)
        for topic, stamp, data in in_turn(content):
            writer.add_message(channels[topic], stamp, data, stamp)
        writer.finish()


def _same(found: Columns, recording: Recording) -> bool:
    """Whether both readers give the same numbers bit for bit."""
    ours = {
        topics.MEASUREMENT: recording.measurement,
        topics.COMMAND: recording.command,
        topics.SETPOINT: recording.setpoint,
    }
    return all(
        len(rows) == len(found[topic.name])
        and all(rows[name].tobytes() == found[topic.name][name].tobytes() for name in topic.layout.fields)
        for topic, rows in ours.items()
        if topic.layout is not None
    )


def _reading(progress: Fraction) -> Report:
    content = messages(SECONDS)
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as name:
        live, packed = Path(name) / "live", Path(name) / "packed.mcap"
        _write_ours(live, list(in_turn(content))).close()
        _write_zstd(packed, content)
        del content
        progress(0.2)
        figures, sizes = [], []
        for part, (what, path) in enumerate((("small plain chunks", live), ("zstd chunks of 1 MB", packed))):
            if not _same(by_rosbags(path), by_ours(path)):
                raise MeasurementError(f"{what}: the readers do not agree")
            contestants: dict[str, Callable[[], object]] = {
                "ours": lambda path=path: by_ours(path),  # type: ignore[misc]
                "rosbags": lambda path=path: by_rosbags(path),  # type: ignore[misc]
            }
            begin = 0.2 + 0.4 * part
            times = by_turns(
                contestants,
                ROUNDS,
                progress=lambda done, begin=begin: progress(begin + 0.4 * done),  # type: ignore[misc]
            )
            ours, theirs = times["ours"].best, times["rosbags"].best
            figures.append(
                Figure(f"opening, {what}", ours, "s", "rosbags, raw", theirs, Bar("<=", 0.5, "ratio"))
            )
            files = [path] if path.is_file() else list(path.iterdir())
            sizes.append(sum(file.stat().st_size for file in files) / 1e6)
    return Report(
        "Reader beside rosbags' raw bytes",
        figures,
        notes=[
            f"{SECONDS:.0f} s at 2 kHz with commands and setpoints, {sizes[0]:.0f} MB in the recorder's chunks of 0.1 s"
            f" and {sizes[1]:.0f} MB compressed; file in the page cache, processor time, best of {ROUNDS}. rosbags"
            " gives the bytes of each message and checks the chunks, numpy.frombuffer makes columns of them; ours also"
            " checks data section, index, summary, counts and sequence numbers.",
            "Decision: rosbags would replace our reader if it took at most twice the time.",
        ],
    )


@dataclass
class _Fates:
    """Results of reading damaged recordings."""

    refused: int = 0
    exact: int = 0
    wrong: int = 0


def fates(count: int, seed: int, progress: Fraction = lambda _: None) -> dict[str, _Fates]:
    """Damage the file of our recording in many ways; return the results of each reader.

    ``wrong`` counts those that are read without an error and differ from the recorded data.
    """
    rng = random.Random(seed)
    result = {"ours": _Fates(), "rosbags": _Fates()}
    content = messages(SMALL)
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as name:
        folder = Path(name) / "run"
        _write_ours(folder, list(in_turn(content))).close()
        truth, file = by_ours(folder), folder / "run_0.mcap"
        before = file.read_bytes()
        for k in range(count):
            after = mutated(before, rng)
            file.write_bytes(after)
            for who, fate in result.items():
                try:
                    if who == "ours":
                        recording = by_ours(folder)
                        same = _same(_columns_of(recording), truth)
                    else:
                        same = _same(by_rosbags(folder), truth)
                except InputError:
                    fate.refused += 1
                except Exception:  # rosbags passes on the exceptions of its parsers
                    if who == "ours":
                        raise
                    fate.refused += 1
                else:
                    fate.exact += same
                    fate.wrong += not same
            progress((k + 1) / count)
    return result


def _columns_of(recording: Recording) -> Columns:
    return {
        topics.MEASUREMENT.name: recording.measurement,
        topics.COMMAND.name: recording.command,
        topics.SETPOINT.name: recording.setpoint,
    }


def _damaged(progress: Fraction) -> Report:
    found = fates(DAMAGED, 1, progress)
    ours, theirs = found["ours"], found["rosbags"]
    return Report(
        "Damaged recordings read as if they were whole",
        [
            Figure(
                "wrong data without an error",
                float(ours.wrong),
                "",
                "rosbags",
                float(theirs.wrong),
                Bar("<=", 0.0),
            ),
            Figure("refused", float(ours.refused), "", "rosbags", float(theirs.refused)),
            Figure("read exactly", float(ours.exact), "", "rosbags", float(theirs.exact)),
        ],
        notes=[
            f"{DAMAGED} copies of a recording of ours, each damaged at random: bits flipped, bytes removed, moved,"
            " repeated or overwritten, the end cut off. What rosbags reads exactly is damaged outside the messages.",
            "A file without an end is refused by both; gyrowheel salvage recovers it with the parts of our reader.",
        ],
    )


def _writing(progress: Fraction) -> Report:
    content = messages(WRITTEN)
    turns = list(in_turn(content))
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as name:
        folder = Path(name) / "run"

        def run(write: Callable[[Path, list[tuple[Topic, int, bytes]]], Any]) -> Callable[[], object]:
            def once() -> None:
                write(folder, turns).close()
                shutil.rmtree(folder)

            return once

        times = by_turns(
            {"ours": run(_write_ours), "rosbags": run(_write_rosbags)},
            ROUNDS,
            progress=lambda done: progress(0.8 * done),
        )
        lost, unchecked = {}, {}
        for who, write in (("ours", _write_ours), ("rosbags", _write_rosbags)):
            going: Any = write(folder, turns)
            # files of a process that is killed now: its buffers are lost
            shutil.copytree(folder, Path(name) / "killed")
            saved = salvage(Path(name) / "killed", Path(name) / "saved")
            last = int(Recording.open(saved.target).measurement["stamp_ns"][-1])
            lost[who] = WRITTEN - last / wire.SECOND
            going.close()
            unchecked[who] = float(Recording.open(folder).unchecked)
            for made in ("run", "killed", "saved"):
                shutil.rmtree(Path(name) / made)
        began = time.process_time()
        with RecordingWriter(folder) as writer:
            writer.write_columns(
                [
                    (topic, topic.layout.stamps(content[topic.name]), content[topic.name])
                    for topic in _TOPICS
                    if topic.layout is not None
                ]
            )
        whole = time.process_time() - began
    count = len(turns)
    theirs = 1e6 * times["rosbags"].best / count
    return Report(
        "Writer beside rosbags'",
        [
            Figure(
                "a message",
                1e6 * times["ours"].best / count,
                "µs",
                "rosbags",
                theirs,
                Bar("<=", 1.0, "ratio"),
            ),
            Figure("a message, whole columns", 1e6 * whole / count, "µs", "rosbags", theirs),
            Figure("lost when killed", lost["ours"], "s", "rosbags", lost["rosbags"], Bar("<=", 0.25)),
            Figure(
                "messages without checksum",
                unchecked["ours"],
                "",
                "rosbags",
                unchecked["rosbags"],
                Bar("<=", 0.0),
            ),
        ],
        notes=[
            f"{count} messages, {WRITTEN:.0f} s of a running bench; processor time, best of {ROUNDS}. Lost when killed:"
            " what gyrowheel salvage does not find in the folder before it is completed. rosbags writes chunks of 1 MB"
            " through a buffer, without checksums.",
            "Decision: rosbags' writer would replace ours if it lost at most 0.25 s and wrote checksums.",
        ],
    )


def measure(progress: Fraction) -> list[Report]:
    """Measure reading, damage and writing."""
    return [
        _reading(lambda part: progress(0.6 * part)),
        _damaged(lambda part: progress(0.6 + 0.2 * part)),
        _writing(lambda part: progress(0.8 + 0.2 * part)),
    ]
