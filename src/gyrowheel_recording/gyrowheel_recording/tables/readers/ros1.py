"""Bags of ROS 1: their records from the first to the last, each once.

The libraries go by the index, which may lead to one place as often as it likes, and unpack a chunk to whatever it
grows to.
"""

from __future__ import annotations

import bz2
import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import lz4.frame
from rosbags.typesys.msg import normalize_msgtype

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import require_room
from gyrowheel_recording.bags.mcap.records import MOST_COMPRESSED
from gyrowheel_recording.bags.mcap.topics import TopicData

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
    digest: str  # checksum of the definition; ``*`` where there is none


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
