"""MATLAB files up to version 7, by SciPy; those of version 7.3 are HDF5 files."""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import largest_unpacked, require_room
from gyrowheel_recording.tables.grid import Column, Grid, split
from gyrowheel_recording.tables.readers import inflate, library_errors, object_remarks

_HEAD: Final = 128  # bytes before the first variable
_TAG: Final = 8
_MATRIX, _COMPRESSED = 14, 15
#: Bytes of a number, or of a letter, of each type of data.
_WIDTHS: Final = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}
_CELL, _STRUCTURE, _OBJECT_CLASS, _TEXT, _SPARSE = 1, 2, 3, 4, 5
_NUMERIC: Final = range(6, 16)
_FUNCTION, _OPAQUE = 16, 17
#: Bytes of overhead in memory of an array, a structure and a field of it.
_ARRAY, _STRUCT, _FIELD = 200, 400, 100
_MOST_DIMENSIONS, _MOST_FIELDS, _DEEPEST = 32, 10_000, 50
#: Version 4: bytes of the numbers of each precision; sparse matrices are the third type.
_OLD_WIDTHS: Final = (8, 4, 4, 2, 2, 1)
_OLD_HEAD: Final = 20
_OLD_SPARSE: Final = 2
_OLD_LARGEST: Final = 5000  # of the number by which the order of bytes is detected


def unpacked(path: Path) -> io.BytesIO:
    """Return a file with its variables unpacked, if SciPy can read it within the limit of memory.

    Raises
    ------
    InputError
        If it grows to more than the limit, or is damaged so that it could.
    """
    with path.open("rb") as file:
        size = path.stat().st_size
        head = file.read(_HEAD)
        if 0 in head[:4]:  # version 4, by which SciPy goes, too
            require_room(4.0 * size, f"{path}: it")
            data = head + file.read()
            _require_whole(data, path)
            return io.BytesIO(data)
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
        grown = 0.0
        while self._left:
            variable = self._next()
            elements = _Elements(self._path, variable, self._order, grown)
            elements.matrix(0)
            grown = elements.grown
            self._out.write(variable)
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
            self._require(length)
            return bytearray(tag + self._take(length))
        packed = self._take(length)
        tag = b"".join(inflate(packed, _TAG))
        if len(tag) < _TAG:
            raise InputError(f"{self._path}: damaged: a packed variable holds nothing")
        _, length = struct.unpack(f"{self._order}II", tag)
        self._require(length)
        variable = bytearray()
        for piece in inflate(packed, _TAG + length + 1):  # one more, so that its checksum is read, too
            variable += piece
        if len(variable) != _TAG + length:
            raise InputError(f"{self._path}: damaged: a packed variable is shorter or longer than it states")
        return variable

    def _require(self, length: int) -> None:
        """Refuse more bytes than there may be: as they are unpacked, and as SciPy copies them."""
        require_room(2.0 * (self._out.tell() + length), f"{self._path}: unpacked, it")

    def _take(self, count: int) -> bytes:
        data = self._file.read(min(count, self._left))
        self._left -= len(data)
        if len(data) < count:
            raise InputError(f"{self._path}: damaged: it breaks off within a variable")
        return data


class _Elements:
    """The elements of a variable."""

    def __init__(self, path: Path, data: bytearray, order: str, grown: float) -> None:
        self._path, self._data, self._place = path, memoryview(data), 0
        self._limit = largest_unpacked()
        self._pair = struct.Struct(f"{order}II")
        self._order = order
        self.grown = grown  # bytes that what was gone through takes in memory, as SciPy returns it

    def matrix(self, depth: int) -> None:
        """Go through one array of any class, and through what is in it."""
        kind, length = self._numbers()
        if kind != _MATRIX:
            raise self._damaged(f"an element of type {kind} where an array must be")
        self._grow(_ARRAY)
        if not length:
            return
        if depth > _DEEPEST:
            raise InputError(f"{self._path}: has arrays within arrays, more than {_DEEPEST} deep")
        self._numbers()
        flags, _ = self._numbers()
        own, parts = flags & 0xFF, 2 if flags >> 11 & 1 else 1
        if own == _OPAQUE:
            for _ in range(3):
                self._element()
            self.matrix(depth + 1)
            return
        count = self._count()
        self._element()  # the name
        if own in _NUMERIC:
            values = sum(self._values() for _ in range(parts))
            self._grow(8.0 * values if parts > 1 else 0.0)
        elif own == _SPARSE:
            for _ in range(2 + parts):
                self._values()
        elif own == _TEXT:
            self._grow(8.0 * (len(self._element()[1]) or count))
        elif own == _CELL:
            self._several(count, depth)
        elif own in (_STRUCTURE, _OBJECT_CLASS):
            if own == _OBJECT_CLASS:
                self._element()
            fields = self._fields()
            self._grow((_STRUCT + _FIELD * float(fields)) * count)
            self._several(count * fields, depth)
        elif own == _FUNCTION:
            self.matrix(depth + 1)
        else:
            raise self._damaged(f"an array of class {own}, which there is not")

    def _several(self, count: int, depth: int) -> None:
        if _TAG * count > len(self._data) - self._place:
            raise self._damaged(f"{count} arrays in {len(self._data) - self._place} bytes")
        self._grow(8.0 * count)
        for _ in range(count):
            self.matrix(depth + 1)

    def _numbers(self) -> tuple[int, int]:
        """Return two whole numbers."""
        end = self._place + _TAG
        if end > len(self._data):
            raise self._damaged("it breaks off")
        first, other = self._pair.unpack_from(self._data, self._place)
        self._place = end
        return first, other

    def _element(self) -> tuple[int, memoryview]:
        """Return the type and the bytes of an element that holds no others."""
        begin = self._place
        kind, length = self._numbers()
        if small := kind >> 16:  # it is within its tag
            if small > 4:
                raise self._damaged(f"a short element of {small} bytes")
            return kind & 0xFFFF, self._data[begin + 4 : begin + 4 + small]
        begin = self._place
        if length > len(self._data) - begin:
            raise self._damaged(f"an element of {length} bytes where {len(self._data) - begin} are left")
        self._place = begin + length + -length % _TAG
        return kind, self._data[begin : begin + length]

    def _values(self) -> int:
        """Return how many numbers an element holds."""
        kind, data = self._element()
        if kind not in _WIDTHS:
            raise self._damaged(f"numbers of type {kind}, which there is not")
        self._grow(len(data))
        return len(data) // _WIDTHS[kind]

    def _count(self) -> int:
        """Return the number of elements that an array states."""
        _, data = self._element()
        if len(data) > 4 * _MOST_DIMENSIONS:
            raise self._damaged(f"an array of {len(data) // 4} dimensions")
        sizes = struct.unpack_from(f"{self._order}{len(data) // 4}i", data)
        if any(size < 0 for size in sizes):
            raise self._damaged("an array of less than nothing")
        return math.prod(sizes)

    def _fields(self) -> int:
        """Return how many fields a structure has."""
        _, data = self._element()
        width = struct.unpack_from(f"{self._order}i", data)[0] if len(data) >= 4 else 0
        _, names = self._element()
        if width < 1:
            raise self._damaged(f"names of {width} letters")
        count = len(names) // width
        if count > _MOST_FIELDS:
            raise InputError(
                f"{self._path}: has a structure of {count} fields; allowed: up to {_MOST_FIELDS}"
            )
        return count

    def _grow(self, size: float) -> None:
        self.grown += size
        if self.grown > self._limit:
            require_room(self.grown, f"{self._path}: what is in it")

    def _damaged(self, what: str) -> InputError:
        return InputError(f"{self._path}: damaged: {what}")


def _require_whole(data: bytes, path: Path) -> None:
    """Refuse a file of version 4 whose variables claim more than it has, or less than nothing."""
    (first,) = struct.unpack_from("<i", data) if len(data) >= 4 else (0,)
    form = struct.Struct(f"{'<' if 0 <= first <= _OLD_LARGEST else '>'}5i")
    place = 0
    while place < len(data):
        left = len(data) - place - _OLD_HEAD
        if left < 0:
            raise InputError(f"{path}: damaged: it breaks off within a variable")
        kind, rows, columns, imaginary, name = form.unpack_from(data, place)
        precision = kind // 10 % 10
        if not 0 <= kind <= _OLD_LARGEST or precision >= len(_OLD_WIDTHS) or min(rows, columns, name) < 0:
            raise InputError(f"{path}: damaged: at byte {place} there is no variable, as version 4 has them")
        parts = 2 if imaginary == 1 and kind % 10 != _OLD_SPARSE else 1
        size = name + _OLD_WIDTHS[precision] * rows * columns * parts
        if size > left:
            raise InputError(f"{path}: damaged: a variable of {size} bytes where {left} are left")
        place += _OLD_HEAD + size


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
