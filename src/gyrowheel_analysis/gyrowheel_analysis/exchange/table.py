"""A table of another program, read column by column and checked value by value."""

from __future__ import annotations

import codecs
import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from gyrowheel_analysis.exchange.column_map import ColumnMap
from gyrowheel_analysis.exchange.fields import Reading
from gyrowheel_analysis.exchange.map_file import TIMESTAMP, Source
from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.limits import require_room
from gyrowheel_core.units import unit_registry

Array = NDArray[np.float64]

SUFFIXES: Final = (".csv", ".parquet")
_TEXT_TO_MEMORY: Final = 2.0  # a short number takes more bytes in memory than in a text
_BYTES_A_VALUE: Final = 16  # as it is read, and as it is converted
_HEAD: Final = 1 << 16  # bytes by which a text is known
#: How files begin that are sometimes called .csv.
_KINDS: Final = {
    b"PK\x03\x04": "a zip archive or a spreadsheet",
    b"\x1f\x8b": "compressed by gzip",
    b"\x28\xb5\x2f\xfd": "compressed by zstd",
    b"PAR1": "a Parquet file",
    b"\x89MCAP": "an MCAP file",
    b"\x89HDF": "an HDF5 file",
    b"MATLAB 5.0": "a MATLAB file",
    b"SQLite format 3": "a database",
}
_STEP: Final = 0.1  # largest deviation of a time step, as a fraction of the sample period
_PERIOD: Final = 0.01  # the same for the mean time step


def check_suffix(path: Path) -> None:
    """Refuse a file whose ending is not one of `SUFFIXES`.

    Raises
    ------
    InputError
        If it does.
    """
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: the ending '{path.suffix}' is not known; allowed: {', '.join(SUFFIXES)}")


class Table:
    """The columns that a map needs, read and converted one by one."""

    def __init__(self, path: Path, column_map: ColumnMap) -> None:
        check_suffix(path)
        self.path = path
        self._map = column_map
        self._csv = path.suffix == ".csv"
        self._table = self._read()
        if self._table.num_rows < 2:
            raise InputError(f"{path}: {self._table.num_rows} rows; allowed: 2 or more")

    def place(self, row: int) -> str:
        """Return the name of a row for messages."""
        # the header is line 1 where nothing is skipped
        return f"line {row + 2 + self._map.csv.skip_lines}" if self._csv else f"row {row + 1}"

    def filled(self, sources: Mapping[str, Source]) -> NDArray[np.int64]:
        """Return the rows in which the columns of a group have values: in each row all of them or none."""
        masks = {s.column: self._table.column(s.column).is_valid().to_numpy() for s in sources.values()}
        whole = np.logical_or.reduce(list(masks.values()))
        for name, mask in masks.items():
            if np.any(mask != whole):
                k = int(np.flatnonzero(mask != whole)[0])
                raise InputError(
                    f"{self.path}: column '{name}', {self.place(k)}: the value is missing while others of the same"
                    " message are there; allowed: all or none"
                )
        return np.flatnonzero(whole)

    def values(
        self,
        source: Source,
        field: Reading,
        what: str,
        rows: NDArray[np.int64] | None = None,
        *,
        missing: bool = False,
    ) -> Array:
        """Return the values of a source in SI units, checked; in some rows, or in all of them.

        With `missing`, a value that is not there, or not finite, is NaN; without, it is an error.
        """
        if not source.column:
            constant = to_si(np.array([source.value]), source.unit, field)
            self._check_range(constant, field, lambda _: f"{self._map.origin}: {what}.value", source)
            return np.full(self._table.num_rows, constant[0])
        raw = self._numbers(source.column, rows, missing=missing)
        result = to_si(raw * source.scale + source.offset, source.unit, field)

        def where(k: int) -> str:
            row = k if rows is None else int(rows[k])
            return f"{self.path}: column '{source.column}', {self.place(row)}"

        self._check_range(result, field, where, source, raw)
        return result

    def integers(
        self, source: Source, field: Reading, what: str, rows: NDArray[np.int64] | None = None
    ) -> NDArray[np.int64]:
        """Return the values of a source as whole numbers."""
        values = self.values(source, field, what, rows)
        wrong = np.flatnonzero(values != np.round(values))
        if len(wrong):
            k = int(wrong[0] if rows is None else rows[wrong[0]])
            raise InputError(
                f"{self.path}: column '{source.column}', {self.place(k)}: {values[wrong[0]]:g}; allowed: whole numbers"
            )
        return values.astype(np.int64)

    def sequence(self) -> NDArray[np.int64]:
        """Return the numbers of the samples, from 0 on, by their times and sequence numbers."""
        time, name = self._time(), self._map.time.column
        period = self._map.bench.sample_period
        steps = np.diff(time)
        wrong = np.flatnonzero(~(steps > 0.0))
        if len(wrong):
            k = int(wrong[0]) + 1
            what = "the same time as" if steps[k - 1] == 0.0 else f"{-1e3 * steps[k - 1]:.6g} ms before"
            raise InputError(
                f"{self.path}: column '{name}', {self.place(k)}: {what} the row before; time must ascend"
            )
        if self._map.sequence is None:
            sequence, counted = np.arange(len(time)), np.ones(len(steps), dtype=np.int64)
        else:
            source = self._map.sequence
            sequence = self.integers(source, Reading("", 0, 2**53), "sequence")
            counted = np.diff(sequence)
            back = np.flatnonzero(counted < 1)
            if len(back):
                k = int(back[0]) + 1
                raise InputError(
                    f"{self.path}: column '{source.column}', {self.place(k)}: {sequence[k]} follows"
                    f" {sequence[k - 1]}; the sequence must ascend"
                )
        mean = float(np.median(steps / counted))
        if not abs(mean / period - 1.0) <= _PERIOD:
            raise InputError(
                f"{self.path}: column '{name}': a row every {1e3 * mean:.6g} ms; allowed for the bench"
                f" {self._map.bench.name}: {1e3 * period:g} ms ± {100 * _PERIOD:g} % (is the unit right?)"
            )
        with np.errstate(over="ignore"):  # a step of any size is told below
            wrong = np.flatnonzero(~(np.abs(steps / mean - counted) <= _STEP))
        if len(wrong):
            k = int(wrong[0]) + 1
            hint = (
                "" if self._map.sequence else "; where samples are missing, map a column of sequence numbers"
            )
            raise InputError(
                f"{self.path}: column '{name}', {self.place(k)}: {1e3 * steps[k - 1]:.6g} ms after the row"
                f" before; allowed: {1e3 * mean * counted[k - 1]:.6g} ms ± {1e3 * mean * _STEP:.2g} ms{hint}"
            )
        result: NDArray[np.int64] = sequence - sequence[0]
        return result

    def _time(self) -> Array:
        """Return the times from the first row on [s]."""
        source = self._map.time
        if not source.column:
            raise InputError(f"{self._map.origin}: time: must be a column")
        if source.unit == TIMESTAMP:
            column = self._column(source.column)
            if not pa.types.is_timestamp(column.type):
                raise InputError(
                    f"{self.path}: column '{source.column}': holds {column.type}; allowed for the unit"
                    f" {TIMESTAMP}: dates with times"
                )
            stamps = column.cast(pa.timestamp("ns")).cast(pa.int64()).to_numpy()
            return (stamps - stamps[0]) * 1e-9
        column = self._column(source.column)
        if pa.types.is_integer(column.type):  # large numbers keep their last digits
            whole = column.to_numpy()
            numbers = (whole - whole[0]).astype(np.float64)
        else:
            numbers = self._numbers(source.column)
            numbers = numbers - numbers[0]
        return to_si(numbers * source.scale, source.unit, Reading("s", -math.inf, math.inf))

    def _column(self, name: str, rows: NDArray[np.int64] | None = None, *, missing: bool = False) -> Any:
        column = self._table.column(name)
        if rows is not None:
            column = column.take(pa.array(rows))
        if column.null_count and not missing:
            k = int(np.flatnonzero(column.is_null().to_numpy())[0])
            raise InputError(
                f"{self.path}: column '{name}', {self.place(k)}: the value is missing; allowed: a number in every row"
            )
        return column.combine_chunks()

    def _numbers(self, name: str, rows: NDArray[np.int64] | None = None, *, missing: bool = False) -> Array:
        column = self._column(name, rows, missing=missing)
        kind = column.type
        numeric = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)
        if not (numeric or pa.types.is_decimal(kind)):
            raise InputError(f"{self.path}: column '{name}': holds {kind}; allowed: numbers")
        values: Array = column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
        if missing:  # where nothing stands, arrow gives NaN
            return np.where(np.isfinite(values), values, np.nan)
        wrong = np.flatnonzero(~np.isfinite(values))
        if len(wrong):
            k = int(wrong[0] if rows is None else rows[wrong[0]])
            raise InputError(
                f"{self.path}: column '{name}', {self.place(k)}: {values[wrong[0]]} is not allowed;"
                " allowed: a finite number in every row"
            )
        return values

    def _check_range(
        self,
        values: Array,
        field: Reading,
        where: Callable[[int], str],
        source: Source,
        raw: Array | None = None,
    ) -> None:
        # NaN is in every range: missing values were refused earlier where they must not be
        wrong = np.flatnonzero((values < field.low) | (values > field.high))
        if len(wrong):
            k = int(wrong[0])
            given = source.value if raw is None else raw[k]
            value = f"{given:g} {source.unit}".strip()
            if values[k] != given:
                value += f", which is {values[k]:.6g} {field.unit}"
            raise InputError(
                f"{where(k)}: {value}; allowed: {field.low:g} .. {field.high:g} {field.unit}".rstrip()
                + " (are unit and scale right?)" * bool(field.unit)
            )

    def _read(self) -> Any:
        names = self._map.names
        try:
            if self.path.exists() and not self.path.is_file():
                raise InputError(f"{self.path}: cannot be read: it is not a file")
            return self._read_csv(names) if self._csv else self._read_parquet(names)
        except FileNotFoundError:
            raise InputError(f"{self.path}: no such file") from None
        except OSError as error:
            # arrow raises OSError for faults inside a file, too
            raise InputError(f"{self.path}: cannot be read: {error.strerror or one_line(error)}") from None
        except (pa.ArrowException, UnicodeDecodeError) as error:
            raise InputError(f"{self.path}: cannot be read: {one_line(error)}") from None

    def _read_parquet(self, names: Sequence[str]) -> Any:
        with self.path.open("rb") as opened, pq.ParquetFile(opened) as file:
            self._check_columns(file.schema_arrow.names, names)
            # what the file claims of its size may be small: a column of one repeated value has hardly any bytes
            rows = file.metadata.num_rows
            require_room(_BYTES_A_VALUE * rows * len(names), f"{self.path}: its table of {rows} rows")
            return file.read(columns=list(names))

    def _check_text(self) -> None:
        """Refuse a file whose beginning is no text: the parser would quote what it cannot read."""
        encoding = self._map.csv.encoding
        with self.path.open("rb") as file:
            head = file.read(_HEAD)
        kind = next((kind for mark, kind in _KINDS.items() if head.startswith(mark)), "")
        if kind:
            raise InputError(f"{self.path}: is {kind}, not a text; allowed: a table as text, or Parquet")
        try:
            # a character may be cut in two at the end
            text = codecs.getincrementaldecoder(encoding)().decode(head)
        except UnicodeDecodeError as error:
            raise InputError(
                f"{self.path}: byte {error.start + 1} is no text in {encoding}; {self._map.origin}: csv.encoding names "
                "another encoding"
            ) from None
        except LookupError:
            return  # is told where the file is read
        if "\0" in text:
            raise InputError(f"{self.path}: is no text: it has a zero byte near its beginning")

    def _read_csv(self, names: Sequence[str]) -> Any:
        settings = self._map.csv
        self._check_text()
        require_room(_TEXT_TO_MEMORY * self.path.stat().st_size, f"{self.path}: it")
        read = pc.ReadOptions(skip_rows=settings.skip_lines, encoding=settings.encoding)
        parse = pc.ParseOptions(delimiter=settings.delimiter)
        try:
            # opened here and below: arrow refuses names of files that are not text
            with (
                self.path.open("rb") as opened,
                pc.open_csv(opened, read_options=read, parse_options=parse) as stream,
            ):
                self._check_columns(stream.schema.names, names)
        except pa.ArrowInvalid:
            self._name_the_row(read)
            raise
        except LookupError:
            raise InputError(
                f"{self._map.origin}: csv.encoding: '{settings.encoding}' is not known; allowed: such as utf-8"
            ) from None

        def options(kind: Any) -> Any:
            types = dict.fromkeys(names, kind)
            if self._map.time.unit == TIMESTAMP and kind != pa.string():
                types[self._map.time.column] = pa.timestamp("ns")
            return pc.ConvertOptions(
                include_columns=list(names), column_types=types, decimal_point=settings.decimal
            )

        try:
            with self.path.open("rb") as opened:
                return pc.read_csv(
                    opened, read_options=read, parse_options=parse, convert_options=options(pa.float64())
                )
        except pa.ArrowInvalid:
            self._name_the_row(read)
            with self.path.open("rb") as opened:
                texts = pc.read_csv(
                    opened, read_options=read, parse_options=parse, convert_options=options(pa.string())
                )
            self._name_the_text(texts)
            raise

    def _name_the_row(self, read: Any) -> None:
        """Raise for the first row that has too few columns or too many."""
        wrong: list[Any] = []

        def note(row: Any) -> str:
            wrong.append(row)
            return "skip"

        # rows are counted by one thread alone
        one = pc.ReadOptions(skip_rows=read.skip_rows, encoding=read.encoding, use_threads=False)
        parse = pc.ParseOptions(delimiter=self._map.csv.delimiter, invalid_row_handler=note)
        with contextlib.suppress(pa.ArrowInvalid), self.path.open("rb") as opened:
            pc.read_csv(opened, read_options=one, parse_options=parse)
        if wrong and wrong[0].number is not None:
            row = wrong[0]
            raise InputError(
                f"{self.path}: line {row.number}: {row.actual_columns} columns; "
                f"allowed: {row.expected_columns}, as in the line of names"
            )

    def _name_the_text(self, table: Any) -> None:
        """Raise for the first text that is no number."""
        for name in table.column_names:
            if name == self._map.time.column and self._map.time.unit == TIMESTAMP:
                continue
            for k, text in enumerate(table.column(name).to_pylist()):
                try:
                    float((text or "nan").replace(self._map.csv.decimal, "."))
                except ValueError:
                    raise InputError(
                        f"{self.path}: column '{name}', {self.place(k)}: '{text}' is not allowed; allowed: a number"
                    ) from None

    def _check_columns(self, there: Sequence[str], needed: Sequence[str]) -> None:
        for name in needed:
            count = list(there).count(name)
            if count == 0:
                raise InputError(
                    f"{self.path}: no column '{name}', which {self._map.origin} names; there are: {', '.join(there)}"
                )
            if count > 1:
                raise InputError(f"{self.path}: {count} columns are called '{name}'; allowed: one")


def to_si(values: Array, unit: str, field: Reading) -> Array:
    """Convert to the unit of a field; what has no unit stays."""
    if not field.unit:
        return values
    quantity = unit_registry().Quantity(values, unit)
    result: Array = np.asarray(quantity.to(field.unit).magnitude, dtype=np.float64)
    return result
