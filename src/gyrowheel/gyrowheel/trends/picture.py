"""Picture of many recordings over time: values with their errors, and control limits."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from gyrowheel.show.figure import (
    BLUE,
    FAINT,
    INK,
    SOFT,
    VERMILION,
    Picture,
    add_grid,
    drawn,
    letters_in,
    shared_legend,
)
from gyrowheel.trends.page import day, summary, unit_of
from gyrowheel_analysis.trend import Course, Trend

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST = 6
_DAY = 86400.0  # s


@drawn(10.0)
def figure_of_trend(result: Trend) -> Figure:
    """Draw up to six courses with their control limits, 1200 dots wide; those that left them first."""
    shown = result.courses[:_MOST]
    rows = -(-len(shown) // 2)
    figure = Picture(12.0, 1.8 + 2.6 * rows)
    height = figure.get_figheight()
    lines = textwrap.wrap(summary(result), letters_in(11.0, 13.0), max_lines=2, placeholder=" …")
    figure.text(
        0.06, 1.0 - 0.45 / height, "\n".join(lines), fontsize=13, fontweight="bold", color=INK, va="center"
    )
    edges = {"left": 0.08, "right": 0.98, "top": 1.0 - 1.35 / height, "bottom": 0.6 / height}
    grid = figure.subplots(rows, 2, squeeze=False, gridspec_kw={**edges, "hspace": 0.55, "wspace": 0.22})
    places = [axes for row in grid for axes in row]
    for axes, course in zip(places, shown, strict=False):
        _course(axes, course)
    for axes in places[len(shown) :]:
        axes.set_visible(False)
    shared_legend(figure, places, loc="upper left", bbox_to_anchor=(0.05, 1.0 - 0.7 / height), ncols=5)
    return figure


def _course(axes: Axes, course: Course) -> None:
    begin = float(course.time[0])
    days = (course.time - begin) / _DAY
    unit = unit_of(course.name, abs(course.centre))
    low, high = (end / unit.size for end in course.limits)
    value = course.value / unit.size
    axes.fill_between(days, low, high, color=FAINT, label="control limits", zorder=1)
    axes.axhline(course.centre / unit.size, color=SOFT, lw=0.8, zorder=2)
    axes.errorbar(
        days,
        value,
        course.standard_error / unit.size,
        fmt="o",
        ms=3.5,
        lw=0.8,
        color=BLUE,
        label="value",
        zorder=3,
    )
    if course.departure is not None:
        first = course.departure.first
        axes.plot(
            days[first], value[first], "o", ms=10, mfc="none", mec=VERMILION, mew=1.6,
            label=f"{course.departure.kind}", zorder=4,
        )  # fmt: skip
    axes.set_title(f"{course.name}, over the {course.over}", fontsize=10)
    axes.set_xlabel(f"days since {day(begin)}", fontsize=9)
    axes.set_ylabel(unit.label or "1", fontsize=9)
    add_grid(axes)
