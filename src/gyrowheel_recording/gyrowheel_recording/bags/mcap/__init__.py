"""MCAP files: constants, checksums (CRC-32) and compressed collections that readers and writer share."""

from __future__ import annotations

import functools
import struct
import zlib
from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np

MAGIC: Final = b"\x89MCAP0\r\n"


class Op:
    """The opcodes of records."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    STATISTICS = 0x0B
    METADATA = 0x0C
    METADATA_INDEX = 0x0D
    SUMMARY_OFFSET = 0x0E
    DATA_END = 0x0F


#: Head of every record: opcode and length of the contents.
RECORD_HEAD: Final = struct.Struct("<BQ")
#: Head of a message: head of the record, channel, sequence, log time and publish time [ns].
MESSAGE_HEAD: Final = struct.Struct("<BQHIQQ")
#: The same as a numpy dtype.
MESSAGE_HEAD_DTYPE: Final = np.dtype([
    ("opcode", "u1"), ("length", "<u8"),
    ("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8"),
])  # fmt: skip
#: Length of a message record beyond that of its data.
MESSAGE_OVERHEAD: Final = MESSAGE_HEAD.size - RECORD_HEAD.size
#: The end of a file: footer record (head, start of summary, start of summary offsets, checksum) and magic.
FOOTER_FORM: Final = struct.Struct("<BQQQI8s")


try:
    from isal.isal_zlib import crc32
except ImportError:  # no build for this machine: the same numbers, three times slower
    from zlib import crc32

__all__ = ["crc32", "joined", "joined_with"]

_POLYNOMIAL: Final = 0xEDB88320  # of CRC-32, the highest power in the lowest bit
_ONE: Final = 1 << 31
#: Bytes of a part from which on its checksum is sooner joined than computed again.
_WORTH: Final = 1 << 16


def joined_with(data: memoryview, known: Iterable[tuple[int, int, int]]) -> int:
    """Return the CRC-32 of data; `known` are begin, end and checksum of some parts of it, in order."""
    result = at = 0
    for begin, end, checksum in known:
        if end - begin >= _WORTH:
            result = joined(crc32(data[at:begin], result), checksum, end - begin)
            at = end
    return crc32(data[at:], result)


def joined(first: int, second: int, length: int) -> int:
    """Return the CRC-32 of two parts, one behind the other, by their checksums and the bytes of the second."""
    # the first one is moved by the bits of the second: multiplied by x to their number
    return _product(_power(length), first) ^ second


@functools.lru_cache(maxsize=4096)
def _power(length: int) -> int:
    """Return x to the bits of so many bytes; most chunks of a file have one of a few lengths."""
    power, k = _ONE, 3
    while length:
        if length & 1:
            power = _product(_POWERS[k % len(_POWERS)], power)
        length >>= 1
        k += 1
    return power


def _product(a: int, b: int) -> int:
    """Return the product of two polynomials over bits, modulo that of the checksum."""
    result, bit = 0, _ONE
    while a:
        if a & bit:
            result ^= b
            a ^= bit
        bit >>= 1
        b = (b >> 1) ^ _POLYNOMIAL if b & 1 else b >> 1
    return result


def _powers() -> tuple[int, ...]:
    found = [_ONE >> 1]
    while len(found) < 32:  # the next one would be the first again
        found.append(_product(found[-1], found[-1]))
    return tuple(found)


#: x to the powers of two, from 1 on.
_POWERS: Final = _powers()


class PackedBytes:
    """Bytes to which more are appended; iterating yields all of them in pieces, as often as wanted."""

    def __init__(self) -> None:
        self.size = 0  # bytes appended
        # records of some hundred bytes that are alike need neither a large window nor much memory
        self._compressor = zlib.compressobj(wbits=12, memLevel=5)
        self._packed: list[bytes] = []

    def append(self, data: bytes) -> None:
        """Append bytes."""
        if packed := self._compressor.compress(data):
            self._packed.append(packed)
        self.size += len(data)

    def __iter__(self) -> Iterator[bytes]:
        """Yield the bytes, a small part of them at once."""
        unpacker = zlib.decompressobj()
        for packed in (*self._packed, self._compressor.copy().flush()):
            if piece := unpacker.decompress(packed):
                yield piece
