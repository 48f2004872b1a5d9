"""Tables of text, as far as they can be read without being told how they are written."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.csv as pc

from gyrowheel_analysis.tables.grid import Column, Grid
from gyrowheel_analysis.tables.readers.arrow import as_numbers
from gyrowheel_analysis.tables.text import TextForm, form_of, plain_rows, text_of
from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.limits import require_room

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
    return rows_of(data, form, str(path), names)


def rows_of(data: bytes, form: TextForm, where: str, names: Sequence[str] | None = None) -> Grid:
    """Return the columns of a text of a known form. A row of another length is left out, and counted."""
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
    convert = pc.ConvertOptions(
        decimal_point=form.decimal, null_values=["", "nan", "NaN", "NAN", "#N/A", "NULL", "-"]
    )
    try:
        table = pc.read_csv(
            io.BytesIO(body), read_options=read_options, parse_options=parse, convert_options=convert
        )
    except pa.ArrowException as error:
        raise InputError(f"{where}: cannot be read: {one_line(error)}") from None
    wanted = [name for name in unique if names is None or name in names]
    columns = [
        Column(name, as_numbers(table.column(name)), unit)
        for name, unit in zip(unique, units, strict=True)
        if name in wanted
    ]
    remarks = [f"{left_out} rows of another length are left out"] if left_out else []
    return Grid.of(where, columns, remarks)
