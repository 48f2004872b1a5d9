"""Questions about the columns of a table: missing, unusual, or rather commanded than measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from gyrowheel_core.units import conversion
from gyrowheel_recording.bags.reader import LONGEST, SHORTEST
from gyrowheel_recording.mapping.clock import period_of
from gyrowheel_recording.mapping.column_names import SEQUENCE, TIME, UNITS, meaning_of, unknown_unit
from gyrowheel_recording.mapping.map_file import TIMESTAMP
from gyrowheel_recording.mapping.suggestion import Problem, Proposal, guess_unit, holes, largest, usual_size
from gyrowheel_recording.mapping.suggestion.checks import merged_loggers, odd_cells, sentinel, value_problems
from gyrowheel_recording.tables import Grid
from gyrowheel_sim.bench import Bench

#: The next finer unit of time, in which a slow table may be a fast one.
_FINER: Final = {"s": "ms", "ms": "us", "us": "ns"}

#: Readings that stand for each other, and the consequences if both, the first or the second one is missing.
_PAIRED: Final = (
    (
        ("spin_rate", "spin_angle"),
        "Name one of them; nothing can be found without both.",
        "The rate of the angle is taken; the ripple of the motor is not compared.",
        "It is summed up from the speed; averages alone are compared.",
    ),
    (
        ("motor_current", "motor_voltage"),
        "Nothing will be said of the torque about the spin axis.",
        "It is computed from voltage and speed; the voltage alone shows the motor's torque.",
        "The current alone shows the motor's torque; a fault of the motor's constants does not show.",
    ),
)


def column_problems(
    found: Mapping[str, Proposal], problems: list[Problem], bench: Bench, grid: Grid
) -> dict[str, str]:
    """Report what is missing, unusual, or rather commanded than measured.

    Returns
    -------
    dict of str to str
        Units in which readings of unusual size would have a usual one, by field.
    """
    likelier: dict[str, str] = {}

    def ask(what: str, cure: str, *, asks: bool = True) -> None:
        problems.append(Problem(what, cure, asks=asks))

    if TIME not in found:
        ask(
            "no column of times is found.",
            "Name it `time` in the map, or state there how many rows there are a second, such as `rate: 1000`.",
        )
    for own in found.values():
        column = grid.columns[own.column]
        problems += odd_cells(own.field, own.column, column)
        if own.field in (TIME, SEQUENCE) or own.unit == TIMESTAMP:
            continue
        problems += value_problems(own, column, bench)
        lost = holes(column)
        if lost:
            ask(
                f"{own.field}: {lost} of {len(column.values)} values of '{own.column}' are missing.",
                "`missing: keep` in the map counts their samples as lost.",
                asks=False,
            )
        if not own.stated and (unit := unknown_unit(own.column, column.unit)):
            ask(
                f"{own.field}: the unit '{unit}' of '{own.column}' is not known; {own.unit} is taken.",
                "Set `unit:` in the map.",
            )
        if meaning_of(own.column, column.unit).commanded:
            ask(
                f"{own.field}: '{own.column}' seems to be what was asked for, not what was measured.",
                "Name the column that was measured, or leave it out.",
            )
        if own.field == "spin_angle":
            continue
        values = np.asarray(column.values, dtype=np.float64)
        values = values[np.isfinite(values) & (values != sentinel(own, column))] * own.scale
        if not len(values):
            continue
        low, high = usual_size(own.field, bench)
        size = largest(values, own.unit, own.field)
        if not low <= size <= high:
            other = guess_unit(own.field, values, bench)
            cure = f"Is it in {other}? Set `unit: {other}`." if other else "Check unit, scale and column."
            if other:
                likelier[own.field] = other
            is_si = own.unit == UNITS[own.field]
            ask(
                f"{own.field}: '{own.column}' reaches {np.percentile(np.abs(values), 99.9):.4g} {own.unit}"
                f"{'' if is_si else f', which is {size:.4g} {UNITS[own.field]}'}; usual on the "
                f"bench {bench.name}: {low:.3g} .. {high:.3g} {UNITS[own.field]}.",
                cure,
            )
    if TIME in found and found[TIME].unit != TIMESTAMP:
        own = found[TIME]
        times = np.asarray(grid.columns[own.column].values, dtype=np.float64)
        times = times[np.isfinite(times)]
        step = period_of(times) * own.scale * conversion(own.unit, "s")[1]
        if step < 0.0:
            pass  # rows that run backward are reported by their order
        elif len(times) > 2 and not np.any(np.diff(times)):
            ask(f"time: '{own.column}' is {times[0]:.10g} in every row.", "Write times with more digits.")
        elif not SHORTEST <= step <= LONGEST:
            other = guess_unit(TIME, times, bench)
            cure = f"Is it in {other}? Set `unit: {other}`." if other else "Check unit and column."
            if other:
                likelier[TIME] = other
            if step > LONGEST:
                cure += f" Fewer than {1.0 / LONGEST:g} samples a second show nothing of the wheel."
            ask(f"time: a row every {step:.4g} s in '{own.column}'.", cure)
        elif not own.stated and own.unit in _FINER and 1e-3 * step >= 2.0 * SHORTEST:
            ask(
                f"time: '{own.column}' does not say its unit: in {own.unit} it has {1.0 / step:.4g} rows a second, "
                f"in {_FINER[own.unit]} {1e3 / step:.4g}.",
                "Set `unit:` in the map to the right one.",
            )
    problems += merged_loggers(found, grid)
    problems += _missing(found)
    return likelier


def _missing(found: Mapping[str, Proposal]) -> Iterator[Problem]:
    """Yield the readings without a column, and what follows from that."""

    def lacks(name: str, cure: str, *, asks: bool = False) -> Problem:
        return Problem(f"{name}: no such column is found.", cure, asks=asks)

    for axis in "xy":
        if f"tilt_{axis}" not in found:
            cure = f"Name the column of the tilt about {axis}; nothing can be found without it."
            yield lacks(f"tilt_{axis}", cure, asks=True)
        if f"coil_voltage_{axis}" in found:
            continue
        if f"coil_current_{axis}" in found:
            yield Problem(
                f"coil_voltage_{axis}: a current is there in its place.",
                "`resistance` in the map makes it a voltage. It is estimated from what holds up the flexures; "
                "put the measured one there.",
                asks=False,
            )
        else:
            cure = f"Nothing will be said of torques about {axis}, nor once a revolution."
            yield lacks(f"coil_voltage_{axis}", cure)
    for names, both, first, second in _PAIRED:
        absent = [name for name in names if name not in found]
        if len(absent) == 2:
            yield lacks(", ".join(names), both, asks=names[1] == "spin_angle")
        elif absent:
            yield lacks(absent[0], first if absent[0] == names[0] else second)
    slow = [name for name in ("coil_temperature", "air_temperature", "air_pressure") if name not in found]
    if slow:
        yield lacks(
            ", ".join(slow),
            "Those of the bench are taken, and how far they may be off counts in the result; where you know them, put "
            "`value:` in the map.",
        )
