"""Records and chunks of MCAP: their fields, and the messages in chunks, found by their index.

Every length, offset, number and checksum is checked before it is used: what is damaged raises `Damaged`.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import lz4.frame
import numpy as np
import numpy.typing as npt
import zstandard

from gyrowheel_analysis.recording.mcap.format import (
    MESSAGE,
    MESSAGE_HEAD_DTYPE,
    MESSAGE_OVERHEAD,
    RECORD_HEAD,
)
from gyrowheel_core.errors import InputError

_HEAD: Final = MESSAGE_HEAD_DTYPE.itemsize
_LIMIT: Final = 1 << 29  # bytes in a chunk; a larger number counts as damage and is never allocated
_INDEX_HEAD: Final = struct.Struct("<HI")  # channel, and length of what follows
_CHUNK_HEAD: Final = struct.Struct("<QQQI")  # first and last time, length of the records, their checksum
_ENTRY: Final = np.dtype([("time", "<i8"), ("place", "<i8")])  # of an index
#: A part of a file, copied or not.
Bytes: TypeAlias = bytes | memoryview


class Broken(InputError):
    """A file that is incomplete or damaged, of which `salvage` may save a part."""


class Damaged(Exception):
    """Damage in a file: what is wrong, and where."""


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
    heads = heads_at(records, places, where)
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
            opcode, start, stop = record_at(records, position, int(ends[gap]))
            if opcode == MESSAGE:
                further.append(position)
            else:
                others.append((opcode, records[start:stop]))
            position = stop
    if further:
        places = np.sort(np.concatenate([places, np.array(further)]))
        heads = heads_at(records, places, where)
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


def record_at(data: memoryview, position: int, end: int) -> tuple[int, int, int]:
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


def heads_at(records: memoryview, places: npt.NDArray[np.int64], where: str) -> npt.NDArray[Any]:
    """Return the heads of the messages at ascending `places`, checked."""
    if len(places) == 0:
        return np.empty(0, MESSAGE_HEAD_DTYPE)
    if places[0] < 0 or places[-1] > len(records) - _HEAD:
        raise Damaged(f"damaged: the index of {where} points outside it")
    heads = gathered(records, places, MESSAGE_HEAD_DTYPE)
    space = (len(records) - RECORD_HEAD.size - places).astype(np.uint64)
    length = heads["length"]
    if np.any(heads["opcode"] != MESSAGE) or np.any(length < MESSAGE_OVERHEAD) or np.any(length > space):
        raise Damaged(f"damaged: the index of {where} does not point at messages")
    return heads


def gathered(records: memoryview, places: npt.NDArray[np.int64], dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """Return what is at `places`, one element of `dtype` each."""
    size = dtype.itemsize
    # One element at every byte, so that numpy's indexing copies the wanted ones.
    everywhere = np.ndarray((len(records) - size + 1,), dtype=f"V{size}", buffer=records, strides=(1,))
    return everywhere[places].view(dtype)


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
