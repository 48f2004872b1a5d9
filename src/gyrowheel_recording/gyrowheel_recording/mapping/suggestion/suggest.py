"""A map suggested for a table: each column with a reason, all that is doubtful, and a trial import by the map."""

from __future__ import annotations

import math
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mapping.clock import clock_offset
from gyrowheel_recording.mapping.column_names import COIL_CURRENT, SEQUENCE, TIME, UNITS, known_unit
from gyrowheel_recording.mapping.map_file import READINGS, SCHEMA, ColumnMap
from gyrowheel_recording.mapping.suggestion.checks import (
    broken_laws,
    rows_in_order,
    sentinel,
    words_for_nothing,
)
from gyrowheel_recording.mapping.suggestion.columns import assigned
from gyrowheel_recording.mapping.suggestion.questions import questions
from gyrowheel_recording.mapping.suggestion.records import Problem, Proposal, Suggestion
from gyrowheel_recording.mapping.suggestion.sizes import holes, in_si
from gyrowheel_recording.mapping.table_import import import_table
from gyrowheel_recording.mislabelled.find import wrong_setups
from gyrowheel_recording.mislabelled.fixes import WrongSetup
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
    """Return the content of the map file."""
    content: dict[str, Any] = {"schema": SCHEMA}
    if bench_name:
        content["bench"] = bench_name
    if TIME in found:
        content["time"] = {"column": found[TIME].column, "unit": found[TIME].unit}
    if SEQUENCE in found:
        content["sequence"] = {"column": found[SEQUENCE].column}
    nothing = {name: sentinel(own, grid.columns[own.column]) for name, own in found.items()}
    gone = [
        name
        for name, own in found.items()
        if own.field in READINGS and (holes(grid.columns[own.column]) or not math.isnan(nothing[name]))
    ]
    if gone:
        content["missing"] = "keep"
    columns: dict[str, Any] = {}
    for name in READINGS:
        own = found.get(name)
        if own is None and name.startswith("coil_voltage"):
            own = found.get(name.replace("voltage", "current"))
        if own is None:
            continue
        entry: dict[str, Any] = {"column": own.column} | ({"unit": own.unit} if own.unit else {})
        if own.pulses:
            entry["pulses"] = own.pulses
        if own.scale != 1.0:
            entry["scale"] = own.scale
        if own.clock:
            entry["clock"] = own.clock
        if not math.isnan(nothing[own.field]):
            entry["missing"] = nothing[own.field]
        if own.field in COIL_CURRENT:
            entry["resistance"] = _resistance(found, grid, bench)
        columns[name] = entry
    content["columns"] = columns
    if form is not None:
        usual = TextForm()
        keys = ("delimiter", "decimal", "skip_lines", "unit_lines", "comment", "encoding")
        other = {key: getattr(form, key) for key in keys if getattr(form, key) != getattr(usual, key)}
        if words := words_for_nothing(found, grid):
            other["missing"] = words
        if other:
            content["csv"] = other
    for clock in sorted({own.clock for own in found.values() if own.clock}):
        late = clock_offset(found, grid, clock, bench)
        if late is None:
            if fast := [
                own.column for own in found.values() if own.clock == clock and own.field not in _SLOW
            ]:
                problems.append(
                    Problem(
                        f"the clock '{clock}' of {', '.join(fast)} shows nothing that '{found[TIME].column}' shows "
                        "too: what lies between the two is not known.",
                        f"Put what is to be added to its times into the map, 0 for none: clocks: {{{clock}: 0.0}}.",
                        asks=True,
                    )
                )
            continue
        offset, error = late
        if abs(offset) > 3.0 * error:
            content.setdefault("clocks", {})[clock] = round(offset, 6)
            problems.append(
                Problem(
                    f"the clock '{clock}' is {1e3 * -offset:.4g} ± {1e3 * error:.2g} ms ahead of that of "
                    f"'{found[TIME].column}', by the correlation of what both show.",
                    f"The map adds {1e3 * offset:.4g} ms to it (`clocks:`).",
                    asks=False,
                )
            )
    return content


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
    stiff = 0.5 * (bench.value("flexure_stiffness_x") + bench.value("flexure_stiffness_y"))
    volts = stiff / bench.value("coil_constant")
    return float(f"{abs(volts / per_rad):.3g}") if per_rad else 1.0


_TRIALS: Final = 6  # imports by the map, each without what the last one refused


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
    path = Path(file)
    form: TextForm | None = None
    kind = "table in memory"
    if grid is None:
        format_ = format_of(path)
        kind = format_.title
        if format_.name == "text":
            form = form_of_file(path)
        grid = read_grid(path)
        content_grid = None
    else:
        content_grid = grid
    problems: list[Problem] = []
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
    if grid.remarks:
        problems += [
            Problem(
                f"{remark}.",
                "See whether the file is whole." if remark.endswith("left out") else "It is not used.",
                asks=False,
            )
            for remark in grid.remarks
        ]
    found = assigned(grid, bench, problems)
    content = map_content(found, grid, form, bench_name, bench, problems)
    used = {own.column for own in found.values()} | {own.clock for own in found.values()}
    unused = tuple(name for name in grid.columns if name not in used)
    likelier = questions(found, problems, bench, grid)
    ordered = False
    if TIME in found:
        own = found[TIME].column
        ordered, rows = _in_order(grid, own, problems)
        if ordered or (form is not None and any(column.odd for column in grid.columns.values())):
            # what is wrong there is told: the rest is looked at without it
            content_grid = grid.cut(rows)
    setups: tuple[WrongSetup, ...] = ()
    remarks: tuple[str, ...] = ()
    recording = None
    # as the map stands; where that is refused, with the units that are likelier, then without what is refused still
    dropped: set[str] = set()
    units: dict[str, str] = {}
    for _ in range(_TRIALS):
        trial = {
            name: replace(own, unit=units.get(name, own.unit))
            for name, own in found.items()
            if name not in dropped
        }
        if TIME not in trial or not {"spin_rate", "spin_angle"} & trial.keys():
            break
        try:
            tried = map_content(trial, grid, form, bench_name, bench, []) if units or dropped else content
            recording, remarks = _tried(path, tried, bench, content_grid)
        except InputError as error:
            bad = _told(str(error).replace(f"{path}: ", ""), trial, problems)
            if likelier and not units:
                units = likelier
            elif bad:
                dropped |= bad
            else:
                break
            continue
        setups = tuple(wrong_setups([recording], bench))
        changed = _mended(found, setups)
        if changed is None:
            break
        found = changed
        content = map_content(found, grid, form, bench_name, bench, [])
    if recording is not None and not setups and not any(problem.asks for problem in problems):
        problems += broken_laws(recording, bench)
    if dropped or units or ordered:
        recording, remarks = None, ()  # not what the map makes of the table
    return Suggestion(
        str(file), kind, tuple(found.values()), tuple(problems), setups, unused, remarks, content, recording
    )


def _in_order(grid: Grid, column: str, problems: list[Problem]) -> tuple[bool, Any]:
    """Return whether the order of the rows had to be questioned, and which rows can be looked at."""
    times = grid.columns[column].values
    every: Any = slice(None)
    if times.dtype.kind == "M":
        known = ~np.isnat(times)
        values = (
            (times - times[known][0]).astype("timedelta64[ns]").astype(np.float64) if known.any() else times
        )
    else:
        values = np.asarray(times, dtype=np.float64)
        known = np.isfinite(values)
    lengths = {len(own.values) for own in grid.columns.values() if own.numeric or own.dated}
    if len(lengths) > 1 or not known.any():
        return False, every
    rows = np.flatnonzero(known)
    wrong, part = rows_in_order(values[rows], column)
    if wrong is None:
        return False, every if known.all() else rows
    problems.append(wrong)
    return True, rows[part]


def _told(said: str, trial: Mapping[str, Proposal], problems: list[Problem]) -> set[str]:
    """Tell what an import refused, where it is not told yet; return the readings without which to try again."""
    known = {name: own.column for name, own in trial.items() if f"'{own.column}'" in said}
    if not any(
        problem.asks and f"'{name}'" in problem.what for name in known.values() for problem in problems
    ):
        problems.append(Problem(f"{said}.", "Correct the map there, or the table."))
    if "spin angle turns" in said:
        return {"spin_angle"}
    return {name for name in known if name not in (TIME, "tilt_x", "tilt_y")}


def _tried(
    path: Path, content: Mapping[str, Any], bench: Bench, grid: Grid | None
) -> tuple[Recording, tuple[str, ...]]:
    """Return the recording that a map makes of a table, and what was done for it."""
    column_map = replace(ColumnMap.from_mapping(dict(content), "the suggested map"), bench=bench)
    with tempfile.TemporaryDirectory(prefix="gyrowheel-") as folder:
        place = Path(folder) / "run"
        place.mkdir()
        made = import_table(path, column_map, place, grid=grid)
        return replace(Recording.open(place), path=path), made.remarks


def _mended(found: Mapping[str, Proposal], setups: Sequence[WrongSetup]) -> dict[str, Proposal] | None:
    """Return proposals with units that were only guessed put right; None where there is nothing of the kind."""
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
