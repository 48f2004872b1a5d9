"""The messages of a topic as they are read: as rows where their layout is the wanted one, else serialized."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from gyrowheel_core.files import largest_unpacked

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
    #: Definition of the type and its encoding, ``ros2msg`` or ``ros2idl``; empty
    #: where there is none.
    definition_encoding: str = ""
    definition: str = ""
    count: int = 0
    unchecked: int = 0  # messages that no checksum covers
    #: Log times [ns] in the order of the file; only of topics that were requested as serialized messages.
    times: list[npt.NDArray[np.int64]] = field(default_factory=list)
    #: The messages in the order of the file: as rows where possible, else serialized.
    pieces: list[Rows | list[bytes]] = field(default_factory=list)
    expected: int = 0  # how many messages the file states; nothing relies on it
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
            # only what is written takes memory, so that a false number costs nothing
            stated = min(self.expected, largest_unpacked() // row.itemsize)
            try:
                return np.zeros(max(stated, count), row)
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
