"""Bytes that are collected for long and read once, kept compressed in memory."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from typing import Final

_PIECE: Final = 1 << 15  # compressed bytes that are read at once


class PackedBytes:
    """Bytes to which more are appended; iterating yields all of them in pieces, as often as wanted.

    Attributes
    ----------
    size : int
        Bytes appended.
    """

    def __init__(self) -> None:
        self.size = 0
        self._compressor = zlib.compressobj()
        self._packed = bytearray()

    def append(self, data: bytes) -> None:
        """Append bytes."""
        self._packed += self._compressor.compress(data)
        self.size += len(data)

    def __iter__(self) -> Iterator[bytes]:
        """Yield the bytes, a small part of them at once."""
        packed = bytes(self._packed) + self._compressor.copy().flush()
        unpacker = zlib.decompressobj()
        for start in range(0, len(packed), _PIECE):
            if piece := unpacker.decompress(packed[start : start + _PIECE]):
                yield piece
