"""Results of many recordings over time in words."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import UTC, datetime

from rich.console import RenderableType
from rich.text import Text

from gyrowheel.show.layout import figures_table, heading, indented, sentences, words_table
from gyrowheel_analysis.trend import Change, Course, Trend
from gyrowheel_core.quantities import fixed, pair, short
from gyrowheel_core.units import Unit, unit_for
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import registry

_KINDS: dict[Change, str] = {"outlier": "one value", "step": "a step", "drift": "a drift"}
_LISTED = 20


def day(time: float) -> str:
    """Return the day of a time [s since 1970], UTC."""
    try:
        return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%d")
    except (OverflowError, ValueError, OSError):
        return f"{time:.0f} s"


def summary(result: Trend) -> str:
    """Return what left its control limits, in one line."""
    if not result.courses:
        return f"{len(result.shared)} quantities, too few dated recordings for control limits"
    if not result.departed:
        return f"{len({c.name for c in result.courses})} quantities, all within their control limits"
    course = result.departed[0]
    assert course.departure is not None  # it departed
    others = len({c.name for c in result.departed} - {course.name})
    also = f"; and {others} more" if others else ""
    return f"{course.name}: {_KINDS[course.departure.kind]}, {_since(course)}{also}"


def _since(course: Course) -> str:
    """Return the first day, and the machine or the recording, at which a course left its limits."""
    assert course.departure is not None
    first = course.departure.first
    machine = course.machines[first] if course.over == "machines" else ""
    own = f"machine {machine}" if machine else f"recording {course.recordings[first]}"
    word = "on" if course.departure.kind == "outlier" else "from"
    return f"{word} {day(float(course.time[first]))}, {own}"


def trend_page(result: Trend) -> Iterator[RenderableType]:
    """Yield what left its limits, the usual spread of every quantity, and what machines share."""
    if result.versions > 1:
        yield from sentences(
            [
                f"The recordings were diagnosed by {result.versions} versions, which may differ in what a value means. "
                "The verb batch with the folders of all diagnoses the older ones again."
            ]
        )
        yield Text()
    if result.courses:
        yield from _courses(result)
    else:
        yield Text("Too few dated recordings for control limits.")
    if result.shared:
        yield from _shared(result)


def _courses(result: Trend) -> Iterator[RenderableType]:
    if result.departed:
        yield heading("Outside of the control limits")
        yield from sentences(_departed(course) for course in result.departed)
    else:
        yield Text("No quantity left its control limits.")
    yield heading("Within the control limits" if result.departed else "Quantities")
    table = words_table("quantity", "over", "values", "unit", "mean", "usual spread", whole=(0, 3))
    for column in (table.columns[2], *table.columns[4:]):
        column.justify = "right"
    inside = [course for course in result.courses if course.departure is None]
    for course in inside[:_LISTED]:
        spread = math.sqrt(sum(course.deviation**2) / len(course.value))
        unit = unit_of(course.name, max(abs(course.centre), spread))
        mean, _, own = pair(course.centre / unit.size, spread / unit.size).partition(" ± ")
        table.add_row(course.name, course.over, str(len(course.value)), unit.label, mean, own)
    yield indented(table)
    left = []
    if len(inside) > _LISTED:
        left.append(f"{len(inside) - _LISTED} more quantities are in the JSON file.")
    if result.few:
        left.append(f"Too few recordings with a value: {', '.join(result.few)}.")
    yield from sentences(left)


def _shared(result: Trend) -> Iterator[RenderableType]:
    """Yield the mean of all machines and the spread between them, of every quantity."""
    yield heading("What machines share")
    table = figures_table("quantity", "unit", "mean of machines", "spread", "from", "to", "machines")
    table.columns[1].justify = "left"
    for own in result.shared[:_LISTED]:
        unit = unit_of(own.name, max(abs(own.mean), own.standard_error))
        spread = () if own.spread is None or own.interval is None else (own.spread, *own.interval)
        cells = [fixed(value / unit.size, 2) for value in spread] or ["", "", ""]
        mean = pair(own.mean / unit.size, own.standard_error / unit.size)
        table.add_row(own.name, unit.label, mean, *cells, str(own.machines))
    yield indented(table)
    every, differing = len(result.shared), len(result.differing)
    notes = []
    if every > _LISTED:
        notes.append(f"{every - _LISTED} more quantities are in the JSON file.")
    if differing:
        number = "all" if differing == every else f"the first {differing} of {every}"
        notes.append(f"Machines differ in {number} quantities by more than the errors of their values.")
    elif any(own.chance is not None for own in result.shared):
        notes.append("Machines differ in no quantity by more than the errors of their values.")
    if result.unsteady:
        names = ", ".join(own.name for own in result.unsteady)
        notes.append(
            f"Recordings of a machine differ by more than their errors in {names}; so may the machines."
        )
    yield from sentences(notes)


def unit_of(name: str, size: float) -> Unit:
    """Return the unit in which people read a quantity; that of a user's effect, which no table has, is the SI unit."""
    effect, _, key = name.partition(".")
    known, bench = registry().get(effect), Bench.load().parameters
    units = {c.name: c.unit for c in known.coefficients} if known else {}
    own = units.get(key) if key else bench[effect].unit if effect in bench else None
    return Unit("SI unit", 1.0) if own is None else unit_for(size, own, pure=True)


def _departed(course: Course) -> str:
    """Return how a course left its limits as a sentence."""
    left = course.departure
    assert left is not None
    unit = unit_of(course.name, max(abs(course.centre), abs(left.size)))
    size = " ".join(f"({pair(left.size / unit.size, left.standard_error / unit.size)}) {unit.label}".split())
    mean = " ".join(f"{short(course.centre / unit.size)} {unit.label}".split())
    what = {
        "outlier": f"{size} from the mean of all others",
        "step": f"by {size}",
        "drift": f"by {size} from the first to the last value",
    }[left.kind]
    chance = "less than 1 in a million" if left.chance < 1e-6 else f"{left.chance:.1g}"
    return (
        f"{course.name} over the {course.over}: {_KINDS[left.kind]} {what} (mean {mean}), "
        f"{_since(course)}; probability by chance {chance}."
    )
