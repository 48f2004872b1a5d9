"""MATLAB files up to version 7, by SciPy; those of version 7.3 are HDF5 files."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_recording.tables.grid import Column, Grid, split
from gyrowheel_recording.tables.readers import inflate, library_errors, object_remarks

_HEAD: Final = 128  # bytes before the first variable
_TAG: Final = 8
_COMPRESSED: Final = 15


def unpacked(path: Path) -> io.BytesIO:
    """Return a file with its variables unpacked and their checksums compared, which SciPy does not do.

    Raises InputError if it is damaged.
    """
    with path.open("rb") as file:
        size = path.stat().st_size
        head = file.read(_HEAD)
        if 0 in head[:4]:  # version 4, by which SciPy goes, too
            return io.BytesIO(head + file.read())
        if len(head) < _HEAD:
            raise InputError(f"{path}: damaged: it breaks off within its head")
        return _Variables(path, file, size, head).read()


class _Variables:
    """The variables of a file of version 5 to 7."""

    def __init__(self, path: Path, file: BinaryIO, size: int, head: bytes) -> None:
        self._path, self._file, self._left = path, file, size - len(head)
        self._order = "<" if head[126:128] == b"IM" else ">"
        self._out = io.BytesIO()
        self._out.write(head)

    def read(self) -> io.BytesIO:
        """Return all of them, unpacked."""
        while self._left:
            self._out.write(self._next())
        self._out.seek(0)
        return self._out

    def _next(self) -> bytearray:
        """Return the next variable, unpacked."""
        tag = self._take(_TAG)
        kind, length = struct.unpack(f"{self._order}II", tag)
        if length > self._left or not length:
            raise InputError(
                f"{self._path}: damaged: a variable of {length} bytes where {self._left} are left"
            )
        if kind != _COMPRESSED:
            return bytearray(tag + self._take(length))
        packed = self._take(length)
        tag = b"".join(inflate(packed, _TAG))
        if len(tag) < _TAG:
            raise InputError(f"{self._path}: damaged: a packed variable holds nothing")
        _, length = struct.unpack(f"{self._order}II", tag)
        variable = bytearray()
        for piece in inflate(packed, _TAG + length + 1):  # one more, so that its checksum is read, too
            variable += piece
        if len(variable) != _TAG + length:
            raise InputError(f"{self._path}: damaged: a packed variable is shorter or longer than it states")
        return variable

    def _take(self, count: int) -> bytes:
        data = self._file.read(min(count, self._left))
        self._left -= len(data)
        if len(data) < count:
            raise InputError(f"{self._path}: damaged: it breaks off within a variable")
        return data


_MOST: Final = 64  # elements of an array of cells or structures that are looked into, one by one
#: Fields of what SciPy returns for an object: name, kind, class and content.
_OBJECT: Final = ("s0", "s1", "s2", "arr")
_TEXTS: Final = ("string", "categorical")
_UNREAD: Final = "Read error: "  # how SciPy returns a variable that it could not read


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read variables that are vectors, matrices, or structures or cells of them (see `formats.read_grid`)."""
    from scipy.io import loadmat

    objects: dict[str, str] = {}
    with library_errors(path):
        content = loadmat(unpacked(path), squeeze_me=True, struct_as_record=False)
        for name, value in content.items():
            if isinstance(value, str) and value.startswith(_UNREAD):
                raise InputError(f"{path}: damaged: {name}: {value}")
        columns = [
            column
            for name, value in content.items()
            if not name.startswith("__")
            for column in _columns(name, value, objects)
            if names is None or column.name in names
        ]
    return Grid.of(str(path), columns, object_remarks(objects, path, columns, all_read=names is None))


def _columns(name: str, value: Any, objects: dict[str, str]) -> Iterator[Column]:
    if hasattr(value, "_fieldnames"):  # a structure
        if {"label", "values"} <= set(value._fieldnames):
            yield from _labelled(name, value)
            return
        for field in value._fieldnames:
            yield from _columns(f"{name}.{field}", getattr(value, field), objects)
        return
    array = np.asarray(value)
    if array.dtype.names == _OBJECT and array.size:
        _note(name, array, objects)
        return
    if array.dtype != object:
        yield from split(name, array)
        return
    if not array.ndim:  # a sparse matrix, and what else NumPy does not know
        return
    items = list(array.ravel())
    if all(map(_is_number, items)):  # a cell for every row
        yield from split(name, np.array(items))
        return
    if len(items) > 1 and all(hasattr(own, "_fieldnames") for own in items):  # a structure for every row
        for field in items[0]._fieldnames:
            values = [getattr(own, field, None) for own in items]
            if all(map(_is_number, values)):
                yield from split(f"{name}.{field}", np.array(values))
    called = [str(getattr(own, "Name", "")) for own in items]
    if all(called) and len(set(called)) == len(items):  # channels of dSPACE and others
        for own, label in zip(items, called, strict=True):
            unit = getattr(own, "Unit", "")
            yield from split(
                f"{name}.{label}", getattr(own, "Data", ()), unit=unit if isinstance(unit, str) else ""
            )
        return
    for k, own in enumerate(items[:_MOST]):
        yield from _columns(f"{name}.{k + 1}", own, objects)


def _labelled(name: str, signal: Any) -> Iterator[Column]:
    """Yield the columns of a signal of Simulink by its label, or its labels, where there is one for each column."""
    columns = split(f"{name}.values", signal.values)
    labels = [str(own).strip() for own in np.atleast_1d(signal.label)] if np.size(signal.label) else []
    place = name.rpartition(".signals")[0] or name
    if len(labels) == len(columns) and all(labels):
        columns = [
            replace(column, name=f"{place}.{label}") for column, label in zip(columns, labels, strict=True)
        ]
    yield from columns


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number | np.bool_)


def _note(name: str, array: Any, objects: dict[str, str]) -> None:
    """Note an object by its name and class."""
    own, kind = (
        value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
        for value in (array.ravel()[0]["s0"], array.ravel()[0]["s2"])
    )
    if kind not in _TEXTS:
        objects[own if name == "None" else name] = kind  # SciPy knows no names of variables that are objects
