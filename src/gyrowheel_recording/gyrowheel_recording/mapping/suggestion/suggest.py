"""A map suggested for a table: each column with a reason, all that is doubtful, and a trial import by the map."""

from __future__ import annotations

import math
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mapping.clock import clock_offset, rows_twice
from gyrowheel_recording.mapping.column_names import COIL_CURRENT, SEQUENCE, TIME, UNITS, known_unit
from gyrowheel_recording.mapping.exchange import import_table
from gyrowheel_recording.mapping.map_file import READINGS, SCHEMA, ColumnMap
from gyrowheel_recording.mapping.suggestion import Problem, Proposal, Suggestion, holes, in_si
from gyrowheel_recording.mapping.suggestion.checks import (
    broken_laws,
    column_problems,
    sentinel,
    words_for_nothing,
)
from gyrowheel_recording.mapping.suggestion.columns import assign_columns, with_stamps
from gyrowheel_recording.mapping.suggestion.row_order import rows_again, rows_in_order
from gyrowheel_recording.mapping.table_file import interpolated, sample_rows
from gyrowheel_recording.mislabelled import WrongSetup
from gyrowheel_recording.mislabelled.find import wrong_setups
from gyrowheel_recording.tables import Grid, TextForm, form_of_file, format_of, read_grid
from gyrowheel_sim.bench import Bench

#: Readings that change so slowly that no offset between two clocks counts.
_SLOW = ("coil_temperature", "air_temperature", "air_pressure")


def map_content(
    found: Mapping[str, Proposal],
    grid: Grid,
    form: TextForm | None,
    bench_name: str,
    bench: Bench,
    problems: list[Problem],
) -> dict[str, Any]:
    """Return the content of the map file; to `problems` are added those of its clocks."""
    content: dict[str, Any] = {"schema": SCHEMA}
    if bench_name:
        content["bench"] = bench_name
    if TIME in found:
        scale = {} if found[TIME].scale == 1.0 else {"scale": found[TIME].scale}
        content["time"] = {"column": found[TIME].column, "unit": found[TIME].unit} | scale
    if SEQUENCE in found:
        content["sequence"] = {"column": found[SEQUENCE].column}
    sentinels = {name: sentinel(own, grid.columns[own.column]) for name, own in found.items()}
    if any(
        own.field in READINGS and (holes(grid.columns[own.column]) or not math.isnan(sentinels[name]))
        for name, own in found.items()
    ):
        content["missing"] = "keep"
    content["columns"] = {
        name: _source(own, sentinels[own.field], found, grid, bench)
        for name in READINGS
        if (own := found.get(name) or found.get(name.replace("coil_voltage", "coil_current")))
    }
    if form is not None and (settings := _csv_settings(form, found, grid)):
        content["csv"] = settings
    unknown: dict[str, list[str]] = {}
    for clock in sorted({own.clock for own in found.values() if own.clock}):
        late = clock_offset(found, grid, clock, bench)
        if late is None:
            fast = [own.column for own in found.values() if own.clock == clock and own.field not in _SLOW]
            unknown |= {clock: fast} if fast else {}
        elif _counts(late):
            problems.append(_clock_remark(clock, late, found))
            content.setdefault("clocks", {})[clock] = round(late[0], 6)
    if unknown:
        problems.append(_clock_question(unknown, found))
    return content


def _source(
    own: Proposal, nothing: float, found: Mapping[str, Proposal], grid: Grid, bench: Bench
) -> dict[str, Any]:
    """Return the entry of a column in the map; `nothing` is the number that stands for no reading, or NaN."""
    entry: dict[str, Any] = {"column": own.column} | ({"unit": own.unit} if own.unit else {})
    if own.pulses:
        entry["pulses"] = own.pulses
    if own.scale != 1.0:
        entry["scale"] = own.scale
    if own.clock:
        entry["clock"] = own.clock
    if not math.isnan(nothing):
        entry["missing"] = nothing
    if own.field in COIL_CURRENT:
        entry["resistance"] = _resistance(found, grid, bench)
    return entry


def _csv_settings(form: TextForm, found: Mapping[str, Proposal], grid: Grid) -> dict[str, Any]:
    """Return how a text is written, where that is not as usual."""
    usual = TextForm()
    keys = ("delimiter", "decimal", "skip_lines", "unit_lines", "comment", "encoding")
    other = {key: getattr(form, key) for key in keys if getattr(form, key) != getattr(usual, key)}
    words = words_for_nothing(found, grid)
    return other | ({"missing": words} if words else {})


def _counts(late: tuple[float, float]) -> bool:
    """Whether the offset of a clock is more than its error."""
    return abs(late[0]) > 3.0 * late[1]


def _clock_question(unknown: Mapping[str, Sequence[str]], found: Mapping[str, Proposal]) -> Problem:
    """Return the question of the offsets of clocks that are unknown and count; `unknown` has their columns."""
    clocks = " and ".join(f"'{clock}' of {', '.join(columns)}" for clock, columns in unknown.items())
    several = len(unknown) > 1
    return Problem(
        f"the clock{'s' * several} {clocks} show{'s' * (not several)} nothing that '{found[TIME].column}' shows too: "
        "what lies between them is not known.",
        "Put what is to be added to the times into the map, 0 for none: clocks: "
        f"{{{', '.join(f'{clock}: 0.0' for clock in unknown)}}}.",
    )


def _clock_remark(clock: str, late: tuple[float, float], found: Mapping[str, Proposal]) -> Problem:
    """Return what the offset of a clock is, with its error."""
    offset, error = late
    return Problem(
        f"the clock '{clock}' is {1e3 * -offset:.4g} ± {1e3 * error:.2g} ms ahead of that of "
        f"'{found[TIME].column}', by the correlation of what both show.",
        f"The map adds {1e3 * offset:.4g} ms to it (`clocks:`).",
        asks=False,
    )


def _resistance(found: Mapping[str, Proposal], grid: Grid, bench: Bench) -> float:
    """Return the resistance by which the currents of the coils are their voltages [ohm]: that holds up the flexures."""
    tilts, currents = [], []
    for axis in "xy":
        tilt, current = found.get(f"tilt_{axis}"), found.get(f"coil_current_{axis}")
        if tilt is None or current is None or tilt.clock or current.clock:
            continue
        tilts.append(in_si(tilt, grid, "rad"))
        currents.append(in_si(current, grid, "A"))
    if not tilts:
        return 1.0
    x, y = np.concatenate(tilts), np.concatenate(currents)
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known] - x[known].mean(), y[known] - y[known].mean()
    per_rad = float(x @ y) / float(x @ x) if float(x @ x) else 0.0
    volts = bench.flexure_stiffness / bench.value("coil_constant")
    return float(f"{abs(volts / per_rad):.3g}") if per_rad else 1.0


_TRIALS: Final = 6  # imports by the map, each without what the last one refused


@dataclass(frozen=True)
class _Table:
    """A table to suggest a map for; `given` where it is no file."""

    path: Path
    raw: Grid  # as it was read
    grid: Grid  # as it is looked at: times that stand in two columns are one
    form: TextForm | None
    kind: str
    given: bool
    bench: Bench
    bench_name: str
    stamps: Mapping[str, tuple[str, str, str]]  # columns that are two of the table

    @classmethod
    def read(cls, path: Path, grid: Grid | None, bench: Bench, bench_name: str) -> _Table:
        form, kind = None, "table in memory"
        raw = grid
        if raw is None:
            format_ = format_of(path)
            form, kind = form_of_file(path) if format_.name == "text" else None, format_.title
            raw = read_grid(path)
        seen, stamps = with_stamps(raw)
        return cls(path, raw, seen, form, kind, grid is not None, bench, bench_name, stamps)

    def map_content(self, found: Mapping[str, Proposal], problems: list[Problem]) -> dict[str, Any]:
        content = map_content(found, self.grid, self.form, self.bench_name, self.bench, problems)
        if (two := self.stamps.get(content.get("time", {}).get("column", ""))) is not None:
            content["time"] = {"column": two[0], "unit": "s", "plus": two[1], "plus_unit": two[2]}
        return content


@dataclass
class _Trial:
    """Columns and map after the trial imports, and their result.

    `changed` is whether the recording is not exactly what the map makes of the table.
    """

    found: dict[str, Proposal]
    content: dict[str, Any]
    setups: tuple[WrongSetup, ...] = ()
    remarks: tuple[str, ...] = ()
    recording: Recording | None = None
    changed: bool = False


def suggest(file: str | Path, bench: Bench, *, bench_name: str = "", grid: Grid | None = None) -> Suggestion:
    """Look at a table and return a map for it.

    Parameters
    ----------
    file : str or Path
        The table, or its name where `grid` is given.
    bench : Bench
        The bench that it was measured on.
    bench_name : str
        Its name or file, for the map; the default bench if empty.
    grid : Grid, optional
        The table itself, where it is no file.

    Raises
    ------
    InputError
        If it cannot be read at all.
    """
    table = _Table.read(Path(file), grid, bench, bench_name)
    problems = _table_problems(table)
    found = assign_columns(table.grid, bench, problems)
    content = table.map_content(found, problems)
    used = {own.column for own in found.values()} | {own.clock for own in found.values()}
    unused = tuple(name for name in table.grid.columns if name not in used)
    likelier = column_problems(found, problems, bench, in_samples(found, table.grid))
    rows: Any = None  # that can be imported; None for the unchanged file
    disordered = False
    if TIME in found:
        disordered, rows = _rows_in_order(table.grid, found, problems)
        odd = table.form is not None and any(column.odd for column in table.grid.columns.values())
        rows = rows if disordered or odd else None  # what is wrong elsewhere has been reported
    trial_grid = table.raw if table.given else None
    if rows is not None:
        trial_grid = table.raw.cut(rows)
    if rows is None or isinstance(rows, slice) or len(rows) > 1:
        trial = _trial_imports(table, found, content, likelier, trial_grid, problems)
    else:
        trial = _Trial(found, content)
    recording, remarks = trial.recording, trial.remarks
    if recording is not None and not trial.setups and not any(problem.asks for problem in problems):
        problems += broken_laws(recording, bench)
    if trial.changed or disordered:
        recording, remarks = None, ()
    return Suggestion(
        str(file),
        table.kind,
        tuple(trial.found.values()),
        tuple(problems),
        trial.setups,
        unused,
        remarks,
        trial.content,
        recording,
    )


def in_samples(found: Mapping[str, Proposal], grid: Grid) -> Grid:
    """Return a table without rows that are no samples, as an import takes it: slow readings may have their own rows."""
    own = {
        name: item
        for name, item in found.items()
        if name in READINGS and not item.clock and not item.pulses and grid.columns[item.column].numeric
    }
    time = found.get(TIME)
    lengths = {len(column.values) for column in grid.columns.values() if column.numeric or column.dated}
    if time is None or len(lengths) > 1:
        return grid
    values = {
        name: np.asarray(grid.columns[item.column].values, dtype=np.float64) for name, item in own.items()
    }
    slow = {name: array for name, array in values.items() if READINGS[name].constant}
    fast = {name: array for name, array in values.items() if name not in slow}
    if not fast or not slow or all(np.isfinite(array).all() for array in slow.values()):
        return grid
    samples = sample_rows(fast, slow)
    when = np.asarray(grid.columns[time.column].values).astype(np.float64)
    moved = {own[name].column: interpolated(when, array, samples) for name, array in slow.items()}
    cut = grid.cut(samples)
    columns = {
        name: column if (new := moved.get(name)) is None else replace(column, values=new)
        for name, column in cut.columns.items()
    }
    return replace(cut, columns=columns)


def _table_problems(table: _Table) -> list[Problem]:
    """Return what is doubtful about the names and the rows of a table."""
    problems: list[Problem] = []
    form = table.form
    if form is not None and not form.named:
        problems.append(
            Problem(
                "the table has no line of names.",
                "Write one above the numbers: a name and a unit for every column.",
            )
        )
    for name, count in Counter(form.names if form is not None else ()).items():
        if name and count > 1:
            problems.append(Problem(f"{count} columns are called '{name}'.", "Give each a name of its own."))
    for remark in table.grid.remarks:
        broken = "rows of another length" in remark or "breaks off" in remark or "damaged" in remark
        cure = "See whether the file is whole." if broken else ""
        problems.append(Problem(f"{remark}.", cure, asks=False))
    return problems


def _trial_imports(
    table: _Table,
    found: dict[str, Proposal],
    content: dict[str, Any],
    likelier: dict[str, str],
    grid: Grid | None,
    problems: list[Problem],
) -> _Trial:
    """Import a table by its map until the laws of the wheel hold, and report what is refused.

    Where the map is refused, the units that are likelier are tried, then the map without what is still refused.
    """
    result = _Trial(found, content)
    dropped: set[str] = set()
    units: dict[str, str] = {}
    for _ in range(_TRIALS):
        trial = {
            name: replace(own, unit=units.get(name, own.unit))
            for name, own in result.found.items()
            if name not in dropped
        }
        if not {TIME, "tilt_x", "tilt_y"} <= trial.keys() or not {"spin_rate", "spin_angle"} & trial.keys():
            break
        try:
            tried = table.map_content(trial, []) if units or dropped else result.content
            result.recording, result.remarks = _import(table.path, tried, table.bench, grid)
        except InputError as error:
            bad = _report_refusal(str(error).replace(f"{table.path}: ", ""), trial, problems)
            if likelier and not units:
                units = likelier
            elif bad:
                dropped |= bad
            else:
                break
            continue
        result.setups = tuple(wrong_setups([result.recording], table.bench))
        corrected = _with_corrected_units(result.found, result.setups)
        if corrected is None:
            break
        result.found, result.content = corrected, table.map_content(corrected, [])
    result.changed = bool(dropped or units)
    return result


def _rows_in_order(grid: Grid, found: Mapping[str, Proposal], problems: list[Problem]) -> tuple[bool, Any]:
    """Return whether the order of the rows had to be questioned, and which rows can be looked at."""
    column = found[TIME].column
    times = grid.columns[column].values
    every: Any = slice(None)
    if times.dtype.kind == "M":
        known = ~np.isnat(times)
        values = (
            1e-9 * (times - times[known][0]).astype("timedelta64[ns]").astype(np.float64)
            if known.any()
            else times
        )
    else:
        values = np.asarray(times, dtype=np.float64)
        known = np.isfinite(values)
    lengths = {len(own.values) for own in grid.columns.values() if own.numeric or own.dated}
    if len(lengths) > 1 or not known.any():
        return False, every
    rows = np.flatnonzero(known)
    angle, turned = found.get("spin_angle"), None
    if angle is not None and not angle.pulses and not angle.clock:
        turned = in_si(angle, grid, "turn")[rows]
    readings = [
        np.asarray(grid.columns[own.column].values)[rows]
        for name, own in found.items()
        if name in READINGS and not READINGS[name].constant and not own.clock
    ]
    twice = rows_twice(values[rows], readings)
    wrong, part = rows_in_order(
        values[rows],
        column,
        turned,
        twice,
        again=rows_again(values[rows], readings),
        unit=" s" if times.dtype.kind == "M" else "",
    )
    if wrong is None:
        return False, every if known.all() else rows
    problems.append(wrong)
    return True, rows[part]


def _report_refusal(said: str, trial: Mapping[str, Proposal], problems: list[Problem]) -> set[str]:
    """Report what an import refused, where it is not reported yet; return the readings to try again without."""
    known = {name: own.column for name, own in trial.items() if f"'{own.column}'" in said}
    if not any(
        problem.asks and f"'{name}'" in problem.what for name in known.values() for problem in problems
    ):
        problems.append(Problem(f"{said}.", "Correct the map there, or the table."))
    if "spin angle turns" in said:
        return {"spin_angle"}
    return {name for name in known if name not in (TIME, "tilt_x", "tilt_y")}


def _import(
    path: Path, content: Mapping[str, Any], bench: Bench, grid: Grid | None
) -> tuple[Recording, tuple[str, ...]]:
    """Return the recording that a map makes of a table, and what was done for it."""
    column_map = replace(ColumnMap.from_mapping(dict(content), "the suggested map"), bench=bench)
    with tempfile.TemporaryDirectory(prefix="gyrowheel-") as folder:
        place = Path(folder) / "run"
        place.mkdir()
        made = import_table(path, column_map, place, grid=grid)
        return replace(Recording.open(place), path=path), made.remarks


def _with_corrected_units(
    found: Mapping[str, Proposal], setups: Sequence[WrongSetup]
) -> dict[str, Proposal] | None:
    """Return proposals with guessed units corrected by the laws of the wheel; None where none is."""
    result = dict(found)
    changed = False
    for wrong in setups:
        units = [known_unit("Hz" if own.strip() == "Hz" else own) for own in wrong.unit.split(",")]
        if wrong.kind != "unit" or len(units) not in (1, len(wrong.columns)) or not all(units):
            continue
        for k, name in enumerate(wrong.columns):
            own = result.get(name)
            if own is None or own.stated:
                continue
            unit = units[k] if len(units) > 1 else units[0]
            # what is seen is the unit of readings that were taken for SI units
            if own.unit != UNITS[name] or own.scale != 1.0:
                continue
            result[name] = replace(
                own, unit=unit, reason=f"{own.reason}; the laws of the wheel say {unit}", stated=True
            )
            changed = True
    return result if changed else None
