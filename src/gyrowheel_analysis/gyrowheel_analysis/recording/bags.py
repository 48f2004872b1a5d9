"""The messages of any ROS 2 bag, as rows or serialized."""

from __future__ import annotations

import contextlib
import functools
import sqlite3
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
import zstandard
from rosbags.interfaces import ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag2 import Reader

from gyrowheel_analysis.recording.mcap.reader import read_mcap
from gyrowheel_analysis.recording.mcap.records import Broken, Damaged
from gyrowheel_analysis.recording.mcap.topics import TopicData, Wanted
from gyrowheel_analysis.recording.metadata import METADATA_FILE, Metadata, read_metadata
from gyrowheel_analysis.recording.unpacking import file_in_memory, unpack
from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.files import is_file

_BATCH: Final = 1 << 14  # messages parsed together
_SQLITE: Final = b"SQLite format 3\0"
_MESSAGE_LIMIT: Final = 1 << 28  # bytes of a decompressed message; more counts as damage


def read_bag(path: Path, wanted: Wanted) -> dict[str, TopicData]:
    """Read the messages of some topics of a bag, and count those of the others.

    Parameters
    ----------
    path : Path
        A rosbag2 directory, or one ``.mcap`` or ``.db3`` file.
    wanted : mapping of str to Want or None
        Names of the topics to read, and how.

    Returns
    -------
    dict of str to TopicData
        All topics by name.

    Raises
    ------
    InputError
        If there is no such bag, or it is incomplete or damaged; where `salvage` may mend that, the message names it.
    """
    try:
        return _read(path, wanted)
    except Broken as error:
        raise InputError(f"{error}; gyrowheel salvage {path} -o DIR saves what can be read") from None


def _read(path: Path, wanted: Wanted) -> dict[str, TopicData]:
    if is_file(path):
        if path.suffix != ".mcap":
            _require_database(path)
        return _merge(path, read_mcap(path, wanted) if path.suffix == ".mcap" else _read_other(path, wanted))
    if not path.is_dir():
        raise InputError(
            f"{path}: {'is neither a directory nor a file' if path.exists() else 'no such recording'}"
        )
    file = path / METADATA_FILE
    if not file.is_file():
        begun = any(path.glob("*.mcap"))
        if begun:
            raise Broken(f"{path}: no {METADATA_FILE}: the recording was not completed")
        what = "the recording was not completed" if any(path.glob("*.db3")) else "this is no recording"
        raise InputError(f"{path}: no {METADATA_FILE}: {what}")
    metadata = read_metadata(file)
    metadata.require_readable(file)
    if metadata.storage == "mcap":
        channels = [topic for name in metadata.files for topic in _read_file(path / name, metadata, wanted)]
    else:
        channels = _read_other(path, wanted)
    found = sum(topic.count for topic in channels)
    if found != metadata.count:
        kind = Broken if metadata.storage == "mcap" and metadata.compression != "file" else InputError
        raise kind(f"{path}: {METADATA_FILE} counts {metadata.count} messages, but the files hold {found}")
    return _merge(path, channels)


def _read_file(file: Path, metadata: Metadata, wanted: Wanted) -> list[TopicData]:
    """Read one MCAP file of a bag."""
    if metadata.compression == "file":
        with _decompressed(file) as plain:
            try:
                return read_mcap(plain, wanted)
            except InputError as error:
                raise InputError(str(error).replace(str(plain), str(file))) from None
    return read_mcap(file, wanted, _decompress if metadata.compression == "message" else None)


@contextlib.contextmanager
def _decompressed(file: Path) -> Iterator[Path]:
    """Give a decompressed copy of a file, in memory, that lasts as long as the block."""
    with file_in_memory(file.stem) as (plain, place):
        try:
            with file.open("rb") as source:
                unpack(source, plain, file)
        except OSError as error:
            raise InputError(f"{file}: cannot be read: {error.strerror or error}") from None
        except zstandard.ZstdError as error:
            raise InputError(f"{file}: damaged: cannot be decompressed ({one_line(error)})") from None
        yield place


def _decompress(message: bytes) -> bytes:
    try:
        if zstandard.frame_content_size(message) > _MESSAGE_LIMIT:
            raise Damaged("damaged: a message claims more bytes than it can have")
        return zstandard.ZstdDecompressor().decompress(message, max_output_size=_MESSAGE_LIMIT)
    except (zstandard.ZstdError, MemoryError) as error:
        raise Damaged(f"damaged: a message cannot be decompressed ({error})") from None


def _read_other(path: Path, wanted: Wanted) -> list[TopicData]:
    """Read a bag of sqlite3 with rosbags."""
    encodings = {
        MessageDefinitionFormat.MSG: "ros2msg",
        MessageDefinitionFormat.IDL: "ros2idl",
        MessageDefinitionFormat.NONE: "",
    }
    for file in [path] if path.is_file() else sorted(path.glob("*.db3")):
        _check_database(file)
    try:
        with Reader(path) as reader:
            channels: dict[int, TopicData] = {}
            for connection in reader.connections:
                assert isinstance(connection.ext, ConnectionExtRosbag2)
                channels[connection.id] = TopicData(
                    connection.topic,
                    connection.msgtype,
                    connection.ext.serialization_format,
                    encodings[connection.msgdef.format],
                    connection.msgdef.data,
                    connection.msgcount,
                    connection.msgcount,
                )
            read = [connection for connection in reader.connections if connection.topic in wanted]
            messages: dict[int, list[bytes]] = {connection.id: [] for connection in read}
            times: dict[int, list[int]] = {connection.id: [] for connection in read}
            counts = dict.fromkeys(messages, 0)

            def hand_over(number: int) -> None:
                topic, batch = channels[number], messages[number]
                want = wanted[topic.name]
                if batch:
                    topic.add(want, batch)
                    if want is None:
                        topic.times.append(np.array(times[number], dtype=np.int64))
                messages[number], times[number] = [], []

            for connection, time, data in reader.messages(read) if read else ():
                number = connection.id
                messages[number].append(bytes(data))
                times[number].append(time)
                counts[number] += 1
                if len(messages[number]) >= _BATCH:
                    hand_over(number)
            for number in messages:
                hand_over(number)
    except InputError:
        raise
    except Exception as error:  # on damaged files rosbags passes on whatever its parsers and sqlite3 raise
        raise InputError(f"{path}: cannot be read: {one_line(error)}") from None
    for number, count in counts.items():
        topic = channels[number]
        if count != topic.count:
            raise InputError(f"{path}: {topic.name} has {count} messages where {topic.count} are counted")
    return list(channels.values())


def _require_database(file: Path) -> None:
    """Refuse a file that is no database by its name or first bytes."""
    try:
        with file.open("rb") as stream:
            head = stream.read(len(_SQLITE))
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror or error}") from None
    if file.suffix != ".db3" and head != _SQLITE:
        raise InputError(f"{file}: not a recording; allowed: a folder of a bag, or its .mcap or .db3 file")


def _check_database(file: Path) -> None:
    """Let SQLite check for damage: its files have no checksums, but their structure reveals most damage."""
    try:
        with contextlib.closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)) as database:
            # its report quotes damaged bytes
            database.text_factory = functools.partial(str, encoding="utf-8", errors="replace")
            found = [str(row[0]) for row in database.execute("PRAGMA integrity_check(1)")]
    except sqlite3.Error as error:
        raise InputError(f"{file}: cannot be read: {one_line(error)}") from None
    except UnicodeDecodeError:  # an SQLite error that quotes damaged bytes
        raise InputError(f"{file}: damaged: its description of the tables is not text") from None
    if found != ["ok"]:
        raise InputError(f"{file}: damaged: {' '.join(' '.join(found).split())}")


def _merge(path: Path, channels: Iterable[TopicData]) -> dict[str, TopicData]:
    """Join the channels of each topic."""
    merged: dict[str, TopicData] = {}
    for channel in channels:
        topic = merged.setdefault(channel.name, channel)
        if topic is channel:
            continue
        if topic.type_name != channel.type_name or topic.definition != channel.definition:
            raise InputError(f"{path}: {topic.name} has messages of several types")
        topic.count += channel.count
        topic.unchecked += channel.unchecked
        topic.times += channel.times
        topic.pieces += channel.pieces
    return merged
