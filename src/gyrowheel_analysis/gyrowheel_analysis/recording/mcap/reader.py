"""Reading of MCAP files by whole chunks: fixed-layout messages go to numpy arrays without a loop over them.

Every length, offset and number in a file is checked before it is used, and so is every checksum that the file
has: a damaged file is either refused or read exactly. No more than one chunk of a file is in memory at a time.

The reader is ours because rosbags' raw bytes with numpy.frombuffer take seven times as long (``benchmarks readers``).
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from typing import Any, Final, TypeAlias

import lz4.frame
import numpy as np
import numpy.typing as npt
import zstandard

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
from gyrowheel_core.errors import InputError
from gyrowheel_core.limits import require_room

_HEAD: Final = MESSAGE_HEAD_DTYPE.itemsize
_OBJECT: Final = 40  # bytes that a message takes beside its content
_LIMIT: Final = 1 << 29  # bytes in a chunk; a larger number counts as damage and is never allocated
_BATCH: Final = 1 << 20  # bytes of messages outside of chunks that are parsed together
_AHEAD: Final = 1 << 20  # bytes that are read at a time: records are often short
_INDEX_HEAD: Final = struct.Struct("<HI")  # channel, and length of what follows
_CHUNK_HEAD: Final = struct.Struct("<QQQI")  # first and last time, length of the records, their checksum
_ENTRY: Final = np.dtype([("time", "<i8"), ("place", "<i8")])  # of an index


class Damaged(Exception):
    """Damage in a file: what is wrong, and where."""


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


#: A part of a file, copied or not.
Bytes: TypeAlias = bytes | memoryview

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
        raise InputError(f"{path}: {error}") from None


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
            self._take(records, places, _heads(records, places, "the file"), checked=checked)
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
            begins = places[mine] + _HEAD
            sizes = heads["length"][mine].astype(np.int64) - MESSAGE_OVERHEAD
            self._kept += int(sizes.sum()) + _OBJECT * count
            require_room(self._kept, f"{self._file.name}: what is recorded on {topic.name}")
            want = self._wanted[topic.name]
            if want is None:
                topic.times.append(heads["log_time"][mine].astype(np.int64))
            elif (
                self._unpack is None
                and np.all(sizes == want.dtype.itemsize)
                and topic.take(want, _gather(records, begins, want.dtype))
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
            opcode, begin, stop = _record(summary, position, end)
            if opcode == STATISTICS:
                total = Fields(summary[begin:stop]).number("<Q")
                count = sum(topic.count for topic in self._topics.values())
                if total != count:
                    raise Damaged(f"damaged: {count} messages where the summary counts {total}")
            elif opcode in (SCHEMA, CHANNEL):  # a topic without messages may be declared here only
                self._read_declaration(opcode, summary[begin:stop])
            position = stop


@dataclass(frozen=True)
class Chunk:
    """The contents of a chunk.

    Attributes
    ----------
    start, end : int
        Smallest and largest log time that it states [ns].
    records : memoryview
        Its records.
    checked : bool
        Whether a checksum covers them.
    """

    start: int
    end: int
    records: memoryview
    checked: bool


def open_chunk(contents: memoryview, where: str) -> Chunk:
    """Open the contents of a chunk record.

    Raises
    ------
    Damaged
        If they contradict what the record states; the message names `where`.
    """
    fields = Fields(contents)
    start, end, size, checksum = fields.numbers(_CHUNK_HEAD)
    compression = fields.text()
    if size > _LIMIT:
        raise Damaged(f"damaged: {where} claims {size} bytes")
    records = _decompress(fields.data(fields.number("<Q")), compression, size, where)
    if len(records) != size:
        raise Damaged(f"damaged: {where} has {len(records)} bytes instead of {size}")
    if checksum and zlib.crc32(records) != checksum:
        raise Damaged(f"damaged: the checksum of {where} is wrong")
    return Chunk(start, end, records, checksum != 0)


@dataclass(frozen=True)
class Found:
    """The records in chunks.

    Attributes
    ----------
    records : memoryview
        The records, one chunk after the other.
    places : ndarray of int64, shape (n,)
        Where the messages are, ascending.
    heads : structured ndarray, shape (n,)
        Their heads, `MESSAGE_HEAD_DTYPE`.
    others : list of (int, memoryview)
        Opcode and contents of the other records.
    """

    records: memoryview
    places: npt.NDArray[np.int64]
    heads: npt.NDArray[Any]
    others: list[tuple[int, memoryview]]


def find_messages(chunks: Sequence[tuple[memoryview, Sequence[Bytes]]], where: str) -> Found:
    """Find the messages in chunks by their index, and all records between them.

    Parameters
    ----------
    chunks : sequence of (memoryview, sequence of Bytes)
        The records of each chunk and the contents of its index records; messages missing from the index are found too.
    where : str
        What to name in an error.

    Raises
    ------
    Damaged
        If an index does not fit, or a record is cut off.
    """
    records = chunks[0][0] if len(chunks) == 1 else memoryview(b"".join(part for part, _ in chunks))
    starts = np.cumsum([0, *(len(part) for part, _ in chunks)])
    channels, times, places = _index(
        [(part, *starts[k : k + 2].tolist()) for k, (_, index) in enumerate(chunks) for part in index], where
    )
    heads = _heads(records, places, where)
    if not np.array_equal(heads["channel"], channels) or not np.array_equal(heads["log_time"], times):
        raise Damaged(f"damaged: {where} and its index differ")
    begins = np.concatenate([[0], places + RECORD_HEAD.size + heads["length"].astype(np.int64)])
    ends = np.concatenate([places, [len(records)]])
    # the last message before each chunk begins
    crossing = begins[np.searchsorted(places, starts[1:-1])] > starts[1:-1]
    if np.any(begins > ends) or np.any(crossing):
        raise Damaged(f"damaged: messages overlap in {where}")
    further: list[int] = []
    others: list[tuple[int, memoryview]] = []
    for gap in np.flatnonzero(begins < ends):
        position = int(begins[gap])
        while position < ends[gap]:
            opcode, start, stop = _record(records, position, int(ends[gap]))
            if opcode == MESSAGE:
                further.append(position)
            else:
                others.append((opcode, records[start:stop]))
            position = stop
    if further:
        places = np.sort(np.concatenate([places, np.array(further)]))
        heads = _heads(records, places, where)
    return Found(records, places, heads, others)


class Fields:
    """Reads the fields of a record one after the other."""

    def __init__(self, data: memoryview) -> None:
        self._data = data
        self._position = 0

    def data(self, size: int) -> memoryview:
        """Return the next `size` bytes."""
        start = self._position
        if size > len(self._data) - start:
            raise Damaged("damaged: a record ends within a field")
        self._position += size
        return self._data[start : start + size]

    @property
    def left(self) -> int:
        """How many bytes have not been read."""
        return len(self._data) - self._position

    def number(self, form: str) -> int:
        """Return the next number, of a format of `struct`."""
        result: int = struct.unpack(form, self.data(struct.calcsize(form)))[0]
        return result

    def numbers(self, form: struct.Struct) -> tuple[int, ...]:
        """Return the next numbers, of a form."""
        return form.unpack(self.data(form.size))

    def text(self) -> str:
        """Return the next text."""
        return self.data(self.number("<I")).tobytes().decode(errors="replace")


def _record(data: memoryview, position: int, end: int) -> tuple[int, int, int]:
    """Return opcode, begin and end of the contents of the record at `position`; it must end by `end`."""
    start = position + RECORD_HEAD.size
    if start <= end:
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        if length <= end - start:
            return opcode, start, start + length
    raise Damaged(f"damaged: the record at byte {position} is cut off")


def _index(
    parts: Sequence[tuple[Bytes, int, int]], where: str
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return channels, times and places from index records, in the order of places.

    Each part is an index record with the begin and end of its chunk.
    """
    heads, starts, rooms, lists = [], [], [], []
    for part, start, end in parts:
        if len(part) < _INDEX_HEAD.size:
            raise Damaged("damaged: a record ends within a field")
        channel, length = _INDEX_HEAD.unpack_from(part)
        if length > len(part) - _INDEX_HEAD.size:
            raise Damaged("damaged: a record ends within a field")
        if length % _ENTRY.itemsize:
            raise Damaged(f"damaged: the index of {where}")
        heads.append((channel, length // _ENTRY.itemsize))
        starts.append(start)
        rooms.append(end - start)
        lists.append(part[_INDEX_HEAD.size : _INDEX_HEAD.size + length])
    entries = np.frombuffer(b"".join(lists), _ENTRY)
    channels, counts = np.array(heads, dtype=np.int64).reshape(-1, 2).T
    places = entries["place"]
    if np.any(places < 0) or np.any(places >= np.repeat(np.array(rooms, dtype=np.int64), counts)):
        raise Damaged(f"damaged: the index of {where} points outside it")
    places = places + np.repeat(np.array(starts, dtype=np.int64), counts)
    order = np.argsort(places, kind="stable")
    return np.repeat(channels, counts)[order], entries["time"][order], places[order]


def _heads(records: memoryview, places: npt.NDArray[np.int64], where: str) -> npt.NDArray[Any]:
    """Return the heads of the messages at ascending `places`, checked."""
    if len(places) == 0:
        return np.empty(0, MESSAGE_HEAD_DTYPE)
    if places[0] < 0 or places[-1] > len(records) - _HEAD:
        raise Damaged(f"damaged: the index of {where} points outside it")
    heads = _gather(records, places, MESSAGE_HEAD_DTYPE)
    space = (len(records) - RECORD_HEAD.size - places).astype(np.uint64)
    length = heads["length"]
    if np.any(heads["opcode"] != MESSAGE) or np.any(length < MESSAGE_OVERHEAD) or np.any(length > space):
        raise Damaged(f"damaged: the index of {where} does not point at messages")
    return heads


def _gather(records: memoryview, places: npt.NDArray[np.int64], dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """Return what is at `places`, one element of `dtype` each."""
    size = dtype.itemsize
    # One element at every byte, so that numpy's indexing copies the wanted ones.
    everywhere = np.ndarray((len(records) - size + 1,), dtype=f"V{size}", buffer=records, strides=(1,))
    return everywhere[places].view(dtype)


def _filled(file: FileIO, length: int) -> bytes:
    """Return the next bytes of a file, fewer only where it ends."""
    parts: list[bytes] = []
    while length > 0 and (part := file.read(length)):
        parts.append(part)
        length -= len(part)
    return parts[0] if len(parts) == 1 else b"".join(parts)


def _decompress(data: memoryview, compression: str, size: int, where: str) -> memoryview:
    try:
        if compression == "":
            return data
        if compression == "zstd":
            if zstandard.frame_content_size(data) > size:
                raise Damaged(f"damaged: {where} holds more than {size} bytes")
            return memoryview(zstandard.ZstdDecompressor().decompress(data, max_output_size=size))
        if compression == "lz4":
            return memoryview(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
        raise Damaged(f"damaged: {where} cannot be decompressed ({error})") from None
    raise Damaged(f"{where} has the compression {compression!r}, which is not known; known: zstd, lz4")
