"""A figure of panels with curves: the form of most pictures of the published test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from gyrowheel.show.figure import FAINT, ZERO, Picture, drawn, headline


@dataclass(frozen=True)
class Curve:
    """One curve."""

    label: str  # in the legend; empty for none
    x: ArrayLike  # points, in the units of the labels
    y: ArrayLike
    colour: str
    error: ArrayLike | None = None  # bars, to both sides
    line: str = "-"  # as matplotlib has it, like `marker`
    marker: str = ""


@dataclass(frozen=True)
class Panel:
    """One panel: its title, what its axes show with units, and its curves."""

    title: str
    x: str
    y: str
    curves: Sequence[Curve]


@drawn()
def curves_figure(title: str, remark: str, panels: Sequence[Panel]) -> Figure:
    """Draw one to three panels side by side, with a headline, a line below it, and the legend above the panels."""
    figure = Picture(12.0 if len(panels) > 1 else 9.0, 4.8, dots=110)
    left = 0.07 if len(panels) > 1 else 0.1
    grid = figure.add_gridspec(1, len(panels), left=left, right=0.98, top=0.70, bottom=0.13, wspace=0.26)
    labels: dict[str, Any] = {}
    for place, panel in enumerate(panels):
        axes = figure.add_subplot(grid[0, place])
        axes.axhline(0.0, color=ZERO, linewidth=0.8, zorder=1)
        for curve in panel.curves:
            handle = axes.errorbar(
                curve.x,
                curve.y,
                curve.error,
                color=curve.colour,
                linestyle=curve.line or "none",
                marker=curve.marker or None,
                markersize=5.5,
                linewidth=1.7,
                capsize=3 if curve.error is not None else 0,
            )
            if curve.label:
                labels.setdefault(curve.label, handle)
        axes.set_title(panel.title)
        axes.set_xlabel(panel.x)
        axes.set_ylabel(panel.y)
        axes.grid(axis="y", color=FAINT, linewidth=0.8)
        axes.set_axisbelow(True)
    headline(figure, title, remark)
    figure.legend(
        list(labels.values()),
        list(labels),
        loc="upper left",
        ncols=5,
        fontsize=10,
        bbox_to_anchor=(0.005, 1.0 - 0.74 / figure.get_figheight()),
        columnspacing=1.4,
    )
    return figure
