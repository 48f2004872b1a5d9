"""Parquet files and tables of arrow."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from gyrowheel_core.errors import InputError, one_line
from gyrowheel_recording.tables.grid import Column, Grid, require_table


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read a Parquet file (see `formats.read_grid`)."""
    try:
        # opened here: arrow refuses names of files that are not text
        with path.open("rb") as opened, pq.ParquetFile(opened) as file:
            there = file.schema_arrow.names
            wanted = list(there) if names is None else [name for name in there if name in names]
            # what the file claims of its size may be small: a column of one repeated value has hardly any bytes
            require_table(file.metadata.num_rows * len(wanted), str(path))
            return of_table(file.read(columns=wanted), str(path))
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path}: cannot be read: {one_line(error)}") from None


def of_table(table: Any, where: str) -> Grid:
    """Return a table of arrow."""
    columns = []
    while any(pa.types.is_struct(field.type) for field in table.schema):
        table = table.flatten()  # the fields of records, as record.field
    for name, values in zip(table.column_names, table.columns, strict=True):
        about = table.schema.field(name).metadata or {}
        unit = about.get(b"unit", b"").decode("utf-8", "replace")
        if pa.types.is_duration(values.type):
            unit = "s"
        columns.append(Column(name, as_numbers(plain(values)), "" if unit == "1" else unit))
    return Grid.of(where, columns)


def plain(values: Any) -> Any:
    """Return a column of arrow with categories as what they stand for, and durations in seconds."""
    if pa.types.is_dictionary(values.type):
        values = values.cast(values.type.value_type)
    if pa.types.is_duration(values.type):
        counts = values.cast(pa.duration("ns")).cast(pa.int64()).cast(pa.float64(), safe=False)
        return pc.divide(counts, 1e9)
    return values


def as_numbers(values: Any) -> Any:
    """Return a column of arrow as numbers with NaN where nothing stands, as dates, or as texts."""
    kind = values.type
    if pa.types.is_timestamp(kind):
        return values.cast(pa.timestamp("ns"), safe=False).to_numpy()
    if pa.types.is_null(kind):
        return np.full(len(values), np.nan)
    if pa.types.is_integer(kind) and not values.null_count:
        return values.to_numpy()
    if (
        pa.types.is_integer(kind)
        or pa.types.is_floating(kind)
        or pa.types.is_boolean(kind)
        or pa.types.is_decimal(kind)
    ):
        return values.cast(pa.float64(), safe=False).to_numpy()
    return np.array([_text(value) for value in values.slice(0, 1000)], dtype=object)


def _text(value: Any) -> str:
    """Return what a cell holds as text; empty where Python has nothing like it, as dates beyond the year 9999."""
    try:
        return str(value.as_py())
    except (ValueError, OverflowError, pa.ArrowException):
        return ""
