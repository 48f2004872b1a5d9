"""Parquet and Feather files, and tables of arrow."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.ipc
import pyarrow.parquet as pq

from gyrowheel_core.errors import InputError, one_line
from gyrowheel_recording.tables.grid import Column, Grid, require_table

_NAMED: Final = 3  # columns, in a message
_SEEN: Final = 1000  # texts of a column, and characters of a text


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read a Parquet file (see `formats.read_grid`)."""
    try:
        with path.open("rb") as opened:  # opened here: arrow refuses names of files that are not text
            kinds = dict(_cells(pq.read_schema(opened)))
            sizes = {name: _size(kind) for name, kind in kinds.items() if names is None or name in names}
            wanted, others = ([name for name in sizes if bool(sizes[name]) is own] for own in (True, False))
            if others and names is not None:
                raise InputError(
                    f"{path}: column '{others[0]}' holds {kinds[others[0]]}; allowed: numbers and dates"
                )
            if not wanted:
                cells = ", ".join(f"{name} of {kinds[name]}" for name in others[:_NAMED])
                raise InputError(f"{path}: has no columns of numbers; its cells are {cells or 'none'}")
            # a repeated text takes its memory once
            texts = [name for name in wanted if _is_text(kinds[name])]
            with pq.ParquetFile(opened, read_dictionary=texts) as file:
                # what the file claims of its size may be small: a column of one repeated value has hardly any bytes
                require_table(file.metadata.num_rows * sum(sizes.values()), str(path))
                found = of_table(file.read(columns=wanted), str(path))
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {one_line(error)}") from None
    return _without(found, {name: kinds[name] for name in others})


def read_feather(path: Path, names: Sequence[str] | None) -> Grid:
    """Read a Feather file of version 2, a file of arrow (see `formats.read_grid`)."""
    try:
        with path.open("rb") as opened:
            table = pa.ipc.open_file(opened).read_all()
            table.validate(full=True)  # arrow trusts the places of texts in a file
            table = _flat(table)
            asked = [k for k, own in enumerate(table.schema) if names is None or own.name in names]
            wanted = [k for k in asked if _size(table.schema[k].type)]
            others = {own.name: own.type for own in map(table.schema.field, asked) if not _size(own.type)}
            found = of_table(table.select(wanted), str(path))  # by number: names may be there twice
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {one_line(error)}") from None
    return _without(found, others)


def _without(found: Grid, others: Mapping[str, Any]) -> Grid:
    """Return a table with remarks on columns that are left out, by their names and types."""
    left_out = [f"{name} is left out: its cells are of {kind}" for name, kind in others.items()]
    return replace(found, remarks=(*found.remarks, *left_out))


def _flat(table: Any) -> Any:
    """Return a table with the fields of records as columns, as record.field."""
    while any(pa.types.is_struct(field.type) for field in table.schema):
        table = table.flatten()
    return table


def _cells(fields: Iterable[Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the columns of a schema with their types; those of a record by its name and theirs."""
    for own in fields:
        if pa.types.is_struct(own.type):
            yield from _cells(own.type, f"{above}{own.name}.")
        else:
            yield f"{above}{own.name}", own.type


def _is_text(kind: Any) -> bool:
    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _size(kind: Any) -> float:
    """Return how many numbers a cell of a type takes the memory of; 0 for lists and bytes, which are no readings."""
    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    if _is_text(kind) or pa.types.is_null(kind):
        return 1.0
    plain = pa.types.is_primitive(kind) or pa.types.is_decimal(kind)
    return max(kind.bit_width / 64.0, 1.0) if plain else 0.0


def of_table(table: Any, where: str) -> Grid:
    """Return a table of arrow."""
    columns = []
    table = _flat(table)
    for name, values in zip(table.column_names, table.columns, strict=True):
        about = table.schema.field(name).metadata or {}
        unit = about.get(b"unit", b"").decode("utf-8", "replace")
        if pa.types.is_duration(values.type):
            unit = "s"
        if _is_text(values.type):
            values = _unquoted(values)
        if pa.types.is_dictionary(values.type) and _is_text(values.type):
            cells = values.slice(0, _SEEN).combine_chunks()
            values = pc.utf8_slice_codeunits(cells.dictionary, 0, _SEEN).take(cells.indices)
        if pa.types.is_time(values.type):
            unit = "s"
        columns.append(Column(name, as_numbers(plain(values)), "" if unit == "1" else unit))
    return Grid.of(where, columns)


def _unquoted(values: Any) -> Any:
    """Return texts as numbers where all of them are numbers; a repeated text is looked at once."""
    with contextlib.suppress(pa.ArrowException):
        if not pa.types.is_dictionary(values.type):
            return values.cast(pa.float64())
        parts = [own.dictionary.cast(pa.float64()).take(own.indices) for own in values.chunks]
        return pa.chunked_array(parts, pa.float64())
    return values


def plain(values: Any) -> Any:
    """Return a column of arrow with categories as what they stand for, and durations in seconds."""
    if pa.types.is_dictionary(values.type):
        values = values.cast(values.type.value_type)
    if pa.types.is_time(values.type):  # of day, from midnight on
        values = values.cast(pa.time64("ns")).cast(pa.int64()).cast(pa.float64(), safe=False)
        return pc.divide(values, 1e9)
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
    return np.array([_text(value) for value in values.slice(0, _SEEN)], dtype=object)


def _text(value: Any) -> str:
    """Return what a cell holds as text; empty where Python has nothing like it, as dates beyond the year 9999."""
    try:
        return str(value.as_py())
    except (ValueError, OverflowError, pa.ArrowException):
        return ""
