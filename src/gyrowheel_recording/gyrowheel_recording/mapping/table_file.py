"""The columns that a map names, as the file has them: a text as the map states that it is written, or as it seems."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

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
