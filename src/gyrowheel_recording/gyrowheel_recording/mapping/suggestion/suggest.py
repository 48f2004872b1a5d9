"""What a table seems to hold: a map with a reason for every column, and everything that is doubtful about it at once.

Names and units come first, then the size of the values. What then stands in the map is tried: the table is imported by
it, and the laws of the wheel are asked (`setups`) whether its columns can be what they are called.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mapping.column_map import ColumnMap
from gyrowheel_recording.mapping.column_names import TIME, UNITS, known_unit
from gyrowheel_recording.mapping.suggestion.columns import assigned
from gyrowheel_recording.mapping.suggestion.content import map_content
from gyrowheel_recording.mapping.suggestion.laws import broken_laws
from gyrowheel_recording.mapping.suggestion.order import rows_in_order
from gyrowheel_recording.mapping.suggestion.questions import questions
from gyrowheel_recording.mapping.suggestion.records import Problem, Proposal, Suggestion
from gyrowheel_recording.mapping.table_import import import_table
from gyrowheel_recording.mislabelled.find import wrong_setups
from gyrowheel_recording.mislabelled.fixes import WrongSetup
from gyrowheel_recording.tables import Grid, TextForm, form_of_file, format_of, read_grid
from gyrowheel_sim.bench import Bench

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
