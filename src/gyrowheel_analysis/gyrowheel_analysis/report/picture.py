"""One picture of an error that falls: residuals window by window, and their size beside the noise floor."""

from __future__ import annotations

import itertools
import math
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.errors import TORQUE_CHANNELS, ErrorRow, ErrorTable, Residuals
from gyrowheel_sim.errors import InputError
from gyrowheel_sim.units import RPM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_MILLI = 1e-3
_SIZE = (16.0, 10.0)  # inches, of 100 dots
_DOTS = 100
# of the palette of Okabe and Ito, which people tell apart whatever their colour vision
_BEFORE, _AFTER = "#D55E00", "#0072B2"
_NOISE, _INK, _FAINT = "#9A9A9A", "#222222", "#E4E4E4"
_TITLES = {"tilt_x": "tilt x", "tilt_y": "tilt y", "spin": "spin"}
_ROLES = {"fit": "fitted", "validation": "not used to fit"}
_SAME_SPEED = 0.04  # relative
_WIDE = 12.0  # range of sizes from which on an axis is logarithmic
_GAP = 2.0  # between two recordings in one panel [s]
_STYLE: Any = {  # typed by matplotlib key by key
    "font.family": "sans-serif",
    "font.size": 11.5,
    "axes.edgecolor": "#888888",
    "axes.labelcolor": _INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": _INK,
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "axes.titlesize": 13,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
}


def save_picture(
    path: str | Path,
    residuals: Sequence[Residuals],
    error: ErrorTable,
    *,
    title: str,
    subtitle: str = "",
) -> None:
    """Draw a picture of the error before and after, and write it as PNG of 1600 by 1000 dots.

    Parameters
    ----------
    path : str or Path
        File to write; it is whole or as it was before.
    residuals : sequence of Residuals
        Residuals of every recording, fitted and for validation.
    error : ErrorTable
        The table of errors.
    title, subtitle : str
        The result in words, and what else to say in one line.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    import matplotlib as mpl

    with mpl.rc_context(_STYLE):
        figure = draw(residuals, error, title=title, subtitle=subtitle)
        _write(figure, Path(path))


def draw(residuals: Sequence[Residuals], error: ErrorTable, *, title: str, subtitle: str = "") -> Figure:
    """Return the figure of `save_picture`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE, dpi=_DOTS, facecolor="white")
    figure.text(0.045, 0.955, title, fontsize=_title_size(title), fontweight="bold", va="center")
    if subtitle:
        figure.text(0.045, 0.913, subtitle, fontsize=13, color="#555555", va="center")
    roles = [role for role in _ROLES if any(r.role == role for r in residuals)]
    widths = [math.sqrt(sum(r.time[-1] for r in residuals if r.role == role) + 5.0) for role in roles]
    left = figure.add_gridspec(
        3,
        len(roles),
        left=0.07,
        right=0.665,
        top=0.815,
        bottom=0.075,
        hspace=0.16,
        wspace=0.05,
        width_ratios=widths,
    )
    changed = any(
        not np.array_equal(before, after) for r in residuals for before, after, _ in r.channels.values()
    )
    labelled = []
    for row, channel in enumerate(TORQUE_CHANNELS):
        first: Axes | None = None
        for column, role in enumerate(roles):
            axes = figure.add_subplot(left[row, column], sharey=first)
            _residual_panel(
                axes, [r for r in residuals if r.role == role], channel, named=row == 0, changed=changed
            )
            if first is None:
                first = axes
                labelled.append(axes)
                axes.set_ylabel(f"residual, {_TITLES[channel]}\nmN·m")
            else:
                axes.tick_params(labelleft=False)
            if row == 0:
                names = ", ".join(r.name for r in residuals if r.role == role)
                axes.set_title(f"{_ROLES[role]}: {names}", pad=26)
            axes.tick_params(labelbottom=row == 2)
            if row == 2:
                axes.set_xlabel("time in the recording, s")
    figure.align_ylabels(labelled)
    _size_panels(figure, error, changed=changed)
    _legend(figure, changed=changed)
    return figure


def _residual_panel(
    axes: Axes, residuals: Sequence[Residuals], channel: str, *, named: bool, changed: bool
) -> None:
    """Draw residuals over time, the noise about zero, and where which speed was."""
    offset = 0.0
    axes.axhline(0.0, color="#BBBBBB", linewidth=0.8, zorder=1)
    for residual in residuals:
        order = np.argsort(residual.time)
        time = residual.time[order] + offset
        before, after, sigma = (np.asarray(part)[order] / _MILLI for part in residual.channels[channel])
        _speeds(axes, time, residual.spin_rate[order], named=named)
        axes.fill_between(time, -sigma, sigma, color=_NOISE, alpha=0.45, linewidth=0.0, zorder=2, step="mid")
        if changed:
            axes.vlines(time, before, after, color=_BEFORE, linewidth=1.2, alpha=0.3, zorder=3)
            axes.plot(time, before, "o", markersize=7.0, color=_BEFORE, markeredgewidth=0.0, zorder=4)
        axes.plot(time, after, "D", markersize=4.6, color=_AFTER, markeredgewidth=0.0, zorder=5)
        offset = float(time[-1]) + _GAP
    axes.margins(x=0.02, y=0.12)
    axes.grid(axis="y", color=_FAINT, linewidth=0.8)
    axes.set_axisbelow(True)


def _speeds(axes: Axes, time: Array, spin_rate: Array, *, named: bool) -> None:
    """Shade every second stretch of equal speed, and name the speed above the panel."""
    changes = np.flatnonzero(np.abs(np.diff(spin_rate)) > _SAME_SPEED * spin_rate[1:])
    edges = [0, *(changes + 1), len(time)]
    for index, (start, stop) in enumerate(itertools.pairwise(edges)):
        low = time[start] if start == 0 else 0.5 * (time[start - 1] + time[start])
        high = time[-1] if stop == len(time) else 0.5 * (time[stop - 1] + time[stop])
        if index % 2:
            axes.axvspan(low, high, color="#F4F4F4", linewidth=0.0, zorder=0)
        if named:
            rpm = np.median(spin_rate[start:stop]) / RPM
            axes.text(
                0.5 * (low + high),
                1.02,
                f"{round(rpm, -1):.0f}" + ("" if index else " rpm"),
                transform=axes.get_xaxis_transform(),
                ha="center",
                va="bottom",
                fontsize=10,
                color="#666666",
            )


def _size_panels(figure: Figure, error: ErrorTable, *, changed: bool) -> None:
    """Draw the sizes of the residuals before and after as bars, with the noise floor."""
    parts = [("fitted", error.before, error.after, error.noise_floor)]
    if error.validation_before is not None and error.validation_after is not None:
        floor = error.validation_noise_floor or error.noise_floor
        parts.append(("not used to fit", error.validation_before, error.validation_after, floor))
    grid = figure.add_gridspec(len(parts), 1, left=0.735, right=0.975, top=0.815, bottom=0.075, hspace=0.28)
    rows = [row for part in parts for row in part[1:]]
    sizes = [row.rms[name] / _MILLI for row in rows for name in TORQUE_CHANNELS if row.rms[name] > 0.0]
    smallest, largest = (min(sizes), max(sizes)) if sizes else (1.0, 1.0)
    logarithmic = largest > _WIDE * smallest
    low, high = (smallest / 2.5, largest * 2.2) if logarithmic else (0.0, 1.18 * largest)
    for index, (name, before, after, floor) in enumerate(parts):
        axes = figure.add_subplot(grid[index])
        change = f"χ²/N {_short(before.chi2_per_n)} → " if changed else "χ²/N "
        change += _short(after.chi2_per_n)
        axes.set_title(f"RMS, {name}", pad=10)
        axes.set_title(change, pad=10, loc="right", fontsize=11.5, fontweight="normal", color="#555555")
        if logarithmic:
            axes.set_yscale("log")
            axes.minorticks_off()
        axes.set_ylim(low, high)
        _bars(axes, [(before, _BEFORE), (after, _AFTER)] if changed else [(after, _AFTER)], floor, low)
        axes.set_ylabel("mN·m")


def _bars(axes: Axes, rows: Sequence[tuple[ErrorRow, str]], floor: ErrorRow, low: float) -> None:
    width = 0.4
    for place, name in enumerate(TORQUE_CHANNELS):
        level = floor.rms[name] / _MILLI
        for side, (row, colour) in enumerate(rows):
            size = row.rms[name] / _MILLI
            at = place + (side - 0.5 * (len(rows) - 1)) * (width + 0.02)
            axes.bar(at, max(size - low, 0.0), width, bottom=low, color=colour, zorder=2)
            # a label that would lie on the noise floor goes above it
            hidden = 0.0 <= _height(axes, level) - _height(axes, size) < 0.08
            axes.annotate(
                _short(size),
                (at, level if hidden else max(size, low)),
                xytext=(0, 4),
                textcoords="offset points",
                ha="center",
                fontsize=10,
                color=colour,
                fontweight="bold",
            )
        axes.plot([place - 0.45, place + 0.45], [level, level], color=_INK, linewidth=1.8, zorder=3)
    axes.set_xticks(range(len(TORQUE_CHANNELS)), [_TITLES[name] for name in TORQUE_CHANNELS])
    axes.tick_params(axis="x", length=0)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.grid(axis="y", color=_FAINT, linewidth=0.8)
    axes.set_axisbelow(True)


def _height(axes: Axes, value: float) -> float:
    """Return where a value lies between bottom (0) and top (1) of a panel."""
    return float((axes.transScale + axes.transLimits).transform((0.0, value))[1])


def _legend(figure: Figure, *, changed: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Line2D([], [], marker="D", linestyle="", color=_AFTER, markersize=6.5, label="model after"),
        Patch(color=_NOISE, alpha=0.45, linewidth=0.0, label="noise, ±1σ"),
        Line2D([], [], color=_INK, linewidth=1.8, label="noise floor"),
    ]
    if changed:
        before = Line2D([], [], marker="o", linestyle="", color=_BEFORE, markersize=8, label="model before")
        handles.insert(0, before)
    else:
        handles[0].set_label("model")
    figure.legend(
        handles=handles,
        loc="center right",
        bbox_to_anchor=(0.98, 0.895),
        ncols=4,
        frameon=False,
        columnspacing=1.6,
    )


def _title_size(title: str) -> float:
    """Return the size of letters in which a title fits the width."""
    return min(22.0, 22.0 * 88.0 / max(len(title), 1))


def _short(value: float) -> str:
    if value <= 0.0:
        return "0"
    places = max(1 - math.floor(math.log10(value)), 0)
    return f"{value:.{places}f}"


def _write(figure: Figure, path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".png")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    try:
        with os.fdopen(handle, "wb") as stream:
            figure.savefig(stream, format="png", dpi=_DOTS)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
