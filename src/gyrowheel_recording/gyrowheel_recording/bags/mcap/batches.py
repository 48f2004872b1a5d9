"""The records of an MCAP file in batches, and the messages of a topic as rows where their layout is the wanted one."""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from gyrowheel_core.arrays import zeros
from gyrowheel_core.files import require_room
from gyrowheel_recording.bags.mcap import (
    MAGIC,
    MESSAGE_HEAD_DTYPE,
    MESSAGE_OVERHEAD,
    RECORD_HEAD,
    Op,
    joined_with,
)
from gyrowheel_recording.bags.mcap.records import (
    CHUNK_HEAD,
    Chunk,
    Damaged,
    Fields,
    Found,
    Indexed,
    find,
    heads_at,
    open_chunk,
    plain_chunks,
)

#: Bytes of a batch, read or unpacked; a chunk that is larger is a batch of its own.
SIZE: Final = 1 << 22


class Buffer:
    """Memory that is read into again and again: fresh memory costs more than reading."""

    def __init__(self) -> None:
        self._data = memoryview(b"")

    def room(self, size: int) -> memoryview:
        """Return at least so many bytes, beginning with those that were there."""
        if size > len(self._data):
            data = np.empty(size, np.uint8).data
            data[: len(self._data)] = self._data
            self._data = data
        return self._data


@dataclass
class Batch:
    """Whole records that follow one another in a file; each chunk with all of its index."""

    number: int  # of the batch
    place: int  # where it begins in the file
    #: Its bytes, up to the end of the data where that is in it.
    data: memoryview = field(default_factory=lambda: memoryview(b""))
    #: Begin and end of the contents of every chunk.
    chunks: list[tuple[int, int]] = field(default_factory=list)
    #: Chunk, begin and length of the contents of every index record.
    index: list[tuple[int, int, int]] = field(default_factory=list)
    #: Opcode, begin and end of the contents of every other record.
    others: list[tuple[int, int, int]] = field(default_factory=list)
    #: Of the data up to its end, as the file states it, 0 if it does not; None if the end is not in this batch.
    checksum: int | None = None


class Batches:
    """The data section of the file `name`, batch by batch, up to its footer at `end`."""

    def __init__(self, descriptor: int, end: int, name: str) -> None:
        self._descriptor = descriptor
        self._name = name
        self._end = end
        self._ended = False
        #: Of the next batch.
        self.number = 0
        #: Where the next batch begins; after the last one, the summary.
        self.position = len(MAGIC)

    def next(self, buffer: Buffer) -> Batch | None:
        """Read the next batch; return None behind the end of the data.

        Raises Damaged if the file has no record where one must be, or has become shorter. Raises InputError
        if a record claims more memory than is allowed.
        """
        if self._ended:
            return None
        place, left = self.position, self._end - self.position
        size = min(SIZE, left)
        data = buffer.room(size)
        self._read(data[:size], place)
        batch = Batch(self.number, place)
        chunks, index = batch.chunks, batch.index
        unpack, head = RECORD_HEAD.unpack_from, RECORD_HEAD.size
        owner = -1  # the chunk that an index record is of
        at = 0
        whole = 0  # up to where the records are read, and chunks have all of their index
        unpacked = 0
        while True:
            begin = stop = at + head
            opcode = 0
            if begin <= size:
                opcode, length = unpack(data, at)
                stop += length
                if opcode == 0:
                    raise Damaged(f"damaged: no record at byte {place + at}")
                if opcode != Op.MESSAGE_INDEX:
                    whole = at
                    if unpacked > SIZE:
                        break
            if stop > size:
                if whole:
                    break  # the next batch begins with it
                if stop > left:
                    raise Damaged(
                        "damaged: the data have no end where they must have"
                        if at == left
                        else f"damaged: the record at byte {place + at} is cut off"
                    )
                before, size = size, min(max(stop, 2 * size), left)
                require_room(size, f"{self._name}: what belongs together at byte {place + whole}")
                data = buffer.room(size)
                self._read(data[before:size], place + before)
                continue
            if opcode == Op.MESSAGE_INDEX:
                if owner >= 0:
                    index.append((owner, begin, length))
            elif opcode == Op.CHUNK:
                owner = len(chunks)
                chunks.append((begin, stop))
                if length >= CHUNK_HEAD.size:
                    unpacked += CHUNK_HEAD.unpack_from(data, begin)[2]
            elif opcode == Op.DATA_END:
                batch.checksum = Fields(data[begin:stop]).number("<I")
                self._ended = True
                break
            else:
                owner = -1
                batch.others.append((opcode, begin, stop))
                whole = stop
            at = stop
        if chunks and chunks[-1][0] > whole:  # its index goes on
            chunks.pop()
            while index and index[-1][0] == len(chunks):
                index.pop()
        batch.data = data[:whole]
        self.position = place + (stop if self._ended else whole)
        self.number += 1
        return batch

    def _read(self, part: memoryview, place: int) -> None:
        """Read a part of the file, whose length was asked for when it was opened."""
        if filled(self._descriptor, part, place) < len(part):
            raise Damaged("the file has become shorter while it was read")


def filled(descriptor: int, part: memoryview, place: int) -> int:
    """Read from a place of a file; return how many bytes it gave, fewer only where it ends."""
    count = 0
    while count < len(part) and (read := os.preadv(descriptor, [part[count:]], place + count)):
        count += read
    return count


@dataclass(frozen=True)
class Share:
    """Messages of one channel."""

    channel: int
    records: memoryview  # holds them
    #: Shape (n,): begins and lengths of their contents there.
    begins: npt.NDArray[np.int64]
    sizes: npt.NDArray[np.int64]
    times: npt.NDArray[np.uint64]  # log times of the messages of all channels [ns]
    own: npt.NDArray[np.int64]  # (n,): which of them are theirs
    checked: bool | None  # whether a checksum covers them; None if that of the whole data would


@dataclass(frozen=True)
class Contents:
    """Contents of a batch."""

    declarations: list[tuple[int, memoryview]]  # opcode and contents of the schemas and channels
    shares: list[Share]
    checksum: int  # of the bytes of the batch


def contents(batch: Batch, *, compiled: bool = False) -> Contents:
    """Return the contents of a batch; `compiled` as for `find`.

    Raises
    ------
    Damaged
        If something contradicts what the file states of it.
    """
    data = batch.data
    declarations = [(opcode, data[a:b]) for opcode, a, b in batch.others if opcode in (Op.SCHEMA, Op.CHANNEL)]
    places = [begin - RECORD_HEAD.size for opcode, begin, _ in batch.others if opcode == Op.MESSAGE]
    shares: list[Share] = []
    if places:
        at = np.array(places)
        shares += _shares(Found(data, at, heads_at(data, at, "the file"), []), None)
    plain = plain_chunks(data, np.array(batch.chunks)) if batch.chunks else None
    for found, checked in _found(batch, None if plain is None else plain[0], compiled):
        declarations += found.others
        shares += _shares(found, checked)
    known = () if plain is None else zip(*plain[0].T.tolist(), plain[1], strict=True)
    return Contents(declarations, shares, joined_with(data, known))


def _found(batch: Batch, plain: npt.NDArray[np.int64] | None, compiled: bool) -> Iterator[tuple[Found, bool]]:
    """Yield the contents of the chunks, at once where all of them are `plain`, and whether checksums cover them."""
    if not batch.chunks:
        return
    index = np.array(batch.index, dtype=np.int64).reshape(-1, 3)
    if plain is not None:
        with contextlib.suppress(Damaged):  # reading them one by one shows which of them it is
            found = find(Indexed(batch.data, plain, batch.data, index), "", compiled=compiled)
            yield found, True
            return
    opened = [open_chunk(batch.data[a:b], _name(batch, a)) for a, b in batch.chunks]
    for checked, group in itertools.groupby(range(len(opened)), key=lambda k: opened[k].checked):
        for found in _together(batch, opened, list(group), index, compiled):
            yield found, checked


def _together(
    batch: Batch, opened: Sequence[Chunk], group: Sequence[int], index: npt.NDArray[np.int64], compiled: bool
) -> Iterator[Found]:
    """Yield the contents of consecutive chunks: small chunks are faster together than one by one."""
    parts = [opened[k].records for k in group]
    records = parts[0] if len(parts) == 1 else memoryview(b"".join(parts))
    sizes = np.array([len(part) for part in parts], dtype=np.int64)
    stops = np.cumsum(sizes)
    spans = np.stack([stops - sizes, stops], axis=1)
    own = index[(index[:, 0] >= group[0]) & (index[:, 0] <= group[-1])] - np.array([group[0], 0, 0])
    where = _name(batch, batch.chunks[group[0]][0]) if len(group) == 1 else ""
    try:
        found = find(Indexed(records, spans, batch.data, own), where, compiled=compiled)
    except Damaged:
        if len(group) == 1:
            raise
    else:
        yield found
        return
    for k in group:
        yield from _together(batch, opened, [k], index, compiled)


def _name(batch: Batch, begin: int) -> str:
    return f"the chunk at byte {batch.place + begin - RECORD_HEAD.size}"


def _shares(found: Found, checked: bool | None) -> Iterator[Share]:
    """Yield the messages by their channels."""
    channels = np.ascontiguousarray(found.heads["channel"])
    lengths = found.heads["length"].astype(np.int64) - MESSAGE_OVERHEAD
    begins = found.places + MESSAGE_HEAD_DTYPE.itemsize
    for channel in np.flatnonzero(np.bincount(channels)).tolist():
        own = np.flatnonzero(channels == channel)
        yield Share(channel, found.records, begins[own], lengths[own], found.heads["log_time"], own, checked)


_BLOCK: Final = 48 << 20  # bytes of rows that are laid out at a time where their number is not known

Rows: TypeAlias = npt.NDArray[Any]


@dataclass(frozen=True)
class Want:
    """How to make rows of the messages of a topic."""

    dtype: np.dtype[Any]  # of one serialized message; its itemsize is the required length of a message
    row: np.dtype[Any]
    #: Whether rows can be made of the messages of a topic, by what is declared of it.
    fits: Callable[[TopicData], bool]
    #: Writes such messages into as many rows; returns False if they are not as declared. Arguments: the memory that
    #: holds them, where they begin in it, the rows, and whether to do it by a compiled loop.
    take: Callable[[memoryview, npt.NDArray[np.int64], Rows, bool], bool]


#: Topics to read, by name; None: as serialized messages.
Wanted: TypeAlias = Mapping[str, Want | None]


@dataclass
class TopicData:
    """The messages of one topic."""

    name: str
    type_name: str
    message_encoding: str = "cdr"  # serialization format, ``cdr`` in ROS 2
    #: Definition of the type and its encoding, ``ros2msg`` or ``ros2idl``; empty if the file has no definition.
    definition_encoding: str = ""
    definition: str = ""
    count: int = 0
    unchecked: int = 0  # messages that no checksum covers
    #: Log times [ns] in the order of the file; only of topics that were requested as serialized messages.
    times: list[npt.NDArray[np.int64]] = field(default_factory=list)
    #: The messages in the order of the file: as rows where possible, else serialized.
    pieces: list[Rows | list[bytes]] = field(default_factory=list)
    expected: int = 0  # how many messages the file states, at most its bytes; nothing relies on it
    _fits: bool | None = None
    _block: Rows | None = None
    _used: int = 0  # rows of it

    def fits(self, want: Want) -> bool:
        """Whether its messages are declared to be the wanted ones."""
        if self._fits is None:
            self._fits = want.fits(self)
        return self._fits

    def add(self, want: Want | None, messages: list[bytes]) -> None:
        """Append messages, as rows where possible."""
        self.pieces.append(self.made(want, messages))

    def made(self, want: Want | None, messages: list[bytes]) -> Rows | list[bytes]:
        """Return messages as rows where possible."""
        if (
            want is None
            or not self.fits(want)
            or any(len(message) != want.dtype.itemsize for message in messages)
        ):
            return messages
        rows = np.zeros(len(messages), want.row)
        begins = np.arange(len(messages)) * want.dtype.itemsize
        return rows if want.take(memoryview(b"".join(messages)), begins, rows, False) else messages

    def reserve(self, want: Want, count: int) -> Rows:
        """Append rows of zeros that are to be written; those of a topic follow one another in memory, if they can."""
        if self._block is None or self._used + count > len(self._block):
            self._block, self._used = self._new_block(want.row, count), 0
        rows = self._block[self._used : self._used + count]
        self._used += count
        self.pieces.append(rows)
        return rows

    def _new_block(self, row: np.dtype[Any], count: int) -> Rows:
        if self._block is None:
            try:
                return zeros(max(self.expected, count), row)
            except MemoryError:
                pass
        return np.zeros(max(_BLOCK // row.itemsize, count), row)


def joined(pieces: list[Rows]) -> Rows | None:
    """Return rows that follow one another in memory as one array; None if they do not."""
    if len(pieces) == 1:
        return pieces[0]
    block = pieces[0].base
    if not isinstance(block, np.ndarray) or any(piece.base is not block for piece in pieces):
        return None
    places = [piece.ctypes.data for piece in pieces]
    if any(b - a != piece.nbytes for a, b, piece in zip(places, places[1:], pieces, strict=False)):
        return None
    first = (places[0] - block.ctypes.data) // block.itemsize
    result: Rows = block[first : first + sum(map(len, pieces))]
    return result
