"""HDF5 files, and those of MATLAB from version 7.3 on, by h5py."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_recording.tables.grid import Column, Grid, require_table, split
from gyrowheel_recording.tables.readers.damage import refused, said
from gyrowheel_recording.tables.readers.hdf5_texts import Texts
from gyrowheel_recording.tables.readers.objects import said_of_objects
from gyrowheel_recording.tables.readers.packed import require_plain

_UNITS: Final = ("unit", "units", "Unit", "Units", "UNIT")
#: Classes of MATLAB whose data set holds its numbers; in that of another one stand references to what it is.
_NUMBERS: Final = (
    "double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "logical",
)  # fmt: skip
_TEXTS: Final = ("char", "string", "categorical", "cell", "struct", "canonical empty", "function_handle")
_DEEPEST: Final = 50  # groups within groups
_LONGEST: Final = 64  # values of an attribute
_WIDEST: Final = 1 << 16  # bytes of one of them


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read data sets that are vectors, matrices or records (see `formats.read_grid`)."""
    import h5py  # takes a while, as the other readers' libraries do

    columns: list[Column] = []
    objects: dict[str, str] = {}
    remarks: list[str] = []
    size = 0.0
    with refused(path), h5py.File(path, "r") as file, Texts(path, file) as texts:
        attributes = _Attributes(texts)
        joint = "." if _is_matlab(path) else "/"
        for name, node in _data_sets(file, path):
            own = name.replace("/", joint)
            if node.shape is None or node.ndim > 2:
                continue
            kind = "".join(_text(value) for value in attributes.of(node, "MATLAB_class")[:1])
            if kind and kind not in _NUMBERS:
                if kind not in _TEXTS:
                    objects[own] = kind
                continue
            if names is not None and not any(n == own or n.startswith(own + joint) for n in names):
                continue
            try:
                fields = _fields(node.dtype)
            except TypeError as error:  # a type that NumPy does not know
                if names is not None:
                    raise
                remarks.append(f"{own} is left out: {said(error)}")
                continue
            if fields is None or node.size < 2:
                continue
            require_plain(node, path, own)
            size += float(node.size) * max(len(fields), node.dtype.itemsize / 8.0, 1.0)
            require_table(size, str(path))
            columns.extend(
                split(own, _physical(node, fields, attributes), unit=attributes.unit(node), joint=joint)
            )
    found = [own for own in columns if names is None or own.name in names]
    said_of = said_of_objects(objects, path, found, all_read=names is None)
    return Grid.of(str(path), found, [*said_of, *remarks])


def _data_sets(file: Any, path: Path) -> Iterator[tuple[str, Any]]:
    """Yield the data sets of a file by their places, each once; links to others and to other files are not followed."""
    import h5py

    def number(node: Any) -> Any:
        about = h5py.h5o.get_info(node.id)
        return about.fileno, about.addr

    seen = {number(file)}
    waiting = [("", file, iter(file))]
    while waiting:
        place, group, links = waiting[-1]
        name = next(links, None)
        if name is None:
            waiting.pop()
            continue
        if not place and name.startswith("#"):  # MATLAB's own
            continue
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        node = group[name]
        if number(node) in seen:
            continue
        seen.add(number(node))
        if isinstance(node, h5py.Dataset):
            yield f"{place}{name}", node
        elif isinstance(node, h5py.Group):
            if len(waiting) > _DEEPEST:
                raise InputError(f"{path}: has groups within groups, more than {_DEEPEST} deep")
            waiting.append((f"{place}{name}/", node, iter(node)))


def _fields(dtype: Any) -> list[str] | None:
    """Return the fields of records that hold numbers, none of plain numbers; None if nothing is a number."""
    if dtype.names is None:
        return [] if dtype.kind in "biuf" else None
    kinds = {name: dtype[name].base for name in dtype.names}
    return [
        name for name, own in kinds.items() if own.kind in "biuf" or (own.names and not own.hasobject)
    ] or None


def _physical(node: Any, fields: list[str], attributes: _Attributes) -> Any:
    """Return the values of a data set; netCDF packs them by a factor and an offset, and has numbers for none."""
    if fields:  # texts are not read, which may be anywhere in the file
        return node[()] if fields == list(node.dtype.names) else node.fields(fields)[()]
    values = node[()]
    factor, zero = (attributes.numbers(node, name) for name in ("scale_factor", "add_offset"))
    nothing = [own for name in ("_FillValue", "missing_value") for own in attributes.numbers(node, name)]
    if not (factor or zero or nothing):
        return values
    real = np.asarray(values, dtype=np.float64) * (factor or [1.0])[0] + (zero or [0.0])[0]
    return np.where(np.isin(values, nothing), np.nan, real)


class _Attributes:
    """The attributes of what is in a file."""

    def __init__(self, texts: Texts) -> None:
        self._texts = texts

    def of(self, node: Any, name: str) -> Any:
        """Return the values of an attribute; none where there is no such one, or it is longer than any of interest."""
        import h5py

        if name not in node.attrs:
            return np.zeros(0)
        stored = node.attrs.get_id(name)
        if (
            not 0 < stored.get_space().get_simple_extent_npoints() <= _LONGEST
            or stored.dtype.itemsize > _WIDEST
        ):
            return np.zeros(0)
        if stored.dtype.hasobject:
            text = self._texts.of(node, name) if h5py.check_string_dtype(stored.dtype) else ""
            if text is not None:
                return np.array([text], dtype=object)
        return np.asarray(node.attrs[name]).ravel()

    def numbers(self, node: Any, name: str) -> list[float]:
        """Return the numbers in an attribute; none where there is no such one."""
        value = self.of(node, name)
        return [float(own) for own in value] if value.dtype.kind in "biuf" else []

    def unit(self, node: Any) -> str:
        """Return the unit of a data set; empty where none is stated."""
        for name in _UNITS:
            value = self.of(node, name)
            if len(value):
                return _text(value[0]).partition(" since ")[0]  # a date stands behind those of times
        return ""


def _is_matlab(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(6) == b"MATLAB"


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
