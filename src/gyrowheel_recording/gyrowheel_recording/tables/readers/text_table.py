"""Tables of text: numbers, dates and odd cells, as far as they are read without a map."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from pyarrow import csv

from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.files import require_room
from gyrowheel_recording.tables.grid import Column, Grid, Odd, distinct
from gyrowheel_recording.tables.readers.arrow import as_numbers
from gyrowheel_recording.tables.text import (
    EMPTY,
    LIKE_PLAIN,
    TextForm,
    form_of,
    has_empty_rows,
    needs_no_change,
    one_byte_encoding,
    plain_rows,
    text_of,
)

_EXPONENT: Final = r"([eEdD][-+]?\d+)?"
_MOST: Final = 8  # different texts that are reported


def numbers_of(
    values: Any, decimal: str, missing: Sequence[str] = ()
) -> tuple[NDArray[np.float64], tuple[Odd, ...]]:
    """Return a column of texts (null: empty) as numbers, NaN where a cell is none, and the odd cells.

    Numbers that are written in another way than the rest are read, and reported. `missing` are words for none.
    """
    texts = values.cast(pa.string()).combine_chunks()
    if not pc.all(pc.string_is_ascii(texts)).as_py():  # null where there are no cells
        for own, other in LIKE_PLAIN.items():
            texts = pc.replace_substring(texts, own, other)
    texts = pc.utf8_trim(texts, characters=" \t\r\n")
    result = np.full(len(texts), np.nan)
    empty = pc.or_(texts.is_null(), pc.is_in(texts, pa.array([*EMPTY, *missing])))
    left = ~np.asarray(empty.to_numpy(zero_copy_only=False))
    odd: list[Odd] = []
    for kind, pattern, change in _cell_kinds(decimal):
        found = left & np.asarray(
            pc.fill_null(pc.match_substring_regex(texts, pattern), False).to_numpy(zero_copy_only=False)
        )
        rows = np.flatnonzero(found)
        if not len(rows):
            continue
        left &= ~found
        if kind != "clock":
            own = texts.take(pa.array(rows))
            for old, new in change:
                own = pc.replace_substring_regex(own, old, new)
            result[rows] = _floats(own)
        if kind:
            odd.append(Odd(kind, str(texts[int(rows[0])]), len(rows), int(rows[0])))
    rest = np.flatnonzero(left)
    words: dict[str, list[int]] = {}
    for row in rest.tolist():
        words.setdefault(str(texts[row]), []).append(row)
    for text, rows_of_it in sorted(words.items(), key=lambda item: -len(item[1]))[:_MOST]:
        odd.append(Odd("text", text, len(rows_of_it), rows_of_it[0]))
    return result, tuple(odd)


#: How dates that leave no doubt which number is the month become those of ISO 8601: day.month.year, and year/month/day.
_TO_ISO: Final = (
    (r"^(\d)\.", r"0\1."),
    (r"^(\d\d)\.(\d)\.", r"\1.0\2."),
    (r"^(\d\d)\.(\d\d)\.(\d{4})[ T,;]+", r"\3-\2-\1T"),
    (r"^(\d{4})[/.](\d\d)[/.](\d\d)[ T,;]+", r"\1-\2-\3T"),
    (r",(\d+)", r".\1"),
)


#: Names of months, English and German, as far as they tell one from another.
_MONTHS: Final = (
    "jan", "feb", "mar|mär|mrz", "apr", "may|mai", "jun", "jul", "aug", "sep", "oct|okt", "nov", "dec|dez",
)  # fmt: skip
_NAMED: Final = r"\d{1,2}[-. /]+\pL{3,9}\.?[-., /]+\d{4}|\pL{3,9}\.? \d{1,2},? \d{4}"
_SLASHES: Final = r"^(?P<one>\d{1,2})/(?P<two>\d{1,2})/\d{4}"


def _with_numbers(values: Any) -> Any:
    """Return dates with names of months, without signs between the digits, or with slashes as those with points.

    Of two numbers between slashes the one that is beyond 12 somewhere in the column is the day; where neither is,
    the dates stay as they are.
    """
    if pc.any(pc.match_substring_regex(values, f"^({_NAMED})")).as_py():
        for month, names in enumerate(_MONTHS, 1):
            values = pc.replace_substring_regex(
                values, rf"(?i)^(\d{{1,2}})[-. /]+(?:{names})\pL*\.?[-., /]+(\d{{4}})", rf"\1.{month}.\2"
            )
            values = pc.replace_substring_regex(
                values, rf"(?i)^(?:{names})\pL*\.? (\d{{1,2}}),? (\d{{4}})", rf"\1.{month}.\2"
            )
    values = pc.replace_substring_regex(
        values, r"^(\d{4})(\d\d)(\d\d)T(\d\d)(\d\d)(\d\d)", r"\1-\2-\3T\4:\5:\6"
    )
    values = pc.replace_substring_regex(values, r"(:\d\d:\d\d):(\d{3,9})$", r"\1.\2")
    part = pc.extract_regex(
        values.combine_chunks() if hasattr(values, "combine_chunks") else values, _SLASHES
    )
    if len(part) and part.null_count == values.null_count < len(part):
        one, two = (pc.max(pc.cast(part.field(name), pa.int64())).as_py() or 0 for name in ("one", "two"))
        if (one > 12) != (two > 12):
            turned = r"\1.\2.\3" if one > 12 else r"\2.\1.\3"
            values = pc.replace_substring_regex(values, r"^(\d{1,2})/(\d{1,2})/(\d{4})", turned)
    return values


def dates_of(values: Any) -> Any:
    """Return a column of texts as dates with times, or None if one of them is no date.

    `values`: texts; null where a cell is empty. Dates as in ISO 8601, all with a zone behind them or none, or
    as in `_TO_ISO` and `_with_numbers`. 05/04/2026 is ambiguous, and refused, but before a time with AM or PM.
    """
    values = _of_24_hours(_with_numbers(values))
    for _ in range(2):
        for zone in (None, "UTC"):
            with contextlib.suppress(pa.ArrowException):
                return values.cast(pa.timestamp("ns", zone))
        for old, new in _TO_ISO:
            values = pc.replace_substring_regex(values, old, new)
    return None


_OF_DAY: Final = r"^(?P<h>[01]?\d|2[0-3]):(?P<m>[0-5]\d):(?P<s>[0-5]\d(?:[.,]\d+)?)$"
_DAY: Final = 86400.0  # s


def times_of_day(values: Any) -> tuple[NDArray[np.float64], list[int]] | None:
    """Return times of day (hh:mm:ss) as seconds from the first midnight on, and the rows that begin a new day.

    None if a cell is anything else. A step back by more than half a day is midnight; a smaller one stays one, as where
    a clock is set.
    """
    part = pc.extract_regex(_with_numbers(values).combine_chunks(), _OF_DAY)
    if part.null_count or not len(part):
        return None
    hours, minutes, seconds = (
        _floats(pc.replace_substring(part.field(name), ",", ".")) for name in ("h", "m", "s")
    )
    time = 3600.0 * hours + 60.0 * minutes + seconds
    begins = np.flatnonzero(np.diff(time) < -0.5 * _DAY) + 1
    time += _DAY * np.searchsorted(begins, np.arange(len(time)), side="right")
    return time, begins.tolist()


_HALF_DAY: Final = (
    r"^(?P<date>.*?)[ T,;]*(?P<hour>\d{1,2})(?P<rest>:\d{2}(?::\d{2}(?:[.,]\d+)?)?)"
    r" ?(?P<half>[AaPp])\.?[Mm]\.?$"
)


def _of_24_hours(values: Any) -> Any:
    """Return dates with times of 12 hours, AM or PM, as such of 24 hours; others as they are."""
    if not values.null_count < len(values) or not pc.all(pc.match_substring_regex(values, _HALF_DAY)).as_py():
        return values
    part = pc.extract_regex(
        values.combine_chunks() if hasattr(values, "combine_chunks") else values, _HALF_DAY
    )
    date, hour, rest, half = (part.field(name) for name in ("date", "hour", "rest", "half"))
    hours = pc.cast(pc.if_else(pc.equal(hour, ""), "0", hour), pa.int64())
    hours = pc.subtract(hours, pc.multiply(12, pc.cast(pc.equal(hours, 12), pa.int64())))
    hours = pc.add(hours, pc.multiply(12, pc.cast(pc.equal(pc.utf8_lower(half), "p"), pa.int64())))
    for old, new in (
        (r"^(\d)/", r"0\1/"), (r"^(\d\d)/(\d)/", r"\1/0\2/"), (r"^(\d\d)/(\d\d)/(\d{4})$", r"\3-\1-\2"),
    ):  # fmt: skip
        date = pc.replace_substring_regex(date, old, new)
    text = pc.utf8_lpad(pc.cast(hours, pa.string()), 2, "0")
    joined = pc.binary_join_element_wise(date, pc.binary_join_element_wise(text, rest, ""), " ")
    return pc.if_else(pc.equal(rest, ""), None, joined)


def _floats(texts: Any) -> NDArray[np.float64]:
    """Return texts of plain numbers as such; one beyond all numbers is infinite."""
    try:
        return np.asarray(texts.cast(pa.float64()).to_numpy(zero_copy_only=False))
    except pa.ArrowInvalid:
        return np.array([float(text) for text in texts.to_pylist()])


def _cell_kinds(decimal: str) -> list[tuple[Any, str, list[tuple[str, str]]]]:
    """Return the ways to read a cell, the plain one first: its kind, its pattern, and what makes it a plain number."""
    other = "," if decimal == "." else "."
    own, foreign = (rf"[-+]?(\d+[{sign}]?\d*|[{sign}]\d+){_EXPONENT}" for sign in (decimal, other))
    exponent, plus = ("[dD]", "e"), (r"^\+", "")  # neither is known to arrow
    return [
        ("", f"^{own}$", [(rf"[{decimal}]", "."), exponent, plus]),
        (
            "thousands",
            rf"^[-+]?(\d{{1,3}}([{other}' ]\d{{3}})+[{decimal}]\d*|\d{{1,3}}([' ]\d{{3}})+){_EXPONENT}$",
            [(rf"[{other}' ]", ""), (rf"[{decimal}]", "."), plus],
        ),
        ("decimal", f"^{foreign}$", [(rf"[{other}]", "."), exponent, plus]),
        (
            "unit",
            rf"^{own}\s*[A-Za-zµμ°Ω%/]+$",
            [(r"\s*[A-Za-zµμ°Ω%/]+$", ""), (rf"[{decimal}]", "."), exponent, plus],
        ),
        (
            "clock",
            rf"^(((\d{{1,4}}[-./]\d{{1,2}}[-./]\d{{1,4}}|{_NAMED})[ T,;]*)?"
            r"\d{1,2}:\d{2}(:\d{2}([.,:]\d+)?|[.,]\d+)?( ?[AaPp][Mm])?|\d{8}T\d{6}([.,]\d+)?)(Z|[-+]\d{2}(:?\d{2})?)?$",
            [],
        ),
    ]


def _one_unit(values: Any) -> str:
    """Return the unit behind all numbers of a column of texts; empty where they have several."""
    numbers = pc.filter(values, pc.match_substring_regex(values, r"^\s*[-+]?[.,]?\d"))
    behind = pc.replace_substring_regex(numbers, r"^\s*[-+]?[\d.,]+([eE][-+]?\d+)?", "")
    units = pc.unique(pc.utf8_trim_whitespace(behind)).to_pylist()
    return str(units[0]) if len(units) == 1 else ""


_TEXT_TO_MEMORY: Final = 2.0  # a short number takes more bytes in memory than in a text
_HEAD: Final = 1 << 18


def read(
    path: Path,
    names: Sequence[str] | None,
    given: Mapping[str, Any] = MappingProxyType({}),
    missing: Sequence[str] = (),
) -> Grid:
    """Read a text as it seems to be written (see `formats.read_grid`), as far as it is not `given`.

    `given` are fields of `TextForm`, `missing` are words that stand for no number.
    """
    try:
        data = text_of(path)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or one_line(error)}") from None
    require_room(_TEXT_TO_MEMORY * len(data), f"{path}: it")
    form = form_of(data[:_HEAD], str(path), whole=len(data) <= _HEAD, given=given)
    try:
        data.decode(form.encoding)
    except UnicodeDecodeError as error:  # further down than was looked at
        if form.encoding != "utf-8" or "encoding" in given:
            raise InputError(f"{path}: cannot be read: {one_line(error)}") from None
        form = replace(form, encoding=one_byte_encoding(data))
    return rows_of(data, form, str(path), names, missing)


def rows_of(
    data: bytes,
    form: TextForm,
    where: str,
    names: Sequence[str] | None = None,
    missing: Sequence[str] = (),
) -> Grid:
    """Return the columns of a text of a known form.

    A row of another length is left out, and so is one that repeats the names; both are counted. A column with numbers
    in most of its cells is one of numbers, whatever stands in the others.
    """
    unique = names_of(form)
    beginning = data[:_HEAD].decode(form.encoding, "ignore")
    begin = form.skip_lines + 1 + form.unit_lines
    found, repeated = None, 0
    unchanged = form.encoding in ("utf-8", "utf-8-sig") and needs_no_change(beginning, form)
    if unchanged and not has_empty_rows(data, form):
        found = _Rows(data, begin, unique, form, names, missing).read()
        plain = found is not None and not any(pa.types.is_string(column.type) for column in found[0].columns)
        lines: Sequence[int] = range(begin + 1, begin + 1 + (found[0].num_rows if found is not None else 0))
        if not plain or (found is not None and found[1]):
            found = None  # words in it may be lines that are no rows
    if found is None:
        body, lines, repeated = plain_rows(data, form)
        found = _Rows(body, 0, unique, form, names, missing).read()
        if found is None:
            raise InputError(f"{where}: cannot be read: its rows are not those of a table")
    table, wrong = found
    unit_of = dict(zip(unique, form.units or ("",) * len(unique), strict=True))
    remarks: list[str] = []
    columns = [
        _column(name, values, unit_of[name], form.decimal, missing, remarks)
        for name, values in zip(table.column_names, table.columns, strict=True)
    ]
    uneven = None
    if wrong:
        left_out = {row for row, _ in wrong}
        row, count = wrong[0]
        if [row for row, _ in wrong] == [len(lines)]:
            remarks.append("the last line breaks off: it is left out")
        else:
            remarks.append(f"{len(wrong)} rows of another length are left out")
            uneven = lines[row - 1], count, len(unique)
        lines = [line for k, line in enumerate(lines, 1) if k not in left_out]
    if repeated:
        remarks.append(f"{repeated} lines that repeat the names are left out")
    return replace(Grid.of(where, columns, remarks), lines=lines, uneven=uneven)


def names_of(form: TextForm) -> list[str]:
    """Return the names by which maps call the columns of a text: each once, a number behind one that comes again."""
    return distinct(name or "column" for name in form.names)


class _Rows:
    """Rows of a text as arrow reads them."""

    def __init__(
        self,
        body: bytes,
        skipped: int,
        unique: Sequence[str],
        form: TextForm,
        names: Sequence[str] | None,
        missing: Sequence[str],
    ) -> None:
        self._body, self._form, self._missing = body, form, missing
        self._names = list(unique)
        self._wanted = [name for name in unique if names is None or name in names]
        self._skipped = skipped

    def read(self) -> tuple[Any, list[tuple[int, int]]] | None:
        """Return the columns, and the rows of another length: number from 1 on, and cells; None if arrow cannot."""
        for types in ({}, dict.fromkeys(self._names, pa.string())):  # a text behind the first million numbers
            try:
                wrong: list[Any] = []
                table = self._table(types, wrong, threads=True)
                if wrong:  # rows are counted by one thread alone
                    wrong = []
                    table = self._table(types, wrong, threads=False)
                return table, [(row.number - self._skipped, row.actual_columns) for row in wrong]
            except pa.ArrowInvalid:
                continue
        return None

    def _table(self, types: dict[str, Any], wrong: list[Any], *, threads: bool) -> Any:
        def note(row: Any) -> str:
            wrong.append(row)
            return "skip"

        return csv.read_csv(
            io.BytesIO(self._body),
            read_options=csv.ReadOptions(
                skip_rows=self._skipped, column_names=self._names, block_size=1 << 24, use_threads=threads
            ),
            parse_options=csv.ParseOptions(delimiter=self._form.delimiter, invalid_row_handler=note),
            convert_options=csv.ConvertOptions(
                decimal_point=self._form.decimal,
                null_values=[*EMPTY, *self._missing],
                strings_can_be_null=True,
                column_types=types,
                include_columns=self._wanted,
            ),
        )


def _column(
    name: str, values: Any, unit: str, decimal: str, missing: Sequence[str], remarks: list[str]
) -> Column:
    """Return a column as it was read: of numbers, where most of its cells are numbers or times of day."""
    if pa.types.is_time(values.type):
        values = values.cast(pa.string())
    if not pa.types.is_string(values.type):
        return Column(name, as_numbers(values), unit)
    numbers, odd = numbers_of(values, decimal, missing)
    clock = sum(own.count for own in odd if own.kind == "clock")
    known = len(values) - values.null_count
    if clock == known > 0 and (dates := dates_of(values)) is not None:
        return Column(name, as_numbers(dates), unit)
    if clock == known == len(values) and (of_day := times_of_day(values)) is not None:
        time, begins = of_day
        midnight = f"; midnight before row {begins[0] + 1}" if begins else ""
        remarks.append(f"{name}: times of day without a date: read as seconds from midnight{midnight}")
        return Column(name, time, "s")
    words = tuple(own for own in odd if own.kind == "text")
    in_cells = sum(own.count for own in odd if own.kind == "unit") + sum(own.count for own in words)
    if (
        0 < in_cells == known
        and len(words) < len(odd)
        and (stated := _one_unit(values))
        and unit in ("", stated)
    ):
        return Column(name, numbers, stated, odd=words)  # the same in every cell
    if 2 * (int(np.isfinite(numbers).sum()) + clock) > known:
        return Column(name, numbers, unit, odd=odd)
    return Column(name, as_numbers(values), unit)
