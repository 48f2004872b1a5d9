"""Chunks that contradict their index, with checksums that are right: read with compiled loops as without them.

A flipped bit is stopped by a checksum. Here the files are made by somebody who means it: lengths and times at the ends
of their types, messages without an index, index records that are unsorted, doubled, split, cut off or of another
channel, records that do not belong into a chunk.
"""

from __future__ import annotations

import random
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags.columns import definition, wanted
from gyrowheel_recording.bags.mcap import MAGIC, Op, batches
from gyrowheel_recording.bags.mcap.batches import Want
from gyrowheel_recording.bags.mcap.reader import read_mcap

from .harness import Case, WrongAnswer

#: Channels whose messages have a layout; beside them one of texts, and one of anything.
_LAYOUTS = {
    1: (topics.MEASUREMENT, wire.MEASUREMENT),
    2: (topics.COMMAND, wire.COMMAND),
    3: (topics.SETPOINT, wire.SETPOINT),
    4: (topics.DRAG_ESTIMATE, wire.DRAG_ESTIMATE),
}
_TEXTS, _ANYTHING = 8, 9
_WANTED: dict[str, Want | None] = {topic.name: wanted(layout) for topic, layout in _LAYOUTS.values()}
_WANTED["/texts"] = None
#: Numbers at which something ends: none, one, a head, an entry, the types.
_ENDS = (
    *(0, 1, 15, 16, 21, 22, 23, 31),
    *(2**31 - 1, 2**32 - 1, 2**63 - 1, 2**63, 2**63 + 5, 2**64 - 31, 2**64 - 9, 2**64 - 1),
)
_SIZES = (200, 1000, 5000, 1 << 22)  # bytes of a batch


def record(opcode: int, body: bytes) -> bytes:
    """Return a record."""
    return struct.pack("<BQ", opcode, len(body)) + body


def message(channel: int, time: int, data: bytes, *, length: int | None = None) -> bytes:
    """Return the record of a message."""
    body = struct.pack("<HIQQ", channel, 0, time, time) + data
    return struct.pack("<BQ", Op.MESSAGE, len(body) if length is None else length) + body


def index(channel: int, entries: list[tuple[int, int]], *, length: int | None = None) -> bytes:
    """Return an index record; an entry is a time and a place."""
    body = b"".join(struct.pack("<QQ", *entry) for entry in entries)
    return record(
        Op.MESSAGE_INDEX, struct.pack("<HI", channel, len(body) if length is None else length) + body
    )


def chunk(records: bytes, *, checked: bool = True) -> bytes:
    """Return the record of a chunk."""
    head = struct.pack("<QQQI", 0, 0, len(records), zlib.crc32(records) if checked else 0)
    return record(Op.CHUNK, head + _text("") + struct.pack("<Q", len(records)) + records)


def file(parts: list[bytes]) -> bytes:
    """Return a file with these records, without a summary."""
    head = MAGIC + record(Op.HEADER, _text("ros2") + _text(""))
    end = record(Op.DATA_END, bytes(4)) + record(Op.FOOTER, bytes(20)) + MAGIC
    return head + b"".join(parts) + end


def declarations() -> bytes:
    """Return the schemas and channels of all topics."""
    parts = [_channel(_TEXTS, 0, "/texts"), _channel(_ANYTHING, 0, "/other")]
    for number, (topic, layout) in _LAYOUTS.items():
        name, text = layout.type_name, definition(layout.type_name).text
        schema = struct.pack("<H", number) + _text(name) + _text("ros2msg") + _text(text)
        parts += [record(Op.SCHEMA, schema), _channel(number, number, topic.name)]
    return b"".join(parts)


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text.encode())) + text.encode()


def _channel(number: int, schema: int, name: str) -> bytes:
    return record(Op.CHANNEL, struct.pack("<HH", number, schema) + _text(name) + _text("cdr") + _text(""))


class _Odd:
    """Decides what is wrong with a file: mostly nothing, or little."""

    def __init__(self, rng: random.Random) -> None:
        self.rng = rng
        self._much = rng.choice((0.0, 0.0, 0.5, 0.5, 1.0, 1.5))

    def __call__(self, chance: float) -> bool:
        return self.rng.random() < chance * self._much


def _data(channel: int, odd: _Odd) -> bytes:
    rng = odd.rng
    if channel not in _LAYOUTS:
        return rng.randbytes(rng.randrange(12))
    layout = _LAYOUTS[channel][1]
    own = np.frombuffer(bytearray(rng.randbytes(layout.size)), np.uint8)
    own[layout.constant_bytes[:, 0]] = layout.constant_bytes[:, 1]
    ended = 10**9 + rng.randrange(2**31) if odd(0.02) else rng.randrange(10**9)
    own.view(layout.dtype)["nanosec"] = ended
    data = bytes(own)
    if odd(0.03):
        place = rng.randrange(len(data))
        data = data[:place] + bytes([data[place] ^ 1 << rng.randrange(8)]) + data[place + 1 :]
    if odd(0.03):
        data = data[: rng.randrange(len(data) + 1)]
    return data + bytes(rng.choice((1, 7, 8)) if odd(0.03) else 0)


def _records(odd: _Odd, begin: int) -> tuple[bytes, dict[int, list[tuple[int, int]]]]:
    """Return the records of a chunk, and the entries of its index by channel; times go on from `begin`."""
    rng, body = odd.rng, b""
    entries: dict[int, list[tuple[int, int]]] = {}
    for k in range(rng.choice((0, 1, 1, 2, 5, 20, 60))):
        channel = rng.choice((*_LAYOUTS, *_LAYOUTS, _TEXTS, _ANYTHING))
        time = rng.choice(_ENDS) if odd(0.02) else begin + k
        if not odd(0.03):
            entries.setdefault(channel, []).append((time, len(body)))
        length = rng.choice(_ENDS) if odd(0.02) else None
        body += message(channel, time, _data(channel, odd), length=length)
        if odd(0.02):
            opcode = rng.choice((0, Op.HEADER, Op.SCHEMA, Op.CHANNEL, Op.MESSAGE, Op.MESSAGE_INDEX, 99))
            body += record(opcode, rng.randbytes(rng.choice((0, 3, 21, 22, 40))))
        if odd(0.02):
            body += rng.randbytes(rng.randrange(12))
        if odd(0.01):
            body += declarations()
    return body[: rng.randrange(len(body) + 1)] if odd(0.05) else body, entries


def _index(channel: int, entries: list[tuple[int, int]], size: int, odd: _Odd) -> bytes:
    """Return the index records of a channel in a chunk of `size` bytes."""
    rng, own = odd.rng, list(entries)
    if odd(0.06):
        rng.shuffle(own)
    if odd(0.05):
        own.append(rng.choice(own))
    if odd(0.05):
        own.pop(rng.randrange(len(own)))
    if own and odd(0.05):
        own[rng.randrange(len(own))] = (rng.choice(_ENDS), own[0][1])
    if own and odd(0.05):
        place = rng.choice((*_ENDS, size, max(size - 1, 0), max(size - 31, 0)))
        own[rng.randrange(len(own))] = (own[0][0], place)
    if odd(0.04):
        channel = rng.choice((*_LAYOUTS, _ANYTHING, 77, 2**16 - 1))
    if odd(0.05):
        half = rng.randrange(len(own) + 1)
        return index(channel, own[:half]) + index(channel, own[half:])
    length = 16 * len(own)
    if odd(0.04):
        return index(channel, own, length=max(length + rng.choice((-16, -8, -1, 16)), 0))
    return index(channel, own) * (2 if odd(0.05) else 1)


def _file(rng: random.Random) -> bytes:
    odd = _Odd(rng)
    parts, checked = [declarations()], rng.random() < 0.8
    for number in range(rng.randint(0, 8)):
        body, entries = _records(odd, rng.choice((0, 10**18)) + 100 * number)
        parts.append(chunk(body, checked=checked and not odd(0.1)))
        channels = list(entries)
        rng.shuffle(channels)
        parts += [_index(channel, entries[channel], len(body), odd) for channel in channels]
        if odd(0.05):
            parts.append(index(rng.choice((1, 2, 77)), []))
        if odd(0.03):
            parts.append(record(Op.MESSAGE_INDEX, rng.randbytes(rng.randrange(8))))
        if odd(0.1):
            parts.append(message(rng.choice((1, 2, _ANYTHING)), 5, b"abc"))
    return file(parts)


def _read(path: Path, **how: Any) -> Any:
    """Return all that is read of a file, to the byte, or why it is refused."""
    try:
        found = read_mcap(path, _WANTED, **how)
    except InputError as error:
        return str(error)
    return [
        (
            topic.name,
            topic.count,
            topic.unchecked,
            [times.tolist() for times in topic.times],
            [piece if isinstance(piece, list) else piece.tobytes() for piece in topic.pieces],
        )
        for topic in found
    ]


def chunks(rng: random.Random, folder: Path) -> Iterator[Case]:
    """Make files whose chunks, index and checksums are put together by hand, and read them in both ways."""
    path = folder / "chunks.mcap"
    while True:
        size, threads = rng.choice(_SIZES), rng.choice((1, 1, 1, 3))

        def use(data: bytes, size: int = size, threads: int = threads) -> str:
            path.write_bytes(data)
            usual, batches.SIZE = batches.SIZE, size  # type: ignore[misc]
            try:
                plain = _read(path, threads=1, compiled=False)
                compiled = _read(path, threads=threads, compiled=True)
            finally:
                batches.SIZE = usual  # type: ignore[misc]
            if plain != compiled:
                raise WrongAnswer(f"{str(plain)[:200]}, and with compiled loops {str(compiled)[:200]}")
            return "refused" if isinstance(plain, str) else "read"

        yield Case("chunks", _file(rng), use)
