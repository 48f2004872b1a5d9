"""The messages of any ROS 2 bag, as rows or serialized; compressed files are unpacked into memory."""

from __future__ import annotations

import contextlib
import functools
import mmap
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
import zstandard

from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.files import is_file, largest_unpacked, require_room
from gyrowheel_recording.bags.mcap.batches import TopicData, Wanted
from gyrowheel_recording.bags.mcap.reader import read_mcap
from gyrowheel_recording.bags.mcap.records import MOST_COMPRESSED, Broken, Damaged
from gyrowheel_recording.bags.metadata import METADATA_FILE, Metadata, read_metadata

_HEAD: Final = b"SQLite format 3\0"
_BATCH: Final = 1 << 14  # messages parsed together
_EXPRESSION: Final = -2  # instead of the number of a column, in an index
_LONGEST: Final = 1 << 28  # bytes of a row
_OBJECT: Final = 40  # bytes of overhead of a message
#: Place of the journal mode in a file: 2 for a log next to it, which a file in memory cannot have.
_WAYS: Final = slice(18, 20)
#: Columns that are read.
_MESSAGES: Final = ("topic_id", "timestamp", "data")
_TOPICS: Final = ("id", "name", "type", "serialization_format")
_DEFINITIONS: Final = ("topic_type", "encoding", "encoded_message_definition")


def is_database(file: Path) -> bool:
    """Whether a file is an sqlite3 database by its first bytes; raises InputError if it cannot be read."""
    try:
        with file.open("rb") as stream:
            return stream.read(len(_HEAD)) == _HEAD
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror or error}") from None


def read_database(
    file: Path,
    wanted: Wanted,
    unpack: Callable[[bytes], bytes] | None = None,
    content: memoryview | None = None,
) -> list[TopicData]:
    """Read the messages of some topics of an sqlite3 file, and count those of the others; one result for each topic.

    `wanted`: names of the topics to read, and how; `unpack`: decompresses one message, where each is
    compressed on its own; raises `Damaged`. `content`: content of the file, where it was compressed. Raises
    InputError if it cannot be read, is no such file, or is visibly damaged: it has no checksums.
    """
    if content is None and not is_file(file):  # a pipe would be waited for
        why = "is no file" if file.exists() else "cannot be read: No such file or directory"
        raise InputError(f"{file}: {why}")
    try:
        with _opened(file, content) as database:
            _check_within_memory(database, file)
            topics = _topics(database, file)
            _read_messages(database, file, topics, wanted, unpack)
    except sqlite3.Error as error:
        raise InputError(f"{file}: cannot be read: {one_line(error)}") from None
    except UnicodeDecodeError:  # an error of SQLite that quotes damaged bytes
        raise InputError(f"{file}: damaged: its description of the tables is not text") from None
    except Damaged as error:
        raise InputError(f"{file}: {error}") from None
    return list(topics.values())


@contextlib.contextmanager
def _opened(file: Path, content: memoryview | None) -> Iterator[sqlite3.Connection]:
    """Open a file so that nothing is written, and nothing of it is run."""
    if content is None:
        database = sqlite3.connect(_address(file), uri=True)
    else:
        database = sqlite3.connect(":memory:")
        if bytes(content[_WAYS]) == b"\2\2":
            content[_WAYS] = b"\1\1"
        database.deserialize(content)
    with contextlib.closing(database):
        # damaged bytes in names; messages are no text
        database.text_factory = functools.partial(str, encoding="utf-8", errors="replace")
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST)
        for setting in ("trusted_schema = OFF", "ignore_check_constraints = ON", "temp_store = MEMORY"):
            database.execute(f"PRAGMA {setting}")
        yield database


def _address(file: Path) -> str:
    """Return the URI by which SQLite opens a file.

    A file that was not closed has a log next to it, with which SQLite reads it. Any other is opened as immutable, so
    that no file is created.
    """
    logs = (file.with_name(f"{file.name}{end}") for end in ("-wal", "-journal"))
    is_open = any(is_file(log) and log.stat().st_size for log in logs)
    return f"{file.absolute().as_uri()}?mode=ro{'' if is_open else '&immutable=1'}"


def _check_within_memory(database: sqlite3.Connection, file: Path) -> None:
    """Check the tables; lengths in a damaged file may ask for any memory, which SQLite refuses before it takes it."""
    try:
        _check(database, file)
    except MemoryError:
        raise InputError(
            f"{file}: damaged: its description of the tables asks for more memory than there is"
        ) from None


def _check(database: sqlite3.Connection, file: Path) -> None:
    """Refuse what is no bag, what is more than tables, and damage as far as SQLite sees it."""
    kinds = {str(name): str(kind) for _, name, kind, *_ in database.execute("PRAGMA table_list")}
    for name, kind in kinds.items():
        if kind != "table":
            raise InputError(f"{file}: its {name[:60]!r} is a {kind}; allowed in a recording: tables")
    for table in kinds:
        for name, hidden in database.execute("SELECT name, hidden FROM pragma_table_xinfo(?)", (table,)):
            if hidden:
                place = f"column {name[:60]!r} of its table {table[:60]!r}"
                raise InputError(f"{file}: {place} is computed; allowed in a recording: stored ones")
        # an index of an expression computes it for every row where the index is checked
        for name, partial in database.execute("SELECT name, partial FROM pragma_index_list(?)", (table,)):
            columns = database.execute("SELECT cid FROM pragma_index_xinfo(?)", (name,))
            if partial or any(cid == _EXPRESSION for (cid,) in columns):
                raise InputError(
                    f"{file}: its index {name[:60]!r} is computed; allowed in a recording: those of columns"
                )
    for table, needed in (("topics", _TOPICS), ("messages", _MESSAGES)):
        if table not in kinds:
            raise InputError(f"{file}: not a recording: it has no table '{table}'")
        _require_columns(database, file, table, needed)
    # its report quotes damaged bytes
    found = " ".join(str(row[0]) for row in database.execute("PRAGMA integrity_check(1)"))
    if found != "ok":
        raise InputError(f"{file}: damaged: {' '.join(found.split())}")


def _require_columns(database: sqlite3.Connection, file: Path, table: str, needed: tuple[str, ...]) -> None:
    found = {str(name) for (name,) in database.execute("SELECT name FROM pragma_table_xinfo(?)", (table,))}
    for name in needed:
        if name not in found:
            raise InputError(f"{file}: its table '{table}' has no column '{name}'")


def _topics(database: sqlite3.Connection, file: Path) -> dict[int, TopicData]:
    """Return the topics by number, with how many messages they have."""
    definitions: dict[str, tuple[str, str]] = {}
    if database.execute("PRAGMA table_info(message_definitions)").fetchone() is not None:
        _require_columns(database, file, "message_definitions", _DEFINITIONS)
        for name, encoding, text in database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        ):
            definitions.setdefault(str(name), (str(encoding), str(text or "")))
    topics = {}
    for number, name, kind, encoding in database.execute(
        "SELECT id, name, type, serialization_format FROM topics"
    ):
        topics[_number(number, "the number of a topic")] = TopicData(
            str(name), str(kind), str(encoding), *definitions.get(str(kind), ("", ""))
        )
    for number, count in database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"):
        topic = topics.get(_number(number, "the topic of a message"))
        if topic is None:
            raise Damaged(f"damaged: messages of topic {number}, which is not declared")
        topic.count = topic.unchecked = topic.expected = count
    return topics


def _read_messages(
    database: sqlite3.Connection,
    file: Path,
    topics: dict[int, TopicData],
    wanted: Wanted,
    unpack: Callable[[bytes], bytes] | None,
) -> None:
    """Read the messages of the wanted topics."""
    chosen = [number for number, topic in topics.items() if topic.name in wanted and topic.count]
    messages: dict[int, list[bytes]] = {number: [] for number in chosen}
    times: dict[int, list[int]] = {number: [] for number in chosen}
    kept = 0

    def hand_over(number: int) -> None:
        topic = topics[number]
        want = wanted[topic.name]
        if messages[number]:
            topic.add(want, messages[number])
            if want is None:
                topic.times.append(np.array(times[number], dtype=np.int64))
        messages[number], times[number] = [], []

    if not chosen:
        return
    # by a plus in front of it an index on the topic is not used, which would lead to the messages out of order
    marks = ", ".join("?" * len(chosen))
    for number, time, data in database.execute(
        f"SELECT topic_id, timestamp, data FROM messages WHERE +topic_id IN ({marks}) ORDER BY rowid", chosen
    ):
        if not isinstance(data, bytes):
            raise Damaged("damaged: a message that is no bytes")
        message = data if unpack is None else unpack(data)
        kept += len(message) + _OBJECT
        require_room(kept, f"{file}: what is recorded on {topics[number].name}")
        messages[number].append(message)
        times[number].append(_number(time, "the time of a message"))
        if len(messages[number]) >= _BATCH:
            hand_over(number)
    for number in chosen:
        hand_over(number)


def _number(value: object, what: str) -> int:
    if not isinstance(value, int):
        raise Damaged(f"damaged: {what} is no whole number")
    return value


_BLOCK = 1 << 20  # bytes


@contextlib.contextmanager
def file_in_memory(name: str) -> Iterator[tuple[BinaryIO, Path]]:
    """Yield an empty file that has no place on the disk, and a path by which this process can open it."""
    number = os.memfd_create(name[:200], os.MFD_CLOEXEC)
    with os.fdopen(number, "w+b", buffering=0) as file:
        yield file, Path(f"/proc/self/fd/{number}")


def unpack(source: BinaryIO, target: BinaryIO, name: Path) -> None:
    """Decompress a file (zstd) into `target`, which after an error has what could be unpacked before.

    Raises
    ------
    InputError
        If it unpacks to more than `largest_unpacked`, or to more than any recording can; it names `name`.
    zstandard.ZstdError
        If it is damaged.
    """
    limit, written = largest_unpacked(), 0
    with zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True, closefd=False) as plain:
        while block := plain.read(_BLOCK):
            written += len(block)
            if written > limit:
                require_room(float("inf"), f"{name}: unpacked it")
            if written > MOST_COMPRESSED * max(source.tell(), _BLOCK):
                raise InputError(
                    f"{name}: unpacks to more than {MOST_COMPRESSED} times its size, as no recording does"
                )
            target.write(block)


_MESSAGE_LIMIT: Final = 1 << 28  # bytes of a decompressed message; more counts as damage


def read_bag(path: Path, wanted: Wanted) -> dict[str, TopicData]:
    """Read the messages of some topics of a bag, and count those of the others; return all topics by name.

    Parameters
    ----------
    path : Path
        A rosbag2 directory, or one ``.mcap`` or ``.db3`` file.
    wanted : mapping of str to Want or None
        Names of the topics to read, and how.

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
        if path.suffix == ".mcap":
            return _merge(path, read_mcap(path, wanted))
        if path.suffix != ".db3" and not is_database(path):
            raise InputError(
                f"{path}: not a recording; allowed: a folder of a bag, or its .mcap or .db3 file"
            )
        return _merge(path, read_database(path, wanted))
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
    read = _read_file if metadata.storage == "mcap" else _read_database
    channels = [topic for name in metadata.files for topic in read(path / name, metadata, wanted)]
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


def _read_database(file: Path, metadata: Metadata, wanted: Wanted) -> list[TopicData]:
    """Read one sqlite3 file of a bag."""
    if metadata.compression == "file":
        with file_in_memory(file.stem) as (plain, _):
            _unpack(file, plain)
            if not plain.tell():
                raise InputError(f"{file}: the file is empty")
            with mmap.mmap(plain.fileno(), 0) as mapped, memoryview(mapped) as content:
                return read_database(file, wanted, content=content)
    return read_database(file, wanted, _decompress if metadata.compression == "message" else None)


@contextlib.contextmanager
def _decompressed(file: Path) -> Iterator[Path]:
    """Give a decompressed copy of a file, in memory, that lasts as long as the block."""
    with file_in_memory(file.stem) as (plain, place):
        _unpack(file, plain)
        yield place


def _unpack(file: Path, target: BinaryIO) -> None:
    """Decompress a file."""
    try:
        if file.exists() and not file.is_file():  # a pipe would be waited for
            raise InputError(f"{file}: is no file")
        with file.open("rb") as source:
            unpack(source, target, file)
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror or error}") from None
    except zstandard.ZstdError as error:
        raise InputError(f"{file}: damaged: cannot be decompressed ({one_line(error)})") from None


def _decompress(message: bytes) -> bytes:
    try:
        if zstandard.frame_content_size(message) > _MESSAGE_LIMIT:
            raise Damaged("damaged: a message claims more bytes than it can have")
        return zstandard.ZstdDecompressor().decompress(message, max_output_size=_MESSAGE_LIMIT)
    except (zstandard.ZstdError, MemoryError) as error:
        raise Damaged(f"damaged: a message cannot be decompressed ({error})") from None


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
