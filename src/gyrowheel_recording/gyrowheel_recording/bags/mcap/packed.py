"""Bytes that are collected for long and read once, kept compressed in memory."""

from __future__ import annotations

import zlib
from collections.abc import Iterator


class PackedBytes:
    """Bytes to which more are appended; iterating yields all of them in pieces, as often as wanted.

    Attributes
    ----------
    size : int
        Bytes appended.
    """

    def __init__(self) -> None:
        self.size = 0
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
