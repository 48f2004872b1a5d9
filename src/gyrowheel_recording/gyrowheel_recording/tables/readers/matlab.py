"""MATLAB files up to version 7, by SciPy; those of version 7.3 are HDF5 files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_recording.tables.grid import Column, Grid, split
from gyrowheel_recording.tables.readers.damage import refused
from gyrowheel_recording.tables.readers.mat5 import unpacked
from gyrowheel_recording.tables.readers.objects import said_of_objects

_MOST: Final = 64  # elements of an array of cells or structures that are looked into, one by one
#: Fields of what SciPy returns for an object: name, kind, class and content.
_OBJECT: Final = ("s0", "s1", "s2", "arr")
_TEXTS: Final = ("string", "categorical")
_UNREAD: Final = "Read error: "  # how SciPy returns a variable that it could not read


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read variables that are vectors, matrices, or structures or cells of them (see `formats.read_grid`)."""
    from scipy.io import loadmat

    objects: dict[str, str] = {}
    with refused(path):
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
    return Grid.of(str(path), columns, said_of_objects(objects, path, columns, all_read=names is None))


def _columns(name: str, value: Any, objects: dict[str, str]) -> Iterator[Column]:
    if hasattr(value, "_fieldnames"):  # a structure
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
