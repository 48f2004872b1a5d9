"""Exchange of tables with other programs: import as recordings, export of recordings and of notch-filtered signals."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq
import yaml
from numpy.typing import NDArray

from gyrowheel_control.plans.plan import SETPOINT_PERIOD
from gyrowheel_core import topics, wire
from gyrowheel_core.arrays import picked
from gyrowheel_core.errors import InputError, printable
from gyrowheel_core.files import new_file, write_text
from gyrowheel_core.units import DEG, conversion
from gyrowheel_recording.bags import Origin, Recording, RecordingWriter, described
from gyrowheel_recording.derived import ASSUMED
from gyrowheel_recording.mapping.clock import Clock
from gyrowheel_recording.mapping.map_file import (
    COMMANDS,
    GROUPS,
    KEEP,
    READINGS,
    SCHEMA,
    SETPOINTS,
    ColumnMap,
    Source,
)
from gyrowheel_recording.mapping.pulses import PulseError, ShaftAngle, angle_from_pulses
from gyrowheel_recording.mapping.table import Table, check_suffix
from gyrowheel_recording.mislabelled.held import rows_a_value
from gyrowheel_recording.tables import Grid
from gyrowheel_sim import environment as environments

#: Turning between two samples beyond which an angle does not show how far it was [rad].
_TURNS: Final = 0.9 * math.pi
_OTHER_RATE: Final = 0.05  # part by which a table is slower than the loop


@dataclass(frozen=True)
class Imported:
    """Result of an import."""

    samples: int  # number of samples
    seconds: float  # time from the first to the last one, and the period of one [s]
    rate: float  # samples in a second
    remarks: tuple[str, ...]  # what was done to make a recording of it, and what it lacks


def import_table(
    file: str | Path, column_map: ColumnMap, directory: str | Path, *, grid: Grid | None = None
) -> Imported:
    """Write a table as a recording.

    Parameters
    ----------
    file : str or Path
        A table of any format that `tables` reads; one row a sample, in the order of time.
    column_map : ColumnMap
        What its columns mean.
    directory : str or Path
        The recording, to create. Its time begins at 0 with the first row.
    grid : Grid, optional
        The table itself, where it is no file; `file` is its name then.

    Raises
    ------
    InputError
        If the file cannot be read or lacks a column; if a value is missing (unless the map keeps such readings) or out
        of range; if its times are those of no clock; or if the directory cannot be written.
    """
    table = Table(Path(file), column_map, grid)
    bench = column_map.bench
    clock = table.clock()
    sequence, stamps = clock.sequence, clock.stamps_ns
    readings = wire.MEASUREMENT.array(len(sequence))
    wire.MEASUREMENT.set_stamps(readings, stamps)
    readings["sequence"] = sequence
    wrong = []
    for name in READINGS:
        source = column_map.columns.get(name)
        readings[name] = math.nan
        if source is not None and not source.pulses:
            try:
                readings[name] = table.values(
                    source, READINGS[name], f"columns.{name}", missing=column_map.keep_missing
                )
            except InputError as error:
                wrong.append(str(error))
    if wrong:  # all at once
        raise InputError("; ".join([wrong[0], *(text.removeprefix(f"{table.path}: ") for text in wrong[1:])]))
    remarks = [*clock.remarks, *table.remarks]
    origins = assumed(column_map)
    angle = column_map.columns.get("spin_angle")
    pulses, angle = (angle, None) if angle is not None and angle.pulses else (None, angle)
    if angle is not None and (step := table.clock_step(angle)) > clock.period:
        remarks += _hidden_turns(readings, clock.period, step)  # before it is compared with the speed
    if pulses is not None:
        found = _turned(table, pulses, readings, clock)
        readings["spin_angle"] = found.angle
        origins["spin_angle"] = Origin(found.uncertainty, pulses.pulses)
        remarks += [f"spin_angle: {text}" for text in found.remarks]
        remarks.append(f"spin_angle is known to {found.uncertainty / DEG:.2g} deg")
    elif {"spin_angle", "spin_rate"} <= column_map.columns.keys():
        _check_spin(table, readings, np.asarray(stamps * 1e-9, dtype=np.float64))
    if angle is not None and np.isfinite(readings["spin_angle"]).any():
        remarks += _hidden_turns(readings, clock.period, clock.period)
    remarks += _lacking(readings, column_map)
    readings["spin_angle"] = np.mod(readings["spin_angle"], 2.0 * math.pi)
    # a remainder may round up to the divisor itself
    readings["spin_angle"][readings["spin_angle"] >= 2.0 * math.pi] = 0.0
    remarks += [
        f"{name} is new in one of {rows:.3g} rows only"
        for name in ASSUMED
        if (rows := rows_a_value(readings[name].astype(np.float64), sequence)) > 1.0
    ]
    slower = clock.period / bench.sample_period
    if slower > 1.0 + _OTHER_RATE:
        remarks[0] += (
            f", where the loop of the bench gives {1.0 / bench.sample_period:.5g} voltages: {1.0 - 1.0 / slower:.0%} "
            "of them are not in the table, and averages are noisier. Record averages over each sample, or at the rate "
            "of the loop, or state another `sample_period` in the bench"
        )
    lacking = [name for name in READINGS if name not in column_map.columns]
    if lacking:
        remarks.append(f"not in the table: {', '.join(lacking)}")

    columns: list[tuple[topics.Topic, NDArray[np.int64], Any]] = []
    first = np.zeros(1, dtype=np.int64)
    columns.append((topics.BENCH, first, [wire.pack_text(described(bench.describe(), origins))]))
    if column_map.environment:
        text = environments.to_json(column_map.environment)
        columns.append((topics.ENVIRONMENT, first, [wire.pack_text(text)]))
    if column_map.setpoint:
        columns.append(_setpoints(table, column_map, stamps))
    columns.append((topics.MEASUREMENT, stamps, readings))
    if column_map.command:
        columns.append(_commands(table, column_map, stamps, sequence))
    with RecordingWriter(directory) as writer:
        writer.write_columns(columns)
    length = float(stamps[-1]) / wire.SECOND
    return Imported(len(sequence), length, 1.0 / clock.period, tuple(remarks))


def assumed(column_map: ColumnMap) -> dict[str, Origin]:
    """Return the uncertainties of assumed values, where the map states them."""
    return column_map.readings | {
        name: Origin(source.uncertainty * conversion(source.unit, READINGS[name].unit)[1])
        for name, source in column_map.columns.items()
        if source.uncertainty
    }


def _turned(table: Table, source: Source, readings: NDArray[Any], clock: Clock) -> ShaftAngle:
    """Return the angle by its pulses."""
    even = clock.period * clock.sequence.astype(np.float64)
    rate = readings["spin_rate"]
    try:
        return angle_from_pulses(
            even,
            rate if np.isfinite(rate).any() else None,
            table.edges(source, even),
            source.pulses,
            at=source.edge_angle_deg * DEG,
        )
    except PulseError as error:
        raise InputError(f"{table.path}: column '{source.column}': {error}") from None


def _lacking(readings: NDArray[Any], column_map: ColumnMap) -> list[str]:
    """Return how many samples lack a reading that the others have."""
    lacking = {name: ~np.isfinite(readings[name]) for name in READINGS if name in column_map.columns}
    lacking = {name: none for name, none in lacking.items() if none.any() and not none.all()}
    if not lacking:
        return []
    count = int(np.logical_or.reduce(list(lacking.values())).sum())
    lack = "lacks" if count == 1 else "lack"
    return [f"{count} of {len(readings)} samples {lack} a reading ({', '.join(lacking)})"]


def _hidden_turns(readings: NDArray[Any], period: float, step: float) -> list[str]:
    """Leave out an angle that was read too seldom, every `step` seconds, to show how far it turns."""
    fastest = _fastest(readings, period)
    if fastest * step <= _TURNS:
        return []
    readings["spin_angle"] = math.nan
    return [
        f"spin_angle is left out: at {fastest / (2.0 * math.pi):.4g} turns a second, {1.0 / step:.4g} "
        "samples a second do not show how far it turns"
    ]


def _fastest(readings: NDArray[Any], period: float) -> float:
    """Return the highest speed [rad/s], by the reading of the speed where there is one."""
    rate = readings["spin_rate"]
    if not np.isfinite(rate).any():
        turned = np.diff(readings["spin_angle"])
        rate = (np.remainder(turned + math.pi, 2.0 * math.pi) - math.pi) / period
    return float(np.nanmax(np.abs(rate), initial=0.0))


def _check_spin(table: Table, readings: NDArray[Any], time: NDArray[np.float64]) -> None:
    """Refuse a spin rate that disagrees with the spin angle: the unit of one of them, or of the time, is wrong."""
    angle, rate, passed = np.diff(readings["spin_angle"]), readings["spin_rate"], np.diff(time)
    turns = np.remainder(angle + math.pi, 2.0 * math.pi) - math.pi
    means = 0.5 * (rate[1:] + rate[:-1])
    # the angle does not show the number of turns in a gap
    known = (np.diff(readings["sequence"].astype(np.int64)) == 1) & np.isfinite(turns) & np.isfinite(means)
    held = rows_a_value(readings["spin_angle"].astype(np.float64), readings["sequence"].astype(np.int64))
    # an angle that is held over too many rows is reported as held
    known &= np.abs(means) * passed * held < _TURNS
    turned, expected = float(np.sum(turns[known])), float(np.sum((means * passed)[known]))
    # noise and the ends of the range make less than a tenth of a turn
    if abs(turned - expected) > max(0.02 * abs(expected), 0.2 * math.pi):
        raise InputError(
            f"{table.path}: the spin angle turns by {turned:.6g} rad where the spin rate gives {expected:.6g} rad;"
            " allowed: 2 % between them (are unit and scale of columns.spin_angle, columns.spin_rate and time right?)"
        )


def _setpoints(
    table: Table, column_map: ColumnMap, stamps: NDArray[np.int64]
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
        rows[name] = read(source, SETPOINTS[name], f"setpoint.{name}", filled)
        changed[1:] |= rows[name][1:] != rows[name][:-1]
    ticks = stamps // round(SETPOINT_PERIOD * wire.SECOND)
    chosen = np.flatnonzero(changed | np.r_[True, np.diff(ticks) > 0])
    return topics.SETPOINT, stamps[chosen], picked(rows, chosen)


def _commands(
    table: Table, column_map: ColumnMap, stamps: NDArray[np.int64], sequence: NDArray[np.int64]
) -> tuple[topics.Topic, NDArray[np.int64], NDArray[Any]]:
    filled = table.filled(column_map.command)
    stamps, sequence = stamps[filled], sequence[filled]
    rows = wire.COMMAND.array(len(stamps))
    wire.COMMAND.set_stamps(rows, stamps)
    rows["measurement_sequence"] = sequence
    for name, source in column_map.command.items():
        rows[name] = table.values(source, COMMANDS[name], f"command.{name}", filled)
    return topics.COMMAND, stamps, rows


_SIGNAL_HEAD: Final = ["recording", "stamp", "notched_tilt_x"]


def write_signals(
    signals: Sequence[Mapping[str, Any]], units: Mapping[str, str], file: str | Path
) -> list[str]:
    """Write signals as a table, the recordings one after the other.

    Parameters
    ----------
    signals : sequence of mapping
        For each recording ``recording``, its name, and columns of equal length [SI], ``stamp`` first.
    units : mapping
        Unit of each column, for the metadata of a Parquet file.
    file : str or Path
        The ``.csv`` or ``.parquet`` file; it is whole or as it was before.

    Returns
    -------
    list of str
        Names of the columns.

    Raises
    ------
    InputError
        If the file has another ending, or cannot be written.
    """
    path = Path(file)
    check_suffix(path)
    names = [name for name in signals[0] if name != "recording"]
    fields = [pa.field("recording", pa.string())]
    fields += [pa.field(name, pa.float64(), metadata={"unit": units[name]}) for name in names]
    schema = pa.schema(fields, metadata={"gyrowheel": json.dumps({"signals": "notched"})})
    paths = [printable(str(own["recording"])) for own in signals for _ in own["stamp"]]
    columns = [pa.array(np.concatenate([own[name] for own in signals])) for name in names]
    table = pa.Table.from_arrays([pa.array(paths, pa.string()), *columns], schema=schema)
    with new_file(path) as place, place.open("wb") as opened:
        if path.suffix == ".csv":
            pc.write_csv(table, opened)
        else:
            pq.write_table(table, opened, compression="zstd")
    return [str(name) for name in schema.names]


def is_signal_head(names: Sequence[str]) -> bool:
    """Return whether the first line of a table is one of `write_signals`."""
    return list(names[: len(_SIGNAL_HEAD)]) == _SIGNAL_HEAD


#: First line of a map that was written.
_MAP_HEAD: Final = "# What the columns of the table mean, for `gyrowheel import`.\n"
_CHUNK: Final = 200_000  # rows written at a time


def export_recording(
    recording: Recording,
    file: str | Path,
    *,
    map_file: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[str]:
    """Write a recording as a table: one row per sample, SI units.

    Parameters
    ----------
    recording : Recording
        The recording.
    file : str or Path
        The ``.csv`` or ``.parquet`` file; it is whole or as it was before.
    map_file : str or Path, optional
        Map file to write, with which `import_table` reads the table back.
    progress : callable, optional
        Called repeatedly with the fraction done.

    Returns
    -------
    list of str
        Names of the columns.

    Raises
    ------
    InputError
        If the file has another ending, or cannot be written.
    """
    path = Path(file)
    check_suffix(path)
    schema, groups = _table_schema(recording)
    command, setpoint = _nearest(recording)
    with new_file(path) as place, contextlib.ExitStack() as stack:
        # opened here: arrow refuses names of files that are not text
        opened = stack.enter_context(place.open("wb"))
        if path.suffix == ".csv":
            writer: Any = stack.enter_context(pc.CSVWriter(opened, schema))
        else:
            writer = stack.enter_context(pq.ParquetWriter(opened, schema, compression="zstd"))
        total = len(recording.measurement)
        for begin in range(0, total, _CHUNK):
            rows = slice(begin, min(begin + _CHUNK, total))
            writer.write_table(_rows(recording, rows, schema, command, setpoint))
            if progress is not None:
                progress(rows.stop / total)
    if map_file is not None:
        write_text(Path(map_file), _map_text(recording, groups))
    return [str(name) for name in schema.names]


def is_exported_table(file: Path) -> bool:
    """Return whether a file was written by `export_recording`.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    if file.suffix == ".csv":
        with file.open(encoding="utf-8", errors="replace") as stream:
            first = [name.strip().strip('"') for name in stream.readline(100_000).split(",")]
        return first[: 2 + len(READINGS)] == ["time", "sequence", *READINGS] or is_signal_head(first)
    try:
        with file.open("rb") as opened:
            return b"gyrowheel" in (pq.read_schema(opened).metadata or {})
    except pa.ArrowException:
        return False


def is_exported_map(file: Path) -> bool:
    """Return whether a file is a map written by `export_recording`.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    with file.open(encoding="utf-8", errors="replace") as stream:
        return stream.readline(1000) == _MAP_HEAD


def _table_schema(recording: Recording) -> tuple[Any, dict[str, dict[str, str]]]:
    """Return the arrow schema of a recording's table, and the columns by group and field."""
    groups = {"columns": {name: name for name in READINGS}}
    if len(recording.command):
        groups["command"] = {name: f"command_{name}" for name in COMMANDS}
    if len(recording.setpoint):
        groups["setpoint"] = {name: f"setpoint_{name}" for name in SETPOINTS}
    entries = [("time", "s", pa.float64()), ("sequence", "", pa.int64())]
    for group, names in groups.items():
        for name, column in names.items():
            whole = group == "setpoint" and name in wire.SETPOINT.integers
            entries.append((column, GROUPS[group][name].unit, pa.int64() if whole else pa.float64()))
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
    recording: Recording, rows: slice, schema: Any, command: NDArray[np.int64], setpoint: NDArray[np.int64]
) -> Any:
    samples = recording.measurement[rows]
    arrays = [
        pa.array(recording.seconds(samples["stamp_ns"])),
        pa.array(samples["sequence"].astype(np.int64)),
        *(pa.array(np.ascontiguousarray(samples[name])) for name in READINGS),
    ]
    for source, index, names in (
        (recording.command, command[rows], COMMANDS),
        (recording.setpoint, setpoint[rows], SETPOINTS),
    ):
        if len(source):
            chosen = source[np.maximum(index, 0)]
            arrays += [pa.array(np.ascontiguousarray(chosen[name]), mask=index < 0) for name in names]
    cast = [array.cast(field.type) for array, field in zip(arrays, schema, strict=True)]
    return pa.Table.from_arrays(cast, schema=schema)


def _map_text(recording: Recording, groups: dict[str, dict[str, str]]) -> str:
    """Return the map file with which a table reads back."""
    content: dict[str, Any] = {"schema": SCHEMA}
    if recording.carried_bench is not None:
        content["bench"] = recording.carried_bench[0]
    content["time"] = {"column": "time", "unit": "s"}
    content["sequence"] = {"column": "sequence"}
    if any(not np.all(np.isfinite(recording.measurement[name])) for name in READINGS):
        content["missing"] = KEEP
    for group, names in groups.items():
        fields = GROUPS[group]
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
            | ({"machine": event.machine} if event.machine else {})
            for event in recording.environment
        ]
    if recording.origins:
        content["readings"] = {name: asdict(own) for name, own in recording.origins.items()}
    return _MAP_HEAD + yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
