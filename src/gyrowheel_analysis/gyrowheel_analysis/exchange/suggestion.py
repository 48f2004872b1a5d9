"""What a table seems to hold: a map with a reason for every column, and everything that is doubtful about it at once.

Names and units come first, then the size of the values. What then stands in the map is tried: the table is imported by
it, and the laws of the wheel are asked (`setups`) whether its columns can be what they are called.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import NDArray

from gyrowheel_analysis.derived import completed, unmeasured
from gyrowheel_analysis.exchange.clock import LONGEST, SHORTEST
from gyrowheel_analysis.exchange.column_map import ColumnMap
from gyrowheel_analysis.exchange.fields import READINGS
from gyrowheel_analysis.exchange.importing import import_table
from gyrowheel_analysis.exchange.map_file import SCHEMA, TIMESTAMP
from gyrowheel_analysis.exchange.naming import (
    COIL_CURRENT,
    SEQUENCE,
    TEMPERATURE,
    TIME,
    UNITS,
    Named,
    known_unit,
    named,
)
from gyrowheel_analysis.exchange.offset import clock_offset
from gyrowheel_analysis.recording import Recording
from gyrowheel_analysis.setups.cures import WrongSetup
from gyrowheel_analysis.setups.find import wrong_setups
from gyrowheel_analysis.tables import Column, Grid, TextForm, form_of, format_of, read_grid, text_of
from gyrowheel_core.errors import InputError
from gyrowheel_core.readings import Readings
from gyrowheel_core.units import conversion
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

_SEEN: Final = 1 << 18  # bytes by which is told how a text is written
_SOME: Final = 20_000  # values that are looked at
_TILT: Final = ("rad", "deg", "mrad", "arcmin")
_THERMAL: Final = ("degC", "K", "degF")
#: Units that are tried where none is stated, likeliest first.
_GUESSES: Final[dict[str, tuple[str, ...]]] = {
    "tilt_x": _TILT,
    "tilt_y": _TILT,
    "spin_angle": ("rad", "deg", "turn"),
    "spin_rate": ("rad/s", "rpm", "turn/s", "deg/s"),
    "coil_voltage_x": ("V", "mV"),
    "coil_voltage_y": ("V", "mV"),
    "motor_voltage": ("V", "mV"),
    "motor_current": ("A", "mA"),
    **dict.fromkeys(COIL_CURRENT, ("A", "mA")),
    **dict.fromkeys(("coil_temperature", "air_temperature"), _THERMAL),
    "air_pressure": ("Pa", "hPa", "kPa", "bar", "mmHg"),
    TIME: ("s", "ms", "us", "ns", "min"),
}
_WHOLE_TURNS: Final = (
    360.0,
    2.0 * math.pi,
    1.0,
    3600.0,
    36000.0,
    4000.0,
    10000.0,
    *(2.0**k for k in range(8, 25)),
)
_NEAR: Final = 0.03  # part by which a range may fall short of a whole turn
_AGREE: Final = 0.02  # part by which an angle may turn otherwise than the speed says
_MISSING: Final = 0.5  # of the rows; a column with fewer values is not used


@dataclass(frozen=True)
class Proposal:
    """What one column seems to be.

    Attributes
    ----------
    field : str
        A reading, ``time`` or ``sequence``.
    column : str
        Its name in the table.
    unit : str
        Its unit.
    scale : float
        What its values are multiplied by before the unit counts.
    reason : str
        Why.
    stated : bool
        Whether the file states the unit.
    clock : str
        Column with the times of its rows, where that is not the map's.
    lowest, highest : float
        Its range, in the unit.
    """

    field: str
    column: str
    unit: str
    scale: float
    reason: str
    stated: bool
    clock: str = ""
    lowest: float = math.nan
    highest: float = math.nan


@dataclass(frozen=True)
class Problem:
    """What is doubtful about a table, or missing.

    Attributes
    ----------
    what, cure : str
        What it is, and what to do.
    asks : bool
        Whether nothing may be concluded before it is answered.
    """

    what: str
    cure: str
    asks: bool = True


@dataclass(frozen=True)
class Suggestion:
    """A map for a table.

    Attributes
    ----------
    table : str
        The table.
    kind : str
        Its format.
    proposals : tuple of Proposal
        What its columns seem to be.
    problems : tuple of Problem
        All that is doubtful or missing.
    setups : tuple of WrongSetup
        What the laws of the wheel say against the map.
    unused : tuple of str
        Columns that the map leaves out.
    remarks : tuple of str
        What an import by the map does.
    content : dict
        The map file.
    recording : Recording or None
        What the map makes of the table, if it can be imported.
    """

    table: str
    kind: str
    proposals: tuple[Proposal, ...]
    problems: tuple[Problem, ...]
    setups: tuple[WrongSetup, ...] = ()
    unused: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    content: Mapping[str, Any] = field(default_factory=dict)
    recording: Recording | None = None

    @property
    def settled(self) -> bool:
        """Whether nothing is left to be answered."""
        return not self.setups and not any(problem.asks for problem in self.problems)

    def map_text(self) -> str:
        """Return the map file, with a reason beside every column."""
        reasons = {own.field: own.reason for own in self.proposals}
        lines = [f"# Suggested for {self.table}; the reason stands behind every column."]
        lines += [f"# ? {problem.what} {problem.cure}" for problem in self.problems if problem.asks]
        rest = {
            key: value for key, value in self.content.items() if key not in ("time", "sequence", "columns")
        }
        lines.append(yaml.safe_dump({"schema": SCHEMA}, sort_keys=False).strip())
        for key in ("time", "sequence"):
            if key in self.content:
                lines.append(f"{key}: {_flow(self.content[key])}  # {reasons.get(key, '')}".rstrip(" #"))
        lines.append("columns:")
        for name, source in self.content.get("columns", {}).items():
            why = reasons.get(name) or reasons.get(name.replace("voltage", "current"), "")
            lines.append(f"  {name}: {_flow(source)}  # {why}".rstrip(" #"))
        rest.pop("schema", None)
        if rest:
            lines.append(yaml.safe_dump(rest, sort_keys=False, allow_unicode=True).strip())
        return "\n".join(lines) + "\n"


def _flow(source: Any) -> str:
    return yaml.safe_dump(
        source, sort_keys=False, default_flow_style=True, width=10_000, allow_unicode=True
    ).strip()


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
            form = form_of(text_of(path, most=_SEEN), str(path), whole=path.stat().st_size < _SEEN)
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
    if grid.remarks:
        problems += [
            Problem(f"{remark}.", "See whether the file is whole.", asks=False) for remark in grid.remarks
        ]
    found = _assigned(grid, bench, problems)
    content = _content(found, grid, form, bench_name, bench, problems)
    used = {own.column for own in found.values()} | {own.clock for own in found.values()}
    unused = tuple(name for name in grid.columns if name not in used)
    _questions(found, problems, bench, grid)
    setups: tuple[WrongSetup, ...] = ()
    remarks: tuple[str, ...] = ()
    recording = None
    if TIME in found and ({"spin_rate", "spin_angle"} & found.keys()):
        for _ in range(3):
            try:
                recording, remarks = _tried(path, content, bench, content_grid)
            except InputError as error:
                said = str(error).replace(f"{path}: ", "")
                known = [own.column for own in found.values() if f"'{own.column}'" in said]
                if not any(
                    problem.asks and f"'{name}'" in problem.what for name in known for problem in problems
                ):
                    problems.append(Problem(f"{said}.", "Correct the map there, or the table."))
                break
            setups = tuple(wrong_setups([_complete(recording, bench)], bench))
            changed = _mended(found, setups)
            if changed is None:
                break
            found = changed
            content = _content(found, grid, form, bench_name, bench, [])
    return Suggestion(
        str(file), kind, tuple(found.values()), tuple(problems), setups, unused, remarks, content, recording
    )


def _assigned(grid: Grid, bench: Bench, problems: list[Problem]) -> dict[str, Proposal]:
    """Return which column is which field: the clearest names first, each column once."""
    names = {name: named(name, column.unit) for name, column in grid.columns.items() if _usable(column)}
    for name, column in grid.columns.items():
        if name not in names and not column.numeric and column.values.dtype.kind != "M":
            what = named(name, column.unit)
            if max(what.fields.values(), default=0) >= 2 and not what.asked:
                text = next((str(value) for value in column.values if str(value)), "")
                problems.append(
                    Problem(
                        f"column '{name}' holds text, such as '{text[:20]}'.",
                        "Write numbers in every row; leave a cell empty where there is none.",
                    )
                )
    claims: list[tuple[float, int, str, str]] = []
    for order, (name, what) in enumerate(names.items()):
        column = grid.columns[name]
        for own, clear in what.fields.items():
            score = float(clear) - 4.0 * what.asked + 0.5 * bool(what.unit) + _likely(column, own, what)
            claims.append((-score, order, name, own))
    found: dict[str, Proposal] = {}
    taken: set[str] = set()
    for score, _, name, own in sorted(claims):
        if name in taken or own in found or -score <= 0.0:
            continue
        column, what = grid.columns[name], names[name]
        if own == TEMPERATURE:
            continue
        proposal = _proposed(own, column, what, bench, found, grid)
        if proposal is None:
            continue
        found[own] = proposal
        taken.add(name)
    for name, what in names.items():  # a thermometer that does not say of what
        if TEMPERATURE in what.fields and name not in taken and not what.asked:
            free = [f for f in ("air_temperature", "coil_temperature") if f not in found]
            proposal = _proposed(free[0], grid.columns[name], what, bench, found, grid) if free else None
            if proposal is not None:
                found[free[0]] = replace(proposal, reason=f"{proposal.reason}; of what is not said")
                taken.add(name)
    if TIME not in found:
        _time_by_values(grid, names, taken, found)
    if TIME in found:  # those with a clock of their own
        own = found[TIME].column
        for key, item in found.items():
            clock = grid.columns[item.column].clock or _clock_for(grid, item.column, own)
            found[key] = replace(item, clock=clock if clock != own else "")
    return {name: found[name] for name in (*UNITS, SEQUENCE) if name in found}


def _usable(column: Column) -> bool:
    if column.values.dtype.kind == "M":
        return True
    if not column.numeric:
        return False
    some = np.asarray(column.values[: _SOME * 10], dtype=np.float64)
    return bool(np.isfinite(some).mean() > _MISSING)


def _likely(column: Column, own: str, what: Named) -> float:
    """Return how well the values of a column go with a field, beside its name."""
    if column.values.dtype.kind == "M":
        return 2.0 if own == TIME else -9.0
    values = np.asarray(column.values, dtype=np.float64)
    steps = np.diff(values[:_SOME])
    rising = bool(len(steps)) and bool(np.mean(steps >= 0.0) > 0.999) and float(steps.sum()) > 0.0
    if own == TIME:
        return 1.0 if rising and column.clock in ("", column.name) else -4.0
    if own == SEQUENCE:
        return (
            1.0
            if rising
            and bool(np.all(values[:_SOME] == np.round(values[:_SOME])))
            and bool(np.all(steps >= 1.0))
            else -9.0
        )
    if own == "spin_angle":
        return 0.5 if len(steps) and np.median(np.abs(steps)) > 0.0 else -1.0
    return -0.5 if rising and own not in ("coil_temperature", "air_temperature") else 0.0


def _time_by_values(
    grid: Grid, names: Mapping[str, Named], taken: set[str], found: dict[str, Proposal]
) -> None:
    """Find a clock by its values: a column that rises evenly."""
    for name in names:
        column = grid.columns[name]
        if name in taken or not (column.numeric or column.values.dtype.kind == "M"):
            continue
        values = np.asarray(column.values[:_SOME]).astype(np.float64)
        steps = np.diff(values)
        if len(steps) > 10 and np.all(steps > 0.0) and float(np.std(steps)) < 0.5 * float(np.mean(steps)):
            proposal = _proposed(TIME, column, named("time", column.unit), Bench.load(), found, grid)
            if proposal is not None:
                found[TIME] = replace(proposal, reason=f"rises evenly; {proposal.reason}")
                taken.add(name)
                return


def _clock_for(grid: Grid, column: str, usual: str) -> str:
    """Return the column with the times of a column: the one beside it in its folder, or one of as many rows."""
    rows, here = len(grid.columns[column].values), _folder(column)
    if column == usual or (rows == len(grid.columns[usual].values) and here == _folder(usual)):
        return ""
    like = [
        name
        for name, own in grid.columns.items()
        if name != column
        and len(own.values) == rows
        and TIME in named(name[len(_folder(name)) :], own.unit).fields
    ]
    like = [name for name in like if _folder(name) == here] or [name for name in like if name != usual]
    return "" if usual in like or not like else min(like, key=len)


def _folder(column: str) -> str:
    """Return the path before the name of a column."""
    return column[: max(column.rfind("/"), column.rfind(".")) + 1]


def _proposed(
    own: str, column: Column, what: Named, bench: Bench, found: Mapping[str, Proposal], grid: Grid
) -> Proposal | None:
    """Return what a column is as a field; None where its values cannot be."""
    clear = what.fields.get(own, 0)
    said = f"named '{column.name}'" if clear else "by its values"
    if column.values.dtype.kind == "M":
        if own != TIME:
            return None
        return Proposal(own, column.name, TIMESTAMP, 1.0, f"{said}, holds dates", True)
    values = np.asarray(column.values, dtype=np.float64)
    values = values[np.isfinite(values)]
    if len(values) < 2:
        return None
    low, high = float(values.min()), float(values.max())
    if own == SEQUENCE:
        return Proposal(own, column.name, "", 1.0, f"{said}, whole numbers that rise", True, "", low, high)
    unit, scale, stated = what.unit, 1.0, bool(what.unit)
    if own == "spin_angle":
        unit, scale, why = _angle(values, what.unit, found, grid)
        return Proposal(own, column.name, unit, scale, f"{said}; {why}", bool(what.unit), "", low, high)
    if not unit:
        unit = _guessed(own, values, bench)
        if not unit:
            return (
                None
                if clear < 2
                else Proposal(
                    own,
                    column.name,
                    UNITS[own],
                    1.0,
                    f"{said}; no usual unit fits {low:.4g} .. {high:.4g}",
                    False,
                    "",
                    low,
                    high,
                )
            )
    why = f"unit {unit} stated" if stated else f"in {unit} {low:.4g} .. {high:.4g} is usual"
    return Proposal(own, column.name, unit, scale, f"{said}; {why}", stated, "", low, high)


def _usual(own: str, bench: Bench) -> tuple[float, float]:
    """Return between which values the largest magnitude of a field usually lies [SI]."""
    v = bench.value
    fastest, slowest = v("spin_rate_maximum"), v("spin_rate_minimum")
    back = v("motor_constant")
    return {
        "tilt_x": (2e-3, 1.5 * v("tilt_limit")),
        "tilt_y": (2e-3, 1.5 * v("tilt_limit")),
        "spin_rate": (0.5 * slowest, 1.3 * fastest),
        "coil_voltage_x": (5e-3, 50.0),
        "coil_voltage_y": (5e-3, 50.0),
        "motor_voltage": (0.4 * back * slowest, 4.0 * back * fastest),
        "motor_current": (5e-3, 20.0),
        "coil_current_x": (1e-4, 5.0),
        "coil_current_y": (1e-4, 5.0),
        "coil_temperature": (268.0, 400.0),
        "air_temperature": (268.0, 330.0),
        "air_pressure": (2e3, 1.15e5),
    }.get(own, (-math.inf, math.inf))


def _largest(values: Array, unit: str, own: str) -> float:
    zero, factor = conversion(unit, UNITS[own])
    return float(np.percentile(np.abs(values * factor + zero), 99.9))


def _guessed(own: str, values: Array, bench: Bench) -> str:
    """Return the likeliest unit of values; empty where none is usual."""
    if own == TIME:
        step = float(np.median(np.diff(values[:_SOME])))
        sizes = {unit: step * conversion(unit, "s")[1] for unit in _GUESSES[TIME]}
        return next((unit for unit, size in sizes.items() if 2.0 * SHORTEST <= size <= 0.5 * LONGEST), "")
    low, high = _usual(own, bench)
    return next((unit for unit in _GUESSES[own] if low <= _largest(values, unit, own) <= high), "")


def _angle(values: Array, unit: str, found: Mapping[str, Proposal], grid: Grid) -> tuple[str, float, str]:
    """Return the unit of an angle, its scale, and why."""
    if unit and unit != "count":
        return unit, 1.0, f"unit {unit} stated"
    low, high = float(values.min()), float(values.max())
    wraps = bool(np.any(np.diff(values) < -0.5 * (high - low))) or bool(
        np.any(np.diff(values) > 0.5 * (high - low))
    )
    span = high - low
    if wraps:
        whole = next((w for w in sorted(_WHOLE_TURNS) if (1.0 - _NEAR) * w <= span <= w * (1.0 + 1e-9)), 0.0)
        if whole == 360.0:
            return "deg", 1.0, "begins anew every 360"
        if whole and abs(whole - 2.0 * math.pi) < 1e-9:
            return "rad", 1.0, "begins anew every 2 pi"
        if whole:
            return "turn", 1.0 / whole, f"begins anew every {whole:g}"
        return "turn", 1.0 / (span * (1.0 + 1.0 / max(len(values), 1))), f"begins anew every {span:g}"
    return ("turn" if unit == "count" else "rad"), 1.0, "goes on without beginning anew"


def _content(
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
    gone = [
        own.column for own in found.values() if own.field in READINGS and _holes(grid.columns[own.column])
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
        entry: dict[str, Any] = {"column": own.column, "unit": own.unit}
        if own.scale != 1.0:
            entry["scale"] = own.scale
        if own.clock:
            entry["clock"] = own.clock
        if own.field in COIL_CURRENT:
            entry["resistance"] = _resistance(found, grid, bench)
        columns[name] = entry
    content["columns"] = columns
    if form is not None:
        settings = {
            "delimiter": form.delimiter,
            "decimal": form.decimal,
            "skip_lines": form.skip_lines,
            "unit_lines": form.unit_lines,
            "comment": form.comment,
            "encoding": form.encoding,
        }
        usual = {
            "delimiter": ",",
            "decimal": ".",
            "skip_lines": 0,
            "unit_lines": 0,
            "comment": "",
            "encoding": "utf-8",
        }
        other = {key: value for key, value in settings.items() if value != usual[key]}
        if other:
            content["csv"] = other
    clocks = {own.clock for own in found.values() if own.clock}
    for clock in clocks:
        late = clock_offset(found, grid, clock, bench)
        if late is None:
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


def _holes(column: Column) -> int:
    return int(np.count_nonzero(~np.isfinite(column.values))) if column.values.dtype.kind == "f" else 0


def _resistance(found: Mapping[str, Proposal], grid: Grid, bench: Bench) -> float:
    """Return the resistance by which the currents of the coils are their voltages [ohm]: that holds up the flexures."""
    tilts, currents = [], []
    for axis in "xy":
        tilt, current = found.get(f"tilt_{axis}"), found.get(f"coil_current_{axis}")
        if tilt is None or current is None or tilt.clock or current.clock:
            continue
        tilts.append(_si(tilt, grid, "rad"))
        currents.append(_si(current, grid, "A"))
    if not tilts:
        return 1.0
    x, y = np.concatenate(tilts), np.concatenate(currents)
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known] - x[known].mean(), y[known] - y[known].mean()
    per_rad = float(x @ y) / float(x @ x) if float(x @ x) else 0.0
    stiff = 0.5 * (bench.value("flexure_stiffness_x") + bench.value("flexure_stiffness_y"))
    volts = stiff / bench.value("coil_constant")
    return float(f"{abs(volts / per_rad):.3g}") if per_rad else 1.0


def _si(own: Proposal, grid: Grid, unit: str) -> Array:
    zero, factor = conversion(own.unit, unit)
    return np.asarray(
        np.asarray(grid.columns[own.column].values, dtype=np.float64) * own.scale * factor + zero
    )


def _questions(found: Mapping[str, Proposal], problems: list[Problem], bench: Bench, grid: Grid) -> None:
    """Say what is missing, what is not usual, and what is rather asked for than measured."""
    if TIME not in found:
        problems.append(
            Problem("no column of times is found.", "Name it `time` in the map, or in the line of names.")
        )
    for own in found.values():
        if own.field in (TIME, SEQUENCE) or own.unit == TIMESTAMP:
            continue
        column = grid.columns[own.column]
        holes = _holes(column)
        if holes:
            problems.append(
                Problem(
                    f"{own.field}: {holes} of {len(column.values)} values of '{own.column}' are missing.",
                    "`missing: keep` in the map counts their samples as lost.",
                    asks=False,
                )
            )
        if named(own.column, column.unit).asked:
            problems.append(
                Problem(
                    f"{own.field}: '{own.column}' seems to be what was asked for, not what was measured.",
                    "Name the column that was measured, or leave it out.",
                )
            )
        if own.field == "spin_angle":
            continue
        values = np.asarray(column.values, dtype=np.float64)
        values = values[np.isfinite(values)] * own.scale
        low, high = _usual(own.field, bench)
        size = _largest(values, own.unit, own.field)
        if not low <= size <= high:
            other = _guessed(own.field, values, bench)
            cure = f"Is it in {other}? Set `unit: {other}`." if other else "Check unit, scale and column."
            is_si = own.unit == UNITS[own.field]
            problems.append(
                Problem(
                    f"{own.field}: '{own.column}' reaches {np.percentile(np.abs(values), 99.9):.4g} {own.unit}"
                    f"{'' if is_si else f', which is {size:.4g} {UNITS[own.field]}'}; usual on the "
                    f"bench {bench.name}: {low:.3g} .. {high:.3g} {UNITS[own.field]}.",
                    cure,
                )
            )
    if TIME in found and found[TIME].unit != TIMESTAMP:
        own = found[TIME]
        times = np.asarray(grid.columns[own.column].values, dtype=np.float64)
        step = float(np.median(np.diff(times))) * conversion(own.unit, "s")[1]
        if not SHORTEST <= step <= LONGEST:
            other = _guessed(TIME, times, bench)
            cure = f"Is it in {other}? Set `unit: {other}`." if other else "Check unit and column."
            problems.append(Problem(f"time: a row every {step:.4g} s in '{own.column}'.", cure))
    _missing(found, problems)


def _missing(found: Mapping[str, Proposal], problems: list[Problem]) -> None:
    def lacks(name: str, cure: str, *, asks: bool = False) -> None:
        problems.append(Problem(f"{name}: no such column is found.", cure, asks=asks))

    for axis in "xy":
        if f"tilt_{axis}" not in found:
            lacks(
                f"tilt_{axis}",
                f"Name the column of the tilt about {axis}; nothing can be found without it.",
                asks=True,
            )
        if f"coil_voltage_{axis}" not in found:
            if f"coil_current_{axis}" in found:
                problems.append(
                    Problem(
                        f"coil_voltage_{axis}: a current is there in its place.",
                        "`resistance` in the map makes it a voltage. It is estimated from what holds up the flexures; "
                        "put the measured one there.",
                        asks=False,
                    )
                )
            else:
                lacks(
                    f"coil_voltage_{axis}",
                    f"Nothing will be said of torques about {axis}, nor once a revolution.",
                )
    if "spin_angle" not in found and "spin_rate" not in found:
        lacks("spin_rate, spin_angle", "Name one of them; nothing can be found without both.", asks=True)
    elif "spin_angle" not in found:
        lacks("spin_angle", "It is summed up from the speed; averages alone are compared.")
    elif "spin_rate" not in found:
        lacks("spin_rate", "The rate of the angle is taken; the ripple of the motor is not compared.")
    if "motor_current" not in found and "motor_voltage" not in found:
        lacks("motor_current, motor_voltage", "Nothing will be said of the torque about the spin axis.")
    elif "motor_current" not in found:
        lacks(
            "motor_current",
            "It is computed from voltage and speed; the voltage alone shows the motor's torque.",
        )
    elif "motor_voltage" not in found:
        lacks(
            "motor_voltage",
            "The current alone shows the motor's torque; a fault of the motor's constants does not show.",
        )
    slow = [name for name in ("coil_temperature", "air_temperature", "air_pressure") if name not in found]
    if slow:
        lacks(", ".join(slow), "Those of the bench are taken; where you know them, put `value:` in the map.")


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


def _complete(recording: Recording, bench: Bench) -> Recording:
    """Return a recording with what can be derived, so that the laws of the wheel can be asked about the rest."""
    absent = unmeasured(recording.readings)
    if not absent:
        return recording
    readings: Readings = completed(recording.time, recording.readings, absent, bench)
    rows = recording.measurement.copy()
    for name in absent:
        rows[name] = readings[name]
    return replace(recording, measurement=rows)


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
