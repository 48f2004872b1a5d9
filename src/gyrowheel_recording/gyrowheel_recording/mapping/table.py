"""A table of another program, read column by column and checked value by value."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence, Set
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from gyrowheel_core.errors import InputError
from gyrowheel_core.units import conversion, unit_registry
from gyrowheel_recording.mapping.clock import FARTHEST, Clock, ClockError, clock_of, period_of, rows_twice
from gyrowheel_recording.mapping.map_file import (
    COUNT,
    READINGS,
    TIMESTAMP,
    ColumnMap,
    Reading,
    Source,
    is_time,
)
from gyrowheel_recording.mapping.pulses import Edges, edges_of_count, edges_of_level, edges_of_times
from gyrowheel_recording.mapping.table_file import interpolated, read_columns, sample_rows
from gyrowheel_recording.mislabelled import NOT_HELD, new_rows, renumbered
from gyrowheel_recording.mislabelled.blocks import NAMES
from gyrowheel_recording.tables import Column, Grid

Array = NDArray[np.float64]

SUFFIXES: Final = (".csv", ".parquet")
#: Periods of a clock for which what changes slowly is held before its first and after its last row, and any reading.
_HELD, _JUST_OUTSIDE = 1.5, 0.01
_BRIDGED: Final = 4.5  # periods of a clock; over a longer gap only what changes slowly is interpolated


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

    def __init__(self, path: Path, column_map: ColumnMap, grid: Grid | None = None) -> None:
        self.path = path
        self.remarks: list[str] = []
        self._map = column_map
        self._periods: dict[str, float] = {}  # of the clocks of columns that were interpolated [s]
        self._holed: set[str] = set()  # columns that are NaN within gaps of their clock
        self._pulses: dict[str, tuple[Array, Array]] = {}  # times and values of pulses on another clock
        content = read_columns(path, column_map, grid)
        self._lines = content.lines
        self._columns = {name: _as_arrow(content.columns[name]) for name in column_map.names}
        clocks = {
            s.column: s.clock or content.columns[s.column].clock for s in column_map.sources if s.column
        }
        for name in dict.fromkeys(clocks.values()):
            if name and name not in self._columns:
                self._columns[name] = _as_arrow(content.columns[name])
        self.remarks += content.remarks
        own = [s.column for s in column_map.sources if s.column and not clocks[s.column]]
        rows = len(self._columns[column_map.time.column or (own or list(self._columns))[0]])
        if rows < 2:
            raise InputError(f"{path}: {rows} rows; allowed: 2 or more")
        self._rows = rows
        self._taken = np.arange(rows)  # numbers of the rows that are taken
        self._time: Array = np.zeros(0)
        if column_map.keep_missing:
            self._take_samples(
                {name for name, clock in clocks.items() if clock not in ("", column_map.time.column)}
            )
        self._put_on_one_clock(clocks)
        if column_map.every > 1:
            self._take_new_rows(column_map.every)

    def place(self, row: int) -> str:
        """Return the name of a row for messages."""
        at = int(self._taken[row]) if row < len(self._taken) else row
        return f"line {self._lines[at]}" if self._lines else f"row {at + 1}"

    def _error(
        self, column: str, what: str, k: int | None = None, rows: NDArray[np.int64] | None = None
    ) -> InputError:
        """Return an error in a column, at the `k`-th of some rows or of all."""
        where = "" if k is None else f", {self.place(k if rows is None else int(rows[k]))}"
        return InputError(f"{self.path}: column '{column}'{where}: {what}")

    def filled(self, sources: Mapping[str, Source]) -> NDArray[np.int64]:
        """Return the rows in which the columns of a group have values: in each row all of them or none."""
        masks = {s.column: self._columns[s.column].is_valid().to_numpy() for s in sources.values()}
        whole = np.logical_or.reduce(list(masks.values()))
        for name, mask in masks.items():
            if np.any(mask != whole):
                k = int(np.flatnonzero(mask != whole)[0])
                what = "the value is missing while others of the same message are there; allowed: all or none"
                raise self._error(name, what, k)
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
            return np.full(len(self._time), constant[0])
        missing = missing or source.column in self._holed
        raw = self._numbers(source.column, rows, missing=missing)
        if math.isfinite(source.missing):
            nothing = raw == source.missing
            if not missing and nothing.any():
                k = int(np.flatnonzero(nothing)[0])
                what = (
                    f"{source.missing:g} stands for a missing value; allowed with `missing: keep` in the map"
                )
                raise self._error(source.column, what, k, rows)
            raw = np.where(nothing, np.nan, raw)
        given = raw * source.scale + source.offset
        if source.resistance:
            result = source.resistance * to_si(given, source.unit, Reading("A", -math.inf, math.inf))
        else:
            result = to_si(given, source.unit, field)

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
            k = int(wrong[0])
            raise self._error(source.column, f"{values[k]:g}; allowed: whole numbers", k, rows)
        return values.astype(np.int64)

    def clock(self) -> Clock:
        """Return when the samples were taken, by their times and sequence numbers."""
        source = self._map.sequence
        numbers = None
        if source is not None:
            numbers = self.integers(source, Reading("", 0, 2**53), "sequence")
            back = np.flatnonzero(np.diff(numbers) < 1)
            if len(back):
                k = int(back[0]) + 1
                what = f"{numbers[k]} follows {numbers[k - 1]}; the sequence must ascend"
                raise self._error(source.column, what, k)
            if self._map.every > 1:
                numbers = renumbered(numbers, self._map.every)
        columns = [
            self._columns.get(s.column)
            for name, s in self._map.columns.items()
            if not READINGS[name].constant
        ]
        readings = [column.to_numpy() for column in columns if column is not None]
        if numbers is None and len(twice := rows_twice(self._time, readings)):
            what = "the time and the readings of the row before: it is there twice; allowed: each once"
            raise self._error(self._map.time.column, what, int(twice[0]))
        try:
            return clock_of(self._time, numbers)
        except ClockError as error:
            row = error.row if error.row >= 0 else None
            raise self._error(self._map.time.column, str(error), row) from None

    def _seconds(self, name: str, start: Any = None, late: float = 0.0) -> tuple[Array, Any]:
        """Return the times in a column from its first row on, or from a given start [s], and that start.

        `late` [s] is added to them.
        """
        source = self._map.time
        if not name:
            return np.arange(self._rows) / self._map.rate, 0.0
        column = self._column(name)
        values: NDArray[Any]
        if source.unit == TIMESTAMP:
            values, scale, unit = self._stamps(name, column), 1e-9, "s"
        else:
            values, scale, unit = self._numbers(name), source.scale, source.unit
            if pa.types.is_integer(column.type) and np.all(values < 2.0**63):
                values = column.to_numpy().astype(np.int64)  # large whole numbers keep their last digits
        if source.wraps and name == source.column:
            values, anew = _unwrapped(values, source.wraps)
            if anew:
                self.remarks.append(
                    f"'{name}' restarts at {source.wraps:.10g} in {anew} places: this is added"
                )
        begin = values[0] if start is None else start

        def seconds(passed: Array) -> Array:
            return to_si(passed * scale, unit, Reading("s", -math.inf, math.inf)) + late

        with np.errstate(over="ignore"):  # as floating-point numbers, whose difference does not wrap around
            self._check_span(name, seconds(values.astype(np.float64) - float(begin)))
        passed = seconds((values - begin).astype(np.float64))
        if source.plus and name == source.column:
            more = self._numbers(source.plus)
            passed = passed + to_si(more - more[0], source.plus_unit, Reading("s", -math.inf, math.inf))
        return passed, begin

    def _take_samples(self, others: Set[str]) -> None:
        """Take the rows that are samples, and interpolate slow readings that have rows of their own to them.

        `others` are the columns of other clocks.
        """
        fast: dict[str, Array] = {}
        slow: dict[str, Array] = {}
        for name, source in self._map.columns.items():
            column = self._columns.get(source.column)
            if column is None or source.pulses or source.column in others or pa.types.is_string(column.type):
                continue
            if len(column) == self._rows:
                (slow if READINGS[name].constant else fast)[source.column] = self._readings(source.column)
        if not fast or not slow or all(np.isfinite(own).all() for own in slow.values()):
            return
        samples = sample_rows(fast, slow)
        time, _ = self._seconds(self._map.time.column)
        moved = {}
        for name, values in slow.items():
            own = interpolated(time, values, samples)
            if own is not None:
                moved[name] = own
        taken = np.flatnonzero(samples)
        for name, column in self._columns.items():
            if name in moved:
                self._columns[name] = pa.chunked_array([pa.array(moved[name], from_pandas=True)])
            elif len(column) == self._rows and name not in others:
                self._columns[name] = column.take(pa.array(taken))
        self._taken, self._rows = self._taken[taken], len(taken)
        if moved:
            left = (
                f"; {len(samples) - len(taken)} rows have nothing else" if len(taken) < len(samples) else ""
            )
            self.remarks.append(
                f"{', '.join(moved)}: have rows of their own, interpolated to the samples{left}"
            )

    def _take_new_rows(self, every: float) -> None:
        """Take the rows in which readings that are held over `every` rows are new."""
        for source in self._map.sources:
            if source.pulses and source.column in self._columns and source.column not in self._pulses:
                self._pulses[source.column] = self._time, self._numbers(source.column, missing=True)
        period = period_of(self._time)
        numbers: NDArray[np.int64] = np.asarray(np.round(self._time / max(period, 1e-12)), dtype=np.int64)
        columns = {
            name: self._numbers(source.column, missing=True)
            for name, source in self._map.columns.items()
            if name in NAMES and source.column and not source.pulses
        }
        taken = np.flatnonzero(new_rows(columns, numbers, every))
        if len(taken) < 2:
            raise InputError(f"{self.path}: {NOT_HELD.format(every=f'{every:g}')}")
        self._columns = {name: column.take(pa.array(taken)) for name, column in self._columns.items()}
        self._time, self._taken = self._time[taken], self._taken[taken]
        self.remarks.append(
            f"{len(taken)} of {len(numbers)} rows are taken: those with new values (`every: {every:g}`)"
        )

    def _stamps(self, name: str, column: Any) -> NDArray[np.int64]:
        """Return the dates in a column [ns]."""
        if not pa.types.is_timestamp(column.type):
            what = f"holds {column.type}; allowed for the unit {TIMESTAMP}: dates with times"
            raise self._error(name, what)
        try:
            stamps: NDArray[np.int64] = column.cast(pa.timestamp("ns")).cast(pa.int64()).to_numpy()
        except pa.ArrowInvalid:
            what = "holds dates beyond 1678 .. 2261; allowed: those of a recording"
            raise self._error(name, what) from None
        return stamps

    def _check_span(self, name: str, passed: Array) -> None:
        """Refuse times so far from the first row [s] that no recording lasts so long."""
        far = np.flatnonzero(np.abs(passed) > FARTHEST)
        if len(far):
            k = int(far[0])
            what = f"{passed[k]:.4g} s from the first row; allowed: up to {FARTHEST:g} s"
            raise self._error(name, f"{what} (are unit and first row right?)", k)

    def _put_on_one_clock(self, clocks: Mapping[str, str]) -> None:
        """Interpolate the columns of other clocks than the map's at its times, and drop rows that one does not cover.

        `clocks` has the columns with the times of some columns, by the names of these.
        """
        own = self._map.time.column
        time, start = self._seconds(own)
        others = {name: clock for name, clock in clocks.items() if clock and clock != own}
        for source in self._map.sources:
            if source.pulses and is_time(source.unit):
                self._pulses[source.column] = self._edge_times(source, start), np.zeros(0)
                others.pop(source.column, None)
        begin, end = 0, len(time)
        slow = {own.column for name, own in self._map.columns.items() if READINGS[name].constant}
        for clock in dict.fromkeys(others.values()):
            there, _ = self._seconds(clock, start, self._map.clocks.get(clock, 0.0))
            if len(there) < 2 or np.any(np.diff(there) < 0.0):
                raise self._error(clock, "times do not ascend; allowed: those of a clock")
            here = [name for name, other in others.items() if other == clock]
            more = (_HELD if set(here) <= slow else _JUST_OUTSIDE) * period_of(there)
            first, last = np.searchsorted(time, (there[0] - more, there[-1] + more), side="left")
            begin, end = max(begin, int(first)), min(end, int(last))
            self._interpolate(here, clock, time, there)
        for name, column in self._columns.items():
            if len(column) != len(time) and name not in others.values() and name not in self._pulses:
                what = f"{len(column)} rows, '{own}' has {len(time)}; allowed: as many, or a clock of its own"
                raise self._error(name, f"{what} (`clock:` names the column with its times)")
        if end - begin < 2:
            raise InputError(f"{self.path}: {max(end - begin, 0)} rows; allowed: 2 or more, on all clocks")
        if others and (begin, end) != (0, len(time)):
            left = len(time) - (end - begin)
            several = "s" * (left > 1)
            self.remarks.append(
                f"{left} row{several} that not all clocks cover {'are' if several else 'is'} left out"
            )
        self._taken = self._taken[begin:end]
        self._columns = {
            name: column.slice(begin, end - begin)
            for name, column in self._columns.items()
            if len(column) == len(time)
        }
        zero = time[begin]
        self._time = time[begin:end] - zero
        self._pulses = {name: (when - zero, values) for name, (when, values) in self._pulses.items()}

    def _interpolate(self, names: Sequence[str], clock: str, time: Array, there: Array) -> None:
        """Interpolate the columns of a clock, whose times are `there`, at the times of the map's [s]."""
        pulsed = {source.column for source in self._map.sources if source.pulses}
        period, usual = (max(period_of(x), 1e-12) for x in (there, time))
        rate, step = 1.0 / period, 1.0 / usual
        empty = 0
        for name in names:
            values = self._readings(name)
            if name in pulsed and len(values) == len(there):
                self._pulses[name] = there, values
                continue
            known = np.isfinite(values)
            if len(values) != len(there) or not known.any():
                raise self._error(name, f"has not the rows of its clock '{clock}'")
            between, holes = self._between(name, time, there[known], values[known], period)
            self._columns[name] = pa.chunked_array([between])
            self._periods[name] = period
            empty = max(empty, holes)
        how = f"interpolated to the clock '{self._map.time.column}'"
        if abs(rate / step - 1.0) > 0.01:
            lost = f"; what is faster than {0.5 * min(rate, step):.4g} Hz is {'lost' if rate < step else 'folded'}"
            how = f"{rate:.4g} samples a second, interpolated{lost}"
        self.remarks.append(f"{', '.join(names)}: {how}")
        if empty:
            gaps = f"{empty} rows lie in gaps of the clock '{clock}'"
            self.remarks.append(f"{gaps}: they count as not measured")

    def _readings(self, name: str) -> Array:
        """Return the values in a column; NaN where there is no reading, or what stands for none."""
        values = self._numbers(name, missing=True)
        for source in self._map.sources:
            if source.column == name and math.isfinite(source.missing):
                values = np.where(values == source.missing, np.nan, values)
        return values

    def _between(
        self, name: str, time: Array, there: Array, values: Array, period: float
    ) -> tuple[Array, int]:
        """Return what a column of another clock is at the times of the map's, and how many of these lie in its gaps.

        In a gap only what changes slowly is interpolated; all else is NaN there.
        """
        readings = {field: own for field, own in self._map.columns.items() if own.column == name}
        if "spin_angle" in readings:  # it wraps at every turn, and goes on in between
            own = readings["spin_angle"]
            turn = 2.0 * math.pi / abs(conversion(own.unit, "rad")[1] * own.scale)
            values = np.unwrap(values, period=turn)
        result = np.interp(time, there, values)
        if len(there) < 2 or not readings or all(READINGS[field].constant for field in readings):
            return result, 0
        after = np.clip(np.searchsorted(there, time), 1, len(there) - 1)
        before = after - 1
        inside = (there[before] < time) & (time < there[after])
        inside &= there[after] - there[before] > _BRIDGED * period
        if inside.any():
            self._holed.add(name)
        return np.where(inside, np.nan, result), int(np.count_nonzero(inside))

    def clock_step(self, source: Source) -> float:
        """Return the period of the clock of a column that was interpolated [s]; 0 where it is the map's own clock."""
        return self._periods.get(source.column, 0.0)

    def _edge_times(self, source: Source, start: Any) -> Array:
        """Return the times that a counter took of edges [s], from the start of the map's clock."""
        values = self._numbers(source.column, missing=True)
        with np.errstate(over="ignore"):
            begin = 0.0 if self._map.time.unit == TIMESTAMP else start
            passed = (values - begin) * source.scale + source.offset
            when = to_si(passed, source.unit, Reading("s", -math.inf, math.inf))
        self._check_span(source.column, when)
        return when

    def edges(self, source: Source, even: Array) -> Edges:
        """Return the edges of the pulses of an angle, at times from the first row on [s]; `even` (n,) has no jitter."""
        times, values = self._pulses.get(source.column, (even, None))
        if is_time(source.unit):
            return edges_of_times(times)
        raw = self._numbers(source.column, missing=True) if values is None else values
        if math.isfinite(source.missing):
            raw = np.where(raw == source.missing, np.nan, raw)
        signal = raw * source.scale + source.offset
        if source.unit == COUNT:
            return edges_of_count(times, signal)
        return edges_of_level(times, signal, source.level)

    def _column(self, name: str, rows: NDArray[np.int64] | None = None, *, missing: bool = False) -> Any:
        column = self._columns[name]
        if rows is not None:
            column = column.take(pa.array(rows))
        if column.null_count and not missing:
            k = int(np.flatnonzero(column.is_null().to_numpy())[0])
            raise self._error(name, "the value is missing; allowed: a number in every row", k)
        return column.combine_chunks()

    def _numbers(self, name: str, rows: NDArray[np.int64] | None = None, *, missing: bool = False) -> Array:
        column = self._column(name, rows, missing=missing)
        kind = column.type
        numeric = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)
        if not (numeric or pa.types.is_decimal(kind)):
            raise self._error(name, f"holds {kind}; allowed: numbers")
        values: Array = column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
        if missing:  # where nothing stands, arrow gives NaN
            return np.where(np.isfinite(values), values, np.nan)
        wrong = np.flatnonzero(~np.isfinite(values))
        if len(wrong):
            k = int(wrong[0])
            what = f"{values[k]} is not allowed; allowed: a finite number in every row"
            raise self._error(name, what, k, rows)
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


def _unwrapped(values: NDArray[Any], wraps: float) -> tuple[NDArray[Any], int]:
    """Return the values of a counter as if it never restarted, and the number of restarts."""
    back = np.diff(values.astype(np.float64)) < -0.5 * wraps
    turns = np.concatenate([[0], np.cumsum(back)])
    whole = values.dtype.kind in "iu" and wraps == round(wraps)
    return values + (turns * round(wraps) if whole else turns * wraps), int(back.sum())


def to_si(values: Array, unit: str, field: Reading) -> Array:
    """Convert to the unit of a field; what has no unit stays."""
    if not field.unit:
        return values
    quantity = unit_registry().Quantity(values, unit)
    result: Array = np.asarray(quantity.to(field.unit).magnitude, dtype=np.float64)
    return result


def _as_arrow(column: Column) -> Any:
    """Return a column as one of arrow, without what is no number."""
    values = column.values
    if values.dtype.kind == "M":
        values = values.astype("datetime64[ns]")
    elif values.dtype.kind == "f":
        values = values.astype(np.float64)
    elif values.dtype.kind in "iu":  # arrow reads no numbers whose bytes are the other way round
        values = values.astype(values.dtype.newbyteorder("="))
    elif values.dtype.kind == "b":
        values = values.astype(np.uint8)
    else:
        return pa.chunked_array([pa.array([str(own) for own in values], pa.string())])
    return pa.chunked_array([pa.array(np.ascontiguousarray(values), from_pandas=True)])
