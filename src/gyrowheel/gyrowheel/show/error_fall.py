"""The fall of the error: residuals before and after, window by window, and their RMS next to the noise floor."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gyrowheel.show.figure import (
    AFTER,
    BEFORE,
    INK,
    NOISE,
    SHADE,
    SOFT,
    TICK,
    ZERO,
    Picture,
    add_grid,
    add_title,
    drawn,
    keep_apart,
    letters_in,
)  # fmt: skip
from gyrowheel_analysis.channels import LISTED, TORQUES
from gyrowheel_analysis.residuals.error_table import ErrorRow, ErrorTable, Residuals, noisy
from gyrowheel_core.quantities import number
from gyrowheel_core.units import RPM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Text

Array = NDArray[np.float64]

#: Scale and unit of a panel, by the unit of its channel.
_UNITS = {"N·m": (1e-3, "mN·m"), "V": (1e-3, "mV"), "rad": (1e-6, "µrad")}
_MILLI = 1e-3
_ROLES = {"fit": "fitted", "validation": "not used to fit"}
_SAME_SPEED = 0.04  # relative
_WIDE = 12.0  # range of sizes from which on an axis is logarithmic
_NAMES = -0.66  # where the names of channels begin, in widths of the panel of sizes
_WORTH_A_NUMBER = 1.3  # noise floors
_CLEAR = 1.5  # noise floors that the error of a further channel must have to be drawn window by window
_MARGIN = 0.12  # of an axis, beyond what it shows
_GAP = 2.0  # between two recordings in one panel [s]


@drawn(11.5, title=13.0)
def error_figure(
    residuals: Sequence[Residuals], error: ErrorTable, *, title: str, subtitle: str = ""
) -> Figure:
    """Draw the error before and after a change, 1600 by 1000 dots; the title is the result in words."""
    figure = Picture(16.0, 10.0)
    add_title(figure, title)
    if subtitle:
        subtitle = textwrap.shorten(subtitle, letters_in(14.56, 13.0), placeholder=" …")
        figure.text(0.045, 0.918, subtitle, fontsize=13, color=TICK, va="center")
    roles = [role for role in _ROLES if any(r.role == role for r in residuals)]
    widths = [math.sqrt(sum(r.time[-1] for r in residuals if r.role == role) + 5.0) for role in roles]
    shown = [*TORQUES, *_clearest(error)]
    left = figure.add_gridspec(
        len(shown),
        len(roles),
        left=0.07,
        right=0.605,
        top=0.815,
        bottom=0.075,
        hspace=0.16,
        wspace=0.05,
        width_ratios=widths,
    )
    changed = any(
        not np.array_equal(before, after) for r in residuals for before, after, _ in r.channels.values()
    )
    labelled: list[Axes] = []
    named: list[list[Text]] = []
    for row, channel in enumerate(shown):
        first: Axes | None = None
        last = row == len(shown) - 1
        for column, role in enumerate(roles):
            axes = figure.add_subplot(left[row, column], sharey=first)
            own = [r for r in residuals if r.role == role]
            scale, unit = _UNITS[LISTED[channel].unit]
            _residual_panel(axes, own, channel, scale, named=row == 0, changed=changed)
            if first is None:
                first = axes
                labelled.append(axes)
                size = "residual" if len(LISTED[channel].rows) == 1 else "|residual|"
                axes.set_ylabel(f"{size}, {LISTED[channel].title}\n{unit}")
            else:
                axes.tick_params(labelleft=False)
            if row == 0:
                # the last title may reach over the panels to its right
                share = 0.53 * widths[column] / sum(widths) + (0.37 if role == roles[-1] else 0.0)
                room = letters_in(16.0 * share, 13.0)
                axes.set_title(_named(_ROLES[role], [r.name for r in own], room), pad=26)
                named += [list(axes.texts)]
            axes.tick_params(labelbottom=last)
            if last:
                axes.set_xlabel("time in the recording, s")
    figure.align_ylabels(labelled)
    for speeds in named:
        keep_apart(speeds)
    _size_panels(figure, error, changed=changed)
    _legend(figure, changed=changed)
    return figure


def _named(role: str, names: Sequence[str], room: int) -> str:
    """Return the title of a column, with the names of its recordings where there is room for so many letters."""
    title = f"{role}: {', '.join(names)}"
    if len(title) > room and len(names) > 1:
        title = f"{role}: {len(names)} recordings"
    return title if len(title) <= room else f"{title[: max(room - 1, 1)]}…"


def _clearest(error: ErrorTable) -> list[str]:
    """Return the channel beyond the averaged torques in which the error was largest, where it was clearly there."""
    floors = {
        name: before.rms / floor.rms
        for name, before in error.before.channels.items()
        if name not in TORQUES
        and (floor := error.noise_floor.channels.get(name)) is not None
        and floor.rms > 0.0
    }
    largest = max(floors, key=lambda name: floors[name], default=None)
    return [largest] if largest is not None and floors[largest] > _CLEAR else []


def _rows(residual: Residuals, channel: str) -> tuple[Array, Array, Array]:
    """Return before, after and noise of a channel; of an amplitude its modulus."""
    if channel in residual.channels:
        return residual.channels[channel]
    before, after, sigma = residual.further[channel]
    if not np.iscomplexobj(before):
        return before, after, sigma
    return np.abs(before), np.abs(after), math.sqrt(2.0) * sigma


def _residual_panel(
    axes: Axes, residuals: Sequence[Residuals], channel: str, scale: float, *, named: bool, changed: bool
) -> None:
    """Draw residuals over time, the noise about zero, and where which speed was."""
    offset, span = 0.0, [0.0, 1e-12]
    axes.axhline(0.0, color=ZERO, linewidth=0.8, zorder=1)
    for residual in residuals:
        order = np.argsort(residual.time)
        time = residual.time[order] + offset
        before, after, sigma = (np.asarray(part)[order] / scale for part in _rows(residual, channel))
        _speeds(axes, time, residual.spin_rate[order], named=named)
        axes.fill_between(time, -sigma, sigma, color=NOISE, alpha=0.45, linewidth=0.0, zorder=2, step="mid")
        if changed:
            axes.vlines(time, before, after, color=BEFORE, linewidth=1.2, alpha=0.3, zorder=3)
            axes.plot(time, before, "o", markersize=7.0, color=BEFORE, markeredgewidth=0.0, zorder=4)
        odd = noisy(sigma)
        axes.plot(time[~odd], after[~odd], "D", markersize=4.6, color=AFTER, markeredgewidth=0.0, zorder=5)
        axes.plot(time[odd], after[odd], "x", markersize=6.0, color=AFTER, zorder=5)
        shown = [after, sigma, -sigma, *([before] if changed else [])]
        usual = np.concatenate([span, *(part[~odd] for part in shown)])
        span = [float(usual.min()), float(usual.max())]
        offset = float(time[-1]) + _GAP
    axes.margins(x=0.02)
    # windows that are far noisier than the others may lie outside
    low, high = (span[0] - _MARGIN * np.ptp(span), span[1] + _MARGIN * np.ptp(span))
    if not axes.get_autoscaley_on():  # shared, and set by the panel before
        low, high = min(low, axes.get_ylim()[0]), max(high, axes.get_ylim()[1])
    axes.set_ylim(0.0 if len(LISTED[channel].rows) > 1 else low, high)
    add_grid(axes, "y")


def _speeds(axes: Axes, time: Array, spin_rate: Array, *, named: bool) -> None:
    """Shade every second stretch of equal speed, and name the speed above the panel."""
    changes = np.flatnonzero(np.abs(np.diff(spin_rate)) > _SAME_SPEED * spin_rate[1:])
    edges = [0, *(changes + 1), len(time)]
    for index, (start, stop) in enumerate(itertools.pairwise(edges)):
        low = time[start] if start == 0 else 0.5 * (time[start - 1] + time[start])
        high = time[-1] if stop == len(time) else 0.5 * (time[stop - 1] + time[stop])
        if index % 2:
            axes.axvspan(low, high, color=SHADE, linewidth=0.0, zorder=0)
        if named:
            rpm = np.median(spin_rate[start:stop]) / RPM
            axes.text(
                0.5 * (low + high),
                1.02,
                f"{round(rpm, -1):.0f}" + ("" if index else " rpm"),
                transform=axes.get_xaxis_transform(),
                ha="center",
                va="bottom",
                fontsize=11,
                color=SOFT,
            )


def _size_panels(figure: Figure, error: ErrorTable, *, changed: bool) -> None:
    """Draw the errors before and after in noise floors, channel by channel; the floor is where no model gets below."""
    parts = [("fitted", error.before, error.after, error.noise_floor)]
    if error.validation_before is not None and error.validation_after is not None:
        floor = error.validation_noise_floor or error.noise_floor
        parts.append(("not used to fit", error.validation_before, error.validation_after, floor))
    grid = figure.add_gridspec(len(parts), 1, left=0.775, right=0.98, top=0.815, bottom=0.1, hspace=0.36)
    sizes = [
        size
        for _, *rows, floor in parts
        for row in rows
        for size in _in_floors(row, floor).values()
        if size > 0.0
    ]
    largest = max(sizes, default=1.0)
    logarithmic = largest > _WIDE
    low, high = (min(0.5, 0.8 * min(sizes)), largest * 3.5) if logarithmic else (0.0, max(1.3 * largest, 1.5))
    for index, (name, before, after, floor) in enumerate(parts):
        axes = figure.add_subplot(grid[index])
        change = f"χ²/N {_short(before.chi2_per_n)} → " if changed else "χ²/N "
        change += _short(after.chi2_per_n)
        axes.set_title(f"RMS, {name}", pad=10, x=_NAMES, ha="left")
        axes.set_title(change, pad=10, loc="right", fontsize=11.5, fontweight="normal", color=TICK)
        if logarithmic:
            axes.set_xscale("log")
            axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
            axes.minorticks_off()
        axes.set_xlim(low, high)
        _bars(axes, [(before, BEFORE), (after, AFTER)] if changed else [(after, AFTER)], floor, low)
        if index == len(parts) - 1:
            axes.set_xlabel("noise floors")


def _in_floors(row: ErrorRow, floor: ErrorRow) -> dict[str, float]:
    """Return the error of every channel over its noise floor."""
    level = {name: _size(floor, name) for name in LISTED if _has(row, name) and _has(floor, name)}
    return {name: _size(row, name) / own if own > 0.0 else 0.0 for name, own in level.items()}


def _has(row: ErrorRow, name: str) -> bool:
    return name in row.rms or name in row.channels


def _size(row: ErrorRow, name: str) -> float:
    return row.rms[name] if name in row.rms else row.channels[name].rms


def _bars(axes: Axes, rows: Sequence[tuple[ErrorRow, str]], floor: ErrorRow, low: float) -> None:
    names = list(_in_floors(rows[0][0], floor))
    height = 0.4
    apart = 2.4 if len(rows) > 1 else 0.0  # between the numbers of two equal bars [points]
    for side, (row, colour) in enumerate(rows):
        for place, size in enumerate(_in_floors(row, floor).values()):
            at = place + (side - 0.5 * (len(rows) - 1)) * height
            axes.barh(at, max(size - low, 0.0), height, left=low, color=colour, zorder=2)
            if size < _WORTH_A_NUMBER and side == 0 and len(rows) > 1:
                continue  # noise before the change needs no number
            # a label that would lie on the noise floor goes beyond it
            hidden = 0.0 <= _along(axes, 1.0) - _along(axes, size) < 0.15
            axes.annotate(
                _short(size),
                (1.0 if hidden else max(size, low), at),
                xytext=(4, apart * (0.5 - side)),
                textcoords="offset points",
                va="center_baseline",
                fontsize=10.5,
                color=colour,
                fontweight="bold",
            )
    axes.axvline(1.0, color=INK, linewidth=1.8, zorder=3)
    axes.set_yticks(range(len(names)), [LISTED[name].title for name in names], fontsize=11.5)
    for label in axes.get_yticklabels():
        label.set_horizontalalignment("left")
        label.set_x(_NAMES)
    for place, name in enumerate(names):
        scale, unit = _UNITS[LISTED[name].unit]
        axes.annotate(
            f"{number(_size(floor, name) / scale)} {unit}",
            (0.0, place),
            xytext=(-6, 0),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            ha="right",
            va="center",
            fontsize=11,
            color=SOFT,
        )
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    add_grid(axes, "x")


def _along(axes: Axes, value: float) -> float:
    """Return where a value lies between the left (0) and the right (1) of a panel."""
    return float((axes.transScale + axes.transLimits).transform((value, 0.0))[0])


def _legend(figure: Figure, *, changed: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Line2D([], [], marker="D", linestyle="", color=AFTER, markersize=6.5, label="model after"),
        Patch(color=NOISE, alpha=0.45, linewidth=0.0, label="noise, ±1σ"),
        Line2D([], [], color=INK, linewidth=1.8, label="noise floor (its size next to the name)"),
    ]
    if changed:
        before = Line2D([], [], marker="o", linestyle="", color=BEFORE, markersize=8, label="model before")
        handles.insert(0, before)
    else:
        handles[0].set_label("model")
    figure.legend(
        handles=handles,
        loc="center right",
        bbox_to_anchor=(0.98, 0.888),
        ncols=4,
        frameon=False,
        columnspacing=1.6,
    )


def _short(value: float) -> str:
    if value <= 0.0:
        return "0"
    places = max(1 - math.floor(math.log10(value)), 0)
    return f"{value:.{places}f}"
