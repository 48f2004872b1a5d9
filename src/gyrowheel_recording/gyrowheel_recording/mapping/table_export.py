"""Export of recordings, and of notch-filtered signals, as tables for other programs."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq
import yaml
from numpy.typing import NDArray

from gyrowheel_core import wire
from gyrowheel_core.errors import printable
from gyrowheel_core.files import new_file, write_text
from gyrowheel_core.units import DEG
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mapping.map_file import COMMANDS, GROUPS, KEEP, READINGS, SCHEMA, SETPOINTS
from gyrowheel_recording.mapping.table import check_suffix
from gyrowheel_sim import environment as environments

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
