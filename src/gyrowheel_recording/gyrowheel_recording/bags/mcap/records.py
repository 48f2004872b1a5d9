"""Records and chunks of MCAP: their fields, and the messages in chunks, found by their index.

Every length, offset, number and checksum is checked before it is used: what is damaged raises `Damaged`.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import lz4.frame
import numpy as np
import numpy.typing as npt
import zstandard

from gyrowheel_core.arrays import everywhere, gathered
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags.mcap import MESSAGE_HEAD_DTYPE, MESSAGE_OVERHEAD, RECORD_HEAD, Op, crc32

#: What signals and messages can be compressed by, generously; only a file made to fill a memory reaches more.
MOST_COMPRESSED: Final = 1000
_HEAD: Final = MESSAGE_HEAD_DTYPE.itemsize
#: Bytes in a chunk; a larger number counts as damage and is never allocated.
LARGEST: Final = 1 << 29
_SMALL: Final = 1 << 24  # bytes in a chunk, however much they are compressed
_MOST_DECLARED: Final = 1 << 17  # schemas and channels in a chunk: as many as there are numbers for them
_INDEX_HEAD: Final = np.dtype([("channel", "<u2"), ("length", "<u4")])  # length of what follows
#: Head of a chunk: first and last time, length of the records, their checksum.
CHUNK_HEAD: Final = struct.Struct("<QQQI")
#: The same up to the records, where they are not compressed.
_PLAIN: Final = np.dtype([
    ("start", "<u8"), ("end", "<u8"), ("size", "<u8"), ("checksum", "<u4"), ("name", "<u4"), ("stored", "<u8"),
])  # fmt: skip
_ENTRY: Final = np.dtype([("time", "<i8"), ("place", "<i8")])  # of an index
#: A part of a file, copied or not.
Bytes: TypeAlias = bytes | memoryview


class Broken(InputError):
    """A file that is incomplete or damaged, of which `salvage` may save a part."""


class Damaged(Exception):
    """Damage in a file: what is wrong, and where."""


@dataclass(frozen=True)
class Chunk:
    """The contents of a chunk."""

    #: Smallest and largest log time that it states [ns].
    start: int
    end: int
    records: memoryview  # its records
    checked: bool  # whether a checksum covers them


def open_chunk(contents: memoryview, where: str) -> Chunk:
    """Open the contents of a chunk record.

    Raises Damaged if they contradict what the record states; the message names `where`.
    """
    fields = Fields(contents)
    start, end, size, checksum = fields.numbers(CHUNK_HEAD)
    compression = fields.text()
    if size > LARGEST:
        raise Damaged(f"damaged: {where} claims {size} bytes")
    stored = fields.data(fields.number("<Q"))
    if size > max(_SMALL, MOST_COMPRESSED * len(stored)):
        raise Damaged(f"damaged: {where} claims {size} bytes in {len(stored)}, as none of a recording does")
    records = _decompress(stored, compression, size, where)
    if len(records) != size:
        raise Damaged(f"damaged: {where} has {len(records)} bytes instead of {size}")
    if checksum and crc32(records) != checksum:
        raise Damaged(f"damaged: the checksum of {where} is wrong")
    return Chunk(start, end, records, checksum != 0)


def plain_chunks(
    data: memoryview, chunks: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.int64], list[int]] | None:
    """Return where the records of uncompressed chunks with right checksums are.

    `chunks`, shape (n, 2), has begin and end of the contents of each chunk record in `data`. Returns begin and end
    of the records of each, shape (n, 2), and their checksums; None if one of them must be opened by `open_chunk`.
    """
    begins, ends = chunks.T
    if np.any(ends - begins < _PLAIN.itemsize):
        return None
    heads = gathered(data, begins, _PLAIN)
    sizes = heads["size"]
    begins = begins + _PLAIN.itemsize
    plain = (heads["name"] == 0) & (heads["stored"] == sizes) & (sizes <= (ends - begins).astype(np.uint64))
    if not np.all(plain & (sizes <= LARGEST) & (heads["checksum"] != 0)):
        return None
    spans = np.stack([begins, begins + sizes.astype(np.int64)], axis=1)
    found = [crc32(data[a:b]) for a, b in spans.tolist()]
    return (spans, found) if np.array_equal(found, heads["checksum"]) else None


@dataclass(frozen=True)
class Found:
    """The records in chunks."""

    records: memoryview  # the records, one chunk after the other
    places: npt.NDArray[np.int64]  # (n,): where the messages are, ascending
    heads: npt.NDArray[Any]  # (n,): their heads, `MESSAGE_HEAD_DTYPE`
    #: Opcode and contents of schemas and channels; nothing else in a chunk means anything.
    others: list[tuple[int, memoryview]]


@dataclass(frozen=True)
class Indexed:
    """Chunks, and the index records of each."""

    records: memoryview  # holds the records of all chunks
    spans: npt.NDArray[np.int64]  # (n, 2): begin and end of the records of each chunk, ascending
    index: memoryview  # holds the index records
    parts: npt.NDArray[np.int64]  # (m, 3): chunk, begin and length of the contents of each index record


def find_messages(chunks: Sequence[tuple[memoryview, Sequence[Bytes]]], where: str) -> Found:
    """Find the messages in chunks by their index, and all records between them.

    `chunks` has the records of each chunk and the contents of its index records; messages missing from the
    index are found too. Raises Damaged if an index does not fit, or a record is cut off; it names `where`.
    """
    records = chunks[0][0] if len(chunks) == 1 else memoryview(b"".join(part for part, _ in chunks))
    stops = np.cumsum([len(part) for part, _ in chunks])
    spans = np.stack([np.concatenate([[0], stops[:-1]]), stops], axis=1)
    owned = [(k, part) for k, (_, index) in enumerate(chunks) for part in index]
    sizes = np.array([len(part) for _, part in owned], dtype=np.int64)
    parts = np.stack(
        [np.array([k for k, _ in owned], dtype=np.int64), np.cumsum(sizes) - sizes, sizes], axis=1
    )
    return find(Indexed(records, spans, memoryview(b"".join(part for _, part in owned)), parts), where)


def find(chunks: Indexed, where: str, *, compiled: bool = False) -> Found:
    """Find the messages in chunks as `find_messages` does; `compiled` finds the same in many of them sooner."""
    records = chunks.records
    index = _index_records(chunks, where)
    if compiled and (found := _walked(chunks, index)) is not None:
        return found
    channels, times, places = _entries(chunks, index, where)
    heads = heads_at(records, places, where)
    if not np.array_equal(heads["channel"], channels) or not np.array_equal(heads["log_time"], times):
        raise Damaged(f"damaged: {where} and its index differ")
    stops = places + RECORD_HEAD.size + heads["length"].astype(np.int64)
    further: array[int] = array("q")
    others: list[tuple[int, memoryview]] = []
    for position, end in _gaps(chunks.spans, places, stops, where):
        while position < end:
            opcode, start, stop = record_at(records, position, end)
            if opcode == Op.MESSAGE:
                further.append(position)
            elif opcode in (Op.SCHEMA, Op.CHANNEL):
                others.append((opcode, records[start:stop]))
                if len(others) > _MOST_DECLARED:
                    raise Damaged(f"damaged: {where} declares more than there are numbers for")
            elif opcode == 0:
                raise Damaged(f"damaged: no record at byte {position} of {where}")
            position = stop
    if further:
        places = np.sort(np.concatenate([places, np.array(further, dtype=np.int64)]))
        heads = heads_at(records, places, where)
    return Found(records, places, heads, others)


def _gaps(
    spans: npt.NDArray[np.int64], places: npt.NDArray[np.int64], stops: npt.NDArray[np.int64], where: str
) -> list[tuple[int, int]]:
    """Return what of chunks is in no message; the messages are ascending, each begins in a chunk."""
    first = np.searchsorted(places, spans[:, 0])
    last = np.append(first[1:], len(places))  # behind the last one of a chunk
    filled = last > first
    apart = np.append(stops[:-1] != places[1:], False) if len(places) else np.zeros(0, dtype=bool)
    apart[last[filled] - 1] = False
    before = np.flatnonzero(apart)
    until = spans[:, 1].copy()  # the first message, or the end of a chunk that has none
    until[filled] = places[first[filled]]
    begins = np.concatenate([stops[before], spans[:, 0], stops[last[filled] - 1]])
    ends = np.concatenate([places[before + 1], until, spans[filled, 1]])
    if np.any(begins > ends):
        raise Damaged(f"damaged: messages overlap in {where}")
    gaps = np.flatnonzero(begins < ends)
    return sorted(zip(begins[gaps].tolist(), ends[gaps].tolist(), strict=True))


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


def record_at(data: memoryview, position: int, end: int) -> tuple[int, int, int]:
    """Return opcode, begin and end of the contents of the record at `position`; it must end by `end`."""
    start = position + RECORD_HEAD.size
    if start <= end:
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        if length <= end - start:
            return opcode, start, start + length
    raise Damaged(f"damaged: the record at byte {position} is cut off")


def _walked(chunks: Indexed, index: npt.NDArray[np.int64]) -> Found | None:
    """Return what is in chunks that are as nearly all are: messages in the order of the index and nothing else."""
    from gyrowheel_recording.bags.mcap.loops import walk

    count = int((index[:, 3] - index[:, 2]).sum()) // _ENTRY.itemsize
    if not count or len(chunks.records) < _HEAD or np.any(np.diff(index[:, 0]) < 0):
        return None
    heads, places = np.empty(count, MESSAGE_HEAD_DTYPE), np.empty(count, np.int64)
    every = everywhere(chunks.records, MESSAGE_HEAD_DTYPE), everywhere(chunks.index, _ENTRY)
    if not walk(*every, chunks.spans, index, heads, places):
        return None
    return Found(chunks.records, places, heads, [])


def load_walk() -> None:
    """Load the compiled loop of `find`: it finds a message of one byte in a chunk of its own."""
    head, index = np.zeros(1, MESSAGE_HEAD_DTYPE), np.zeros(1, _INDEX_HEAD)
    head["opcode"], head["length"], index["length"] = Op.MESSAGE, MESSAGE_OVERHEAD + 1, _ENTRY.itemsize
    records, content = head.tobytes() + b"\0", index.tobytes() + bytes(_ENTRY.itemsize)
    spans, parts = np.array([[0, len(records)]]), np.array([[0, 0, len(content)]])
    find(Indexed(memoryview(records), spans, memoryview(content), parts), "", compiled=True)


def _index_records(chunks: Indexed, where: str) -> npt.NDArray[np.int64]:
    """Return chunk, channel, and begin and end of the entries of index records, checked; shape (m, 4)."""
    owner, starts, sizes = chunks.parts.T
    if np.any(sizes < _INDEX_HEAD.itemsize):
        raise Damaged("damaged: a record ends within a field")
    heads = gathered(chunks.index, starts, _INDEX_HEAD)
    lengths = heads["length"].astype(np.int64)
    if np.any(lengths > sizes - _INDEX_HEAD.itemsize):
        raise Damaged("damaged: a record ends within a field")
    if np.any(lengths % _ENTRY.itemsize):
        raise Damaged(f"damaged: the index of {where}")
    begins = starts + _INDEX_HEAD.itemsize
    return np.stack([owner, heads["channel"].astype(np.int64), begins, begins + lengths], axis=1)


def _entries(
    chunks: Indexed, index: npt.NDArray[np.int64], where: str
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return channels, times and places of the entries of index records, in the order of places."""
    owner, channels, begins, ends = index.T
    lengths = ends - begins
    counts = lengths // _ENTRY.itemsize
    first = begins - (np.cumsum(lengths) - lengths)  # where they would begin, had they none before them
    total = np.arange(int(counts.sum())) * _ENTRY.itemsize
    entries = gathered(chunks.index, np.repeat(first, counts) + total, _ENTRY)
    places = entries["place"]
    spans = chunks.spans[owner]
    if np.any(places < 0) or np.any(places >= np.repeat(spans[:, 1] - spans[:, 0], counts)):
        raise Damaged(f"damaged: the index of {where} points outside it")
    places = places + np.repeat(spans[:, 0], counts)
    order = np.argsort(places, kind="stable")
    return np.repeat(channels, counts)[order], entries["time"][order], places[order]


def heads_at(records: memoryview, places: npt.NDArray[np.int64], where: str) -> npt.NDArray[Any]:
    """Return the heads of the messages at ascending `places`, checked."""
    if len(places) and (places[0] < 0 or places[-1] > len(records) - _HEAD):
        raise Damaged(f"damaged: the index of {where} points outside it")
    heads = gathered(records, places, MESSAGE_HEAD_DTYPE)
    space = (len(records) - RECORD_HEAD.size - places).astype(np.uint64)
    length = heads["length"]
    if np.any(heads["opcode"] != Op.MESSAGE) or np.any(length < MESSAGE_OVERHEAD) or np.any(length > space):
        raise Damaged(f"damaged: the index of {where} does not point at messages")
    return heads


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
