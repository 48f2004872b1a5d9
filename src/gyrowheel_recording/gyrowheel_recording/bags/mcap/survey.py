"""Survey of a broken MCAP file: which parts are intact. Examines every record, and every chunk by its checksum."""

from __future__ import annotations

import contextlib
import os
import re
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import BinaryIO, Final

import numpy as np

from gyrowheel_core.files import require_room
from gyrowheel_core.wire import SECOND
from gyrowheel_recording.bags.mcap import FOOTER_FORM, MAGIC, MESSAGE_OVERHEAD, RECORD_HEAD, Op, crc32
from gyrowheel_recording.bags.mcap.records import (
    LARGEST,
    Chunk,
    Damaged,
    Fields,
    Found,
    find_messages,
    open_chunk,
)

_WINDOW: Final = 1 << 22  # bytes searched at a time
_LONGEST: Final = 2 * LARGEST  # bytes of a record; a larger number counts as damage
#: Bytes that are examined where the next chunk is searched: as many times those of the file, and how many at least.
_SEARCHED: Final = 100
_SEARCHED_AT_LEAST: Final = 1 << 28
LOOSE: Final = 1 << 16  # bytes of loose messages that become one chunk
# the begin of a chunk; found with a look-ahead, so that a false match hides no real chunk
_CHUNK: Final = re.compile(
    rb"\x06(?=(?P<length>.{8}).{16}(?P<size>.{8}).{4}"
    rb"(?:(?P<plain>\x00{4})|\x04\x00{3}zstd|\x03\x00{3}lz4)(?P<stored>.{8}))",
    re.DOTALL,
)


@dataclass
class Gap:
    """A lost stretch of the file; times are log times [ns]."""

    reason: str
    byte: int
    size: int
    messages: int | None = None
    start: int | None = None
    end: int | None = None


@dataclass
class Piece:
    """Intact records: a chunk, or messages outside of chunks."""

    byte: int
    size: int  # bytes, head included
    index: list[bytes] | None  # contents of its index records; None: messages outside of chunks


@dataclass
class Survey:
    """What the first pass finds in a file."""

    name: str
    pieces: list[Piece] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    sure: dict[tuple[int, int], bytes] = field(default_factory=dict)  # covered by a checksum
    unsure: dict[tuple[int, int], bytes] = field(default_factory=dict)  # by opcode and number
    ended: bool = False
    data_checked: bool = False
    count: int | None = None  # of messages, stated by the summary
    end: int | None = None  # largest log time, stated by the summary [ns]
    declared_size: int = 0  # bytes of what declares topics

    def declare(self, opcode: int, contents: memoryview, *, sure: bool) -> None:
        """Note a schema or a channel."""
        if opcode in (Op.SCHEMA, Op.CHANNEL) and len(contents) >= 2:
            (number,) = struct.unpack_from("<H", contents)
            kept = self.sure if sure else self.unsure
            if (opcode, number) not in kept:
                self.declared_size += len(contents)
                require_room(self.declared_size, f"{self.name}: what declares its topics")
                kept[opcode, number] = bytes(contents)

    @property
    def declared(self) -> dict[tuple[int, int], bytes]:
        """Schemas and channels; those covered by a checksum take precedence."""
        return self.unsure | self.sure


def take_survey(stream: BinaryIO, name: str, progress: Callable[[float], None]) -> Survey:
    """Survey a file in any state; `progress` is called with the fraction done.

    Raises InputError if a part of it claims more memory than is allowed; it names `name`.
    """
    return _Walk(stream, name, progress).run()


def load_piece(stream: BinaryIO, piece: Piece) -> tuple[memoryview, Found, bool]:
    """Read a piece again; return its records, the messages in them, and whether a checksum covers it."""
    stream.seek(piece.byte)
    data = stream.read(piece.size)
    where = f"byte {piece.byte}"
    if piece.index is None:
        records = memoryview(data)
        return records, find_messages([(records, [])], where), False
    chunk, found, checked, _ = _examine(data[RECORD_HEAD.size :], piece.index, where)
    return chunk.records, found, checked


class _Walk:
    """The first pass through a file."""

    def __init__(self, stream: BinaryIO, name: str, progress: Callable[[float], None]) -> None:
        self._stream = stream
        self._name = name
        self._progress = progress
        self._size = stream.seek(0, os.SEEK_END)
        self._survey = Survey(name)
        self._to_examine = _SEARCHED * self._size + _SEARCHED_AT_LEAST
        self._crc = 0
        self._steady = True  # no damage so far: the checksum of the data can still match
        # place, length and contents of the chunk whose index is being read
        self._chunk: tuple[int, int, bytes] | None = None
        self._index: list[bytes] = []
        self._orphans: list[tuple[int, bytes]] = []  # index records without their chunk

    def run(self) -> Survey:
        """Return the survey of the file."""
        survey = self._survey
        at: int | None = len(MAGIC)
        if self._read(0, len(MAGIC)) != MAGIC:
            survey.notes.append("does not begin as an MCAP file does")
            self._steady = False
            at = self._next_chunk(0)
        else:
            self._crc = crc32(MAGIC)
        while at is not None and at < self._size:
            at = self._step(at)
            self._progress((at or self._size) / self._size)
        self._close_chunk()
        self._close_orphans()
        return survey

    def _read(self, position: int, length: int) -> bytes:
        require_room(min(length, self._size - position), f"{self._name}: what is at byte {position}")
        self._stream.seek(position)
        return self._stream.read(length)

    def _step(self, position: int) -> int | None:
        """Examine the record at `position`; return the place of the next one, or None at the end."""
        head = self._read(position, RECORD_HEAD.size)
        opcode, length = RECORD_HEAD.unpack(head) if len(head) == RECORD_HEAD.size else (0, 0)
        stop = position + RECORD_HEAD.size + length
        if (
            not (Op.HEADER <= opcode <= Op.DATA_END and opcode != Op.FOOTER)
            or stop > self._size
            or length > _LONGEST
        ):
            return self._lose(position, opcode, length)
        body = self._read(position + RECORD_HEAD.size, length)
        if opcode == Op.MESSAGE_INDEX:
            if self._chunk is None:
                self._orphans.append((position, body))
            else:
                self._index.append(body)
        else:
            self._close_chunk()
            self._close_orphans()
            if opcode == Op.CHUNK:
                self._chunk = position, stop - position, body
            elif opcode == Op.MESSAGE:
                if length < MESSAGE_OVERHEAD:
                    return self._lose(position, opcode, length)
                self._loose(position, stop)
            elif opcode == Op.DATA_END:
                return self._finish(stop, body)
            elif opcode in (Op.SCHEMA, Op.CHANNEL):
                self._survey.declare(opcode, memoryview(body), sure=False)
        self._crc = crc32(body, crc32(head, self._crc))
        return stop

    def _loose(self, position: int, stop: int) -> None:
        pieces = self._survey.pieces
        last = pieces[-1] if pieces else None
        if (
            last is not None
            and last.index is None
            and last.byte + last.size == position
            and last.size < LOOSE
        ):
            last.size += stop - position
        else:
            pieces.append(Piece(position, stop - position, None))

    def _close_chunk(self) -> None:
        """Check the current chunk, whose index is complete now."""
        if self._chunk is None:
            return
        (position, size, body), self._chunk = self._chunk, None
        index, self._index = self._index, []
        survey = self._survey
        try:
            _, found, checked, note = _examine(body, index, f"the chunk at byte {position}")
            if note:
                survey.notes.append(note)
                index = []
            for opcode, contents in found.others:
                survey.declare(opcode, contents, sure=checked)
            survey.pieces.append(Piece(position, size, index))
        except Damaged as error:
            self._steady = False
            start, end = _times(body)
            survey.gaps.append(Gap(_reason(error, position), position, size, _indexed(index), start, end))
            for opcode, contents in _declarations(body):
                survey.declare(opcode, contents, sure=False)

    def _close_orphans(self) -> None:
        """Note an index that follows no chunk: its chunk is gone."""
        if not self._orphans:
            return
        orphans, self._orphans = self._orphans, []
        start, end = _indexed_times([body for _, body in orphans])
        self._steady = False
        last = self._survey.gaps[-1] if self._survey.gaps else None
        count = _indexed([body for _, body in orphans])
        if last is not None and last.messages is None and last.byte + last.size >= orphans[0][0]:
            last.messages, last.start, last.end = (
                count,
                start,
                end,
            )  # the chunk that was skipped just before
            return
        self._survey.gaps.append(Gap("an index without its chunk", orphans[0][0], 0, count, start, end))

    def _lose(self, position: int, opcode: int, length: int) -> int | None:
        """Go to the next intact chunk; the bytes before it are lost."""
        self._close_chunk()
        self._close_orphans()
        self._steady = False
        following = self._next_chunk(position + 1)
        rest = (self._size if following is None else following) - position
        start = end = None
        if opcode == Op.CHUNK:
            start, end = _times(self._read(position + RECORD_HEAD.size, 16))
        if following is not None:
            self._survey.gaps.append(Gap("unreadable bytes", position, rest, None, start, end))
        elif opcode in (Op.MESSAGE_INDEX, Op.METADATA) and rest > RECORD_HEAD.size and length > rest:
            pass  # cut off within a part that can be rebuilt
        elif Op.HEADER <= opcode <= Op.DATA_END and length > rest:
            reason = f"a {'chunk' if opcode == Op.CHUNK else 'record'} that is cut off"
            self._survey.gaps.append(Gap(reason, position, rest, None, start, end))
        else:
            self._survey.gaps.append(Gap("unreadable bytes", position, rest))
        return following

    def _next_chunk(self, position: int) -> int | None:
        """Return the place of the next chunk with a matching checksum, or None."""
        overlap = 128
        while position < self._size:
            window = self._read(position, _WINDOW + overlap)
            for match in _CHUNK.finditer(window):
                if match.start() >= _WINDOW:
                    break
                place = position + match.start()
                length, size, stored = (
                    int.from_bytes(match[name], "little") for name in ("length", "size", "stored")
                )
                head = match.end("stored") - match.start() - RECORD_HEAD.size
                if length != head + stored or (match["plain"] is not None and size != stored):
                    continue
                if place + RECORD_HEAD.size + length > self._size:
                    continue
                if size > LARGEST:
                    continue
                self._to_examine -= length + size
                if self._to_examine < 0:  # only in a file that was made for it
                    self._survey.notes.append("too much of it only looks like chunks: not read to its end")
                    return None
                body = self._read(place + RECORD_HEAD.size, length)
                with contextlib.suppress(Damaged):
                    _examine(body, [], "")
                    return place
            position += _WINDOW
        return None

    def _finish(self, position: int, body: bytes) -> int | None:
        """Read the end of the file, after the data section."""
        survey = self._survey
        checksum = int.from_bytes(body[:4], "little") if len(body) == 4 else 0
        if self._steady and checksum:
            survey.data_checked = self._crc == checksum
            if not survey.data_checked and not survey.gaps:
                survey.notes.append("the checksum of its data is wrong, though every chunk is right")
        tail = self._read(position, self._size - position)
        if len(tail) < FOOTER_FORM.size or not tail.endswith(MAGIC):
            survey.notes.append("its summary is cut off")
            return None
        opcode, _, start, _, checksum, _ = FOOTER_FORM.unpack(tail[-FOOTER_FORM.size :])
        right = not checksum or crc32(tail[: -len(MAGIC) - 4]) == checksum
        survey.ended = True
        if opcode != Op.FOOTER or not right:
            survey.notes.append("the checksum of its summary is wrong")
            return None
        # where bytes are missing, the summary begins elsewhere than stated, but its checksum proves it right
        if start:
            with contextlib.suppress(Damaged, struct.error):
                self._read_summary(memoryview(tail)[: -FOOTER_FORM.size], sure=checksum != 0)
        return None

    def _read_summary(self, summary: memoryview, *, sure: bool) -> None:
        position = 0
        while position < len(summary):
            opcode, length = RECORD_HEAD.unpack_from(summary, position)
            contents = summary[position + RECORD_HEAD.size :][:length]
            if opcode == Op.STATISTICS:
                fields = Fields(contents)
                self._survey.count = fields.number("<Q")
                fields.data(2 + 4 * 4 + 8)
                self._survey.end = fields.number("<Q")
            elif opcode == Op.SUMMARY_OFFSET:
                return
            else:
                self._survey.declare(opcode, contents, sure=sure)
            position += RECORD_HEAD.size + length


def _examine(body: bytes, index: Sequence[bytes], where: str) -> tuple[Chunk, Found, bool, str]:
    """Open a chunk and find its messages; return also whether a checksum covers it, and a note.

    Raises Damaged if the chunk is damaged.
    """
    try:
        chunk = open_chunk(memoryview(body), where)
    except (MemoryError, struct.error) as error:
        raise Damaged(f"damaged: {where} ({error})") from None
    try:
        return chunk, find_messages([(chunk.records, index)], where), chunk.checked, ""
    except Damaged:
        if not chunk.checked:
            raise
    # the chunk is right, so the index is wrong
    return (
        chunk,
        find_messages([(chunk.records, [])], where),
        chunk.checked,
        f"the index of {where} was wrong",
    )


def _declarations(body: bytes) -> Iterator[tuple[int, memoryview]]:
    """Yield the schemas and channels at the start of a chunk that is damaged further on."""
    fields = Fields(memoryview(body))
    with contextlib.suppress(Damaged, struct.error):
        fields.data(8 + 8 + 8 + 4)
        if fields.text():
            return
        records = fields.data(min(fields.number("<Q"), fields.left))
        position = 0
        while position + RECORD_HEAD.size <= len(records):
            opcode, length = RECORD_HEAD.unpack_from(records, position)
            if opcode not in (Op.SCHEMA, Op.CHANNEL):
                return
            yield opcode, records[position + RECORD_HEAD.size :][:length]
            position += RECORD_HEAD.size + length


def _indexed(index: Sequence[bytes]) -> int | None:
    """Return the number of messages in an index; None if there is no valid index."""
    sizes = [int.from_bytes(part[2:6], "little") for part in index]
    right = all(size == len(part) - 6 and size % 16 == 0 for size, part in zip(sizes, index, strict=True))
    return sum(sizes) // 16 if index and right else None


def _indexed_times(index: Sequence[bytes]) -> tuple[int | None, int | None]:
    if _indexed(index):
        times = np.concatenate([np.frombuffer(part[6:], "<u8")[::2] for part in index])
        if len(times) and int(times.max()) < 1 << 63:
            return int(times.min()), int(times.max())
    return None, None


def _times(body: bytes) -> tuple[int | None, int | None]:
    """Return the times that a chunk states, if they are plausible."""
    if len(body) < 16:
        return None, None
    start, end = struct.unpack_from("<QQ", body)
    return (start, end) if start <= end < min(start + 3600 * SECOND, 1 << 63) else (None, None)


def _reason(error: Damaged, position: int) -> str:
    text = str(error).removeprefix("damaged: ")
    return text.replace(f"the chunk at byte {position}", "a chunk")
