"""A figure of panels with curves: the form of most pictures of the published test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from gyrowheel.show.figure import Picture, finished, headline
from gyrowheel.show.style import FAINT, ZERO, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Curve:
    """One curve.

    Attributes
    ----------
    label : str
        What the legend says; empty for none.
    x, y : array_like
        Points, in the units of the labels.
    colour : str
        Colour.
    error : array_like, optional
        Bars, to both sides.
    line, marker : str
        As matplotlib has them.
    """

    label: str
    x: ArrayLike
    y: ArrayLike
    colour: str
    error: ArrayLike | None = None
    line: str = "-"
    marker: str = ""


@dataclass(frozen=True)
class Panel:
    """One panel: its title, what its axes show with units, and its curves."""

    title: str
    x: str
    y: str
    curves: Sequence[Curve]


def curves_figure(title: str, remark: str, panels: Sequence[Panel]) -> Figure:
    """Draw panels side by side, the legend above them.

    Parameters
    ----------
    title, remark : str
        Headline, and a line below it.
    panels : sequence of Panel
        One to three panels.
    """
    with style():
        return finished(_draw(title, remark, panels))


def _draw(title: str, remark: str, panels: Sequence[Panel]) -> Figure:
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
