"""Tables of text, as far as they can be read without being told how they are written."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc

from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.limits import require_room
from gyrowheel_recording.tables.cells import dates_of, numbers_of
from gyrowheel_recording.tables.grid import Column, Grid
from gyrowheel_recording.tables.readers.arrow import as_numbers
from gyrowheel_recording.tables.text import EMPTY, TextForm, form_of, plain_rows, text_of

_TEXT_TO_MEMORY: Final = 2.0  # a short number takes more bytes in memory than in a text
_HEAD: Final = 1 << 18


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read a text as it seems to be written (see `formats.read_grid`)."""
    try:
        data = text_of(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or one_line(error)}") from None
    require_room(_TEXT_TO_MEMORY * len(data), f"{path}: it")
    form = form_of(data[:_HEAD], str(path), whole=len(data) <= _HEAD)
    try:
        data.decode(form.encoding)
    except UnicodeDecodeError as error:  # further down than was looked at
        if form.encoding != "utf-8":
            raise InputError(f"{path}: cannot be read: {one_line(error)}") from None
        form = replace(form, encoding="latin-1")
    return rows_of(data, form, str(path), names)


def rows_of(data: bytes, form: TextForm, where: str, names: Sequence[str] | None = None) -> Grid:
    """Return the columns of a text of a known form.

    A row of another length is left out, and so is one that repeats the names; both are counted. A column with numbers
    in most of its cells is one of numbers, whatever stands in the others.
    """
    left_out = 0

    def note(row: Any) -> str:
        nonlocal left_out
        left_out += 1
        return "skip"

    units = form.units or ("",) * len(form.names)
    unique: list[str] = []
    for name in form.names:  # arrow needs names that differ
        own, count = name or "column", 1
        while own in unique:
            count += 1
            own = f"{name} ({count})"
        unique.append(own)
    body = plain_rows(data, form)
    read_options = pc.ReadOptions(skip_rows=1, column_names=unique, block_size=1 << 24)
    parse = pc.ParseOptions(delimiter=form.delimiter, invalid_row_handler=note)

    def read(types: dict[str, Any]) -> Any:
        nonlocal left_out
        left_out = 0
        convert = pc.ConvertOptions(
            decimal_point=form.decimal,
            null_values=list(EMPTY),
            strings_can_be_null=True,
            column_types=types,
            include_columns=[name for name in unique if names is None or name in names],
        )
        return pc.read_csv(
            io.BytesIO(body), read_options=read_options, parse_options=parse, convert_options=convert
        )

    try:
        try:
            table = read({})
        except pa.ArrowInvalid:  # a text behind the first million numbers
            table = read(dict.fromkeys(unique, pa.string()))
    except pa.ArrowException as error:
        raise InputError(f"{where}: cannot be read: {one_line(error)}") from None
    columns = [
        _column(name, table.column(name), unit, form.decimal)
        for name, unit in zip(unique, units, strict=True)
        if name in table.column_names
    ]
    remarks = [f"{left_out} rows of another length are left out"] if left_out else []
    if repeated := _repeated_names(data, form):
        remarks.append(f"{repeated} lines that repeat the names are left out")
    return Grid.of(where, columns, remarks)


def _column(name: str, values: Any, unit: str, decimal: str) -> Column:
    """Return a column as it was read: of numbers, where most of its cells are numbers or times of day."""
    if pa.types.is_time(values.type):
        values = values.cast(pa.string())
    if not pa.types.is_string(values.type):
        return Column(name, as_numbers(values), unit)
    numbers, odd = numbers_of(values, decimal)
    clock = sum(own.count for own in odd if own.kind == "clock")
    known = len(values) - values.null_count
    if clock == known > 0 and (dates := dates_of(values)) is not None:
        return Column(name, as_numbers(dates), unit)
    if 2 * (int(np.isfinite(numbers).sum()) + clock) > known:
        return Column(name, numbers, unit, odd=odd)
    return Column(name, as_numbers(values), unit)


def _repeated_names(data: bytes, form: TextForm) -> int:
    """Return how often the line of names stands in a text once more."""
    if not form.named:
        return 0
    lines = data.decode(form.encoding).splitlines()
    return lines.count(lines[form.skip_lines]) - 1
