"""Texts of any length in attributes of HDF5, read from the bytes of the file.

Such a text is elsewhere, in a heap. HDF5 believes what an attribute and a heap say of each other: on a damaged file it
looks for the end of a heap for ever, or reads beyond its memory and takes the program with it.
"""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from gyrowheel_core.errors import InputError

_ATTRIBUTE, _GOES_ON = 0x0C, 0x10  # types of messages
_MOST_BLOCKS: Final = 1000  # of the head of a data set
_LONGEST: Final = 1 << 16  # bytes of a text
_SHARED: Final = 2  # flag of a message that is elsewhere


class Texts:
    """The texts of a file.

    Parameters
    ----------
    path : Path
        The file.
    file : h5py.File
        The same.
    """

    def __init__(self, path: Path, file: Any) -> None:
        self._path = path
        self._base = int(file.userblock_size)
        self._address, self._length = file.id.get_create_plist().get_sizes()
        with path.open("rb") as stream:
            self._data = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file."""
        self._data.close()

    def of(self, node: Any, name: str) -> str | None:
        """Return the first text in an attribute of a data set; None if the data set has its attributes elsewhere.

        Raises
        ------
        InputError
            If the file is damaged there.
        """
        import h5py

        for body in self._attributes(h5py.h5o.get_info(node.id).addr):
            stored = self._stored(body, name.encode())
            if stored is not None:
                return self._text(stored)
        return None

    def _number(self, place: int, size: int) -> int:
        return int.from_bytes(self._bytes(place, size), "little")

    def _bytes(self, place: int, size: int) -> bytes:
        data = self._data[place : place + size] if place >= 0 else b""
        if len(data) < size:
            raise self._damaged(place)
        return data

    def _attributes(self, address: int) -> Iterator[bytes]:
        """Yield the messages with attributes in the head of a data set."""
        begin = self._base + address
        if self._bytes(begin, 4) == b"OHDR":
            flags = self._number(begin + 5, 1)
            at = begin + 6 + (16 if flags & 0x20 else 0) + (4 if flags & 0x10 else 0)
            width = 1 << (flags & 3)
            blocks = [(at + width, self._number(at, width))]
            form = (
                1,
                4 + (2 if flags & 4 else 0),
                4,
            )  # bytes of a type, of what is before a message, and of a mark
        else:
            blocks = [(begin + 16, self._number(begin + 8, 4))]
            form = 2, 8, 0
        for count, (at, size) in enumerate(blocks):
            if count > _MOST_BLOCKS:
                raise self._damaged(begin)
            end = at + size
            while at + form[1] <= end:
                kind = self._number(at, form[0])
                length = self._number(at + form[0], 2)
                shared = self._number(at + form[0] + 2, 1) & _SHARED
                body = self._bytes(at + form[1], length)
                if kind == _ATTRIBUTE and not shared:
                    yield body
                elif kind == _GOES_ON:
                    place = self._base + int.from_bytes(body[: self._address], "little")
                    more = int.from_bytes(body[self._address : self._address + self._length], "little")
                    blocks.append((place + form[2], more - 2 * form[2]))
                at += form[1] + length

    def _stored(self, body: bytes, name: bytes) -> bytes | None:
        """Return what a message stores, if it is of an attribute of that name."""
        version, *sizes = body[:1], body[2:4], body[4:6], body[6:8]
        lengths = [int.from_bytes(size, "little") for size in sizes]
        at = 9 if version == b"\x03" else 8
        if body[at : at + lengths[0]].rstrip(b"\0") != name:
            return None
        for length in lengths:
            at += length + (-length % 8 if version == b"\x01" else 0)
        return body[at:]

    def _text(self, stored: bytes) -> str:
        """Return the text that is where an attribute says."""
        width = self._address
        length, place, number = (
            int.from_bytes(part, "little")
            for part in (stored[:4], stored[4 : 4 + width], stored[4 + width : 8 + width])
        )
        if not length:
            return ""
        begin = self._base + place
        if self._bytes(begin, 4) != b"GCOL":
            raise self._damaged(begin)
        size = 8 + self._length
        end = begin + self._number(begin + 8, self._length)
        at = begin + size + -size % 8
        while at + size <= end:
            own, room = self._number(at, 2), self._number(at + 8, self._length)
            head = size + -size % 8
            if own == number and length <= min(room, _LONGEST):
                return self._bytes(at + head, length).decode("utf-8", "replace").rstrip("\0")
            if not own or own == number:
                break
            at += head + room + -room % 8
        raise self._damaged(begin)

    def _damaged(self, place: int) -> InputError:
        return InputError(
            f"{self._path}: damaged: the text of an attribute is not at byte {place}, as it should be"
        )
