"""Picture of a recording: the measured signals over time."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel.show.figure import BLUE, FAINT, PANELS, SOFT, VERMILION, Picture, drawn
from gyrowheel_recording.bags import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_POINTS = 4000  # of a line; more do not show
_LINES = (BLUE, VERMILION)


@drawn(10.0)
def recording_figure(recording: Recording, questions: Sequence[str] = ()) -> Figure:
    """Return a figure of tilt, spin rate, voltages and motor current over time.

    A reading that was never taken has no line; the questions about an imported table are in the title. Of a long
    recording the smallest and the largest value of each interval are drawn, so that no spike is lost.
    """
    figure = Picture(11.0, 8.0, layout="constrained")
    panels = figure.subplots(len(PANELS), 1, sharex=True)
    for axes, (title, unit, fields) in zip(panels, PANELS, strict=True):
        for (name, label), colour in zip(fields.items(), _LINES, strict=False):
            time, values = envelope(recording.time, recording.measurement[name] / unit)
            if not np.isfinite(values).any():
                axes.text(
                    0.5, 0.5, f"{name}: not measured", transform=axes.transAxes, ha="center", color=SOFT
                )
                continue
            axes.plot(time, values, color=colour, linewidth=0.9, label=label)
        axes.set_ylabel(title)
        axes.grid(color=FAINT, linewidth=0.6)
        if len(fields) > 1 and axes.get_legend_handles_labels()[0]:
            # above the panel, where no line runs
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.96), borderaxespad=0.0, ncols=2)
    asked = [line for text in questions[:4] for line in textwrap.wrap(f"? {text}", 130)]
    panels[0].set_title("\n".join([recording.name, *asked]), loc="left" if asked else "center")
    panels[-1].set_xlabel("time, s")
    figure.align_ylabels(panels)
    return figure


def envelope(time: NDArray[np.float64], values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return a line of a limited number of points, with the smallest and the largest value of every interval."""
    if len(values) <= _MOST_POINTS:
        return time, values
    starts = np.arange(0, len(values), -(-2 * len(values) // _MOST_POINTS))
    ends = np.stack([np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)], axis=1)
    return np.repeat(time[starts], 2), ends.ravel()
