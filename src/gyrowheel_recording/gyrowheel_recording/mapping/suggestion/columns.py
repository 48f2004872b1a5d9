"""Which column of a table is which reading: the clearest names first, each column once; times in two columns."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_recording.mapping.column_names import (
    COIL_CURRENT,
    INPUTS,
    SEQUENCE,
    TEMPERATURE,
    TIME,
    UNITS,
    Meaning,
    known_unit,
    meaning_of,
)
from gyrowheel_recording.mapping.map_file import READINGS, TIMESTAMP
from gyrowheel_recording.mapping.suggestion import SOME, Problem, Proposal, angle_unit, epoch_unit, guess_unit
from gyrowheel_recording.mapping.suggestion.checks import odd_cells
from gyrowheel_recording.mapping.suggestion.pulses import (
    counted_angle,
    has_levels,
    pulsed_angle,
    running_angle,
)
from gyrowheel_recording.tables import Column, Grid
from gyrowheel_sim.bench import Bench

_FEWEST: Final = 0.02  # of the rows; a column with fewer values is not used
#: Readings that change slowly.
_SLOW: Final = frozenset(["coil_temperature", "air_temperature", "air_pressure", TEMPERATURE])
#: Readings of which not all are zero, whatever the wheel does.
_NEVER_STILL: Final = frozenset(READINGS) - frozenset(["spin_angle"])
_FEWEST_INPUTS: Final = 4  # equal names with numbers that are inputs of a device, and not axes
_FEWEST_NAMED: Final = 4  # readings that a column of texts names
_SHOWN: Final = 3  # of them, in a message
_COUNTED: Final = re.compile(r"^(.*?)(\d+|(?<=[ _])[A-H])(\D?)$", re.DOTALL)
_IN_BRACKETS: Final = re.compile(r"[({<][^(){}<>]*[)}>]")
#: A name with a number in it: what stands before the last one, and behind it.
_NUMBER: Final = re.compile(r"^(.*?)(\d+)(\D*)$", re.DOTALL)


def assign_columns(grid: Grid, bench: Bench, problems: list[Problem]) -> dict[str, Proposal]:
    """Return which column is which field: the clearest names first, each column once."""
    every = {name: meaning_of(_from_one(name, grid), column.unit) for name, column in grid.columns.items()}
    inputs = _numbered_inputs(list(grid.columns))
    for name in inputs:
        every[name] = replace(every[name], fields={})
    for name, what in every.items():
        if _is_clock(grid, name):  # the times of a signal are named after it
            own_fields = {own: clear for own, clear in what.fields.items() if own in (TIME, SEQUENCE)}
            every[name] = replace(what, fields=own_fields)
    names = {name: what for name, what in every.items() if _usable(grid.columns[name], what)}
    claims: list[tuple[float, int, str, str]] = []
    for order, (name, what) in enumerate(names.items()):
        column = grid.columns[name]
        for own, clear in what.fields.items():
            score = float(clear) - 4.0 * what.commanded + 0.5 * bool(what.unit) + _likely(column, own, what)
            claims.append((-score, order, name, own))
    found: dict[str, Proposal] = {}
    taken: set[str] = set()
    for score, _, name, own in sorted(claims):
        if name in taken or own in found or -score <= 0.0:
            continue
        if own in COIL_CURRENT and own.replace("current", "voltage") in found:
            continue
        column, what = grid.columns[name], names[name]
        if own == TEMPERATURE:
            continue
        proposal = _proposed(own, column, what, bench)
        if proposal is None:
            continue
        found[own] = proposal
        taken.add(name)
    _thermometers(grid, names, taken, found, bench, problems)
    if TIME not in found:
        _time_by_values(grid, names, taken, found, bench)
    for name in [own for own in every if own not in names]:
        problems += _unread(grid.columns[name], every[name], found)
    problems += _rivals(claims, found, taken, grid, bench)
    if inputs and not {"tilt_x", "tilt_y"} <= found.keys():
        first, last = inputs[0], inputs[-1]
        problems.append(
            Problem(
                f"'{first}' .. '{last}' are inputs of a device: their names do not show which sensor is connected.",
                "Write a line for each in the map, with the scale of its sensor, such as "
                f"tilt_x: {{column: {first}, unit: deg, scale: 0.5}}.",
            )
        )
    if not {"tilt_x", "tilt_y"} & found.keys() and (problem := _value_a_row(grid)) is not None:
        problems.append(problem)
    if "spin_angle" in found:
        angle = running_angle(found["spin_angle"], grid, found, bench)
        found["spin_angle"] = counted_angle(angle, grid, found, problems)
    else:
        pulsed = pulsed_angle(grid, found, taken, problems)
        if pulsed is not None:
            found["spin_angle"] = pulsed
    if TIME in found:  # those with another clock
        own = found[TIME].column
        for key, item in found.items():
            clock = grid.columns[item.column].clock or _clock_for(grid, item.column, own)
            found[key] = replace(item, clock=clock if clock != own else "")
    return {name: found[name] for name in (*UNITS, SEQUENCE) if name in found}


def _numbered_inputs(names: Sequence[str]) -> list[str]:
    """Return the columns that are inputs of an acquisition device, whose names only count: ``v0``, ``Channel A``."""
    groups: dict[tuple[str, str], list[str]] = {}
    for name in names:
        if (found := _COUNTED.search(_IN_BRACKETS.sub("", name).strip())) is not None:
            word = re.split(r"[^a-z]", found[1].lower().rstrip("[( _-"))[-1]
            if word in INPUTS:
                groups.setdefault((found[1], found[3]), []).append(name)
    return [name for own in groups.values() if len(own) >= _FEWEST_INPUTS for name in own]


def _from_one(name: str, grid: Grid) -> str:
    """Return a name whose number counts from one, where the numbers of its neighbours count from zero."""
    found = _NUMBER.search(name)
    if found is None or f"{found[1]}0{found[3]}" not in grid.columns:
        return name
    return f"{found[1]}{int(found[2]) + 1}{found[3]}"


def _thermometers(
    grid: Grid,
    names: Mapping[str, Meaning],
    taken: set[str],
    found: dict[str, Proposal],
    bench: Bench,
    problems: list[Problem],
) -> None:
    """Take unspecified thermometers for missing temperatures; of several it is asked which is which."""
    guesses = []
    for name, what in names.items():
        if TEMPERATURE in what.fields and name not in taken and not what.commanded:
            free = [f for f in ("air_temperature", "coil_temperature") if f not in found]
            proposal = _proposed(free[0], grid.columns[name], what, bench) if free else None
            if proposal is not None:
                found[free[0]] = replace(proposal, reason=f"{proposal.reason}; its place is not stated")
                taken.add(name)
                guesses.append(f"{free[0]}: '{name}'")
    if len(guesses) > 1:
        problems.append(
            Problem(
                f"{', '.join(guesses)} are guesses: the names do not state where the thermometers are.",
                "Name the right column for each in the map, or leave it out.",
            )
        )


def _unread(column: Column, what: Meaning, found: Mapping[str, Proposal]) -> list[Problem]:
    """Return the problems of a column that cannot be used, where no other column has its reading."""
    own = max(what.fields, key=lambda field: what.fields[field], default="")
    if what.fields.get(own, 0) < 2 or own == SEQUENCE or what.commanded or (own in found and own != TIME):
        return []
    if column.odd:
        return odd_cells(own, column.name, column)
    if column.numeric:
        known = int(np.isfinite(np.asarray(column.values, dtype=np.float64)).sum())
        return [
            Problem(
                f"column '{column.name}' has values in {known} of {len(column.values)} rows; it is not used.",
                "See whether its sensor was connected; take the column out where it was not.",
            )
        ]
    row, text = next(((k, str(value)) for k, value in enumerate(column.values, 1) if str(value)), (1, ""))
    strange = next((sign for sign in text if not sign.isascii()), "")
    named = f", with the character U+{ord(strange):04X} in it" if strange else ""
    cure = (
        "Write seconds from the beginning, or dates with times such as 2026-05-04T10:00:00.0005."
        if own == TIME
        else "Write plain numbers in every row, digits with one decimal sign; leave the cell of a missing value empty."
    )
    return [Problem(f"column '{column.name}' holds text, such as '{text[:24]}' in row {row}{named}.", cure)]


def _rivals(
    claims: Sequence[tuple[float, int, str, str]],
    found: Mapping[str, Proposal],
    taken: Collection[str],
    grid: Grid,
    bench: Bench,
) -> list[Problem]:
    """Return the readings for which several columns are named alike, of which the first is taken.

    A column without a unit whose values would be unusual in all units, where those of the first are not, is no rival.
    """
    scores = {(name, own): score for score, _, name, own in claims}
    problems = []
    for own, proposal in found.items():
        best = scores.get((proposal.column, own))
        if best is None or own in (TIME, SEQUENCE):
            continue
        others = [
            name
            for (name, field), score in scores.items()
            if field == own and name not in taken and score <= best
        ]
        if own in READINGS and _usual(proposal.column, own, grid, bench):
            others = [name for name in others if _usual(name, own, grid, bench)]
        if others:
            reading = READINGS.get(own)
            problems.append(
                Problem(
                    f"{own}: '{proposal.column}' is taken; {', '.join(repr(name) for name in others)} "
                    f"{'is' if len(others) == 1 else 'are'} named as clearly.",
                    "See which is the right one, and name it in the map.",
                    asks=reading is None or not reading.constant,
                )
            )
    return problems


def _usual(name: str, own: str, grid: Grid, bench: Bench) -> bool:
    """Whether the values of a column are usual for a reading, in the stated unit or in any."""
    column = grid.columns[name]
    values = np.asarray(column.values, dtype=np.float64)
    values = values[np.isfinite(values)]
    stated = meaning_of(name, column.unit).unit
    return own == "spin_angle" or bool(stated) or (len(values) > 1 and bool(guess_unit(own, values, bench)))


def _usable(column: Column, what: Meaning) -> bool:
    if column.dated:
        return True
    if not column.numeric:
        return False
    some = np.isfinite(np.asarray(column.values[: SOME * 10], dtype=np.float64))
    if what.fields.keys() & _SLOW and int(some.sum()) >= 2:
        return True  # a few values of what changes slowly are enough
    return bool(some.mean() > _FEWEST)


def _likely(column: Column, own: str, what: Meaning) -> float:
    """Return how well the values of a column fit a field, whatever its name."""
    if column.values.dtype.kind == "M":
        if own != TIME:
            return -9.0
        # dates to whole seconds are no clock of samples where there is another one
        return 2.0 if _moves(np.diff(column.values[:SOME]).astype(np.int64)) else -2.0
    values = np.asarray(column.values, dtype=np.float64)
    values = values[np.isfinite(values)]
    steps = np.diff(values[:SOME])
    rising = bool(len(steps)) and bool(np.mean(steps >= 0.0) > 0.999) and float(steps.sum()) > 0.0
    if own in _NEVER_STILL and len(values) > 1 and not np.any(values):
        return -1.5  # an element of a vector, or an input, that nothing is connected to
    if own == TIME:
        if rising and _moves(steps) and column.clock in ("", column.name):
            return 1.0
        # one that is clearly called so, and is disordered, is questioned (`order`)
        return -1.0 if what.fields[own] > 2 and not column.clock else -4.0
    if own == SEQUENCE:
        return 1.0 if rising and _counts_rows(values[:SOME]) else -9.0
    if own in ("spin_rate", "spin_angle") and has_levels(column):
        return -9.0  # pulses of it
    if own == "spin_angle":
        return 0.5 if len(steps) and np.median(np.abs(steps)) > 0.0 else -1.0
    return -0.5 if rising and own not in ("coil_temperature", "air_temperature") else 0.0


def _counts_rows(values: NDArray[Any]) -> bool:
    """Whether values are whole and ascend, mostly by one; others count something else than the rows."""
    steps = np.diff(values)
    whole = bool(np.all(values == np.round(values)))
    return whole and bool(np.all(steps >= 1.0)) and float(np.median(steps)) == 1.0


def _moves(steps: NDArray[Any]) -> bool:
    """Whether a clock goes on from most rows to the next."""
    return len(steps) == 0 or float(np.mean(steps != 0)) > 0.5


def _time_by_values(
    grid: Grid, names: Mapping[str, Meaning], taken: set[str], found: dict[str, Proposal], bench: Bench
) -> None:
    """Find a clock by its values: a column that rises evenly."""
    for name in names:
        column = grid.columns[name]
        if name in taken or not (column.numeric or column.values.dtype.kind == "M"):
            continue
        values = np.asarray(column.values[:SOME]).astype(np.float64)
        steps = np.diff(values)
        counts = bool(np.all(steps == 1.0)) and not known_unit(column.unit)  # numbers of rows, not times
        even = bool(np.all(steps > 0.0)) and float(np.std(steps)) < 0.5 * float(np.mean(steps))
        dated = column.dated and _moves(steps)  # dates are no readings; `rows_in_order` judges their order
        if len(steps) > 10 and not counts and (even or dated):
            proposal = _proposed(TIME, column, meaning_of("time", column.unit), bench)
            if proposal is not None:
                found[TIME] = replace(proposal, reason=f"rises evenly; {proposal.reason}")
                taken.add(name)
                return


def _is_clock(grid: Grid, column: str) -> bool:
    """Whether a column has times: it is called so within its folder, and goes on from most rows to the next."""
    own = grid.columns[column]
    if not own.numeric or not _is_time(grid, column):
        return False
    steps = np.diff(np.asarray(own.values[:SOME], dtype=np.float64))
    return len(steps) > 0 and bool(np.all(steps >= 0.0)) and _moves(steps)


def _is_time(grid: Grid, column: str) -> bool:
    """Whether a column is called a time within its folder."""
    return TIME in meaning_of(column[len(_folder(column)) :], grid.columns[column].unit).fields


def _value_a_row(grid: Grid) -> Problem | None:
    """Return the problem of a table with a row for each value, in which a text names the reading."""
    texts = [own for own in grid.columns.values() if not (own.numeric or own.dated)]
    numbers = [name for name, own in grid.columns.items() if own.numeric and not _is_time(grid, name)]
    for own in texts if len(numbers) == 1 else ():
        first = [str(value) for value in own.values]
        named = set(first)
        if _FEWEST_NAMED <= len(named) <= len(first) / 2:
            shown = ", ".join(sorted(named)[:_SHOWN])
            return Problem(
                f"the table has a row for every value, and '{own.name}' names what it is: {shown} ...",
                "Save it with a column for each of them, as by pandas: "
                f"table.pivot(index=TIME, columns='{own.name}', values='{numbers[0]}').reset_index().",
            )
    return None


def _clock_for(grid: Grid, column: str, usual: str) -> str:
    """Return the column with the times of a column: in its folder, or with as many rows."""
    rows, here = len(grid.columns[column].values), _folder(column)
    if column == usual or (rows == len(grid.columns[usual].values) and here == _folder(usual)):
        return ""
    like = [
        name
        for name, own in grid.columns.items()
        if name != column and len(own.values) == rows and _is_time(grid, name)
    ]
    near = [name for name in like if _folder(name) == here and (here or usual not in like)]
    if not near and usual in like:
        return ""
    near = near or like
    return "" if usual in near or not near else min(near, key=len)


def _folder(column: str) -> str:
    """Return the path before the name of a column."""
    return column[: max(column.rfind("/"), column.rfind(".")) + 1]


def _proposed(own: str, column: Column, what: Meaning, bench: Bench) -> Proposal | None:
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
        unit, scale, why = angle_unit(values, what.unit)
        return Proposal(own, column.name, unit, scale, f"{said}; {why}", bool(what.unit), "", low, high)
    if own == TIME and not unit and (epoch := epoch_unit(values))[0]:
        return Proposal(own, column.name, *epoch[:2], f"{said}; {epoch[2]}", True, "", low, high)
    if not unit:
        unit = guess_unit(own, values, bench)
        if not unit:
            if clear < 2:
                return None
            why = f"no usual unit fits {low:.4g} .. {high:.4g}"
            return Proposal(own, column.name, UNITS[own], 1.0, f"{said}; {why}", False, "", low, high)
    why = f"unit {unit} stated" if stated else f"in {unit} {low:.4g} .. {high:.4g} is usual"
    return Proposal(own, column.name, unit, scale, f"{said}; {why}", stated, "", low, high)


#: Names of columns with the part of a second: what it is called, in which unit, and how many make a second.
_PARTS: Final = (
    (re.compile(r"(.*?)(nano_?sec(?:ond)?s?|nsecs?|ns)", re.IGNORECASE), "ns", 1_000_000_000),
    (re.compile(r"(.*?)(micro_?sec(?:ond)?s?|usecs?|us)", re.IGNORECASE), "us", 1_000_000),
    (re.compile(r"(.*?)(milli_?sec(?:ond)?s?|msecs?|ms)", re.IGNORECASE), "ms", 1000),
)
_SECONDS: Final = ("sec", "secs", "second", "seconds", "s")
_BRACKETS: Final = re.compile(r"\s*[\[(].*?[\])]\s*$")


def with_stamps(grid: Grid) -> tuple[Grid, dict[str, tuple[str, str, str]]]:
    """Return a table in which seconds and their part are one column, and what that column consists of.

    The result has, by the name of the new column, those of the two and the unit of the second one; of several such
    pairs the first one is taken.
    """
    plain = {_BRACKETS.sub("", name).lower(): name for name in grid.columns}
    for short, name in plain.items():
        for pattern, unit, a_second in _PARTS:
            found = pattern.fullmatch(short)
            whole = found and next((plain[found[1] + own] for own in _SECONDS if found[1] + own in plain), "")
            if not whole or not _fit(grid.columns[whole], grid.columns[name], a_second):
                continue
            seconds, part = (np.asarray(grid.columns[own].values, dtype=np.int64) for own in (whole, name))
            joined = f"{whole} + {name}"
            nanoseconds = seconds * 1_000_000_000 + part * (1_000_000_000 // a_second)
            columns = {own: column for own, column in grid.columns.items() if own not in (whole, name)}
            stamp = Column(joined, nanoseconds, "ns", grid.columns[whole].clock)
            return replace(grid, columns={joined: stamp, **columns}), {joined: (whole, name, unit)}
    return grid, {}


def _fit(seconds: Column, part: Column, a_second: int) -> bool:
    """Whether two columns are whole seconds and the part of each."""
    if (
        not (seconds.numeric and part.numeric)
        or len(seconds.values) != len(part.values)
        or len(part.values) < 2
    ):
        return False
    one, other = (np.asarray(own.values, dtype=np.float64) for own in (seconds, part))
    if not (np.isfinite(one).all() and np.isfinite(other).all()):
        return False
    whole = bool(
        np.all(one == np.round(one)) and np.all(other == np.round(other)) and np.abs(one).max() < 9e9
    )
    return whole and bool(
        other.min() >= 0.0 and other.max() < a_second and np.median(np.abs(np.diff(one))) <= 1.0
    )
