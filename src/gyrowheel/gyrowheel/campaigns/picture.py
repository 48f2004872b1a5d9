"""Picture of a campaign: rates of right answers with their intervals, and coverage of the stated intervals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from gyrowheel.campaigns.summary import LEVELS, Rate, Summary, covered
from gyrowheel.show.figure import AFTER, INK, NOISE, VERMILION, Picture, add_grid, drawn

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@drawn()
def rates_figure(rates: Mapping[str, Rate], summary: Summary) -> Figure:
    """Draw the rate of right answers of each kind of case, and the coverage of the intervals where there are any."""
    given = {
        "coefficients": (summary.intervals, AFTER, "o"),
        "bench parameters": (summary.parameters, VERMILION, "D"),
    }
    shown = {name: own for name, own in given.items() if own[0]}
    figure = Picture(
        11.0, (2.2 if shown else 1.2) + 0.34 * max(len(rates), 4 if shown else 2), layout="constrained"
    )
    panels = figure.subplots(1, 2 if shown else 1, squeeze=False)[0]
    axes, places = panels[0], np.arange(len(rates))[::-1]
    for place, rate in zip(places, rates.values(), strict=True):
        low, high = rate.interval
        axes.plot(
            [100.0 * low, 100.0 * high], [place, place], color=NOISE, linewidth=5, solid_capstyle="butt"
        )
        axes.plot(100.0 * rate.part, place, "o", color=AFTER, markersize=8)
    axes.set_yticks(places, [f"{name} ({rate.count} of {rate.n})" for name, rate in rates.items()])
    axes.set_ylim(-0.7, len(rates) - 0.3)
    axes.set_xlim(-3.0, 103.0)
    axes.set_xlabel("right answers, %; bar: 95 % interval")
    add_grid(axes, "x")
    axes.set_title("Right answers by what was hidden")
    if shown:
        axes, levels = panels[1], np.array(LEVELS)
        axes.plot([45.0, 100.0], [45.0, 100.0], color=INK, linewidth=1.0, linestyle="--", label="as stated")
        # a little apart, so that no bar hides another
        for side, (name, (intervals, colour, marker)) in enumerate(shown.items()):
            found = [covered(intervals, level) for level in LEVELS]
            ends = np.array([rate.interval for rate in found]).T
            parts = np.array([rate.part for rate in found])
            axes.errorbar(
                100.0 * levels + 0.8 * (side - 0.5),
                100.0 * parts,
                100.0 * np.abs(ends - parts),
                color=colour,
                marker=marker,
                linestyle="none",
                capsize=3,
                label=f"{name} ({found[0].n})",
            )
        axes.set_xlabel("interval stated as, %")
        axes.set_ylabel("true value inside, %")
        add_grid(axes)
        axes.set_title("Coverage of the intervals")
        figure.legend(*axes.get_legend_handles_labels(), fontsize=9, loc="outside lower right", ncols=3)
    return figure
