"""The columns that a map names, as the file has them: a text as the map states that it is written, or as it seems.

Several instruments may share the columns of time, each with values only in its own rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.errors import InputError
from gyrowheel_recording.mapping.map_file import TIMESTAMP, ColumnMap
from gyrowheel_recording.tables import Grid, form_of_file, format_of, read_grid
from gyrowheel_recording.tables.readers import text_table


def read_columns(path: Path, column_map: ColumnMap, grid: Grid | None = None) -> Grid:
    """Return the columns that a map names, and their clocks; `grid` has them where the table is no file.

    Raises InputError if the file cannot be read, a column is not there, or a text has other cells than the map allows.
    """
    if grid is None and format_of(path).name == "text":
        return _read_text(path, column_map)
    found = read_grid(path, column_map.names) if grid is None else grid
    _require_columns(path, column_map, list(found.columns))
    return found


def _read_text(path: Path, column_map: ColumnMap) -> Grid:
    settings = column_map.csv.model_dump(exclude_unset=True) if column_map.csv is not None else {}
    missing = settings.pop("missing", [])
    try:
        form = form_of_file(path, settings)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    for name in column_map.names:
        if form.names.count(name) > 1:
            raise InputError(f"{path}: {form.names.count(name)} columns are called '{name}'; allowed: one")
    _require_columns(path, column_map, text_table.names_of(form))
    found = text_table.read(path, column_map.names, settings, missing)
    if found.uneven is not None:
        line, count, usual = found.uneven
        raise InputError(f"{path}: line {line}: {count} columns; allowed: {usual}, as in the line of names")
    _require_numbers(path, column_map, found)
    return found


def _require_columns(path: Path, column_map: ColumnMap, there: Sequence[str]) -> None:
    """Refuse a file in which a column that the map names is not there."""
    for name in column_map.names:
        if name not in there:
            raise InputError(
                f"{path}: no column '{name}', which {column_map.origin} names; there are: {', '.join(there)}"
            )


def _require_numbers(path: Path, column_map: ColumnMap, grid: Grid) -> None:
    """Refuse a text with cells that are no plain numbers, or no dates where the map has dates."""
    wrong = []
    for name, column in grid.columns.items():
        if name == column_map.time.column and column_map.time.unit == TIMESTAMP:
            if not column.dated:
                text = (
                    column.odd[0].text
                    if column.odd
                    else next((str(own) for own in column.values if str(own)), "")
                )
                raise InputError(
                    f"{path}: column '{name}': dates such as '{text[:40]}' cannot be read; allowed: dates with times, "
                    "as 2026-05-04T10:00:00.0005 or 4.5.2026 10:00:00.0005, all with a zone behind them or none"
                )
        elif column.odd:
            first = min(column.odd, key=lambda own: own.row)
            wrong.append(f"column '{name}', line {grid.lines[first.row]}: '{first.text}' is not allowed")
        elif not column.numeric and not column.dated:
            row = next((k for k, own in enumerate(column.values) if str(own)), 0)
            wrong.append(f"column '{name}', line {grid.lines[row]}: '{column.values[row]}' is not allowed")
    if wrong:
        raise InputError(
            f"{path}: {'; '.join(wrong)}; allowed: a number, or a word that `csv: {{missing: [...]}}` in the map takes "
            "for none"
        )


Array = NDArray[np.float64]

_SPARSE = 0.5  # part of the rows of samples; a slow reading with more values has holes, and no separate rows
#: Smallest part of the rows that are no samples, where slow readings stand in rows of samples, too.
_FEWEST = 0.02
_BRIDGED = 4.5  # usual distances of rows with values; a wider gap is a hole


def sample_rows(fast: Mapping[str, Array], slow: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Return which rows of a table are samples: some have values of slow readings alone.

    `fast` and `slow` have the values (n,) of all readings, NaN where a value is missing.
    """
    every = next(iter([*fast.values(), *slow.values()]))
    if not fast or not slow:
        return np.ones(len(every), dtype=bool)
    samples = np.logical_or.reduce([np.isfinite(values) for values in fast.values()])
    others = np.logical_or.reduce([np.isfinite(values) for values in slow.values()]) & ~samples
    apart = not any(np.isfinite(values[samples]).any() for values in slow.values())
    fewest = 2.0 if apart else max(_FEWEST * len(every), 1.0)
    if np.count_nonzero(samples) < 2 or np.count_nonzero(others) < fewest:
        return np.ones(len(every), dtype=bool)
    return np.asarray(samples | ~others)


def interpolated(time: Array, values: Array, samples: NDArray[np.bool_]) -> Array | None:
    """Return a slow reading with separate rows, interpolated to the rows of samples; None for any other reading.

    It stays NaN within gaps of its rows.
    """
    known = np.isfinite(values)
    if float(np.mean(known[samples])) > _SPARSE or np.count_nonzero(known) < 2:
        return None
    there = time[known]
    usual = float(np.median(np.diff(there)))
    when = time[samples]
    after = np.clip(np.searchsorted(there, when), 1, len(there) - 1)
    hole = there[after] - there[after - 1] > _BRIDGED * usual
    outside = (when < there[0] - _BRIDGED * usual) | (when > there[-1] + _BRIDGED * usual)
    inside = (when > there[after - 1]) & (when < there[after])
    return np.where(outside | (hole & inside), np.nan, np.interp(when, there, values[known]))
