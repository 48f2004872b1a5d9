"""Import of tables of other programs as recordings."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.exchange.column_map import ColumnMap
from gyrowheel_analysis.exchange.fields import COMMANDS, READINGS, SETPOINTS
from gyrowheel_analysis.exchange.table import Table
from gyrowheel_analysis.recording import RecordingWriter
from gyrowheel_control.plans.plan import SETPOINT_PERIOD
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_sim import environment as environments


def import_table(file: str | Path, column_map: ColumnMap, directory: str | Path) -> int:
    """Write a table as a recording.

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
        If the file cannot be read or lacks a column; if a value is missing (unless the map keeps such readings) or out
        of range; if its time is not uniform at the sample period of the bench; or if the directory cannot be written.
    """
    table = Table(Path(file), column_map)
    bench = column_map.bench
    sequence = table.sequence()
    period_ns = round(bench.sample_period * wire.SECOND)
    stamps = sequence * period_ns
    readings = wire.MEASUREMENT.array(len(sequence))
    wire.MEASUREMENT.set_stamps(readings, stamps)
    readings["sequence"] = sequence
    for name, source in column_map.columns.items():
        readings[name] = table.values(
            source, READINGS[name], f"columns.{name}", missing=column_map.keep_missing
        )
    _check_spin(table, readings, bench.sample_period)
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
    with RecordingWriter(directory) as writer:
        writer.write_columns(columns)
    return len(sequence)


def _check_spin(table: Table, readings: NDArray[Any], period: float) -> None:
    """Refuse a spin rate that disagrees with the spin angle: the unit of one of them is wrong."""
    angle, rate = np.diff(readings["spin_angle"]), readings["spin_rate"]
    turns = np.remainder(angle + math.pi, 2.0 * math.pi) - math.pi
    means = 0.5 * (rate[1:] + rate[:-1])
    # the angle does not show the number of turns in a gap
    known = (np.diff(readings["sequence"].astype(np.int64)) == 1) & np.isfinite(turns) & np.isfinite(means)
    turned, expected = float(np.sum(turns[known])), float(np.sum(means[known])) * period
    # noise and the ends of the range make less than a tenth of a turn
    if abs(turned - expected) > max(0.02 * abs(expected), 0.2 * math.pi):
        raise InputError(
            f"{table.path}: the spin angle turns by {turned:.6g} rad where the spin rate gives {expected:.6g} rad;"
            " allowed: 2 % between them (are unit and scale of columns.spin_angle and columns.spin_rate right?)"
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
    chosen = np.flatnonzero(changed | (stamps % round(SETPOINT_PERIOD * wire.SECOND) == 0))
    result = rows.view(f"V{rows.dtype.itemsize}")[chosen].view(rows.dtype)  # as bytes: with the padding
    return topics.SETPOINT, stamps[chosen], result


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
