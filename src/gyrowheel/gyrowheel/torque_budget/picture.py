"""Actuator torque budget: the parts stacked over the spin rate or over the tilt."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from gyrowheel.show.figure import (
    BLUE,
    DARK,
    GREEN,
    GROUND,
    INK,
    NOISE,
    ORANGE,
    PINK,
    SKY,
    SOFT,
    VERMILION,
    ZERO,
    Picture,
    drawn,
    shared_legend,
)
from gyrowheel.torque_budget.page import ACROSS, ALONG, MOTOR, rows_of
from gyrowheel_analysis.torques import HoldTorques
from gyrowheel_core.quantities import short
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, SKY, PINK, NOISE, "#F0E442", DARK)
_HATCHES = ("", "///", "...")  # neighbours differ in grey
_MILLI = 1e3
_MOST_LEVEL, _MOST_NAMES = 7, 24  # names of holds that find room side by side, level and upright
_LINE = ("all", "beyond the model")


@drawn()
def figure_of_torques(d: HoldTorques) -> Figure:
    """Draw the torques of all holds, 1500 by 600 dots: parts stacked, their sum as a line.

    The horizontal axis is what varies: the spin rate, else the tilt magnitude, else the number of the hold.
    """
    figure = Picture(15.0, 6.0)
    rpm, tilt = d.spin_rate / RPM, np.abs(d.tilt) / DEG
    if len(d) > 1 and np.ptp(rpm) > 1.0 and np.ptp(tilt) < 0.05:
        names, label = [f"{value:.0f}" for value in rpm], "spin rate, rpm"
        where = f"tilt {short(float(tilt[0]))}°"
    elif len(d) > 1 and np.ptp(rpm) <= 1.0 and np.all(np.diff(tilt) > 0.0):
        names, label = [short(float(value)) for value in tilt], "tilt, °"
        where = f"{rpm[0]:.0f} rpm"
    else:
        apart = "\n" if len(d) <= _MOST_LEVEL else ", "
        names = [f"{short(round(float(t), 2))}{apart}{w:.0f}" for t, w in zip(tilt, rpm, strict=True)]
        label, where = "tilt in °, spin rate in rpm", f"{len(d)} holds"
    source = ", ".join(d.recordings) or d.model
    figure.text(0.03, 0.955, "Actuator torque budget", fontsize=18, fontweight="bold", color=INK, va="center")
    figure.text(0.03, 0.905, f"{where}; {source}", fontsize=11, color=SOFT, va="center")
    styles: dict[str, tuple[str, str]] = {}
    bottom = 0.12 if len(d) <= _MOST_LEVEL else 0.2
    axes = [figure.add_axes((0.065 + 0.28 * k, bottom, 0.21, 0.80 - bottom)) for k in range(3)]
    for ax, direction in zip(axes, (ALONG, ACROSS, MOTOR), strict=True):
        _stack(ax, rows_of(d, direction), styles)
        ax.set_title(direction)
        ax.set_ylabel("torque, mN·m")
        # many names stand upright, and of very many some are left out
        every = -(-len(d) // _MOST_NAMES)
        ax.set_xticks(range(0, len(d), every), names[::every])
        level = len(d) <= _MOST_LEVEL
        ax.tick_params(axis="x", labelsize=10 if level else 9, rotation=0 if level else 90)
        ax.set_xlabel(label)
    shared_legend(figure, axes, loc="upper left", bbox_to_anchor=(0.855, 0.82), fontsize=10)
    return figure


def _stack(ax: Axes, rows: list[tuple[str, Any]], styles: dict[str, tuple[str, str]]) -> None:
    places = np.arange(len(rows[0][1]))
    above, below = np.zeros(len(places)), np.zeros(len(places))
    ax.axhline(0.0, color=ZERO, lw=0.8, zorder=1)
    for title, values in rows:
        torque = _MILLI * np.asarray(values)
        if title in _LINE:
            marker, colour = ("D", INK) if title == "all" else ("x", VERMILION)
            ax.plot(
                places,
                torque,
                color=colour,
                marker=marker,
                ms=5,
                lw=1.4,
                label=title,
                zorder=4,
                clip_on=False,
            )
            continue
        number = len(styles)
        colour, hatch = styles.setdefault(
            title,
            (
                _COLOURS[number % len(_COLOURS)],
                _HATCHES[(number % 2 + number // len(_COLOURS)) % len(_HATCHES)],
            ),
        )
        start = np.where(torque >= 0.0, above, below)
        ax.bar(
            places,
            torque,
            0.7,
            bottom=start,
            color=colour,
            hatch=hatch,
            lw=0,
            edgecolor=GROUND,
            label=title,
            zorder=2,
        )
        above, below = above + np.maximum(torque, 0.0), below + np.minimum(torque, 0.0)
