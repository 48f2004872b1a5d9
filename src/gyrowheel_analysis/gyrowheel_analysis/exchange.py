"""Tables of other programs (CSV, Parquet) become recordings, and recordings become tables.

A map file says which column of a table holds which reading, and in which unit; docs/exchange.md describes it.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq
import yaml
from numpy.typing import NDArray

from gyrowheel_analysis.recording import Recording, RecordingWriter
from gyrowheel_control.plans import SETPOINT_PERIOD
from gyrowheel_sim import environment as environments
from gyrowheel_sim import topics, wire
from gyrowheel_sim.bench import Bench, unit_registry
from gyrowheel_sim.environment import Environment
from gyrowheel_sim.errors import InputError
from gyrowheel_sim.units import DEG
from gyrowheel_sim.yaml_text import read_yaml

Array = NDArray[np.float64]

SCHEMA: Final = 1
SUFFIXES: Final = (".csv", ".parquet")

#: Unit of time stamps written as dates, such as 2026-05-04T10:00:00.0005.
TIMESTAMP: Final = "timestamp"
_STEP: Final = 0.1  # how much a step of time may differ from the sample period, as part of it
_PERIOD: Final = 0.01  # how much the mean step may
#: How a map that was written begins.
_MAP_HEAD: Final = "# What the columns of the table mean, for `gyrowheel import`.\n"
_CHUNK: Final = 200_000  # rows written at a time
_RECORDING_CHUNK: Final = 1 << 20  # bytes


@dataclass(frozen=True)
class _Field:
    """What a field of a message takes: SI unit, the range of what can be meant, whether a constant will do."""

    unit: str
    low: float
    high: float
    constant: bool = False


_VOLTAGE = _Field("V", -1000.0, 1000.0)
_READINGS: Final = {
    "tilt_x": _Field("rad", -0.2, 0.2),
    "tilt_y": _Field("rad", -0.2, 0.2),
    "spin_angle": _Field("rad", -1e9, 1e9),
    "spin_rate": _Field("rad/s", -2000.0, 2000.0),
    "coil_voltage_x": _VOLTAGE,
    "coil_voltage_y": _VOLTAGE,
    "motor_voltage": _VOLTAGE,
    "motor_current": _Field("A", -100.0, 100.0),
    "coil_temperature": _Field("K", 150.0, 600.0, constant=True),
    "air_temperature": _Field("K", 150.0, 400.0, constant=True),
    "air_pressure": _Field("Pa", 0.0, 3e5, constant=True),
}
_COMMANDS: Final = dict.fromkeys(wire.COMMAND.fields, _VOLTAGE)
_SETPOINTS: Final = {
    "segment": _Field("", 0, 2**32 - 1),
    "phase": _Field("", 0, 1),
    "tilt_x": _READINGS["tilt_x"],
    "tilt_y": _READINGS["tilt_y"],
    "tilt_rate_x": _Field("rad/s", -100.0, 100.0),
    "tilt_rate_y": _Field("rad/s", -100.0, 100.0),
    "spin_rate": _READINGS["spin_rate"],
    "spin_acceleration": _Field("rad/s^2", -1e4, 1e4),
}
_GROUPS: Final = {"columns": _READINGS, "command": _COMMANDS, "setpoint": _SETPOINTS}
_CSV: Final[dict[str, Any]] = {"delimiter": ",", "decimal": ".", "skip_lines": 0, "encoding": "utf-8"}


@dataclass(frozen=True)
class Source:
    """Where the values of a field come from.

    Attributes
    ----------
    column : str
        Name of a column; empty for a constant.
    unit : str
        Unit of what stands there.
    scale, offset : float
        What stands there is multiplied by and then increased by, before the unit counts.
    value : float
        The constant, in the unit.
    """

    column: str = ""
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    value: float = math.nan


@dataclass(frozen=True)
class ColumnMap:
    """A map file: what the columns of a table mean.

    Attributes
    ----------
    origin : str
        The file, for errors.
    bench : Bench
        The bench that the table was measured on.
    time : Source
        Time of the samples.
    sequence : Source or None
        Numbers of the samples, where some are missing.
    columns, command, setpoint : dict of str to Source
        Sources of the fields of the messages; the last two may be empty.
    environment : tuple of Environment
        What held on the rig; empty where unknown.
    csv : dict
        How a CSV file is written: delimiter, decimal, skip_lines, encoding.
    """

    origin: str
    bench: Bench
    time: Source
    sequence: Source | None
    columns: dict[str, Source]
    command: dict[str, Source]
    setpoint: dict[str, Source]
    environment: tuple[Environment, ...]
    csv: dict[str, Any]

    @classmethod
    def load(cls, file: str | Path) -> ColumnMap:
        """Read a map file.

        Raises
        ------
        InputError
            If it cannot be read, or a field of it is missing, unknown or not allowed.
        """
        path = Path(file)
        try:
            raw = read_yaml(path.read_text(encoding="utf-8"), str(path))
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "it is no text"
            raise InputError(f"{path}: cannot be read: {reason}") from None
        return cls.from_mapping(raw, str(path))

    @classmethod
    def from_mapping(cls, raw: Any, origin: str) -> ColumnMap:
        """Read the content of a map file (see `load`)."""
        allowed = ("schema", "bench", "time", "sequence", *_GROUPS, "environment", "csv")
        content = _mapping(raw, origin, allowed, needed=("schema", "time", "columns"))
        if content["schema"] != SCHEMA:
            raise InputError(f"{origin}: schema: {content['schema']!r} is not known; allowed: {SCHEMA}")
        groups: dict[str, dict[str, Source]] = {}
        for group, fields in _GROUPS.items():
            where = f"{origin}: {group}"
            if group not in content:
                groups[group] = {}
                continue
            entries = _mapping(content[group], where, tuple(fields), needed=tuple(fields))
            groups[group] = {
                name: _source(entries[name], f"{where}.{name}", field) for name, field in fields.items()
            }
            if group != "setpoint":  # whose rates may all be one column of zeros
                _refuse_shared(groups[group], fields, where)
        sequence = content.get("sequence")
        return cls(
            origin=origin,
            bench=Bench.load(_text(content.get("bench", "gyrowheel"), f"{origin}: bench")),
            time=_source(content["time"], f"{origin}: time", _Field("s", -math.inf, math.inf)),
            sequence=None
            if sequence is None
            else _source(sequence, f"{origin}: sequence", _Field("", 0, 2**53)),
            environment=_environment(content.get("environment", []), f"{origin}: environment"),
            csv=_csv_settings(content.get("csv", {}), f"{origin}: csv"),
            **groups,
        )

    @property
    def names(self) -> list[str]:
        """Names of the columns that are needed, each once."""
        sources = [self.time, *([self.sequence] if self.sequence else [])]
        for group in (self.columns, self.command, self.setpoint):
            sources += group.values()
        return list(dict.fromkeys(source.column for source in sources if source.column))


def import_table(file: str | Path, column_map: ColumnMap, directory: str | Path) -> int:
    """Make a recording of a table.

    Parameters
    ----------
    file : str or Path
        A ``.csv`` or ``.parquet`` file; one row a sample, in the order of time.
    column_map : ColumnMap
        What its columns mean.
    directory : str or Path
        The recording, to create. Its time begins at 0 with the first row.

    Returns
    -------
    int
        Number of samples.

    Raises
    ------
    InputError
        If the file cannot be read, lacks a column, has a value that is missing or cannot be meant, its time is not
        uniform at the sample period of the bench, or the directory cannot be written.
    """
    table = _Table(Path(file), column_map)
    bench = column_map.bench
    sequence = table.sequence()
    period_ns = round(bench.sample_period * wire.SECOND)
    stamps = sequence * period_ns
    readings = wire.MEASUREMENT.array(len(sequence))
    wire.MEASUREMENT.set_stamps(readings, stamps)
    readings["sequence"] = sequence
    for name, source in column_map.columns.items():
        readings[name] = table.values(source, _READINGS[name], f"columns.{name}")
    _check_spin(table, readings, np.multiply(sequence, bench.sample_period, dtype=np.float64))
    readings["spin_angle"] = np.mod(readings["spin_angle"], 2.0 * math.pi)
    # a remainder may round up to the divisor itself
    readings["spin_angle"][readings["spin_angle"] >= 2.0 * math.pi] = 0.0

    columns: list[tuple[topics.Topic, NDArray[np.int64], Any]] = []
    first = np.zeros(1, dtype=np.int64)
    columns.append((topics.BENCH, first, [wire.pack_text(bench.describe())]))
    if column_map.environment:
        text = environments.to_json(column_map.environment)
        columns.append((topics.ENVIRONMENT, first, [wire.pack_text(text)]))
    if column_map.setpoint:
        columns.append(_setpoints(table, column_map, stamps))
    columns.append((topics.MEASUREMENT, stamps, readings))
    if column_map.command:
        columns.append(_commands(table, column_map, stamps, sequence))
    with RecordingWriter(directory, chunk_size=_RECORDING_CHUNK) as writer:
        writer.write_columns(columns)
    return len(sequence)


def export_recording(
    recording: Recording,
    file: str | Path,
    *,
    map_file: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[str]:
    """Write a recording as a table: one row a sample, SI units.

    Parameters
    ----------
    recording : Recording
        The recording.
    file : str or Path
        The ``.csv`` or ``.parquet`` file; it is whole or as it was before.
    map_file : str or Path, optional
        Map file to write, with which `import_table` reads the table back.
    progress : callable, optional
        Called now and then with the fraction done.

    Returns
    -------
    list of str
        Names of the columns.

    Raises
    ------
    InputError
        If the name of the file has another ending, or it cannot be written.
    """
    path = Path(file)
    check_suffix(path)
    schema, groups = _table_schema(recording)
    command, setpoint = _nearest(recording)
    with _whole(path) as place, contextlib.ExitStack() as stack:
        if path.suffix == ".csv":
            writer: Any = stack.enter_context(pc.CSVWriter(place, schema))
        else:
            writer = stack.enter_context(pq.ParquetWriter(place, schema, compression="zstd"))
        total = len(recording.measurement)
        for begin in range(0, total, _CHUNK):
            rows = slice(begin, min(begin + _CHUNK, total))
            writer.write_table(_rows(recording, rows, schema, command, setpoint))
            if progress is not None:
                progress(rows.stop / total)
    if map_file is not None:
        with _whole(Path(map_file)) as place:
            place.write_text(_map_text(recording, groups), encoding="utf-8")
    return [str(name) for name in schema.names]


def check_suffix(path: Path) -> None:
    """Refuse a file whose name ends otherwise than in one of `SUFFIXES`.

    Raises
    ------
    InputError
        If it does.
    """
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: the ending '{path.suffix}' is not known; allowed: {', '.join(SUFFIXES)}")


def is_exported_table(file: Path) -> bool:
    """Return whether a file is plainly a table of `export_recording`.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    if file.suffix == ".csv":
        with file.open(encoding="utf-8", errors="replace") as stream:
            first = [name.strip().strip('"') for name in stream.readline(100_000).split(",")]
        return first[: 2 + len(_READINGS)] == ["time", "sequence", *_READINGS]
    try:
        return b"gyrowheel" in (pq.read_schema(file).metadata or {})
    except pa.ArrowException:
        return False


def is_exported_map(file: Path) -> bool:
    """Return whether a file is plainly a map of `export_recording`.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    with file.open(encoding="utf-8", errors="replace") as stream:
        return stream.readline(1000) == _MAP_HEAD


# --- reading


class _Table:
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
        """Return the place of a row in words."""
        # the header is line 1 where nothing is skipped
        return f"line {row + 2 + self._map.csv['skip_lines']}" if self._csv else f"row {row + 1}"

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
        self, source: Source, field: _Field, what: str, rows: NDArray[np.int64] | None = None
    ) -> Array:
        """Return the values of a source in SI units, checked; in some rows, or in all of them."""
        if not source.column:
            constant = _to_si(np.array([source.value]), source.unit, field)
            self._check_range(constant, field, lambda _: f"{self._map.origin}: {what}.value", source)
            return np.full(self._table.num_rows, constant[0])
        raw = self._numbers(source.column, rows)
        result = _to_si(raw * source.scale + source.offset, source.unit, field)

        def where(k: int) -> str:
            row = k if rows is None else int(rows[k])
            return f"{self.path}: column '{source.column}', {self.place(row)}"

        self._check_range(result, field, where, source, raw)
        return result

    def integers(
        self, source: Source, field: _Field, what: str, rows: NDArray[np.int64] | None = None
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
        """Return the numbers of the samples, from 0 on, as time and sequence tell them."""
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
            sequence = self.integers(source, _Field("", 0, 2**53), "sequence")
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
        return _to_si(numbers * source.scale, source.unit, _Field("s", -math.inf, math.inf))

    def _column(self, name: str, rows: NDArray[np.int64] | None = None) -> Any:
        column = self._table.column(name)
        if rows is not None:
            column = column.take(pa.array(rows))
        if column.null_count:
            k = int(np.flatnonzero(column.is_null().to_numpy())[0])
            raise InputError(
                f"{self.path}: column '{name}', {self.place(k)}: the value is missing; allowed: a number in every row"
            )
        return column.combine_chunks()

    def _numbers(self, name: str, rows: NDArray[np.int64] | None = None) -> Array:
        column = self._column(name, rows)
        kind = column.type
        numeric = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)
        if not (numeric or pa.types.is_decimal(kind)):
            raise InputError(f"{self.path}: column '{name}': holds {kind}; allowed: numbers")
        values: Array = column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
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
        field: _Field,
        where: Callable[[int], str],
        source: Source,
        raw: Array | None = None,
    ) -> None:
        wrong = np.flatnonzero(~((values >= field.low) & (values <= field.high)))
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
            return self._read_csv(names) if self._csv else self._read_parquet(names)
        except FileNotFoundError:
            raise InputError(f"{self.path}: no such file") from None
        except OSError as error:
            # arrow says what it finds wrong inside a file as an error of the system, too
            raise InputError(f"{self.path}: cannot be read: {error.strerror or _line(error)}") from None
        except (pa.ArrowException, UnicodeDecodeError) as error:
            raise InputError(f"{self.path}: cannot be read: {_line(error)}") from None

    def _read_parquet(self, names: Sequence[str]) -> Any:
        with pq.ParquetFile(self.path) as file:
            self._check_columns(file.schema_arrow.names, names)
            return file.read(columns=list(names))

    def _read_csv(self, names: Sequence[str]) -> Any:
        settings = self._map.csv
        read = pc.ReadOptions(skip_rows=settings["skip_lines"], encoding=settings["encoding"])
        parse = pc.ParseOptions(delimiter=settings["delimiter"])
        try:
            with pc.open_csv(self.path, read_options=read, parse_options=parse) as stream:
                self._check_columns(stream.schema.names, names)
        except pa.ArrowInvalid:
            self._name_the_row(read)
            raise
        except LookupError:
            raise InputError(
                f"{self._map.origin}: csv.encoding: '{settings['encoding']}' is not known; allowed: such as utf-8"
            ) from None

        def options(kind: Any) -> Any:
            types = dict.fromkeys(names, kind)
            if self._map.time.unit == TIMESTAMP and kind != pa.string():
                types[self._map.time.column] = pa.timestamp("ns")
            return pc.ConvertOptions(
                include_columns=list(names), column_types=types, decimal_point=settings["decimal"]
            )

        try:
            return pc.read_csv(
                self.path, read_options=read, parse_options=parse, convert_options=options(pa.float64())
            )
        except pa.ArrowInvalid:
            self._name_the_row(read)
            texts = pc.read_csv(
                self.path, read_options=read, parse_options=parse, convert_options=options(pa.string())
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
        parse = pc.ParseOptions(delimiter=self._map.csv["delimiter"], invalid_row_handler=note)
        with contextlib.suppress(pa.ArrowInvalid):
            pc.read_csv(self.path, read_options=one, parse_options=parse)
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
                    float((text or "nan").replace(self._map.csv["decimal"], "."))
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


def _check_spin(table: _Table, readings: NDArray[Any], time: Array) -> None:
    """Refuse a speed that is not that of the angle: the unit of one of them is wrong."""
    angle = np.unwrap(readings["spin_angle"])
    turned = float(angle[-1] - angle[0])
    rate = readings["spin_rate"]
    expected = float(np.sum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time)))
    # a tenth of a turn is more than noise and the ends of the range make
    if abs(turned - expected) > max(0.02 * abs(expected), 0.2 * math.pi):
        raise InputError(
            f"{table.path}: the spin angle turns by {turned:.6g} rad where the spin rate gives {expected:.6g} rad;"
            " allowed: 2 % between them (are unit and scale of columns.spin_angle and columns.spin_rate right?)"
        )


def _setpoints(
    table: _Table, column_map: ColumnMap, stamps: NDArray[np.int64]
) -> tuple[topics.Topic, NDArray[np.int64], NDArray[Any]]:
    """Return the setpoints of a table: one every setpoint period, as the conductor sends them, and at each change."""
    filled = table.filled(column_map.setpoint)
    stamps = stamps[filled]
    rows = wire.SETPOINT.array(len(stamps))
    wire.SETPOINT.set_stamps(rows, stamps)
    changed = np.ones(len(stamps), dtype=bool)
    changed[1:] = np.diff(filled) > 1
    for name, source in column_map.setpoint.items():
        read = table.integers if name in wire.SETPOINT.integers else table.values
        rows[name] = read(source, _SETPOINTS[name], f"setpoint.{name}", filled)
        changed[1:] |= rows[name][1:] != rows[name][:-1]
    chosen = np.flatnonzero(changed | (stamps % round(SETPOINT_PERIOD * wire.SECOND) == 0))
    result = rows.view(f"V{rows.dtype.itemsize}")[chosen].view(rows.dtype)  # as bytes: with the padding
    return topics.SETPOINT, stamps[chosen], result


def _commands(
    table: _Table, column_map: ColumnMap, stamps: NDArray[np.int64], sequence: NDArray[np.int64]
) -> tuple[topics.Topic, NDArray[np.int64], NDArray[Any]]:
    filled = table.filled(column_map.command)
    stamps, sequence = stamps[filled], sequence[filled]
    rows = wire.COMMAND.array(len(stamps))
    wire.COMMAND.set_stamps(rows, stamps)
    rows["measurement_sequence"] = sequence
    for name, source in column_map.command.items():
        rows[name] = table.values(source, _COMMANDS[name], f"command.{name}", filled)
    return topics.COMMAND, stamps, rows


def _to_si(values: Array, unit: str, field: _Field) -> Array:
    if not field.unit:
        return values
    quantity = unit_registry().Quantity(values, unit)
    result: Array = np.asarray(quantity.to(field.unit).magnitude, dtype=np.float64)
    return result


# --- the map file


def _mapping(raw: Any, where: str, allowed: Sequence[str], *, needed: Sequence[str] = ()) -> dict[str, Any]:
    if not isinstance(raw, Mapping):
        raise InputError(f"{where}: {_shown(raw)} is not a mapping; allowed: {', '.join(allowed)}")
    for key in raw:
        if key not in allowed:
            raise InputError(f"{where}: {_shown(key)}: no such field; allowed: {', '.join(allowed)}")
    for key in needed:
        if key not in raw:
            raise InputError(f"{where}.{key}: missing" if ": " in where else f"{where}: {key}: missing")
    return dict(raw)


def _source(raw: Any, where: str, field: _Field) -> Source:
    units = ("unit",) if field.unit else ()
    entry = _mapping(raw, where, ("column", "scale", "offset", "value", *units))
    if ("column" in entry) == ("value" in entry):
        raise InputError(f"{where}: either column or value must be given")
    if "value" in entry and not field.constant:
        raise InputError(f"{where}.value: a constant is not allowed here; allowed: a column")
    unit = ""
    if field.unit:
        if "unit" not in entry:
            raise InputError(f"{where}.unit: missing; allowed: such as {field.unit}")
        unit = _unit(entry["unit"], f"{where}.unit", field.unit)
    numbers = {
        key: _number(entry[key], f"{where}.{key}") for key in ("scale", "offset", "value") if key in entry
    }
    if "value" in numbers and len(numbers) > 1:
        raise InputError(f"{where}: scale and offset belong to a column, not to a value")
    if numbers.get("scale") == 0.0:
        raise InputError(f"{where}.scale: 0 is out of range; allowed: any other number")
    column = _text(entry["column"], f"{where}.column") if "column" in entry else ""
    return Source(column=column, unit=unit, **numbers)


def _refuse_shared(sources: Mapping[str, Source], fields: Mapping[str, _Field], where: str) -> None:
    """Refuse a column that is said to hold two quantities; one thermometer may stand for coils and air."""
    owners: dict[str, str] = {}
    for name, source in sources.items():
        if fields[name].constant:
            continue
        if source.column in owners:
            raise InputError(
                f"{where}.{name}.column: '{source.column}' is that of {owners[source.column]}, too; "
                "allowed: a column of its own"
            )
        owners[source.column] = name


def _unit(raw: Any, where: str, si: str) -> str:
    text = _text(raw, where)
    if si == "s" and text == TIMESTAMP:
        return text
    registry = unit_registry()
    if "rad" in si and "hz" in text.lower():  # turns a second to some, radians a second to others
        raise InputError(f"{where}: '{text}' can be meant in two ways; allowed: such as rad/s, rpm, turn/s")
    try:
        registry.Quantity(1.0, text).to(si)
    except Exception:  # pint raises several unrelated classes for a bad unit
        raise InputError(f"{where}: '{text}' is not a unit of this quantity; allowed: such as {si}") from None
    return text


def _environment(raw: Any, where: str) -> tuple[Environment, ...]:
    if not isinstance(raw, list):
        raise InputError(f"{where}: {_shown(raw)} is not a list of environments")
    fields = ("time_s", "rig", "yaw_deg", "air_density_ratio", "preheat_k", "table_rate_deg_s")
    factors = {"time_s": 1.0, "yaw_deg": DEG, "preheat_k": 1.0, "table_rate_deg_s": DEG}
    events = []
    for k, item in enumerate(raw):
        entry = _mapping(item, f"{where}[{k}]", fields)
        values: dict[str, Any] = {}
        for key, value in entry.items():
            if key == "rig":
                values[key] = _text(value, f"{where}[{k}].rig")
                continue
            name = key.removesuffix("_s").removesuffix("_deg").removesuffix("_k")
            values[name] = _number(value, f"{where}[{k}].{key}") * factors.get(key, 1.0)
        try:
            events.append(Environment(**values))
        except InputError as error:
            raise InputError(f"{where}[{k}]: {error}") from None
    if any(b.time <= a.time for a, b in itertools.pairwise(events)):
        raise InputError(f"{where}: the times must ascend")
    return tuple(events)


def _csv_settings(raw: Any, where: str) -> dict[str, Any]:
    entry = _CSV | _mapping(raw, where, tuple(_CSV))
    for key in ("delimiter", "decimal"):
        if not isinstance(entry[key], str) or len(entry[key]) != 1 or not entry[key].isascii():
            raise InputError(f"{where}.{key}: {_shown(entry[key])}; allowed: one character")
    if entry["delimiter"] == entry["decimal"]:
        raise InputError(f"{where}.decimal: '{entry['decimal']}' is the delimiter too; allowed: another one")
    lines = entry["skip_lines"]
    if type(lines) is not int or not 0 <= lines <= 10_000:
        raise InputError(f"{where}.skip_lines: {_shown(lines)}; allowed: 0 .. 10000")
    _text(entry["encoding"], f"{where}.encoding")
    return entry


def _number(raw: Any, where: str) -> float:
    if isinstance(raw, bool) or not isinstance(raw, int | float) or not abs(raw) <= 1e300:
        raise InputError(f"{where}: {_shown(raw)} is not allowed; allowed: a finite number")
    return float(raw)


def _text(raw: Any, where: str) -> str:
    if not isinstance(raw, str) or not raw:
        raise InputError(f"{where}: {_shown(raw)} is not allowed; allowed: a text")
    return raw


def _shown(raw: Any) -> str:
    text = repr(raw)
    return text if len(text) <= 60 else f"{text[:57]}..."


# --- writing


def _table_schema(recording: Recording) -> tuple[Any, dict[str, dict[str, str]]]:
    """Return the arrow schema of a recording's table, and the columns by group and field."""
    groups = {"columns": {name: name for name in _READINGS}}
    if len(recording.command):
        groups["command"] = {name: f"command_{name}" for name in _COMMANDS}
    if len(recording.setpoint):
        groups["setpoint"] = {name: f"setpoint_{name}" for name in _SETPOINTS}
    entries = [("time", "s", pa.float64()), ("sequence", "", pa.int64())]
    for group, names in groups.items():
        for name, column in names.items():
            whole = group == "setpoint" and name in wire.SETPOINT.integers
            entries.append((column, _GROUPS[group][name].unit, pa.int64() if whole else pa.float64()))
    about = {
        "schema": SCHEMA,
        "recording": recording.name,
        "bench": recording.bench_text,
        "environment": environments.to_json(recording.environment),
    }
    fields = [pa.field(name, kind, metadata={"unit": unit or "1"}) for name, unit, kind in entries]
    return pa.schema(fields, metadata={"gyrowheel": json.dumps(about)}), groups


def _nearest(recording: Recording) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return for every sample the rows of the command that answers it and of the setpoint in force; -1 for none."""
    samples = recording.measurement
    none = np.full(len(samples), -1)
    command = none
    if len(recording.command):
        answered = recording.command["measurement_sequence"]
        order = np.argsort(answered, kind="stable")
        at = np.searchsorted(answered[order], samples["sequence"], side="right") - 1
        found = order[np.maximum(at, 0)]
        command = np.where((at >= 0) & (answered[found] == samples["sequence"]), found, -1)
    setpoint = none
    if len(recording.setpoint):
        setpoint = np.searchsorted(recording.setpoint["stamp_ns"], samples["stamp_ns"], side="right") - 1
    return command, setpoint


def _rows(
    recording: Recording,
    rows: slice,
    schema: Any,
    command: NDArray[np.int64],
    setpoint: NDArray[np.int64],
) -> Any:
    samples = recording.measurement[rows]
    arrays = [
        pa.array(recording.seconds(samples["stamp_ns"])),
        pa.array(samples["sequence"].astype(np.int64)),
        *(pa.array(np.ascontiguousarray(samples[name])) for name in _READINGS),
    ]
    for source, index, names in (
        (recording.command, command[rows], _COMMANDS),
        (recording.setpoint, setpoint[rows], _SETPOINTS),
    ):
        if len(source):
            chosen = source[np.maximum(index, 0)]
            arrays += [pa.array(np.ascontiguousarray(chosen[name]), mask=index < 0) for name in names]
    cast = [array.cast(field.type) for array, field in zip(arrays, schema, strict=True)]
    return pa.Table.from_arrays(cast, schema=schema)


def _map_text(recording: Recording, groups: dict[str, dict[str, str]]) -> str:
    """Return the map file with which a table reads back."""
    content: dict[str, Any] = {"schema": SCHEMA}
    with contextlib.suppress(ValueError, TypeError, KeyError):
        content["bench"] = str(json.loads(recording.bench_text)["name"])
    content["time"] = {"column": "time", "unit": "s"}
    content["sequence"] = {"column": "sequence"}
    for group, names in groups.items():
        fields = _GROUPS[group]
        content[group] = {
            name: {"column": column} | ({"unit": fields[name].unit} if fields[name].unit else {})
            for name, column in names.items()
        }
    if recording.environment:
        content["environment"] = [
            {
                "time_s": event.time,
                "rig": event.rig,
                "yaw_deg": event.yaw / DEG,
                "air_density_ratio": event.air_density_ratio,
                "preheat_k": event.preheat,
                "table_rate_deg_s": event.table_rate / DEG,
            }
            for event in recording.environment
        ]
    return _MAP_HEAD + yaml.safe_dump(content, sort_keys=False, default_flow_style=None)


@contextlib.contextmanager
def _whole(path: Path) -> Iterator[Path]:
    """Give a place for a file that moves to where it belongs when the block has ended well."""
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        os.close(handle)
        temporary = Path(name)
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
        temporary = None
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or _line(error)}") from None
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
