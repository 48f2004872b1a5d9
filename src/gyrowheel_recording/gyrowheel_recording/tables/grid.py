"""The one type of table behind all formats: columns by name, each with its unit and its clock."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import require_room

BYTES_A_VALUE = 16  # as it is read, and as it is converted
_NONE = 9.905e37  # 9.91E+37 is no number, 9.9E+37 beyond the range (SCPI 1999, volume 1, 7.2.1.4)
_LONGEST_UNIT = 80  # characters
_WIDEST = 64  # columns of a matrix; a wider one is no table of signals
#: Cells that are no plain number: one with the other decimal sign, with signs between thousands, with its unit
#: behind it, a time of day or a date, or any other text.
Kind = Literal["decimal", "thousands", "unit", "clock", "text"]


@dataclass(frozen=True)
class Odd:
    """Cells of a column that are not numbers as the others are."""

    kind: Kind  # what they are
    text: str  # what stands there; of numbers, the first
    #: Their number, and the row of the first, from 0 on.
    count: int
    row: int


@dataclass(frozen=True)
class Column:
    """One column of a table."""

    name: str  # its name, as maps call it
    values: NDArray[Any]  # (n,): numbers, dates (``datetime64``) or texts
    unit: str = ""  # unit that the file states; empty where it states none
    clock: str = ""  # name of the column with the times of its rows; empty where the file states none
    #: Cells of a text that are no numbers, or are written in another way than the others.
    odd: tuple[Odd, ...] = ()

    @property
    def numeric(self) -> bool:
        """Whether it holds numbers."""
        return self.values.dtype.kind in "biuf"

    @property
    def dated(self) -> bool:
        """Whether it holds dates with times."""
        return self.values.dtype.kind == "M"


@dataclass(frozen=True)
class Grid:
    """A table that was read."""

    name: str  # name of the file, for messages
    #: Columns in the order of the file. Those of one clock have as many rows; others may have more or fewer.
    columns: Mapping[str, Column] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()  # what the reader left out, and why
    files: tuple[str, ...] = ()  # of several files as one table: what the names of their columns begin with
    lines: Sequence[int] = ()  # of a text: the line of each row, from 1 on
    #: Of a text: the first line of another length, how many cells it has, and how many it should have.
    uneven: tuple[int, int, int] | None = None

    @classmethod
    def of(cls, name: str, columns: Iterable[Column], remarks: Sequence[str] = ()) -> Grid:
        """Return a table of columns; a name that occurs again gets a number.

        Raises
        ------
        InputError
            If there is no column.
        """
        given, said = [], list(remarks)
        for column in columns:
            if len(column.unit) > _LONGEST_UNIT:
                said.append(f"{column.name}: a unit of {len(column.unit)} characters: not used")
                column = replace(column, unit="")
            own, none = _without_overflow(column)
            given.append(own)
            if none:
                said.append(f"{own.name}: {none} values of 9.91E+37 or so, by which instruments mean none")
        names = distinct(column.name for column in given)
        found = {name: replace(column, name=name) for name, column in zip(names, given, strict=True)}
        if not found:
            raise InputError(f"{name}: has no columns of numbers" + "".join(f"; {remark}" for remark in said))
        return cls(name, found, tuple(said))

    def cut(self, rows: Any) -> Grid:
        """Return some rows, a slice or their numbers; all columns must be of one clock. Those of texts stay."""
        own = {
            name: replace(column, values=column.values[rows]) if column.numeric or column.dated else column
            for name, column in self.columns.items()
        }
        return replace(self, columns=own)

    @property
    def rows(self) -> int:
        """Number of rows of the longest column."""
        return max(len(column.values) for column in self.columns.values())


def distinct(names: Iterable[str]) -> list[str]:
    """Return names that differ: one that occurs again gets a number."""
    counts: dict[str, int] = {}
    found: dict[str, None] = {}
    for name in names:
        own = name
        while own in found:
            counts[name] = counts.get(name, 1) + 1
            own = f"{name} ({counts[name]})"
        found[own] = None
    return list(found)


def _without_overflow(column: Column) -> tuple[Column, int]:
    """Return a column without the numbers by which SCPI says that there is none, and how many those are."""
    values = column.values
    if values.dtype.kind != "f" or not len(values):
        return column, 0
    none = np.abs(np.abs(values.astype(np.float64)) / _NONE - 1.0) < 2e-3
    count = int(np.count_nonzero(none))
    return (replace(column, values=np.where(none, np.nan, values)), count) if count else (column, 0)


def split(name: str, values: Any, *, unit: str = "", joint: str = ".") -> list[Column]:
    """Return an array as columns: a vector is one, a matrix has them along its shorter side, a record has fields.

    What holds neither numbers nor dates gives none.
    """
    array = np.asarray(values)
    if array.dtype.names:
        fields = [split(f"{name}{joint}{own}", array[own], unit="", joint=joint) for own in array.dtype.names]
        return [column for columns in fields for column in columns]
    if array.dtype.kind not in "biufM" or array.size < 2:
        return []
    if array.dtype.kind == "M":
        array = array.astype("datetime64[ns]")
    array = np.squeeze(array)
    if array.ndim == 1:
        return [Column(name, array, unit)]
    if array.ndim != 2:
        return []
    if array.shape[0] < array.shape[1]:
        array = array.T
    if array.shape[1] > _WIDEST:
        return []
    return [Column(f"{name}{joint}{k + 1}", array[:, k], unit) for k in range(array.shape[1])]


def require_table(values: float, where: str) -> None:
    """Refuse a table of more values than the memory may hold (`require_room`)."""
    require_room(BYTES_A_VALUE * values, f"{where}: its table")
