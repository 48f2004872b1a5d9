"""Writing of MCAP files: in small chunks that go to the disk at once, or whole columns of messages.

The writer is ours because rosbags' loses 1.7 s when it is killed and writes no checksums (``benchmarks readers``).
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import itertools
import os
import struct
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrowheel_core.arrays import everywhere
from gyrowheel_recording.bags.mcap import (
    MAGIC,
    MESSAGE_HEAD,
    MESSAGE_HEAD_DTYPE,
    MESSAGE_OVERHEAD,
    RECORD_HEAD,
    Op,
    PackedBytes,
    crc32,
)

_AT_ONCE = 1 << 24  # bytes of chunks that are put together at once


@dataclass(frozen=True)
class Block:
    """Messages of one channel and of equal length."""

    channel: int  # channel
    times: npt.NDArray[np.int64]  # (n,): log times [ns], ascending
    #: (n,): one serialized message per element; any dtype whose itemsize is the length of a message.
    messages: npt.NDArray[Any]


class McapWriter:
    """Writes one MCAP file of the profile ``ros2``.

    Parameters
    ----------
    path : Path
        File to create; must not exist.
    chunk_size : int
        Bytes that are collected before they go to the disk as one chunk.
    chunk_span : int, optional
        Span of log times after which a chunk goes to the disk [ns]; no limit if not given.

    Attributes
    ----------
    counts : dict of int to int
        Messages written, by channel.
    start, end : int
        Smallest and largest log time written [ns]; 0 before the first message.
    chunks : int
        Chunks written.

    Notes
    -----
    The file is unbuffered: what has been collected into a chunk survives the end of the process. Every byte
    is covered by a checksum: that of its chunk, of the data section or of the summary. If the disk refuses a chunk,
    the file ends with the chunk before it. The file is locked (`flock`) while it is written.
    """

    def __init__(self, path: Path, *, chunk_size: int, chunk_span: int | None = None) -> None:
        self.counts: dict[int, int] = {}
        self.start = self.end = self.chunks = 0
        self._chunk_size = chunk_size
        self._chunk_span = chunk_span
        self._begun: int | None = None  # log time of the first message of the chunk being collected
        self._crc = 0  # of everything written so far
        self._position = 0
        self._schemas: dict[int, bytes] = {}  # records
        self._numbers: dict[str, int] = {}  # of the schemas, by type name
        self._channels: dict[int, bytes] = {}  # records
        self._chunk_indexes = PackedBytes()  # records, one for each chunk: a run of hours has many
        self._buffer = bytearray()  # records of the chunk being collected
        self._index: dict[int, array[int]] = {}  # log time and place of each message, alternating, by channel
        self._file = path.open("xb", buffering=0)
        with contextlib.suppress(OSError):  # some file systems cannot
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._write(MAGIC + _record(Op.HEADER, _text("ros2"), _text("gyrowheel")))

    def add_channel(self, topic: str, type_name: str, definition: str, metadata: Mapping[str, str]) -> int:
        """Add a topic of CDR messages, with a definition of encoding ``ros2msg``; return the number of its channel."""
        if type_name not in self._numbers:
            number = len(self._schemas) + 1
            record = _record(
                Op.SCHEMA, struct.pack("<H", number), _text(type_name), _text("ros2msg"), _text(definition)
            )
            self._schemas[number], self._numbers[type_name] = record, number
            self._buffer += record
        channel = len(self._channels) + 1
        ids = struct.pack("<HH", channel, self._numbers[type_name])
        record = _record(Op.CHANNEL, ids, _text(topic), _text("cdr"), _map(metadata))
        self._channels[channel] = record
        self._buffer += record
        self.counts[channel] = 0
        return channel

    def adopt(self, schemas: Mapping[int, bytes], channels: Mapping[int, bytes]) -> None:
        """Take over schemas and channels of another file: the contents of their records, by number."""
        self._schemas = {number: _record(Op.SCHEMA, contents) for number, contents in schemas.items()}
        self._channels = {number: _record(Op.CHANNEL, contents) for number, contents in channels.items()}
        self.counts = dict.fromkeys(channels, 0)
        self._write(b"".join([*self._schemas.values(), *self._channels.values()]))

    def append_chunk(self, records: memoryview, index: Mapping[int, npt.NDArray[np.uint64]]) -> None:
        """Write the uncompressed records of a chunk of another file whose schemas and channels were adopted.

        `index` has log time and place of its messages, shape (n, 2), by channel; not empty. Raises OSError if
        the disk refuses it.
        """
        times = [pairs[:, 0] for pairs in index.values()]
        start, end = min(int(part.min()) for part in times), max(int(part.max()) for part in times)
        places = {channel: pairs.astype("<u8").tobytes() for channel, pairs in index.items()}
        self._write_chunk(records, places, start, end)
        for channel, pairs in index.items():
            self.counts[channel] += len(pairs)

    def append(self, channel: int, log_time: int, data: bytes) -> None:
        """Write one message.

        Raises ValueError if the time is negative. Raises OSError if the disk refuses it.
        """
        offset = len(self._buffer)
        try:
            self._buffer += MESSAGE_HEAD.pack(
                Op.MESSAGE, MESSAGE_OVERHEAD + len(data), channel, 0, log_time, log_time
            )
        except struct.error:
            raise ValueError(f"log time {log_time} ns is out of range") from None
        self._buffer += data
        index = self._index.get(channel)
        if index is None:
            index = self._index[channel] = array("Q")
        index.append(log_time)
        index.append(offset)
        if self._begun is None:
            self._begun = log_time
        if len(self._buffer) >= self._chunk_size or (
            self._chunk_span is not None and log_time - self._begun >= self._chunk_span
        ):
            self.flush()

    def append_blocks(self, blocks: Sequence[Block]) -> None:
        """Write whole columns of messages, merged by time (at equal times in the order of the blocks).

        Raises ValueError if a time is negative, or the times of a block do not ascend. Raises OSError if the
        disk refuses it.
        """
        self.flush()
        blocks = [block for block in blocks if len(block.times)]
        if not blocks:
            return
        for block in blocks:
            if block.times[0] < 0 or np.any(np.diff(block.times) < 0):
                raise ValueError("log times must ascend from 0")
        times = np.concatenate([block.times for block in blocks])
        owner = np.repeat(np.arange(len(blocks)), [len(block.times) for block in blocks])
        sizes = np.array([MESSAGE_HEAD.size + block.messages.dtype.itemsize for block in blocks])
        order = np.argsort(times, kind="stable")
        owner = owner[order]
        ends = np.cumsum(sizes[owner])
        offsets = ends - sizes[owner]
        # A chunk ends with the message that makes it reach its size, or with the last one of its span.
        full = np.diff(offsets // self._chunk_size) != 0
        if self._chunk_span is not None:
            ordered = times[order]
            full |= np.diff((ordered - ordered[0]) // self._chunk_span) != 0
        edges = np.concatenate([[0], np.flatnonzero(full) + 1, [len(order)]])
        starts = offsets[edges[:-1]]  # of the chunks
        done = np.zeros(len(blocks), dtype=np.int64)
        # the messages of many chunks are put together at once
        for some in np.split(np.arange(len(starts)), np.flatnonzero(np.diff(starts // _AT_ONCE)) + 1):
            bounds = edges[[*some, some[-1] + 1]]
            first, last = bounds[[0, -1]].tolist()
            buffer = np.empty(ends[last - 1] - offsets[first], dtype=np.uint8)
            pairs, parts = [], []
            for k, block in enumerate(blocks):
                own = first + np.flatnonzero(owner[first:last] == k)
                part = slice(done[k], done[k] + len(own))
                done[k] += len(own)
                _scatter(buffer, offsets[own] - offsets[first], _records(block, part))
                at = np.empty((len(own), 2), dtype="<u8")
                at[:, 0] = block.times[part]
                at[:, 1] = offsets[own] - starts[np.searchsorted(edges, own, side="right") - 1]
                pairs.append(at)
                parts.append(np.searchsorted(own, bounds).tolist())
            for number, (begin, end) in enumerate(itertools.pairwise(bounds.tolist())):
                index: dict[int, bytes] = {}
                for block, at, of in zip(blocks, pairs, parts, strict=True):
                    if own_pairs := at[of[number] : of[number + 1]].tobytes():
                        index[block.channel] = index.get(block.channel, b"") + own_pairs
                        self.counts[block.channel] += of[number + 1] - of[number]
                records = buffer.data[offsets[begin] - offsets[first] : ends[end - 1] - offsets[first]]
                self._write_chunk(records, index, int(times[order[begin]]), int(times[order[end - 1]]))

    def flush(self) -> None:
        """Write the collected messages to the disk."""
        if not self._index:  # at most schemas and channels, which are written with the first message
            return
        times = [entries[::2] for entries in self._index.values()]
        index = {channel: entries.tobytes() for channel, entries in self._index.items()}
        self._write_chunk(self._buffer, index, min(map(min, times)), max(map(max, times)))
        for channel, entries in self._index.items():
            self.counts[channel] += len(entries) // 2
        self.drop()

    def drop(self) -> None:
        """Discard what was collected and not yet written."""
        self._buffer = bytearray()
        self._index = {}
        self._begun = None

    @property
    def size(self) -> int:
        """Bytes of the file so far, collected messages included."""
        return self._position + len(self._buffer)

    @property
    def tail_size(self) -> int:
        """Approximate number of bytes that `finish` adds, without the metadata."""
        records = (*self._schemas.values(), *self._channels.values())
        return self._chunk_indexes.size + sum(map(len, records)) + 1024

    def is_there(self, path: Path) -> bool:
        """Whether the file is still at this path: writing to a deleted file raises no error."""
        try:
            there, here = os.stat(path), os.fstat(self._file.fileno())
        except OSError:
            return False
        return (there.st_dev, there.st_ino) == (here.st_dev, here.st_ino)

    def require_length(self) -> None:
        """Require that the file is as long as what was written: after a cut, writing goes on behind a hole of zeros.

        Raises OSError if it is not.
        """
        found = os.fstat(self._file.fileno()).st_size
        if found != self._position:
            what = "cut it off" if found < self._position else "written into it"
            raise OSError(
                errno.EIO, f"another process has {what} ({self._position} bytes were written, it has {found})"
            )

    def finish(self, metadata: str) -> None:
        """Complete the file with rosbag2's metadata for it (YAML), and close it.

        Raises OSError if the disk refuses it; the file then ends with its last chunk and can be finished
        later.
        """
        self.flush()
        if self._buffer:  # channels without messages
            self._write(self._buffer)
            self.drop()
        metadata_start = self._position
        record = _record(Op.METADATA, _text("rosbag2"), _map({"serialized_metadata": metadata}))
        data_end = _record(Op.DATA_END, struct.pack("<I", crc32(record, self._crc)))
        head = record + data_end

        counts = b"".join(struct.pack("<HQ", channel, count) for channel, count in self.counts.items())
        statistics = struct.pack(
            "<QHIIIIQQI",
            sum(self.counts.values()),
            len(self._schemas),
            len(self._channels),
            0,  # attachments
            1,  # metadata
            self.chunks,
            self.start,
            self.end,
            len(counts),
        )
        metadata_index = struct.pack("<QQ", metadata_start, len(record))
        groups: dict[int, PackedBytes | list[bytes]] = {
            Op.SCHEMA: list(self._schemas.values()),
            Op.CHANNEL: list(self._channels.values()),
            Op.STATISTICS: [_record(Op.STATISTICS, statistics, counts)],
            Op.CHUNK_INDEX: self._chunk_indexes,
            Op.METADATA_INDEX: [_record(Op.METADATA_INDEX, metadata_index, _text("rosbag2"))],
        }
        self._write_all(self._tail(head, groups))
        os.fsync(self._file.fileno())
        self._file.close()

    def _tail(self, head: bytes, groups: Mapping[int, PackedBytes | list[bytes]]) -> Iterator[bytes]:
        """Yield the end of the file piece by piece: `head`, the groups of the summary, and what comes after them."""
        yield head
        summary_start = self._position
        offsets, crc = b"", 0
        for opcode, group in groups.items():
            start = self._position
            for piece in group:
                crc = crc32(piece, crc)
                yield piece
            if length := self._position - start:
                offsets += _record(Op.SUMMARY_OFFSET, struct.pack("<BQQ", opcode, start, length))
        footer = struct.pack("<BQQQ", Op.FOOTER, 20, summary_start, self._position)
        tail = offsets + footer  # the checksum covers the footer up to itself
        yield tail + struct.pack("<I", crc32(tail, crc)) + MAGIC

    def abort(self) -> None:
        """Close the file without an end, so that it does not pass for complete."""
        self._file.close()

    def _write_chunk(
        self, records: bytearray | memoryview, index: Mapping[int, bytes], start: int, end: int
    ) -> None:
        """Write a chunk of records and its index (pairs of log time and place, by channel)."""
        if self._buffer and records is not self._buffer:  # channels added since the last chunk
            self._write(self._buffer)
            self.drop()
        size = len(records)
        head = struct.pack("<QQQI", start, end, size, crc32(records)) + _text("") + struct.pack("<Q", size)
        chunk = RECORD_HEAD.pack(Op.CHUNK, len(head) + size) + head
        indexes = b""
        places = b""
        for channel, entries in index.items():
            place = self._position + len(chunk) + size + len(indexes)
            places += struct.pack("<HQ", channel, place)
            indexes += _record(Op.MESSAGE_INDEX, struct.pack("<HI", channel, len(entries)), entries)
        entry = _record(
            Op.CHUNK_INDEX,
            struct.pack("<QQQQI", start, end, self._position, len(chunk) + size, len(places)),
            places,
            struct.pack("<Q", len(indexes)),
            _text(""),
            struct.pack("<QQ", size, size),
        )
        self._write(b"".join((chunk, records, indexes)))
        self._chunk_indexes.append(entry)
        self.start = start if not self.chunks else min(self.start, start)
        self.chunks += 1
        self.end = max(self.end, end)

    def _write_all(self, pieces: Iterable[bytes]) -> None:
        """Write pieces one after the other, all or none."""
        position, crc = self._position, self._crc
        try:
            for piece in pieces:
                self._write(piece)
        except OSError:
            self._cut(position)
            self._position, self._crc = position, crc
            raise

    def _cut(self, position: int) -> None:
        with contextlib.suppress(OSError):
            self._file.seek(position)
            self._file.truncate()

    def _write(self, data: bytes | bytearray) -> None:
        self.require_length()
        view = memoryview(data)
        try:
            while view:  # an unbuffered file may take less than it is given
                view = view[self._file.write(view) :]
        except OSError:
            self._cut(self._position)  # half a record is useless
            raise
        self._crc = crc32(data, self._crc)
        self._position += len(data)


def _record(opcode: int, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return RECORD_HEAD.pack(opcode, len(body)) + body


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def _map(entries: Mapping[str, str]) -> bytes:
    data = b"".join(_text(key) + _text(value) for key, value in entries.items())
    return struct.pack("<I", len(data)) + data


def _records(block: Block, part: slice) -> npt.NDArray[Any]:
    """Return the message records of a part of a block, one per element."""
    messages = block.messages[part]
    size = messages.dtype.itemsize
    records = np.zeros(len(messages), dtype=[("head", MESSAGE_HEAD_DTYPE), ("data", f"V{size}")])
    head = records["head"]
    head["opcode"] = Op.MESSAGE
    head["length"] = MESSAGE_OVERHEAD + size
    head["channel"] = block.channel
    head["log_time"] = head["publish_time"] = block.times[part]
    records["data"] = np.ascontiguousarray(messages).view(f"V{size}")
    return records


def _scatter(buffer: npt.NDArray[np.uint8], places: npt.NDArray[np.int64], records: npt.NDArray[Any]) -> None:
    """Put records of equal length at places in a buffer."""
    size = records.dtype.itemsize
    # elements overlap, but those at the places of records do not
    everywhere(buffer, np.dtype(f"V{size}"), writeable=True)[places] = records.view(f"V{size}")
