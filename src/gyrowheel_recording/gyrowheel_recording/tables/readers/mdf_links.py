"""The links of an MDF file, gone through before asammdf follows them.

asammdf goes along every list to its end, which a list that leads back to itself does not have, and unpacks each block
to whatever it grows to. So each block of a list must be reached once, and what is packed is measured.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import lz4.frame
import zstandard

from gyrowheel_core.errors import InputError
from gyrowheel_core.limits import largest, require_room
from gyrowheel_recording.tables.readers.damage import DEFLATED, inflated

_FIRST: Final = 64  # byte at which the first block begins
_OLDEST_OF_4: Final = b"4"
_HEAD: Final = struct.Struct("<4s4xQQ")  # name, length and number of links of a block of version 4
#: Which of their links lead to blocks that no other block leads to.
_OWNED: Final = {
    b"##HD": (0, 1, 3, 4), b"##DG": (0, 1, 2), b"##CG": (0, 1), b"##CN": (0, 1, 5), b"##CA": (0,), b"##FH": (0,),
    b"##AT": (0,), b"##EV": (0,), b"##HL": (0,), b"##DL": None, b"##LD": None,
}  # fmt: skip
_CONVERSION: Final = b"##CC"
_CONVERSIONS: Final = slice(4, None)  # links of a conversion to others
_OF_CHANNEL: Final = 4  # link of a channel to its conversion
_DEEPEST, _MOST_CONVERSIONS = 20, 10_000
_PACKED: Final = b"##DZ"
_PACKING: Final = struct.Struct("<2sBBIQQ")  # of what kind, how packed, and the bytes unpacked and packed
_DEFLATE, _ZSTD, _LZ4 = (0, 1), (2, 3), (4, 5)
#: Version 3: number of the link to the next block, and to the first one in it, by name.
_OLD: Final = {b"DG": (4, 8), b"CG": (4, 8), b"CN": (4,)}
_OLD_FIRST: Final = 68


def require_links(path: Path) -> None:
    """Refuse a file whose lists have no end, or that unpacks to more than the limit.

    Raises
    ------
    InputError
        If it does, or is damaged so that it could.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if data[8:9] == _OLDEST_OF_4:
            _Blocks(data, path).check()
        else:
            _check_old(data, path)


class _Blocks:
    """The blocks of a file of version 4."""

    def __init__(self, data: mmap.mmap, path: Path) -> None:
        self._data, self._path = data, path
        self._seen: set[int] = set()
        self._unpacked = 0
        self._conversions: dict[int, int] = {}

    def check(self) -> None:
        """Go through all that asammdf goes through."""
        waiting = [_FIRST]
        while waiting:
            place = waiting.pop()
            if place in self._seen:
                raise self._damaged(f"more than one link leads to the block at byte {place}")
            self._seen.add(place)
            name, links = self._block(place)
            if name == _PACKED:
                self._measure(place)
            owned = _OWNED.get(name, ())
            for k, link in enumerate(links):
                if link and (owned is None or k in owned) and not self._is_elsewhere(name, k, link):
                    waiting.append(link)
            if name == b"##CN" and len(links) > _OF_CHANNEL and links[_OF_CHANNEL]:
                self._converted(links[_OF_CHANNEL], 0)

    def _block(self, place: int) -> tuple[bytes, tuple[int, ...]]:
        """Return the name and the links of a block."""
        if place + _HEAD.size > len(self._data):
            raise self._damaged(f"a link leads to byte {place}, where the file has ended")
        name, _, count = _HEAD.unpack_from(self._data, place)
        if name not in _OWNED and name != _CONVERSION:
            return name, ()
        begin = place + _HEAD.size
        if count > (len(self._data) - begin) // 8:
            raise self._damaged(f"the block at byte {place} has {count} links")
        return name, struct.unpack_from(f"<{count}Q", self._data, begin)

    def _is_elsewhere(self, name: bytes, number: int, link: int) -> bool:
        """Whether a link of a channel for its data leads to what belongs to others, an attachment or a group."""
        if name != b"##CN" or number != 5:
            return False
        return self._block(link)[0] in (b"##AT", b"##CG")

    def _converted(self, place: int, depth: int) -> int:
        """Return how many conversions one consists of."""
        if place in self._conversions:
            return self._conversions[place]
        name, links = self._block(place)
        if name != _CONVERSION:
            return 0
        if depth > _DEEPEST:
            raise self._damaged(
                f"the conversion at byte {place} has others within it, more than {_DEEPEST} deep"
            )
        count = 1 + sum(self._converted(link, depth + 1) for link in links[_CONVERSIONS] if link)
        if count > _MOST_CONVERSIONS:
            raise self._damaged(f"the conversion at byte {place} consists of {count}")
        self._conversions[place] = count
        return count

    def _measure(self, place: int) -> None:
        """Refuse a packed block that is more than its size, which counts."""
        begin = place + _HEAD.size
        if begin + _PACKING.size > len(self._data):
            raise self._damaged(f"the block at byte {place} is cut off")
        _, way, _, _, size, stored = _PACKING.unpack_from(self._data, begin)
        begin += _PACKING.size
        if stored > len(self._data) - begin:
            raise self._damaged(f"the block at byte {place} is cut off")
        self._unpacked += size
        require_room(self._unpacked, f"{self._path}: unpacked, it")
        if way in _DEFLATE and stored * DEFLATED <= largest():
            return
        packed = self._data[begin : begin + stored]
        if sum(map(len, _pieces(packed, way, size + 1))) > size:
            raise self._damaged(
                f"the block at byte {place} unpacks to more than the {size} bytes that it states"
            )

    def _damaged(self, what: str) -> InputError:
        return InputError(f"{self._path}: damaged: {what}")


def _pieces(packed: bytes, way: int, most: int) -> Iterator[bytes]:
    """Yield what a block unpacks to, up to a number of bytes."""
    if way in _DEFLATE:
        yield from inflated(packed, most)
    elif way in _ZSTD:
        with zstandard.ZstdDecompressor().stream_reader(packed) as stream:
            while most > 0 and (piece := stream.read(min(most, 1 << 20))):
                most -= len(piece)
                yield piece
    elif way in _LZ4:
        unpack = lz4.frame.LZ4FrameDecompressor()
        piece = unpack.decompress(packed, max_length=min(most, 1 << 20))
        while piece:
            most -= len(piece)
            yield piece
            if most <= 0 or unpack.eof:
                return
            piece = unpack.decompress(b"", max_length=min(most, 1 << 20))


def _check_old(data: mmap.mmap, path: Path) -> None:
    """Refuse lists without an end in a file of version 3."""
    if len(data) < _OLD_FIRST + 4:
        raise InputError(f"{path}: damaged: it breaks off within its head")
    waiting, seen = [struct.unpack_from("<I", data, _OLD_FIRST)[0]], set()
    while waiting:
        place = waiting.pop()
        if not place:
            continue
        if place in seen:
            raise InputError(f"{path}: damaged: more than one link leads to the block at byte {place}")
        seen.add(place)
        links = _OLD.get(data[place : place + 2], ())
        if place + 12 > len(data):
            raise InputError(f"{path}: damaged: a link leads to byte {place}, where the file has ended")
        waiting += [struct.unpack_from("<I", data, place + link)[0] for link in links]
