"""Reading of MCAP files by whole chunks: fixed-layout messages go to numpy arrays without a loop over them.

Every length, place and number in a file is checked before it is used, and so is every checksum that the file
has: a damaged file is either refused or read exactly.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import lz4.frame
import numpy as np
import numpy.typing as npt
import zstandard

from gyrowheel_analysis.recording.mcap_format import (
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
from gyrowheel_sim.errors import InputError

_HEAD: Final = MESSAGE_HEAD_DTYPE.itemsize
_LIMIT: Final = 1 << 31  # bytes in a chunk; a larger number is taken for damage, not for a reason to allocate


class Damaged(Exception):
    """What is wrong inside a file, and where."""


@dataclass
class TopicData:
    """The messages of one topic.

    Attributes
    ----------
    name, type_name : str
        Name of the topic and type of its messages.
    message_encoding : str
        How they are serialized, ``cdr`` in ROS 2.
    definition_encoding, definition : str
        Definition of the type and its encoding, ``ros2msg`` or ``ros2idl``; empty where there is none.
    count : int
        Number of messages.
    times : list of ndarray of int64
        Log times [ns] in the order of the file, piece by piece; empty for a topic that was not asked for.
    pieces : list of ndarray or list of bytes
        The messages likewise: arrays of the dtype that was asked for, or serialized messages.
    """

    name: str
    type_name: str
    message_encoding: str = "cdr"
    definition_encoding: str = ""
    definition: str = ""
    count: int = 0
    times: list[npt.NDArray[np.int64]] = field(default_factory=list)
    pieces: list[npt.NDArray[Any] | list[bytes]] = field(default_factory=list)


def read_mcap(path: Path, wanted: Mapping[str, np.dtype[Any] | None]) -> list[TopicData]:
    """Read the messages of some topics of an MCAP file, and count those of the others.

    Parameters
    ----------
    path : Path
        The file.
    wanted : mapping of str to dtype or None
        Names of the topics to read; with the dtype of one serialized message where its length is fixed.

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
        if path.stat().st_size == 0:
            raise Damaged("the file is empty")
        with path.open("rb") as file:
            data = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
        return list(_File(data, wanted).read().values())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Damaged as error:
        raise InputError(f"{path}: {error}") from None


class _File:
    """One pass through a file."""

    def __init__(self, data: memoryview, wanted: Mapping[str, np.dtype[Any] | None]) -> None:
        self._data = data
        self._wanted = wanted
        self._schemas: dict[int, tuple[str, str, str]] = {}  # type, encoding and text by number
        self._topics: dict[int, TopicData] = {}  # by channel

    def read(self) -> dict[int, TopicData]:
        """Return the topics by channel."""
        data = self._data
        if bytes(data[: len(MAGIC)]) != MAGIC:
            raise Damaged("not an MCAP file")
        end = len(data) - FOOTER_FORM.size
        if end < len(MAGIC) or bytes(data[-len(MAGIC) :]) != MAGIC:
            raise Damaged("the file breaks off before its end: the recording was not completed")
        self._read_data(end)
        self._check_summary(end)
        return self._topics

    def _read_data(self, end: int) -> None:
        """Read all up to the end of the data section; `end` is where the footer begins."""
        data = self._data
        position = len(MAGIC)
        outside: list[int] = []  # places of messages that are in no chunk
        chunk: tuple[int, int] | None = None
        index: list[memoryview] = []  # of that chunk
        while position < end:
            opcode, start, stop = _record(data, position, end)
            if opcode == MESSAGE_INDEX:
                index.append(data[start:stop])
            else:
                if chunk is not None:
                    self._read_chunk(chunk, index)
                    chunk = None
                index = []
                if opcode == CHUNK:
                    chunk = start, stop
                elif opcode == MESSAGE:
                    outside.append(position)
                elif opcode == DATA_END:
                    checksum = _Fields(data, start, stop).number("<I")
                    if checksum and zlib.crc32(data[:position]) != checksum:
                        raise Damaged("damaged: the checksum of the data is wrong")
                    break
                else:
                    self._read_declaration(opcode, data, start, stop)
            position = stop
        if outside:
            places = np.array(outside)
            self._take(data, places, _heads(data, places, "the file"))

    def _read_declaration(self, opcode: int, data: memoryview, start: int, stop: int) -> None:
        """Take note of a schema or channel; other records are passed over."""
        fields = _Fields(data, start, stop)
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

    def _read_chunk(self, chunk: tuple[int, int], index: list[memoryview]) -> None:
        fields = _Fields(self._data, *chunk)
        fields.number("<Q"), fields.number("<Q")  # times, which the messages have too
        size, checksum = fields.number("<Q"), fields.number("<I")
        compression = fields.text()
        where = f"the chunk at byte {chunk[0]}"
        if size > _LIMIT:
            raise Damaged(f"damaged: {where} claims {size} bytes")
        records = _decompress(fields.data(fields.number("<Q")), compression, size, where)
        if len(records) != size:
            raise Damaged(f"damaged: {where} has {len(records)} bytes instead of {size}")
        if checksum and zlib.crc32(records) != checksum:
            raise Damaged(f"damaged: the checksum of {where} is wrong")

        channels, times, places = _index(index, where)
        heads = _heads(records, places, where)
        if not np.array_equal(heads["channel"], channels) or not np.array_equal(heads["log_time"], times):
            raise Damaged(f"damaged: {where} and its index differ")
        others = self._read_gaps(records, places, heads, where)
        if others:
            places = np.sort(np.concatenate([places, np.array(others)]))
            heads = _heads(records, places, where)
        self._take(records, places, heads)

    def _read_gaps(
        self,
        records: memoryview,
        places: npt.NDArray[np.int64],
        heads: npt.NDArray[Any],
        where: str,
    ) -> list[int]:
        """Read what lies between the messages that the index names; return the places of further messages."""
        others: list[int] = []
        begins = np.concatenate([[0], places + RECORD_HEAD.size + heads["length"].astype(np.int64)])
        ends = np.concatenate([places, [len(records)]])
        if np.any(begins > ends):
            raise Damaged(f"damaged: messages overlap in {where}")
        for gap in np.flatnonzero(begins < ends):
            position = int(begins[gap])
            while position < ends[gap]:
                opcode, start, stop = _record(records, position, int(ends[gap]))
                if opcode == MESSAGE:
                    others.append(position)
                else:
                    self._read_declaration(opcode, records, start, stop)
                position = stop
        return others

    def _take(self, records: memoryview, places: npt.NDArray[np.int64], heads: npt.NDArray[Any]) -> None:
        """Give the messages at `places` to their topics."""
        for channel in np.unique(heads["channel"]).tolist():
            topic = self._topics.get(channel)
            if topic is None:
                raise Damaged(f"damaged: a message on channel {channel}, which is not declared")
            mine = heads["channel"] == channel
            topic.count += int(np.count_nonzero(mine))
            if topic.name not in self._wanted:
                continue
            begins = places[mine] + _HEAD
            sizes = heads["length"][mine].astype(np.int64) - MESSAGE_OVERHEAD
            dtype = self._wanted[topic.name]
            topic.times.append(heads["log_time"][mine].astype(np.int64))
            if dtype is not None and np.all(sizes == dtype.itemsize):
                topic.pieces.append(_gather(records, begins, dtype))
            else:
                pairs = zip(begins.tolist(), sizes.tolist(), strict=True)
                topic.pieces.append([records[a : a + n].tobytes() for a, n in pairs])

    def _check_summary(self, end: int) -> None:
        """Compare with the summary, which ends at `end`, what was read."""
        _, length, start, _, checksum, _ = FOOTER_FORM.unpack_from(self._data, end)
        if self._data[end] != FOOTER or length != FOOTER_FORM.size - RECORD_HEAD.size - len(MAGIC):
            raise Damaged("damaged: no footer where it must be")
        if start == 0:
            return
        if not len(MAGIC) <= start <= end:
            raise Damaged(f"damaged: the summary is said to begin at byte {start}")
        if checksum and zlib.crc32(self._data[start : len(self._data) - len(MAGIC) - 4]) != checksum:
            raise Damaged("damaged: the checksum of the summary is wrong")
        position = int(start)
        while position < end:
            opcode, begin, stop = _record(self._data, position, end)
            if opcode == STATISTICS:
                total = _Fields(self._data, begin, stop).number("<Q")
                count = sum(topic.count for topic in self._topics.values())
                if total != count:
                    raise Damaged(f"damaged: {count} messages where the summary counts {total}")
            elif opcode in (SCHEMA, CHANNEL):  # a topic without messages may be declared here only
                self._read_declaration(opcode, self._data, begin, stop)
            position = stop


class _Fields:
    """Reads the fields of a record one after the other."""

    def __init__(self, data: memoryview, start: int, stop: int) -> None:
        self._data = data
        self._position = start
        self._stop = stop

    def data(self, size: int) -> memoryview:
        """Return the next `size` bytes."""
        start = self._position
        if size > self._stop - start:
            raise Damaged(f"damaged: a record at byte {start} ends within a field")
        self._position += size
        return self._data[start : start + size]

    def number(self, form: str) -> int:
        """Return the next number, of a format of `struct`."""
        result: int = struct.unpack(form, self.data(struct.calcsize(form)))[0]
        return result

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
    parts: list[memoryview], where: str
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return channels, times and places from the index records of a chunk, in the order of places."""
    channels, pairs = [np.empty(0, dtype=np.int64)], [np.empty((0, 2), dtype=np.int64)]
    for part in parts:
        fields = _Fields(part, 0, len(part))
        channel, length = fields.number("<H"), fields.number("<I")
        if length % 16:
            raise Damaged(f"damaged: the index of {where}")
        pairs.append(np.frombuffer(fields.data(length), "<i8").reshape(-1, 2))
        channels.append(np.full(length // 16, channel))
    times, places = np.concatenate(pairs).T
    order = np.argsort(places, kind="stable")
    return np.concatenate(channels)[order], times[order], places[order]


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
    # One element at every byte, so that numpy's indexing copies those that are wanted.
    everywhere = np.ndarray((len(records) - size + 1,), dtype=f"V{size}", buffer=records, strides=(1,))
    return everywhere[places].view(dtype)


def _decompress(data: memoryview, compression: str, size: int, where: str) -> memoryview:
    try:
        if compression == "":
            return data
        if compression == "zstd":
            return memoryview(zstandard.ZstdDecompressor().decompress(data, max_output_size=size))
        if compression == "lz4":
            return memoryview(lz4.frame.decompress(data))
    except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
        raise Damaged(f"damaged: {where} cannot be decompressed ({error})") from None
    raise Damaged(f"{where} has the compression {compression!r}, which is not known; known: zstd, lz4")
