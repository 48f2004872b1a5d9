"""Reading of MCAP files by whole chunks: fixed-layout messages go to numpy arrays without a loop over them.

Every length, offset and number in a file is checked before it is used, and so is every checksum that the file
has: a damaged file is either refused or read exactly. No more than one chunk of a file is in memory at a time.

The reader is ours because rosbags' raw bytes with numpy.frombuffer take seven times as long (``benchmarks readers``).
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from gyrowheel_analysis.recording.mcap.format import (
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    FOOTER_FORM,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD_DTYPE,
    MESSAGE_INDEX,
    MESSAGE_OVERHEAD,
    RECORD_HEAD,
    SCHEMA,
    STATISTICS,
)
from gyrowheel_analysis.recording.mcap.records import (
    Broken,
    Chunk,
    Damaged,
    Fields,
    Found,
    find_messages,
    gathered,
    heads_at,
    open_chunk,
    record_at,
)
from gyrowheel_core.errors import InputError
from gyrowheel_core.limits import require_room

_OBJECT: Final = 40  # bytes that a message takes beside its content
_BATCH: Final = 1 << 20  # bytes of messages outside of chunks that are parsed together
_AHEAD: Final = 1 << 20  # bytes that are read at a time: records are often short


@dataclass
class TopicData:
    """The messages of one topic.

    Attributes
    ----------
    name, type_name : str
        Name of the topic and type of its messages.
    message_encoding : str
        Serialization format, ``cdr`` in ROS 2.
    definition_encoding, definition : str
        Definition of the type and its encoding, ``ros2msg`` or ``ros2idl``; empty where there is none.
    count : int
        Number of messages.
    unchecked : int
        Messages that no checksum covers.
    times : list of ndarray of int64
        Log times [ns] in the order of the file; only of topics that were requested as serialized messages.
    pieces : list of Rows or list of bytes
        The messages in the order of the file: as rows where possible, else serialized.
    """

    name: str
    type_name: str
    message_encoding: str = "cdr"
    definition_encoding: str = ""
    definition: str = ""
    count: int = 0
    unchecked: int = 0
    times: list[npt.NDArray[np.int64]] = field(default_factory=list)
    pieces: list[Rows | list[bytes]] = field(default_factory=list)

    def add(self, want: Want | None, messages: list[bytes]) -> None:
        """Append messages, as rows where possible."""
        if (
            want is None
            or any(len(message) != want.dtype.itemsize for message in messages)
            or not self.take(want, np.frombuffer(b"".join(messages), want.dtype))
        ):
            self.pieces.append(messages)

    def take(self, want: Want, messages: npt.NDArray[Any]) -> bool:
        """Append messages of the wanted length as rows; return False if that is not possible."""
        rows = want.take(self, messages)
        if rows is None:
            return False
        while len(rows):
            last = self.pieces[-1] if self.pieces else None
            if not isinstance(last, Rows) or last.full:
                last = Rows(rows.dtype)
                self.pieces.append(last)
            rows = last.fill(rows)
        return True


class Rows:
    """A block of rows that fills up. Only the filled part takes memory.

    Parameters
    ----------
    dtype : dtype
        Of a row.
    """

    # larger than what the allocator keeps for reuse, so that a block that is released is really free
    _BYTES: Final = 48 << 20

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self._data = np.empty(self._BYTES // dtype.itemsize, dtype)
        self._count = 0

    @property
    def full(self) -> bool:
        """Whether the block is full."""
        return self._count == len(self._data)

    @property
    def filled(self) -> npt.NDArray[Any]:
        """The rows so far."""
        return self._data[: self._count]

    def fill(self, rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Append rows; return those that did not fit."""
        room = len(self._data) - self._count
        part = rows[:room]
        # as plain bytes: numpy would copy rows of equal type field by field
        to = self._data[self._count : self._count + len(part)]
        to.view(f"V{to.itemsize}")[:] = part.view(f"V{to.itemsize}")
        self._count += len(part)
        return rows[room:]


@dataclass(frozen=True)
class Want:
    """How to make rows of the messages of a topic.

    Attributes
    ----------
    dtype : dtype
        Of one serialized message; its itemsize is the required length of a message.
    take : callable
        Makes rows of such messages; returns None if that is not possible.
    """

    dtype: np.dtype[Any]
    take: Callable[[TopicData, npt.NDArray[Any]], npt.NDArray[Any] | None]


#: Topics to read, by name; None: as serialized messages.
Wanted: TypeAlias = Mapping[str, Want | None]


def read_mcap(path: Path, wanted: Wanted, unpack: Callable[[bytes], bytes] | None = None) -> list[TopicData]:
    """Read the messages of some topics of an MCAP file, and count those of the others.

    Parameters
    ----------
    path : Path
        The file.
    wanted : mapping of str to Want or None
        Names of the topics to read, and how.
    unpack : callable, optional
        Decompresses one message, where each is compressed on its own; raises `Damaged`.

    Returns
    -------
    list of TopicData
        One for each channel of the file.

    Raises
    ------
    InputError
        If the file cannot be read, is incomplete or damaged.
    """
    try:
        if path.exists() and not path.is_file():  # a pipe would be waited for
            raise InputError(f"{path}: is no file")
        with path.open("rb", buffering=0) as file:
            size = os.fstat(file.fileno()).st_size
            if size == 0:
                raise Damaged("the file is empty")
            return list(_File(file, size, wanted, unpack).read().values())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Damaged as error:
        raise Broken(f"{path}: {error}") from None


class _File:
    """One pass through a file."""

    def __init__(
        self, file: FileIO, size: int, wanted: Wanted, unpack: Callable[[bytes], bytes] | None
    ) -> None:
        self._unpack = unpack
        self._file = file
        self._size = size
        self._wanted = wanted
        self._position = 0
        self._ahead = memoryview(b"")  # the bytes of the file from `_begin` on
        self._begin = 0
        self._counted = 0  # up to where the checksum counts
        self._crc = 0  # of the data up to there
        self._schemas: dict[int, tuple[str, str, str]] = {}  # type, encoding and text by number
        self._topics: dict[int, TopicData] = {}  # by channel
        self._outside = bytearray()  # records of messages that are in no chunk
        self._places: list[int] = []  # of them
        self._chunks: list[tuple[str, Chunk, list[memoryview]]] = []  # that wait, with name and index
        self._waiting = 0  # bytes in them
        self._kept = 0  # bytes of the messages that were asked for

    def read(self) -> dict[int, TopicData]:
        """Return the topics by channel."""
        if bytes(self._read(min(len(MAGIC), self._size))) != MAGIC:
            raise Damaged("not an MCAP file")
        end = self._size - FOOTER_FORM.size
        tail = b""
        if end >= len(MAGIC):
            self._file.seek(end)
            tail = _filled(self._file, FOOTER_FORM.size)
            self._file.seek(self._begin + len(self._ahead))
        if len(tail) < FOOTER_FORM.size or not tail.endswith(MAGIC):
            raise Damaged("the file breaks off before its end: the recording was not completed")
        self._read_data(end)
        self._check_summary(tail)
        return self._topics

    def _read(self, length: int) -> memoryview:
        """Return the next bytes; they stay as they are while more is read."""
        start = self._position - self._begin
        if length > len(self._ahead) - start:
            self._checksum(self._position)
            left = self._ahead[start:]
            wanted = min(max(length - len(left), _AHEAD), self._size - self._position - len(left))
            self._ahead = memoryview(b"".join((left, _filled(self._file, wanted))))
            self._begin, start = self._position, 0
            if length > len(self._ahead):
                raise Damaged("the file has become shorter while it was read")
        self._position += length
        return self._ahead[start : start + length]

    def _checksum(self, end: int) -> int:
        """Return the checksum of all up to a byte of what was read last."""
        data = self._ahead[self._counted - self._begin : end - self._begin]
        self._crc, self._counted = zlib.crc32(data, self._crc), end
        return self._crc

    def _read_data(self, end: int) -> None:
        """Read all up to the end of the data section; `end` is where the footer begins."""
        chunk: tuple[int, memoryview] | None = None
        index: list[memoryview] = []  # of that chunk
        while self._position < end:
            position = self._position
            if end - position < RECORD_HEAD.size:
                raise Damaged(f"damaged: the record at byte {position} is cut off")
            head = self._read(RECORD_HEAD.size)
            opcode, length = RECORD_HEAD.unpack(head)
            if length > end - self._position:
                raise Damaged(f"damaged: the record at byte {position} is cut off")
            before = self._checksum(position) if opcode == DATA_END else 0
            body = self._read(length)
            if opcode == MESSAGE_INDEX:
                index.append(body)
                continue
            if chunk is not None:
                self._read_chunk(chunk, index)
                chunk = None
            index = []
            if opcode == CHUNK:
                chunk = position, body
                continue
            self._take_chunks()
            if opcode == MESSAGE:
                self._places.append(len(self._outside))
                self._outside += head
                self._outside += body
                if len(self._outside) > _BATCH:
                    self._take_outside()
            elif opcode == DATA_END:
                checksum = Fields(body).number("<I")
                if checksum and before != checksum:
                    raise Damaged("damaged: the checksum of the data is wrong")
                self._take_outside(checked=bool(checksum))
                return
            else:
                self._read_declaration(opcode, body)
        raise Damaged("damaged: the data have no end where they must have")

    def _take_outside(self, *, checked: bool = False) -> None:
        if self._places:
            records, places = memoryview(bytes(self._outside)), np.array(self._places)
            self._take(records, places, heads_at(records, places, "the file"), checked=checked)
            self._outside.clear()
            self._places.clear()

    def _read_declaration(self, opcode: int, contents: memoryview) -> None:
        """Note a schema or channel; skip other records."""
        fields = Fields(contents)
        if opcode == SCHEMA:
            number = fields.number("<H")
            self._schemas[number] = (fields.text(), fields.text(), fields.text())
        elif opcode == CHANNEL:
            number, schema = fields.number("<H"), fields.number("<H")
            type_name, encoding, text = self._schemas.get(schema, ("", "", ""))
            topic = TopicData(fields.text(), type_name, fields.text(), encoding, text)
            known = self._topics.setdefault(number, topic)
            if (known.name, known.type_name) != (topic.name, topic.type_name):
                raise Damaged(f"damaged: channel {number} is both {known.name} and {topic.name}")

    def _read_chunk(self, chunk: tuple[int, memoryview], index: list[memoryview]) -> None:
        where = f"the chunk at byte {chunk[0]}"
        opened = open_chunk(chunk[1], where)
        if self._chunks and self._chunks[0][1].checked != opened.checked:
            self._take_chunks()
        self._chunks.append((where, opened, index))
        self._waiting += len(opened.records)
        if self._waiting > _BATCH:
            self._take_chunks()

    def _take_chunks(self) -> None:
        """Take the messages of the waiting chunks: small chunks are faster together than one by one."""
        chunks, self._chunks, self._waiting = self._chunks, [], 0
        if len(chunks) > 1:
            try:
                found = find_messages([(c.records, index) for _, c, index in chunks], "")
            except Damaged:
                pass  # reading them one by one tells which of them it is
            else:
                self._take_found(found, checked=chunks[0][1].checked)
                return
        for where, chunk, index in chunks:
            self._take_found(find_messages([(chunk.records, index)], where), checked=chunk.checked)

    def _take_found(self, found: Found, *, checked: bool) -> None:
        for opcode, contents in found.others:
            self._read_declaration(opcode, contents)
        self._take(found.records, found.places, found.heads, checked=checked)

    def _take(
        self, records: memoryview, places: npt.NDArray[np.int64], heads: npt.NDArray[Any], *, checked: bool
    ) -> None:
        """Give the messages at `places` to their topics."""
        for channel in np.unique(heads["channel"]).tolist():
            topic = self._topics.get(channel)
            if topic is None:
                raise Damaged(f"damaged: a message on channel {channel}, which is not declared")
            mine = heads["channel"] == channel
            count = int(np.count_nonzero(mine))
            topic.count += count
            topic.unchecked += 0 if checked else count
            if topic.name not in self._wanted:
                continue
            begins = places[mine] + MESSAGE_HEAD_DTYPE.itemsize
            sizes = heads["length"][mine].astype(np.int64) - MESSAGE_OVERHEAD
            self._kept += int(sizes.sum()) + _OBJECT * count
            require_room(self._kept, f"{self._file.name}: what is recorded on {topic.name}")
            want = self._wanted[topic.name]
            if want is None:
                topic.times.append(heads["log_time"][mine].astype(np.int64))
            elif (
                self._unpack is None
                and np.all(sizes == want.dtype.itemsize)
                and topic.take(want, gathered(records, begins, want.dtype))
            ):
                continue
            pairs = zip(begins.tolist(), sizes.tolist(), strict=True)
            messages = [records[a : a + n].tobytes() for a, n in pairs]
            if self._unpack is None:
                topic.pieces.append(messages)
            else:
                topic.add(want, [self._unpack(message) for message in messages])

    def _check_summary(self, tail: bytes) -> None:
        """Compare what was read with the summary; `tail` is the end of the file."""
        opcode, length, start, _, checksum, _ = FOOTER_FORM.unpack(tail)
        if opcode != FOOTER or length != FOOTER_FORM.size - RECORD_HEAD.size - len(MAGIC):
            raise Damaged("damaged: no footer where it must be")
        if start == 0:
            return
        if start != self._position:
            raise Damaged(f"damaged: the summary is said to begin at byte {start}")
        summary = self._read(self._size - self._position)
        end = len(summary) - FOOTER_FORM.size
        if checksum and zlib.crc32(summary[: -len(MAGIC) - 4]) != checksum:
            raise Damaged("damaged: the checksum of the summary is wrong")
        position = 0
        while position < end:
            opcode, begin, stop = record_at(summary, position, end)
            if opcode == STATISTICS:
                total = Fields(summary[begin:stop]).number("<Q")
                count = sum(topic.count for topic in self._topics.values())
                if total != count:
                    raise Damaged(f"damaged: {count} messages where the summary counts {total}")
            elif opcode in (SCHEMA, CHANNEL):  # a topic without messages may be declared here only
                self._read_declaration(opcode, summary[begin:stop])
            position = stop


def _filled(file: FileIO, length: int) -> bytes:
    """Return the next bytes of a file, fewer only where it ends."""
    parts: list[bytes] = []
    while length > 0 and (part := file.read(length)):
        parts.append(part)
        length -= len(part)
    return parts[0] if len(parts) == 1 else b"".join(parts)
