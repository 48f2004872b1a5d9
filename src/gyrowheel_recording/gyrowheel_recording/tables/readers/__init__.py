"""Readers of tables, one module a format; what they share: errors of their libraries, and of objects of MATLAB."""

from __future__ import annotations

import contextlib
import importlib
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from gyrowheel_core.errors import InputError, one_line
from gyrowheel_recording.tables.grid import Column

_LONGEST: Final = 300  # characters of the message of a library
_PIECE: Final = 1 << 24  # bytes


@contextlib.contextmanager
def library_errors(path: Path) -> Iterator[None]:
    """Turn whatever a library raises within the block into one `InputError` that names the file."""
    try:
        with np.errstate(all="ignore"):
            yield
    except (InputError, MemoryError):
        raise
    except Exception as error:  # on damaged data libraries pass on whatever happens to them
        raise InputError(f"{path}: cannot be read: {short_message(error)}") from None


def short_message(error: BaseException) -> str:
    """Return the message of a library's error in one line of limited length."""
    text = one_line(error)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def inflate(packed: bytes, most: int) -> Iterator[bytes]:
    """Yield the content of bytes deflated by zlib, in pieces, up to `most` bytes of it."""
    inflate = zlib.decompressobj()
    rest, got = packed, 0
    while got < most:
        piece = inflate.decompress(rest, min(most - got, _PIECE))
        if not piece:
            return
        rest, got = inflate.unconsumed_tail, got + len(piece)
        yield piece


def library(name: str, extra: str, path: Path) -> Any:
    """Return a library that reads a format.

    Raises
    ------
    InputError
        If it is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InputError(
            f"{path}: needs the library {name}, which is not installed; pip install 'gyrowheel-recording[{extra}]'"
        ) from None


#: How numbers come out of an object.
_CURES: Final = {
    "timetable": "s = table2struct(timetable2table(T), 'ToScalar', true); s.Time = seconds(T.Properties.RowTimes)",
    "table": "s = table2struct(T, 'ToScalar', true)",
    "datetime": "t = posixtime(t)",
    "duration": "t = seconds(t)",
    "timeseries": "s.time = ts.Time; s.data = ts.Data",
}
_OTHERWISE: Final = "save its numbers as plain vectors"


def object_remarks(
    objects: Mapping[str, str], path: Path, columns: Sequence[Column], *, all_read: bool
) -> list[str]:
    """Return the remarks on variables that are objects, by their names and classes.

    Raises InputError if there is nothing else in the file.
    """
    said = [
        f"{name} is an object of MATLAB, a {kind}, which MATLAB alone can read: {_CURES.get(kind, _OTHERWISE)}"
        for name, kind in objects.items()
    ]
    if said and all_read and not columns:
        raise InputError(f"{path}: has no columns of numbers: {'; '.join(said)}")
    return said if all_read else []
