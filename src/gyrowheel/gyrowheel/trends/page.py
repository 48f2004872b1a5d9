"""Results of many recordings over time in words."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import UTC, datetime

from rich.console import RenderableType
from rich.text import Text

from gyrowheel.show.layout import heading, indented, sentences, words_table
from gyrowheel_analysis.trend import Change, Course, Trend
from gyrowheel_core.quantities import pair, short

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
    own = course.machines[first] if course.over == "machines" else course.recordings[first]
    word = "on" if course.departure.kind == "outlier" else "from"
    return f"{word} {day(float(course.time[first]))}, {course.over[:-1]} {own}"


def trend_page(result: Trend) -> Iterator[RenderableType]:
    """Yield what left its limits, and the usual spread of every quantity."""
    if result.departed:
        yield heading("Outside of the control limits")
        yield from sentences(_departed(course) for course in result.departed)
    else:
        yield Text("No quantity left its control limits.")
    yield Text()
    yield heading("Within the control limits" if result.departed else "Quantities, SI units")
    table = words_table("quantity", "over", "values", "mean", "usual spread", whole=(0,))
    for column in table.columns[2:]:
        column.justify = "right"
    inside = [course for course in result.courses if course.departure is None]
    for course in inside[:_LISTED]:
        spread = math.sqrt(sum(course.deviation**2) / len(course.value))
        table.add_row(
            course.name, course.over, str(len(course.value)), short(course.centre), short(spread, 2)
        )
    yield indented(table)
    left = []
    if len(inside) > _LISTED:
        left.append(f"{len(inside) - _LISTED} more quantities are in the JSON file.")
    if result.few:
        left.append(f"Too few recordings with a value: {', '.join(result.few)}.")
    yield from sentences(left)


def _departed(course: Course) -> str:
    """Return how a course left its limits as a sentence."""
    left = course.departure
    assert left is not None
    size = pair(left.size, left.standard_error)
    what = {
        "outlier": f"{size} from the mean of all others",
        "step": f"by {size}",
        "drift": f"by {size} from the first to the last value",
    }[left.kind]
    chance = "less than 1 in a million" if left.chance < 1e-6 else f"{left.chance:.1g}"
    return (
        f"{course.name} over the {course.over}: {_KINDS[left.kind]} {what} (mean {short(course.centre)}, SI units), "
        f"{_since(course)}; probability by chance {chance}."
    )
