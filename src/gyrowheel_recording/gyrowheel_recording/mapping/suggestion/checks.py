"""Doubtful tables: text cells, sentinels, clipping, mixed units, violated laws; and questions.

Questions are about columns that are missing, unusual, or rather commanded than measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.arrays import one_thread
from gyrowheel_core.units import conversion
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.bags.reader import LONGEST, SHORTEST
from gyrowheel_recording.mapping.clock import period_of
from gyrowheel_recording.mapping.column_names import (
    COIL_CURRENT,
    SEQUENCE,
    TIME,
    UNITS,
    fits,
    meaning_of,
    unknown_unit,
)
from gyrowheel_recording.mapping.map_file import READINGS, TIMESTAMP
from gyrowheel_recording.mapping.suggestion import (
    Problem,
    Proposal,
    guess_unit,
    holes,
    largest,
    usual_size,
)
from gyrowheel_recording.mislabelled.blocks import COIL, TILT, averages, blocks_of, never_measured
from gyrowheel_recording.mislabelled.relations import precession, slews, spin
from gyrowheel_recording.tables import Column, Grid
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

#: Texts of loggers for "no reading".
_NO_READING: Final = frozenset(
    ["ovr", "ol", "ovl", "ovld", "ovflw", "over", "overload", "overflow", "overrange", "over range", "err", "error",
     "fault", "invalid", "bad", "inf", "+inf", "-inf", "missing", "****", "#####", "+++", "0l"]
)  # fmt: skip
_MOST_SENTINELS: Final = 0.2  # of the rows
#: Factors between units that are mistaken for each other, with the two units.
_PAIRS: Final = (
    ("V", "mV"), ("A", "mA"), ("rad", "deg"), ("rad", "mrad"), ("deg", "arcmin"), ("rad/s", "rpm"), ("turn/s", "rpm"),
    ("hPa", "Pa"), ("kPa", "hPa"),
)  # fmt: skip
_AS_MUCH: Final = 0.15  # by which the logarithm of a jump may differ from that of such a factor
_BLOCK: Final = 50  # rows whose size is compared with that of the next ones
_BESIDE: Final = 20  # rows before and after a jump
_MOSTLY_NEW: Final = 0.7  # part of the rows that have another value than the row before
_CLIPPED: Final = ("tilt_x", "tilt_y", "spin_rate", "coil_voltage_x", "coil_voltage_y", *COIL_CURRENT, "motor_voltage",
                   "motor_current")  # fmt: skip
_STAYS: Final = 20  # values in a row at the end of a range
_SOME_CLIPPED: Final = 0.01  # part of the values at the end of a range, where no other value is so frequent


#: Odd cells by their kind: what is wrong with them, and the cure.
_ODD: Final = {
    "decimal": (
        "have another decimal sign than the others, {where}: {text}.",
        "Write all numbers with one decimal sign.",
    ),
    "thousands": ("have signs between the thousands, {where}: {text}.", "Write the numbers without them."),
    "unit": (
        "have a unit behind the number, {where}: {text}.",
        "Write the numbers alone, the unit in the line of names; rows of another unit in that unit.",
    ),
    "clock": (
        "hold a time of day or a date, {where}: {text}.",
        "Write seconds from the beginning, or dates with times such as 2026-05-04T10:00:00.0005.",
    ),
    "text": (
        "hold the text {text}, {where}.",
        "The map takes it for no reading (`csv: missing:`); take the rows out where that is wrong.",
    ),
}


def odd_cells(field: str, name: str, column: Column) -> list[Problem]:
    """Return the problems of the cells of a text that are no plain numbers."""
    found = []
    for odd in column.odd:
        what, cure = _ODD[odd.kind]
        if field == TIME and odd.kind == "text":
            cure = "Take these rows out."
        missing = odd.kind == "text" and odd.text.lower() in _NO_READING
        if missing:
            what, cure = "hold {text}, {where}: no reading.", "`csv: missing:` in the map says so."
        strange = next((sign for sign in odd.text if not sign.isascii()), "")
        named = f"'{odd.text[:24]}'" + (f" (with the character U+{ord(strange):04X})" if strange else "")
        what = what.format(where=f"first in row {odd.row + 1}", text=named)
        if odd.count == 1:
            what = what.replace("hold", "holds", 1).replace("have", "has", 1)
        cells = f"{odd.count} cell{'s' * (odd.count > 1)} of '{name}'"
        found.append(Problem(f"{field}: {cells} {what}", cure, asks=not missing))
    return found


def words_for_nothing(found: Mapping[str, Proposal], grid: Grid) -> list[str]:
    """Return the texts in the columns of readings that stand in the place of a number."""
    texts = (
        odd.text
        for own in found.values()
        if own.field != TIME
        for odd in grid.columns[own.column].odd
        if odd.kind == "text"
    )
    return list(dict.fromkeys(texts))


def sentinel(own: Proposal, column: Column) -> float:
    """Return the number that stands for "no reading" in a column; NaN if there is no such number.

    It is beyond all that the reading can be, comes again to the last digit, and most other values are possible.
    """
    reading = READINGS.get(own.field)
    if reading is None or not column.numeric or own.pulses:
        return math.nan
    values = np.asarray(column.values, dtype=np.float64)
    zero, factor = conversion(own.unit, UNITS[own.field])
    real = values * own.scale * factor + zero
    beyond = np.isfinite(values) & ((real < reading.low) | (real > reading.high))
    count = int(beyond.sum())
    if not 0 < count <= _MOST_SENTINELS * len(values):
        return math.nan
    different = np.unique(values[beyond])
    return float(different[0]) if len(different) == 1 else math.nan


def value_problems(own: Proposal, column: Column, bench: Bench) -> Iterator[Problem]:
    """Yield the problems of the values of a column of readings."""
    values = np.asarray(column.values, dtype=np.float64)
    yield from _sentinels(own, column, values)
    values = values[np.isfinite(values) & (values != sentinel(own, column))]
    if own.field in _CLIPPED:
        yield from _clipped(own, values, bench)
    yield from _two_units(own, values)


def _sentinels(own: Proposal, column: Column, values: Array) -> Iterator[Problem]:
    nothing = sentinel(own, column)
    if math.isnan(nothing):
        return
    rows = np.flatnonzero(values == nothing)
    yield Problem(
        f"{own.field}: {len(rows)} of {len(values)} values of '{own.column}' are {nothing:g}, first in row "
        f"{rows[0] + 1}: no reading can be that.",
        f"`missing: {nothing:g}` at the column in the map takes it for no reading.",
        asks=False,
    )


def _clipped(own: Proposal, values: Array, bench: Bench) -> Iterator[Problem]:
    """Yield that a reading stays at the end of its range, where no range of the bench ends."""
    if len(values) < 2 * _STAYS or len(np.unique(values[:5000])) < 0.2 * len(values[:5000]):
        return
    factor = conversion(own.unit, UNITS[own.field])[1] * own.scale
    limits = [bench.value(name) for name in ("coil_voltage_limit", "supply_voltage")]
    for end in (float(values.max()), float(values.min())):
        at = values == end
        # a noisy reading does not stay at the end of its range
        often = int(at.sum()) >= max(_STAYS, _SOME_CLIPPED * len(values))
        if (_longest(at) < _STAYS and not often) or any(
            abs(abs(end * factor) / limit - 1.0) < 0.02 for limit in limits
        ):
            continue
        yield Problem(
            f"{own.field}: '{own.column}' stays at {end:.6g} {own.unit}, the end of its range, in {int(at.sum())} "
            "rows: the logger seems to clip it.",
            "Measure with a wider range, or leave the column out; what is clipped is no average.",
        )
        return


def _longest(where: NDArray[np.bool_]) -> int:
    """Return the length of the longest run."""
    edges = np.flatnonzero(np.diff(np.r_[0, where.astype(np.int8), 0]))
    return int(np.max(edges[1::2] - edges[::2], initial=0))


def _two_units(own: Proposal, values: Array) -> Iterator[Problem]:
    """Yield that a column goes on in another unit: from one row to the next all is larger by such a factor."""
    new = np.flatnonzero(np.r_[True, np.diff(values) != 0.0])
    if _BESIDE < len(new) < _MOSTLY_NEW * len(values):  # of a reading that is repeated, the new values count
        values = values[new]
    else:
        new = np.arange(len(values))
    blocks = len(values) // _BLOCK
    if own.field == "spin_angle" or blocks < 8:
        return
    size = np.median(np.abs(values[: blocks * _BLOCK]).reshape(blocks, _BLOCK), axis=1)
    one, other = size[:-3] + size[1:-2], size[2:-1] + size[3:]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(other / one)
    for units in _PAIRS:
        if not all(fits(unit, own.field) for unit in units):
            continue
        factor = abs(conversion(units[0], units[1])[1])
        for k in np.flatnonzero(np.abs(np.abs(ratio) - math.log(factor)) < math.log(2.0)):
            # the rows about the edge, where the block that has both hides it
            around = np.abs(values[k * _BLOCK : (k + 4) * _BLOCK])
            with np.errstate(divide="ignore", invalid="ignore"):
                jump = np.log(around[1:] / around[:-1])
            at = np.flatnonzero(np.abs(np.abs(jump) - math.log(factor)) < math.log(2.5))
            for row in at[(at >= _BESIDE) & (at < len(around) - _BESIDE - 1)]:
                before, after = around[row + 1 - _BESIDE : row + 1], around[row + 1 : row + 1 + _BESIDE]
                low, high = sorted((float(np.median(before)), float(np.median(after))))
                if low > 0.0 and abs(math.log(high / low / factor)) < _AS_MUCH:
                    here = values[k * _BLOCK :][row + 1 - _BESIDE : row + 1 + _BESIDE]
                    if not _scatters_as_much(here, factor):
                        continue
                    yield Problem(
                        f"{own.field}: '{own.column}' goes on in another unit from row "
                        f"{new[k * _BLOCK + row + 1] + 1} on: "
                        f"all is {high / low:.4g} times as {'large' if after[0] > before[-1] else 'small'}, as "
                        f"between {units[0]} and {units[1]}.",
                        "Write all rows in one unit.",
                    )
                    return


def _scatters_as_much(values: Array, factor: float) -> bool:
    """Whether noise changes by a factor in the middle: a unit multiplies it, the beginning of a motion does not."""
    steps = [np.diff(half) for half in np.split(values, 2)]
    low, high = sorted(float(np.median(np.abs(step - np.median(step)))) for step in steps)
    return low == high or (low > 0.0 and abs(math.log(high / low / factor)) < math.log(3.0))


def merged_loggers(found: Mapping[str, Proposal], grid: Grid) -> Iterator[Problem]:
    """Yield that the rows of two loggers are merged: some columns have values just where others have none."""
    groups: dict[bytes, tuple[Any, list[str]]] = {}
    for own in found.values():
        column = grid.columns[own.column]
        if own.field in (TIME, "coil_temperature", "air_temperature", "air_pressure") or own.clock:
            continue
        if column.values.dtype.kind != "f":
            continue
        known = np.isfinite(column.values)
        if known.all():
            continue
        groups.setdefault(np.packbits(known).tobytes(), (known, []))[1].append(own.column)
    sides: Sequence[tuple[Any, list[str]]] = list(groups.values())
    for k, (one, names) in enumerate(sides):
        for other, others in sides[k + 1 :]:
            both = np.count_nonzero(one & other)
            if len(one) == len(other) and both < 0.01 * len(one) < 0.05 * min(one.sum(), other.sum()):
                yield Problem(
                    f"{', '.join(names)} have values only in rows in which {', '.join(others)} have none: the "
                    "rows of two loggers are merged.",
                    "Write the rows of each logger as a table of its own, and import both together.",
                )
                return


#: Parts of a voltage and of the coils' torque that no effect, no tolerance and no noise leaves unexplained.
_VOLTAGE: Final = 0.3
_TORQUE: Final = 0.6


def broken_laws(recording: Recording, bench: Bench) -> list[Problem]:
    """Return the laws that the readings of a table do not obey, as questions.

    They are asked where `setups` found nothing to change: a column may be something else than it is called, such as
    the voltage of the supply or a duty cycle in the place of the motor's voltage.
    """
    absent = never_measured(recording)
    with one_thread():
        now = averages(blocks_of(recording, absent=absent), absent)
        found = []
        voltage = spin(now, bench).electrical if len(now) else 0.0
        if voltage > _VOLTAGE:
            found.append(
                Problem(
                    f"motor_voltage: {voltage:.0%} of it goes neither with the speed nor with the current, as that of "
                    f"a motor does on the bench {bench.name}, and no other unit, sign or column would mend it.",
                    "Is it the voltage at the motor, not that of a supply or a duty cycle? Name the right column, or "
                    "leave it out.",
                )
            )
        # the coils hold more than the tilt needs while a rate table turns
        turned = any(event.table_rate for event in recording.environment)
        judged = len(now) and now.measured(*TILT) and not now.absent >= set(COIL) and slews(now, bench)
        torque = precession(now, bench) if judged and not turned else 0.0
        if torque > _TORQUE:
            found.append(
                Problem(
                    f"tilts and coil voltages: precession leaves {torque:.0%} of the coil torque unexplained, and no "
                    "other unit, sign or column would mend it.",
                    "Are they what they are called, and of this bench? Name the right columns.",
                )
            )
    return found


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
        "The torque about the spin axis is not analysed.",
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
            cure = f"The torque about {axis} is not analysed, nor that once a revolution."
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
