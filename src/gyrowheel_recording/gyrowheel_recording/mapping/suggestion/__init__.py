"""Map suggested for a table: the proposed meaning of each column, and the unit in which it is likely written."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import NDArray

from gyrowheel_core.units import conversion
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.bags.reader import LONGEST, SHORTEST
from gyrowheel_recording.mapping.clock import period_of
from gyrowheel_recording.mapping.column_names import COIL_CURRENT, TIME, UNITS
from gyrowheel_recording.mapping.map_file import SCHEMA
from gyrowheel_recording.mislabelled import WrongSetup
from gyrowheel_recording.tables import Column, Grid
from gyrowheel_sim.bench import Bench


@dataclass(frozen=True)
class Proposal:
    """Proposed meaning of one column."""

    field: str  # a reading, ``time`` or ``sequence``
    column: str
    unit: str
    scale: float  # what its values are multiplied by before the unit counts
    reason: str
    stated: bool  # whether the file states the unit
    clock: str = ""  # column with the times of its rows, where that is not the map's
    #: Range of its values, in the unit.
    lowest: float = math.nan
    highest: float = math.nan
    pulses: int = 0  # of an angle: pulses a turn by which it is known; 0 where the column holds it itself


@dataclass(frozen=True)
class Problem:
    """A doubt about a table, or a gap in it."""

    what: str
    cure: str
    asks: bool = True  # whether nothing may be concluded before it is answered


@dataclass(frozen=True)
class Suggestion:
    """A map for a table."""

    table: str
    kind: str  # its format
    proposals: tuple[Proposal, ...]  # what its columns seem to be
    problems: tuple[Problem, ...]  # all that is doubtful or missing
    setups: tuple[WrongSetup, ...] = ()  # violations of the laws of the wheel by the map
    unused: tuple[str, ...] = ()  # columns that the map leaves out
    remarks: tuple[str, ...] = ()  # what an import by the map does
    content: Mapping[str, Any] = field(default_factory=dict)  # the map file
    recording: Recording | None = None  # what the map makes of the table, if it can be imported

    @property
    def settled(self) -> bool:
        """Whether nothing is left to be answered."""
        return not self.setups and not any(problem.asks for problem in self.problems)

    def map_text(self) -> str:
        """Return the map file, with a reason for every column."""
        reasons = {own.field: own.reason for own in self.proposals}
        lines = [f"# Suggested for {self.table}; the reason stands behind every column."]
        lines += [f"# ? {problem.what} {problem.cure}" for problem in self.problems if problem.asks]
        rest = {key: self.content[key] for key in self.content if key not in ("time", "sequence", "columns")}
        lines.append(yaml.safe_dump({"schema": SCHEMA}, sort_keys=False).strip())
        for key in ("time", "sequence"):
            if key in self.content:
                lines.append(f"{key}: {_flow(self.content[key])}  # {reasons.get(key, '')}".rstrip(" #"))
        lines.append("columns:" if self.content.get("columns") else "columns: {}")
        for name, source in self.content.get("columns", {}).items():
            why = reasons.get(name) or reasons.get(name.replace("voltage", "current"), "")
            lines.append(f"  {name}: {_flow(source)}  # {why}".rstrip(" #"))
        rest.pop("schema", None)
        if rest:
            lines.append(yaml.safe_dump(rest, sort_keys=False, allow_unicode=True).strip())
        return "\n".join(lines) + "\n"


def _flow(source: Any) -> str:
    style: dict[str, Any] = {"default_flow_style": True, "width": 10_000, "allow_unicode": True}
    return yaml.safe_dump(source, sort_keys=False, **style).strip()


Array = NDArray[np.float64]

SOME: Final = 20_000  # values that are looked at
_TILT: Final = ("rad", "deg", "mrad", "arcmin")
_THERMAL: Final = ("degC", "K", "degF")
#: Units that are tried where none is stated, likeliest first.
_GUESSES: Final[dict[str, tuple[str, ...]]] = {
    **dict.fromkeys(("tilt_x", "tilt_y"), _TILT),
    "spin_angle": ("rad", "deg", "turn"),
    "spin_rate": ("rad/s", "rpm", "turn/s", "deg/s"),
    **dict.fromkeys(("coil_voltage_x", "coil_voltage_y", "motor_voltage"), ("V", "mV")),
    "motor_current": ("A", "mA"),
    **dict.fromkeys(COIL_CURRENT, ("A", "mA")),
    **dict.fromkeys(("coil_temperature", "air_temperature"), _THERMAL),
    "air_pressure": ("Pa", "hPa", "kPa", "bar", "mmHg"),
    TIME: ("s", "ms", "us", "ns", "min", "h", "day"),
}
#: Where an angle wraps: a turn in its units, and counts of usual encoders. Decimal counts are near binary ones:
#: the next larger one is meant.
_WHOLE_TURNS: Final = (
    360.0, 2.0 * math.pi, 1.0, *(2.0**k for k in range(8, 25)),
    *(m * 10.0**k for k in range(2, 6) for m in (1.0, 1.2, 1.25, 1.44, 1.5, 1.6, 1.8, 2.0, 2.4, 2.5, 3.0, 3.2, 3.6)),
    *(m * 10.0**k for k in range(2, 6) for m in (4.0, 5.0, 6.0, 6.4, 7.2, 8.0, 9.0)),
)  # fmt: skip
#: Days to the years of loggers: from 1900, as in spreadsheets, and of the modified Julian date; from the year 0, as in
#: MATLAB and Python; of the Julian date.
_SERIAL: Final = ((2e4, 8e4), (7.0e5, 7.7e5), (2.44e6, 2.48e6))
_NEAR: Final = 0.03  # part by which a range may fall short of a whole turn
#: Numbers of our time by their unit, what a number is in it, and since when: 1970, and as Windows counts, 1601 and 1.
_EPOCHS: Final = (
    *((1e9 * k, 2.2e9 * k, unit, 1.0, "1970") for k, unit in ((1.0, "s"), (1e3, "ms"), (1e6, "us"), (1e9, "ns"))),
    (1.2e17, 1.5e17, "us", 0.1, "1601, 100 ns each"),
    (6.25e17, 6.6e17, "us", 0.1, "the year 1, 100 ns each"),
)  # fmt: skip


def usual_size(own: str, bench: Bench) -> tuple[float, float]:
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


def largest(values: Array, unit: str, own: str) -> float:
    """Return the largest magnitude of values in a unit [SI unit of the field], single readings left out."""
    zero, factor = conversion(unit, UNITS[own])
    return float(np.percentile(np.abs(values * factor + zero), 99.9))


def guess_unit(own: str, values: Array, bench: Bench) -> str:
    """Return the likeliest unit of values; empty where none is usual."""
    if own == TIME:
        step = period_of(values[np.isfinite(values)][:SOME])
        sizes = {unit: step * conversion(unit, "s")[1] for unit in _GUESSES[TIME]}
        fitting = [unit for unit, size in sizes.items() if 2.0 * SHORTEST <= size <= 0.5 * LONGEST]
        middle = float(np.median(values))
        if "day" in fitting and any(low < middle < high for low, high in _SERIAL):
            return "day"
        return fitting[0] if fitting else ""
    low, high = usual_size(own, bench)
    return next((unit for unit in _GUESSES[own] if low <= largest(values, unit, own) <= high), "")


def epoch_unit(values: Array) -> tuple[str, float, str]:
    """Return the unit of times that count from a usual date on, their scale, and why; empty where they do not."""
    middle, step = float(np.median(values)), period_of(values[:SOME])
    for low, high, unit, scale, since in _EPOCHS:
        size = step * scale * conversion(unit, "s")[1]
        if low < middle < high and 2.0 * SHORTEST <= size <= 0.5 * LONGEST:
            return unit, scale, f"counts from {since}"
    return "", 1.0, ""


def angle_unit(values: Array, unit: str) -> tuple[str, float, str]:
    """Return the unit of an angle, its scale, and why."""
    if unit and unit != "count":
        return unit, 1.0, f"unit {unit} stated"
    if not wraps(values):
        return ("turn" if unit == "count" else "rad"), 1.0, "runs on without a wrap"
    span = float(np.ptp(values))
    whole = next((w for w in sorted(_WHOLE_TURNS) if (1.0 - _NEAR) * w <= span <= w * (1.0 + 1e-9)), 0.0)
    if whole == 360.0:
        return "deg", 1.0, "restarts every 360"
    if whole and abs(whole - 2.0 * math.pi) < 1e-9:
        return "rad", 1.0, "restarts every 2 pi"
    if not whole and np.array_equal(values, np.round(values)):
        whole = span + 1.0
    if whole:
        return "turn", 1.0 / whole, f"restarts every {whole:g}"
    return "turn", 1.0 / (span * (1.0 + 1.0 / max(len(values), 1))), f"restarts every {span:g}"


def wraps(values: Array) -> bool:
    """Whether an angle jumps from the end of its range to the other one."""
    steps, span = np.diff(values), float(np.ptp(values))
    return bool(np.any(np.abs(steps) > 0.5 * span))


def holes(column: Column) -> int:
    """Return how many values of a column are missing."""
    return int(np.count_nonzero(~np.isfinite(column.values))) if column.values.dtype.kind == "f" else 0


def in_si(own: Proposal, grid: Grid, unit: str) -> Array:
    """Return the values of a column, as it is proposed, in a unit."""
    zero, factor = conversion(own.unit, unit)
    return np.asarray(
        np.asarray(grid.columns[own.column].values, dtype=np.float64) * own.scale * factor + zero
    )
