"""Reading of MCAP files by whole chunks: fixed-layout messages go to numpy arrays without a loop over them.

Every length, offset and number in a file is checked before it is used, and so is every checksum that the file
has: a damaged file is either refused or read exactly. No more than one batch of chunks for each thread is in memory
besides the result, and the bytes that are used are those that were checked: the file is read once, and may change.

The reader is ours because rosbags' raw bytes with numpy.frombuffer take several times as long (``benchmarks
readers``).
"""

from __future__ import annotations

import os
import struct
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Final

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import require_room
from gyrowheel_recording.bags.mcap import FOOTER_FORM, MAGIC, RECORD_HEAD, Op, crc32, joined
from gyrowheel_recording.bags.mcap.batches import (
    SIZE,
    Batch,
    Batches,
    Buffer,
    Contents,
    Rows,
    Share,
    TopicData,
    Want,
    Wanted,
    contents,
    filled,
)
from gyrowheel_recording.bags.mcap.records import Broken, Damaged, Fields, record_at

_OBJECT: Final = 40  # bytes of overhead of a message
_MOST_THREADS: Final = 4  # more would wait for one another
#: Bytes of a file from which on compiled loops are worth being loaded, and where numba was loaded for something else.
_LARGE: Final = 1 << 30
_LARGE_WITH_NUMBA: Final = 1 << 28
_MOST_OFFSETS: Final = 1 << 16  # bytes of the end of a summary
_STATISTICS_HEAD: Final = 42  # bytes before the numbers of messages
_COUNT: Final = struct.Struct("<HQ")  # channel and number of messages


def read_mcap(
    path: Path,
    wanted: Wanted,
    unpack: Callable[[bytes], bytes] | None = None,
    threads: int | None = None,
    compiled: bool | None = None,
) -> list[TopicData]:
    """Read the messages of some topics of an MCAP file, and count those of the others; one result for each channel.

    `path`: the file; `wanted`: names of the topics to read, and how; `unpack`: decompresses one message,
    where each is compressed on its own; raises `Damaged`. `threads`, `compiled`: number of threads, each with
    memory for a batch, and whether to use compiled loops; by the size of the file if not given. The result
    does not depend on them. Raises InputError if the file cannot be read, is incomplete or damaged.
    """
    try:
        if path.exists() and not path.is_file():  # a pipe would be waited for
            raise InputError(f"{path}: is no file")
        with path.open("rb", buffering=0) as file:
            size = os.fstat(file.fileno()).st_size
            if size == 0:
                raise Damaged("the file is empty")
            own = _File(file, size, wanted, unpack, worth_compiled(size) if compiled is None else compiled)
            return list(own.read(_threads(size) if threads is None else threads).values())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Damaged as error:
        raise Broken(f"{path}: {error}") from None


def worth_compiled(size: int) -> bool:
    """Whether compiled loops are worth it for a file."""
    return size >= (_LARGE_WITH_NUMBA if "numba" in sys.modules else _LARGE)


def _threads(size: int) -> int:
    """Return how many threads are worth it for a file."""
    return max(1, min(_MOST_THREADS, len(os.sched_getaffinity(0)), size // (2 * SIZE)))


class _File:
    """One pass through a file, in which several threads take its batches by turns."""

    def __init__(
        self, file: FileIO, size: int, wanted: Wanted, unpack: Callable[[bytes], bytes] | None, compiled: bool
    ) -> None:
        self._unpack = unpack
        self._compiled = compiled
        self._file = file
        self._size = size
        self._wanted = wanted
        self._schemas: dict[int, tuple[str, str, str]] = {}  # type, encoding and text by number
        self._topics: dict[int, TopicData] = {}  # by channel
        self._stated: dict[int, int] = {}  # number of messages by channel, as the summary has it
        self._kept = 0  # bytes of the messages that were asked for, and of what declares topics
        self._outside: list[tuple[TopicData, int]] = []  # how many messages were in no chunk
        self._crc = 0  # of the data so far
        self._batches = Batches(file.fileno(), size - FOOTER_FORM.size, str(file.name))
        self._reading = threading.Lock()
        self._turn = threading.Condition()
        self._settled = 0  # batches
        self._errors: list[tuple[int, BaseException]] = []  # with the batch

    def read(self, threads: int) -> dict[int, TopicData]:
        """Return the topics by channel."""
        begin = self._part(0, min(len(MAGIC), self._size))
        if begin != MAGIC:
            raise Damaged("not an MCAP file")
        end = self._size - FOOTER_FORM.size
        tail = self._part(end, FOOTER_FORM.size) if end >= len(MAGIC) else b""
        if len(tail) < FOOTER_FORM.size or not tail.endswith(MAGIC):
            raise Damaged("the file breaks off before its end: the recording was not completed")
        self._stated = _stated(self._part, tail, self._size)
        self._crc = crc32(begin)
        others = [threading.Thread(target=self._work, daemon=True) for _ in range(threads - 1)]
        for other in others:
            other.start()
        try:
            self._work()
            for other in others:
                other.join()
        except BaseException as error:  # an interrupt: the file is closed when no thread reads it any more
            self._fail(-1, error)
            for other in others:
                other.join()
        if self._errors:
            raise min(self._errors, key=lambda item: item[0])[1]
        self._check_summary(tail)
        return self._topics

    def _part(self, place: int, size: int) -> bytes:
        """Return a part of the file; less only where the file ends."""
        data = bytearray(size)
        return bytes(data[: filled(self._file.fileno(), memoryview(data), place)])

    def _work(self) -> None:
        """Take batches until the end of the file.

        What a batch holds is found in any order, and settled in that of the file: so the result, and the error that
        is told of a file with several, do not depend on the threads.
        """
        buffer, number = Buffer(), 0
        try:
            while True:
                with self._reading:
                    if self._errors:
                        return
                    number = self._batches.number
                    batch = self._batches.next(buffer)
                if batch is None:
                    return
                found = contents(batch, compiled=self._compiled)
                with self._turn:
                    if not self._comes(number):
                        return
                    jobs = self._settle(batch, found)
                    self._settled += 1
                    self._turn.notify_all()
                for job in jobs:
                    job.do(None if self._unpack is None else self._plain, self._compiled)
        except BaseException as error:
            self._fail(number if isinstance(error, Exception) else -1, error)

    def _plain(self, message: bytes) -> bytes:
        """Decompress a message; what it has grown to counts."""
        assert self._unpack is not None
        plain = self._unpack(message)
        with self._turn:
            self._kept += len(plain)
            require_room(self._kept, f"{self._file.name}: what its messages are unpacked to")
        return plain

    def _fail(self, number: int, error: BaseException) -> None:
        with self._turn:
            self._errors.append((number, error))
            self._turn.notify_all()

    def _comes(self, number: int) -> bool:
        """Wait for the turn of a batch; return False if one before it has failed."""
        while self._settled != number:
            if any(failed < number for failed, _ in self._errors):
                return False
            self._turn.wait()
        return True

    def _settle(self, batch: Batch, found: Contents) -> list[_Job]:
        """Take what a batch holds; return what is left to do for it, which can wait."""
        for opcode, body in found.declarations:
            self._read_declaration(opcode, body)
        jobs = [job for share in found.shares for job in self._take(share)]
        self._crc = joined(self._crc, found.checksum, len(batch.data))
        if batch.checksum is not None:
            if batch.checksum and batch.checksum != self._crc:
                raise Damaged("damaged: the checksum of the data is wrong")
            for topic, count in self._outside:
                topic.unchecked += 0 if batch.checksum else count
        return jobs

    def _read_declaration(self, opcode: int, contents: memoryview) -> None:
        """Note a schema or channel; skip other records."""
        fields = Fields(contents)
        if opcode == Op.SCHEMA:
            number = fields.number("<H")
            schema = fields.text(), fields.text(), fields.text()
            known = self._schemas.get(number)
            if known is None:
                self._keep_declaration(contents)
                self._schemas[number] = schema
            elif known != schema:
                raise Damaged(f"damaged: schema {number} is declared in two ways")
        elif opcode == Op.CHANNEL:
            number, of = fields.number("<H"), fields.number("<H")
            type_name, encoding, text = self._schemas.get(of, ("", "", ""))
            topic = TopicData(fields.text(), type_name, fields.text(), encoding, text)
            topic.expected = min(self._stated.get(number, 0), self._size)
            if number not in self._topics:
                self._keep_declaration(contents)
            before = self._topics.setdefault(number, topic)
            if (before.name, before.type_name) != (topic.name, topic.type_name):
                raise Damaged(f"damaged: channel {number} is both {before.name} and {topic.name}")

    def _keep_declaration(self, contents: memoryview) -> None:
        self._kept += len(contents)
        require_room(self._kept, f"{self._file.name}: what declares its topics")

    def _take(self, share: Share) -> Iterator[_Job]:
        """Count messages, and yield what makes them those of their topic, if it is wanted."""
        topic, count = self._topics.get(share.channel), len(share.begins)
        if topic is None:
            raise Damaged(f"damaged: a message on channel {share.channel}, which is not declared")
        topic.count += count
        if share.checked is None:
            self._outside.append((topic, count))
        else:
            topic.unchecked += 0 if share.checked else count
        if topic.name not in self._wanted:
            return
        want = self._wanted[topic.name]
        as_rows = (
            want is not None
            and self._unpack is None
            and bool(np.all(share.sizes == want.dtype.itemsize))
            and topic.fits(want)
        )
        self._kept += int(share.sizes.sum()) + (0 if as_rows else _OBJECT * count)
        require_room(self._kept, f"{self._file.name}: what is recorded on {topic.name}", self._size)
        rows = None
        if want is None:
            topic.times.append(share.times[share.own].astype(np.int64))
        elif as_rows:
            rows = topic.reserve(want, count)
        if rows is None:
            topic.pieces.append([])
        yield _Job(topic, want, len(topic.pieces) - 1, share, rows)

    def _check_summary(self, tail: bytes) -> None:
        """Compare what was read with the summary; `tail` is the end of the file."""
        opcode, length, start, _, checksum, _ = FOOTER_FORM.unpack(tail)
        if opcode != Op.FOOTER or length != FOOTER_FORM.size - RECORD_HEAD.size - len(MAGIC):
            raise Damaged("damaged: no footer where it must be")
        if start == 0:
            return
        if start != self._batches.position:
            raise Damaged(f"damaged: the summary is said to begin at byte {start}")
        require_room(self._size - start, f"{self._file.name}: its summary")
        summary = memoryview(self._part(start, self._size - start))
        if len(summary) < self._size - start:
            raise Damaged("the file has become shorter while it was read")
        end = len(summary) - FOOTER_FORM.size
        if checksum and crc32(summary[: -len(MAGIC) - 4]) != checksum:
            raise Damaged("damaged: the checksum of the summary is wrong")
        position = 0
        while position < end:
            opcode, begin, stop = record_at(summary, position, end)
            if opcode == Op.STATISTICS:
                total = Fields(summary[begin:stop]).number("<Q")
                count = sum(topic.count for topic in self._topics.values())
                if total != count:
                    raise Damaged(f"damaged: {count} messages where the summary counts {total}")
            elif opcode in (Op.SCHEMA, Op.CHANNEL):  # a topic without messages may be declared here only
                self._read_declaration(opcode, summary[begin:stop])
            position = stop


@dataclass
class _Job:
    """Work that is left for some messages of a topic, whose place among the others is settled."""

    topic: TopicData
    want: Want | None
    place: int  # among the pieces of the topic
    share: Share
    rows: Rows | None

    def do(self, unpack: Callable[[bytes], bytes] | None, compiled: bool) -> None:
        """Make the messages a piece of their topic."""
        share = self.share
        want, rows = self.want, self.rows
        if want is not None and rows is not None and want.take(share.records, share.begins, rows, compiled):
            return
        pairs = zip(share.begins.tolist(), share.sizes.tolist(), strict=True)
        serialized = [share.records[a : a + n].tobytes() for a, n in pairs]
        if unpack is None:
            self.topic.pieces[self.place] = serialized
        else:
            self.topic.pieces[self.place] = self.topic.made(self.want, [unpack(each) for each in serialized])


def _stated(part: Callable[[int, int], bytes], tail: bytes, size: int) -> dict[int, int]:
    """Return how many messages of each channel a file states, if it is found soon; nothing is relied on."""
    _, _, summary, offsets, _, _ = FOOTER_FORM.unpack(tail)
    end = size - FOOTER_FORM.size
    if not 0 < summary <= offsets <= end <= offsets + _MOST_OFFSETS:
        return {}
    try:
        groups = memoryview(part(offsets, end - offsets))
        position = 0
        while position < len(groups):
            opcode, begin, position = record_at(groups, position, len(groups))
            fields = Fields(groups[begin:position])
            if opcode != Op.SUMMARY_OFFSET or fields.number("<B") != Op.STATISTICS:
                continue
            place, length = fields.number("<Q"), fields.number("<Q")
            if length > _MOST_OFFSETS or not summary <= place < offsets:
                return {}
            record = memoryview(part(place, length))
            _, begin, stop = record_at(record, 0, len(record))
            fields = Fields(record[begin:stop])
            fields.data(_STATISTICS_HEAD)
            counts = fields.data(fields.number("<I"))
            return dict(_COUNT.iter_unpack(counts))
    except (Damaged, struct.error):
        pass  # reported where it is read completely
    return {}
