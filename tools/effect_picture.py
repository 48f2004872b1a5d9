"""The signature of an effect as a picture: the torque over the tilts, and rows over speed and tilt."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel.show.figure import (
    BLUE,
    DARK,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    PINK,
    SKY,
    TICK,
    VERMILION,
    ZERO,
    Picture,
    style,
)
from gyrowheel_core.units import DEG, RPM
from tools.effect_signature import RINGS, Curve, Signature

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_VISIBLE = {"N·m": 1e-8, "V": 1e-5}  # less is not drawn
_MILLI = 1e-3
#: Of the rows of a signature, in their order.
_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, SKY, DARK, PINK, DARK)
_LETTERS, _TITLES = 9.5, 10.0  # sizes [points]


def to_svg(found: Signature, description: str = "") -> str:
    """Return the picture of a signature as an SVG document; `description` goes into its metadata."""
    with style(_LETTERS, title=_TITLES):
        stream = io.StringIO()
        metadata: Mapping[str, Any] = {"Date": None, "Creator": None, "Description": description}
        _draw(found).savefig(stream, format="svg", metadata=metadata)
    text = re.sub(r"<[^>]*>", _rounded, stream.getvalue())
    return "\n".join(line.rstrip() for line in text.splitlines()) + "\n"


def _rounded(tag: re.Match[str]) -> str:
    """Return a tag of an SVG document with coordinates to a hundredth of a dot, which is fine enough."""
    return re.sub(r"(?<![\w.])\d+\.\d{3,}(?=[\s\")])", lambda own: f"{float(own[0]):.2f}", tag[0])


def _draw(found: Signature) -> Figure:
    figure = Picture(7.6, 2.75)
    grid = figure.add_gridspec(
        1, 3, left=0.045, right=0.985, top=0.80, bottom=0.20, wspace=0.36, width_ratios=(1.0, 1.25, 1.25)
    )
    _arrows(figure.add_subplot(grid[0]), found)
    rpm, tilt = found.speed_held / RPM, found.tilt_held / DEG
    shown = _visible(found)
    volts = bool(shown) and all(row.unit == "V" for row, _ in shown)
    for place, title, label, x, rows in (
        (1, f"at a tilt of {tilt:.0f}°", "speed, rpm", found.speed / RPM, found.by_speed),
        (2, f"at {rpm:.0f} rpm", "tilt, deg", found.tilt / DEG, found.by_tilt),
    ):
        axes = figure.add_subplot(grid[place])
        _lines(axes, x, [rows[index] for _, index in shown], [index for _, index in shown])
        axes.set_title(title)
        axes.set_xlabel(label)
        axes.set_ylabel("V" if volts else "mN·m", labelpad=2)
    handles = figure.axes[1].get_legend_handles_labels()
    figure.legend(
        *handles,
        loc="upper left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=4,
        frameon=False,
        fontsize=9.5,
        handlelength=1.4,
    )
    return figure


def _visible(found: Signature) -> list[tuple[Curve, int]]:
    """Return the rows that are more than a hundredth of the largest of their unit; volts only where nothing else is."""
    sizes = [
        max(float(np.abs(a.values).max()), float(np.abs(b.values).max()))
        for a, b in zip(found.by_speed, found.by_tilt, strict=True)
    ]
    for unit in ("N·m", "V"):
        rows = [(row, k) for k, row in enumerate(found.by_speed) if row.unit == unit]
        largest = max(sizes[k] for _, k in rows)
        if largest > _VISIBLE[unit]:
            return [(row, k) for row, k in rows if sizes[k] > 0.01 * largest]
    return []


def _lines(axes: Axes, x: Array, rows: Sequence[Curve], colours: Sequence[int]) -> None:
    axes.axhline(0.0, color=ZERO, linewidth=0.8, zorder=1)
    for row, colour in zip(rows, colours, strict=True):
        scale = _MILLI if row.unit == "N·m" else 1.0
        axes.plot(x, row.values / scale, color=_COLOURS[colour], linewidth=1.8, label=row.name, zorder=3)
    axes.margins(x=0.03, y=0.12)
    axes.grid(axis="y", color=FAINT, linewidth=0.8)
    axes.set_axisbelow(True)
    low, high = axes.get_ylim()
    if low > -0.05 * high and high > 0.0:
        axes.set_ylim(min(low, 0.0), high)
    axes.locator_params(axis="y", nbins=5)


def _arrows(axes: Axes, found: Signature) -> None:
    """Draw the torque of the coils as an arrow at every tilt."""
    from matplotlib.patches import Circle

    z, longest = found.tilts / DEG, float(np.abs(found.torques).max())
    limit = float(np.abs(z).max())
    for k in range(1, RINGS + 1):
        axes.add_patch(
            Circle((0.0, 0.0), limit * k / RINGS, fill=False, color=FAINT, linewidth=0.8, zorder=1)
        )
    text = "no steady torque of the coils"
    rows = [row for row in (*found.by_speed, *found.by_tilt) if row.unit == "N·m"]
    if longest > max(_VISIBLE["N·m"], 0.01 * max(float(np.abs(row.values).max()) for row in rows)):
        arrow = found.torques / longest * 0.46 * limit
        axes.quiver(
            z.real, z.imag, arrow.real, arrow.imag, angles="xy", scale_units="xy", scale=1.0, color=INK, width=0.011,
            headwidth=4.0, headlength=4.5, headaxislength=4.0, zorder=3,
        )  # fmt: skip
        text = f"longest: {_short(longest / _MILLI)} mN·m"
    axes.set_aspect("equal")
    axes.set_xlim(-1.5 * limit, 1.5 * limit)
    axes.set_ylim(-1.5 * limit, 1.5 * limit)
    axes.set_axis_off()
    axes.set_title("torque over the tilt", loc="center")
    axes.text(0.5, -0.1, text, transform=axes.transAxes, ha="center", va="center", color=TICK)


def _short(value: float) -> str:
    places = max(1 - math.floor(math.log10(value)), 0)
    return f"{value:.{places}f}"
