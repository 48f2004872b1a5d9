"""The records of an MCAP file in batches: what is read of the file at a time, and where its chunks are in it."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from gyrowheel_core.limits import require_room
from gyrowheel_recording.bags.mcap.format import CHUNK, DATA_END, MAGIC, MESSAGE_INDEX, RECORD_HEAD
from gyrowheel_recording.bags.mcap.records import CHUNK_HEAD, Damaged, Fields

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
    """Whole records that follow one another in a file; each chunk with all of its index.

    Attributes
    ----------
    number : int
        Of the batch.
    place : int
        Where it begins in the file.
    data : memoryview
        Its bytes, up to the end of the data where that is in it.
    chunks : list of (int, int)
        Begin and end of the contents of every chunk.
    index : list of (int, int, int)
        Chunk, begin and length of the contents of every index record.
    others : list of (int, int, int)
        Opcode, begin and end of the contents of every other record.
    checksum : int or None
        Of the data up to its end, as the file states it, 0 if it does not; None if the end is not in this batch.
    """

    number: int
    place: int
    data: memoryview = field(default_factory=lambda: memoryview(b""))
    chunks: list[tuple[int, int]] = field(default_factory=list)
    index: list[tuple[int, int, int]] = field(default_factory=list)
    others: list[tuple[int, int, int]] = field(default_factory=list)
    checksum: int | None = None


class Batches:
    """The data section of a file, batch by batch.

    Parameters
    ----------
    descriptor : int
        Of the file.
    end : int
        Where its footer begins.
    name : str
        What the file is called, for an error.
    """

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

        Raises
        ------
        Damaged
            If the file has no record where one must be, or has become shorter.
        InputError
            If a record claims more memory than is allowed.
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
                if opcode != MESSAGE_INDEX:
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
            if opcode == MESSAGE_INDEX:
                if owner >= 0:
                    index.append((owner, begin, length))
            elif opcode == CHUNK:
                owner = len(chunks)
                chunks.append((begin, stop))
                if length >= CHUNK_HEAD.size:
                    unpacked += CHUNK_HEAD.unpack_from(data, begin)[2]
            elif opcode == DATA_END:
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
