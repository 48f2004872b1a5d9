"""HDF5 files, and those of MATLAB from version 7.3 on, by h5py."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_recording.tables.grid import Column, Grid, require_table, split
from gyrowheel_recording.tables.readers import library_errors, object_remarks, short_message

#: Filters that come with HDF5 and h5py: GZIP, shuffling, checksums, two that pack whole numbers, LZF.
_FILTERS: Final = (1, 2, 3, 5, 6, 32000)
_CURE: Final = "; h5repack writes them into one file, packed by GZIP"


def require_plain(node: Any, path: Path, name: str) -> None:
    """Refuse a data set that is in other files, or packed by what must be looked for."""
    where = f"{path}: {name}"
    if node.is_virtual:
        raise InputError(
            f"{where}: its numbers are in other data sets (it is virtual), which are not read{_CURE}"
        )
    if node.external:
        raise InputError(
            f"{where}: its numbers are in another file (external storage), which is not read{_CURE}"
        )
    settings = node.id.get_create_plist()
    for k in range(settings.get_nfilters()):
        code, _, _, kind = settings.get_filter(k)
        if code not in _FILTERS:  # HDF5 would look for a program that unpacks it
            title = kind.decode("utf-8", "replace") if isinstance(kind, bytes) else str(kind)
            raise InputError(f"{where}: its numbers are packed by {title or code}, which is not read{_CURE}")


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

    with library_errors(path), h5py.File(path, "r") as file:
        found = _Found(path, names, _Attributes())
        for name, node in _data_sets(file, path):
            found.add(name, node)
    return found.grid()


class _Found:
    """The columns of the data sets of a file, as far as they were read."""

    def __init__(self, path: Path, names: Sequence[str] | None, attributes: _Attributes) -> None:
        self._path, self._names, self._attributes = path, names, attributes
        self._joint = "." if _is_matlab(path) else "/"
        self._columns: list[Column] = []
        self._objects: dict[str, str] = {}
        self._remarks: list[str] = []
        self._steps: dict[str, tuple[float, list[int]]] = {}
        self._size = 0.0

    def add(self, name: str, node: Any) -> None:
        """Add the columns of a data set, if it has numbers and is wanted."""
        own = name.replace("/", self._joint)
        if node.shape is None or node.ndim > 2 or not self._has_numbers(own, node):
            return
        place = own.rpartition(self._joint)[0] if self._attributes.is_frame(node) else own
        names = self._names
        if names is not None and not any(n == own or n.startswith(place + self._joint) for n in names):
            return
        try:
            fields = _fields(node.dtype)
        except TypeError as error:  # a type that NumPy does not know
            if names is not None:
                raise
            self._remarks.append(f"{own} is left out: {short_message(error)}")
            return
        if fields and "values_block_0" in fields:
            self._remarks.append(
                f"{own}: a data frame of pandas in the format 'table', whose names are a program of Python: save it in "
                "the format 'fixed', or as Parquet"
            )
        if fields is None or node.size < 2 or self._attributes.numbers(node, "MATLAB_empty") == [1.0]:
            return
        try:
            require_plain(node, self._path, own)
        except InputError as error:
            if names is not None:
                raise
            self._remarks.append(f"{str(error).removeprefix(f'{self._path}: ')}: left out")
            return
        self._size += float(node.size) * max(len(fields), node.dtype.itemsize / 8.0, 1.0)
        require_table(self._size, str(self._path))
        values = _physical(node, fields, self._attributes)
        turned = self._joint == "." and values.ndim == 2
        several = split(own, values.T if turned else values, joint=self._joint)
        head = f"{place}{self._joint}"
        self._columns.extend(_described(several, node, head, self._attributes, self._remarks))
        if several and (step := self._attributes.step(node)):
            last = len(self._columns)
            # vectors of one group, as long as each other, have one clock
            place = own if len(several) > 1 else own.rpartition(self._joint)[0]
            clock = self._joint.join(part for part in (place, "time") if part)
            stated, columns = self._steps.setdefault(clock, (step, []))
            if stated == step and (not columns or self._length(columns[0]) == self._length(last - 1)):
                columns.extend(range(last - len(several), last))

    def _length(self, column: int) -> int:
        return len(self._columns[column].values)

    def _has_numbers(self, own: str, node: Any) -> bool:
        """Whether a data set is none of MATLAB's objects and texts."""
        kind = "".join(_text(value) for value in self._attributes.of(node, "MATLAB_class")[:1])
        if not kind or kind in _NUMBERS:
            return True
        if kind not in _TEXTS:
            self._objects[own] = kind
        return False

    def grid(self) -> Grid:
        """Return the wanted columns with their clocks."""
        names = self._names
        self._add_clocks()
        wanted = {own.name for own in self._columns if names is None or own.name in names}
        wanted |= {own.clock for own in self._columns if own.name in wanted}
        found = [own for own in self._columns if own.name in wanted]
        said_of = object_remarks(self._objects, self._path, found, all_read=names is None)
        return Grid.of(str(self._path), found, [*said_of, *self._remarks])

    def _add_clocks(self) -> None:
        """Add the times of matrices whose rate or step is stated, unless the file has times."""
        for clock, (step, several) in self._steps.items():
            rows = self._length(several[0])
            if self._names is not None and clock not in self._names:
                continue
            same = (own.values for own in self._columns if len(own.values) == rows)
            if self._names is None and any(_are_times(own, step) for own in same):
                continue  # the file has the times themselves
            self._columns.append(Column(clock, step * np.arange(rows), "s", clock))
            for k in several:
                self._columns[k] = replace(self._columns[k], clock=clock)


#: Attributes of a matrix with the names of its columns; of it, its group or its file with the rate or the step.
_LABELS: Final = (
    "channel_names", "column_names", "names", "columns", "channels", "labels", "headers", "col_names",
)  # fmt: skip
_RATES: Final = (
    "sample_rate", "sampling_rate", "samplerate", "sampling_frequency", "fs", "Fs", "rate_hz", "sample_rate_hz",
    "sampling_rate_hz", "fs_hz",
)  # fmt: skip
_STEPS: Final = ("dt", "sample_period", "sampling_period", "sampling_interval", "delta_t", "wf_increment")


_SECOND: Final = (1.0, 1e3, 1e6, 1e9, 1.0 / 60.0, 1.0 / 3600.0, 1.0 / 86400.0)  # in usual units of times


def _are_times(values: Any, step: float) -> bool:
    """Whether a column has the times of rows that are a step [s] apart, in a usual unit."""
    steps = np.diff(values.astype(np.float64))
    if not len(steps) or not np.all(steps > 0.0):
        return False
    usual = float(np.median(steps)) / step
    return any(abs(usual / unit - 1.0) < _AS_STATED for unit in _SECOND)


_AS_STATED: Final = 0.01  # part by which the times of a file may differ from its rate


def _described(
    several: list[Column], node: Any, place: str, attributes: _Attributes, remarks: list[str]
) -> Iterator[Column]:
    """Yield the columns of a data set by the names and units that the file states for it."""
    units, labels = (_listed(own, len(several)) for own in (attributes.units(node), attributes.labels(node)))
    if len(labels) != len(several):
        labels = []
    if len(units) not in (0, 1, len(several)):
        remarks.append(f"{place[:-1]}: {len(units)} units are stated for {len(several)} columns: not used")
        units = []
    for k, column in enumerate(several):
        unit = (
            units[k % len(units)].partition(" since ")[0] if units else ""
        )  # a date stands behind those of times
        yield replace(column, name=f"{place}{labels[k]}" if labels else column.name, unit=unit)


def _listed(texts: list[str], count: int) -> list[str]:
    """Return texts, of which one may be a list of them with commas or semicolons between."""
    for sign in ",;\t" if len(texts) == 1 < count else "":
        if len(parts := texts[0].split(sign)) == count:
            return [part.strip() for part in parts]
    return texts


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
        if stored.dtype.hasobject and not h5py.check_string_dtype(stored.dtype):
            return np.zeros(0)
        return np.asarray(node.attrs[name]).ravel()

    def numbers(self, node: Any, name: str) -> list[float]:
        """Return the numbers in an attribute; none where there is no such one."""
        value = self.of(node, name)
        return [float(own) for own in value] if value.dtype.kind in "biuf" else []

    def texts(self, node: Any, names: Sequence[str]) -> list[str]:
        """Return the texts in the first of some attributes that has any; none where there is no such one."""
        for name in names:
            value = self.of(node, name)
            if len(value) and value.dtype.kind in "OSU":
                return [_text(own) for own in value]
        return []

    def labels(self, node: Any) -> list[str]:
        """Return the names of the columns of a matrix; none where the file states none."""
        if not self.is_frame(node):
            return self.texts(node, _LABELS) or self._beside(node, _LABELS)
        return self._beside(node, [node.name.rpartition("/")[2].replace("_values", "_items")])

    def units(self, node: Any) -> list[str]:
        """Return the units that the file states for a data set; none where it states none."""
        return self.texts(node, _UNITS) or (self._beside(node, _UNITS) if node.ndim == 2 else [])

    def _beside(self, node: Any, names: Sequence[str]) -> list[str]:
        """Return the texts in the first of some data sets that is there in the group of another one."""
        for name in names:
            items = node.parent.get(name)
            texts = items is not None and hasattr(items, "dtype") and items.dtype.kind == "S"
            if texts and items.ndim == 1 and items.nbytes <= _WIDEST:
                return [_text(own) for own in items[()]]
        return []

    def is_frame(self, node: Any) -> bool:
        """Whether a data set has numbers of a data frame of pandas, whose names stand in another one."""
        name = node.name.rpartition("/")[2]
        return name.startswith("block") and name.endswith("_values") and "pandas_type" in node.parent.attrs

    def step(self, node: Any) -> float:
        """Return the time between rows [s] that is stated for a data set, its group or its file; 0 if none is."""
        for place in (node, node.parent, node.file):
            for names, by_rate in ((_RATES, True), (_STEPS, False)):
                for name in names:
                    value = self.numbers(place, name)
                    if len(value) == 1 and math.isfinite(value[0]) and value[0] > 0.0:
                        return 1.0 / value[0] if by_rate else value[0]
        return 0.0


def _is_matlab(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(6) == b"MATLAB"


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
