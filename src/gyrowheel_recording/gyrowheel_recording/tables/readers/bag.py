"""Bags of ROS 1 and ROS 2: every number of every message by topic and field.

The records of a bag of ROS 1 are read from the first to the last, each once. The libraries go by the index, which may
lead to one place as often as it likes, and unpack a chunk to whatever it grows to.
"""

from __future__ import annotations

import bz2
import os
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final

import lz4.frame
import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.msg import normalize_msgtype

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import is_file, largest_unpacked, require_room
from gyrowheel_recording.bags.columns import checked_store
from gyrowheel_recording.bags.mcap.batches import TopicData
from gyrowheel_recording.bags.mcap.records import MOST_COMPRESSED
from gyrowheel_recording.bags.read_bag import read_bag
from gyrowheel_recording.tables.grid import BYTES_A_VALUE, Grid, require_table
from gyrowheel_recording.tables.readers import library_errors, short_message
from gyrowheel_recording.tables.readers.messages import (
    TopicColumns,
    columns_of,
    frame_of,
    stamp_of,
    wanted_fields,
)

MAGIC: Final = b"#ROSBAG V"
_VERSION: Final = b"#ROSBAG V2.0\n"
_MESSAGE, _HEAD, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 5, 6, 7
_LENGTH: Final = struct.Struct("<I")
_TIME: Final = struct.Struct("<II")
_PAIR: Final = struct.Struct("<II")
_LONGEST_HEADER: Final = 1 << 20
_SMALL: Final = 1 << 24  # bytes that chunks may unpack to, however small they are
_OBJECT: Final = 500  # bytes of overhead of a connection

Header = dict[bytes, memoryview]


@dataclass(frozen=True)
class Connection:
    """What one node published on one topic."""

    topic: TopicData  # the topic, its type, and the definition of that
    digest: str  # checksum of the definition; ``*`` if the file has no definition


class Bag:
    """A bag of ROS 1, to be gone through once.

    `path`: the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._connections: dict[int, Connection] = {}
        self._kept = self._unpacked = 0
        self._counts: dict[str, int] = {}  # messages and chunks, as found and as the index states them

    @property
    def topics(self) -> list[str]:
        """Names of the topics that were met."""
        return sorted({own.topic.name for own in self._connections.values()})

    def messages(self) -> Iterator[tuple[Connection, int, memoryview]]:
        """Yield each message with its connection and the time at which it was logged [ns].

        Raises InputError if the bag is damaged, was not completed, or grows to more than the limit.
        """
        with self._path.open("rb") as file:
            left = os.fstat(file.fileno()).st_size - len(_VERSION)
            version = file.read(len(_VERSION))
            if version != _VERSION:
                raise InputError(f"{self._path}: a bag of version {version[8:12]!r}; allowed: 2.0")
            found = stated = chunks = 0
            chunks_stated: int | None = None
            for header, data in self._records(lambda count: self._read(file, count), left, file):
                kind = self._kind(header)
                if kind == _HEAD:
                    chunks_stated = self._head(header)
                elif kind == _CHUNK:
                    chunks += 1
                    for message in self._chunk(header, data, file.tell()):
                        found += 1
                        yield message
                elif kind == _CHUNK_INFO:
                    stated += sum(count for _, count in _PAIR.iter_unpack(data[: len(data) // 8 * 8]))
                elif kind == _CONNECTION:
                    self._connect(header, data)
                elif kind == _MESSAGE:
                    found += 1
                    stated += 1
                    yield self._message(header, data)
        if chunks_stated is None or chunks_stated != chunks or stated != found:
            raise InputError(
                f"{self._path}: damaged: {found} messages in {chunks} chunks, where its index states {stated} in"
                f" {chunks_stated or 0}"
            )

    def _records(
        self, read: Callable[[int], bytes], left: int, file: BinaryIO | None
    ) -> Iterator[tuple[Header, memoryview]]:
        """Yield the header and the data of each record in so many bytes."""
        while left:
            size = self._length(read, left)
            if size > _LONGEST_HEADER:
                raise self._damaged(f"a header of {size} bytes")
            left -= 4
            header = self._header(memoryview(self._some(read, size, left)))
            left -= size
            size = self._length(read, left)
            left -= 4
            if size > left:
                raise self._damaged(f"a record of {size} bytes where {left} are left")
            require_room(size, f"{self._path}: a record of it")
            left -= size
            if file is not None and self._kind(header) not in (
                _HEAD,
                _CHUNK,
                _CHUNK_INFO,
                _CONNECTION,
                _MESSAGE,
            ):
                file.seek(size, os.SEEK_CUR)  # an index, which is not used
                continue
            yield header, memoryview(self._some(read, size, size))

    def _length(self, read: Callable[[int], bytes], left: int) -> int:
        return int(_LENGTH.unpack(self._some(read, 4, left))[0])

    def _some(self, read: Callable[[int], bytes], count: int, left: int) -> bytes:
        data = read(count) if count <= left else b""
        if len(data) < count:
            raise self._damaged("it breaks off within a record")
        return data

    def _read(self, file: BinaryIO, count: int) -> bytes:
        return file.read(count)

    def _header(self, data: memoryview) -> Header:
        """Return the fields of a header."""
        fields: Header = {}
        place = 0
        while place < len(data):
            if place + 4 > len(data):
                raise self._damaged("a header that breaks off")
            end = place + 4 + _LENGTH.unpack_from(data, place)[0]
            if end > len(data):
                raise self._damaged("a header that breaks off")
            field = bytes(data[place + 4 : end])
            name, mark, _ = field.partition(b"=")
            if not mark:
                raise self._damaged("a field of a header without a value")
            fields[name] = data[place + 5 + len(name) : end]
            place = end
        return fields

    def _kind(self, header: Header) -> int:
        return self._field(header, b"op", 1)[0]

    def _field(self, header: Header, name: bytes, size: int) -> memoryview:
        value = header.get(name)
        if value is None or len(value) != size:
            raise self._damaged(f"a record without its field {name.decode()}")
        return value

    def _number(self, header: Header, name: bytes) -> int:
        return int(_LENGTH.unpack(self._field(header, name, 4))[0])

    def _text(self, header: Header, name: bytes) -> str:
        value = header.get(name)
        if value is None:
            raise self._damaged(f"a record without its field {name.decode()}")
        return bytes(value).decode("utf-8", "replace")

    def _head(self, header: Header) -> int:
        """Return how many chunks the bag has."""
        if header.get(b"encryptor"):
            raise InputError(f"{self._path}: is encrypted, which is not read")
        if not any(self._field(header, b"index_pos", 8)):
            raise InputError(f"{self._path}: the recording was not completed; rosbag reindex mends it")
        return self._number(header, b"chunk_count")

    def _chunk(
        self, header: Header, data: memoryview, place: int
    ) -> Iterator[tuple[Connection, int, memoryview]]:
        """Yield the messages of a chunk that ends at some byte of the file."""
        size, way = self._number(header, b"size"), self._text(header, b"compression")
        require_room(size + len(data), f"{self._path}: a chunk of it")
        self._unpacked += size
        if self._unpacked > max(_SMALL, MOST_COMPRESSED * place):
            raise InputError(
                f"{self._path}: unpacks to more than {MOST_COMPRESSED} times its size, as no recording does"
            )
        try:
            if way == "none":
                plain = data
            elif way == "bz2":
                plain = memoryview(bz2.BZ2Decompressor().decompress(data, size + 1))
            elif way == "lz4":
                plain = memoryview(lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1))
            else:
                raise self._damaged(f"a chunk packed by {way[:20]!r}")
        except (OSError, ValueError, RuntimeError, EOFError) as error:
            if isinstance(error, InputError):
                raise
            raise self._damaged("a chunk cannot be unpacked") from None
        if len(plain) != size:
            raise self._damaged(f"a chunk of {len(plain)} bytes that states {size}")
        at = 0

        def read(count: int) -> bytes:
            nonlocal at
            at += count
            return plain[at - count : at]  # type: ignore[return-value]

        for inner, body in self._records(read, len(plain), None):
            kind = self._kind(inner)
            if kind == _CONNECTION:
                self._connect(inner, body)
            elif kind == _MESSAGE:
                yield self._message(inner, body)

    def _message(self, header: Header, data: memoryview) -> tuple[Connection, int, memoryview]:
        own = self._connections.get(self._number(header, b"conn"))
        if own is None:
            raise self._damaged("a message of a connection that is not declared")
        seconds, rest = _TIME.unpack(self._field(header, b"time", 8))
        return own, seconds * 1_000_000_000 + rest, data

    def _connect(self, header: Header, data: memoryview) -> None:
        """Note a connection."""
        number = self._number(header, b"conn")
        about = self._header(data)
        kind, text = self._text(about, b"type"), self._text(about, b"message_definition")
        name = self._text(header, b"topic")
        name = "/" * name.startswith("/") + "/".join(filter(None, name.split("/")))
        topic = TopicData(name, normalize_msgtype(kind), "ros1", "ros2msg", text)
        own = Connection(topic, self._text(about, b"md5sum"))
        known = self._connections.setdefault(number, own)
        if known is own:
            self._kept += _OBJECT + len(data)
            require_room(self._kept, f"{self._path}: what declares its topics")
        elif (known.topic.name, known.topic.type_name, known.topic.definition) != (
            topic.name, topic.type_name, topic.definition,
        ):  # fmt: skip
            raise self._damaged(f"connection {number} is declared in two ways")

    def _damaged(self, what: str) -> InputError:
        return InputError(f"{self._path}: damaged: {what}")


_BYTES: Final = ("uint8", "int8", "byte", "char")
_NO_DIGEST: Final = ("", "*")


class Decoders:
    """Decoders of the messages of a bag, serialized as by ROS 1 or ROS 2."""

    def __init__(self, where: str, *, ros1: bool) -> None:
        self._where, self._ros1 = where, ros1
        self._known: dict[tuple[str, str, str], Callable[[bytes], Any]] = {}

    def of(self, topic: TopicData, digest: str = "") -> Callable[[bytes], Any]:
        """Return what makes objects of the messages of a topic, whose definition has a checksum or none.

        Raises InputError if their type cannot be read; so does what is returned, if a message cannot.
        """
        key = topic.type_name, topic.definition, digest
        if key not in self._known:
            self._known[key] = self._new(topic, digest)
        return self._known[key]

    def _new(self, topic: TopicData, digest: str) -> Callable[[bytes], Any]:
        where, kind = f"{self._where}: {topic.name}", topic.type_name
        store = checked_store(topic, where)
        what = f"{where}: the definition of {kind}"
        take = store.deserialize_ros1 if self._ros1 else store.deserialize_cdr
        try:
            store.get_msgdef(kind)
            own = store.generate_msgdef(kind)[1] if digest not in _NO_DIGEST else digest
        except Exception:  # rosbags makes code of it, for which names or sizes may not do
            raise InputError(f"{what} cannot be read") from None
        if own != digest:
            raise InputError(f"{what} is damaged: its checksum is {own}, not {digest[:40]}")

        def decode(message: bytes) -> Any:
            return take(message, kind)

        return decode

    def has_lists_of_bytes(self, topic: TopicData) -> bool:
        """Whether messages of a topic have lists of bytes, as pictures and clouds of points do."""
        try:
            store = checked_store(topic, self._where)
        except InputError:
            return False
        lists = [
            field[1][0] for _, field in store.fielddefs[topic.type_name][1] if field[0] == Nodetype.SEQUENCE
        ]
        return any(own[0] == Nodetype.BASE and own[1][0] in _BYTES for own in lists)


_MOST_FRAMES: Final = 16  # of a topic

#: A topic, what makes objects of its messages, and each of them with its time [ns].
Message = tuple[TopicData, Callable[[bytes], Any], int, bytes]


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read the topics as ``/topic.field.field``, and their stamps as ``/topic.stamp`` (see `formats.read_grid`).

    Elements of an array are ``/topic.field.0`` and on; where a message names them, as those of joints, by their
    names. Of messages of several frames on one topic, each frame is ``/topic@frame``.
    """
    topics: dict[str, dict[str, TopicColumns]] = {}
    failed: set[str] = set()
    last: dict[tuple[str, str], bytes] = {}  # messages, by topic and frame
    twice: dict[str, int] = {}
    remarks: list[str] = []
    with library_errors(path):
        take = _ros1 if is_file(path) and _begins(path) else _ros2
        kept, most = 0, largest_unpacked() / BYTES_A_VALUE
        for topic, decode, logged, message in take(path, names, remarks):
            if topic.name in failed:
                continue
            frames = topics.setdefault(topic.name, {})
            count = sum(own.count for own in frames.values())
            if names is None and count and all(own.seen and not own.parts for own in frames.values()):
                continue
            try:
                decoded = decode(message)
            except InputError:
                raise
            except Exception as error:  # rosbags passes on any error of its generated code
                what = f"{topic.name}: message {count} cannot be decoded ({short_message(error)})"
                if names is not None:
                    raise InputError(f"{path}: {what}") from None
                remarks.append(f"{what}: left out")
                failed.add(topic.name)
                continue
            frame = frame_of(decoded)
            if stamp_of(decoded) and last.get((topic.name, frame)) == message:
                twice[topic.name] = twice.get(topic.name, 0) + 1
                continue
            last[topic.name, frame] = message
            if frame not in frames and len(frames) >= _MOST_FRAMES:
                frame = next(iter(frames))
            own = frames.get(frame)
            if own is None:
                own = frames[frame] = TopicColumns(wanted_fields(topic.name, frame, names))
            kept += own.add(decoded, logged)
            if kept > most:
                require_table(kept, str(path))
        remarks += [f"{name}: {count} messages are there twice: taken once" for name, count in twice.items()]
        columns = columns_of(
            {name: own for name, own in topics.items() if name not in failed}, names, remarks
        )
    if not columns and remarks:
        raise InputError(f"{path}: has no columns of numbers: {'; '.join(remarks)}")
    return Grid.of(str(path), columns, remarks)


def _begins(path: Path) -> bool:
    """Whether a file is a bag of ROS 1 by its first bytes."""
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def _ros1(path: Path, names: Sequence[str] | None, remarks: list[str]) -> Iterator[Message]:
    """Yield the messages of a bag of ROS 1 on topics that are wanted."""
    bag, decoders = Bag(path), Decoders(str(path), ros1=True)
    wanted: dict[str, bool] = {}
    for connection, logged, message in bag.messages():
        topic = connection.topic
        if topic.name not in wanted:
            wanted[topic.name] = names is None or any(
                name.startswith((f"{topic.name}.", f"{topic.name}@")) for name in names
            )
        if not wanted[topic.name]:
            continue
        try:
            decode = decoders.of(topic, connection.digest)
        except InputError as error:
            if names is not None:
                raise
            wanted[topic.name] = False
            remarks.append(_left_out(error, path))
            continue
        yield topic, decode, logged, bytes(message)
    if not any(wanted.values()) and not remarks:
        raise _nothing(path, bag.topics)


def _ros2(path: Path, names: Sequence[str] | None, remarks: list[str]) -> Iterator[Message]:
    """Yield the messages of a bag of ROS 2 on topics that are wanted, topic by topic."""
    decoders = Decoders(str(path), ros1=False)
    if names is None:
        there = read_bag(path, {})
        wanted = [topic.name for topic in there.values() if topic.count]
        if (
            _bytes_of(path) > largest_unpacked() // 2
        ):  # pictures and the like would not leave room for anything else
            for name in [name for name in wanted if decoders.has_lists_of_bytes(there[name])]:
                wanted.remove(name)
                remarks.append(f"{name} is left out: it has lists of bytes, and the bag is large")
    else:
        wanted = [name[:k] for name in names for k, sign in enumerate(name) if sign in ".@"]
    topics = read_bag(path, dict.fromkeys(wanted))
    if not any(topics[name].count for name in wanted if name in topics):
        raise _nothing(path, sorted(topics))
    for name, topic in topics.items():
        if name not in wanted or not topic.count:
            continue
        try:
            if topic.message_encoding != "cdr":
                raise InputError(
                    f"{path}: {name}: messages of encoding {topic.message_encoding!r}; allowed: cdr"
                )
            decode = decoders.of(topic)
        except InputError as error:
            if names is not None:
                raise
            remarks.append(_left_out(error, path))
            continue
        times = np.concatenate(topic.times).tolist()
        messages = [message for piece in topic.pieces for message in piece]
        topic.pieces, topic.times = [], []
        for logged, message in zip(times, messages, strict=True):
            yield topic, decode, logged, message


def _nothing(path: Path, topics: Sequence[str]) -> InputError:
    return InputError(f"{path}: has no such topic; there are: {', '.join(topics) or 'none'}")


def _left_out(error: InputError, path: Path) -> str:
    return f"{str(error).removeprefix(f'{path}: ')}: left out"


def _bytes_of(path: Path) -> int:
    files = path.iterdir() if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if is_file(file))
