"""Picture of a drag test: filtered voltages over time, and their increments over tilt and speed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from gyrowheel.show.figure import BLUE, INK, NOISE, SOFT, VERMILION, ZERO, Picture, add_grid, drawn
from gyrowheel_analysis.drag.estimate import Estimate
from gyrowheel_analysis.drag.stream import DragTest
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ACTUATORS = (
    ("coil x", "notched_coil_voltage_x"),
    ("coil y", "notched_coil_voltage_y"),
    ("motor", "notched_motor_voltage"),
)
_MILLI = 1e3
_GAP = 2.0  # s between two recordings
_MOST_POINTS = 6000
_ONE_SPEED = 50.0  # rpm; speeds no further apart are one
_STRAIGHT = 0.1 * DEG  # tilts no further from a line lie on it


@drawn(10.0)
def figure_of_drag(result: DragTest) -> Figure:
    """Draw measured and simulated voltages, 1500 by 1000 dots: a row each for coil x, coil y and motor.

    Left: the notch-filtered voltage over time with the means of the holds. Middle: the increments from the reference
    holds over tilt, next to those simulated with and without the air of the model. Right: the differences over speed,
    with their standard errors, which are too small to be seen next to the increments.
    """
    figure = Picture(15.0, 10.0)
    every = result.estimates
    air = any(np.any(e.simulated_air_torque) for e in every)
    title = "DC voltages, measured and simulated"
    figure.text(0.03, 0.965, title, fontsize=18, fontweight="bold", color=INK, va="center")
    constants = "calibrated" if all(e.calibrated for e in every) else "stated, not calibrated"
    about = f"{', '.join(result.recordings)}; constants {constants}{'' if air else '; the model has no air'}"
    figure.text(0.03, 0.93, about, fontsize=11, color=SOFT, va="center")
    edges = {"left": 0.06, "right": 0.98, "top": 0.84, "bottom": 0.07, "wspace": 0.24, "hspace": 0.32}
    grid = figure.subplots(3, 3, width_ratios=(1.5, 1.0, 1.0), gridspec_kw=edges)
    tilt, tilt_label = tilts(every)
    speed = np.array([e.spin_rate for e in every]) / RPM
    for place, (name, signal) in enumerate(_ACTUATORS):
        over_time, over_tilt, over_speed = grid[place]
        _over_time(over_time, result, place, signal)
        over_time.set_title(name)
        over_time.set_ylabel("voltage, V")
        _increments(over_tilt, result, place, tilt, air=air)
        over_tilt.set_ylabel("increment, mV")
        _differences(over_speed, result, place, speed)
        over_speed.set_ylabel("measured less simulated, mV")
        if np.ptp(speed) < _ONE_SPEED:
            over_speed.set_xlim(speed.mean() - _ONE_SPEED, speed.mean() + _ONE_SPEED)
    for axes, label in zip(grid[2], ("time, s", tilt_label, "spin rate, rpm"), strict=True):
        axes.set_xlabel(label)
    handles, labels = grid[0][0].get_legend_handles_labels()
    more = grid[0][1].get_legend_handles_labels()
    figure.legend(
        [*handles, *more[0]], [*labels, *more[1]], loc="upper left", bbox_to_anchor=(0.05, 0.915), ncols=5
    )
    return figure


def _over_time(axes: Axes, result: DragTest, place: int, signal: str) -> None:
    begin = 0.0
    for number, (own, signals) in enumerate(zip(result.holds, result.signals, strict=True)):
        time = begin + signals["stamp"] - signals["stamp"][0]
        step = max(len(time) // _MOST_POINTS, 1)
        label = "" if number else "notch-filtered voltage"
        axes.plot(time[::step], signals[signal][::step], color=NOISE, lw=0.7, label=label, zorder=1)
        for k, e in enumerate(own):
            stop = begin + e.stamp_ns * 1e-9 - signals["stamp"][0]
            label = "" if number or k else "mean of a hold"
            ends = [stop - e.duration, stop]
            axes.plot(ends, [e.dc_voltage[place]] * 2, color=BLUE, lw=2.4, label=label, zorder=2)
        begin = float(time[-1]) + _GAP
    add_grid(axes)


def _increments(axes: Axes, result: DragTest, place: int, where: Any, *, air: bool) -> None:
    every = result.estimates
    measured = _MILLI * np.array([e.voltage_increment[place] for e in every])
    error = _MILLI * np.array([e.voltage_increment_std[place] for e in every])
    simulated = _MILLI * np.array([e.simulated_voltage_increment[place] for e in every])
    axes.axhline(0.0, color=ZERO, lw=0.8, zorder=1)
    axes.errorbar(
        where, measured, error, fmt="o", color=BLUE, ms=5, capsize=2, lw=1.0, label="increment measured"
    )
    axes.plot(where, simulated, "x", color=VERMILION, ms=8, mew=1.5, label="simulated", zorder=3)
    if air:
        without = simulated - _MILLI * air_increments(result, place)
        axes.plot(where, without, "s", mfc="none", mec=INK, ms=8, label="simulated without air", zorder=2)
    add_grid(axes)
    axes.margins(x=0.06, y=0.12)


def _differences(axes: Axes, result: DragTest, place: int, where: Any) -> None:
    every = result.estimates
    left = [float(e.voltage_increment[place] - e.simulated_voltage_increment[place]) for e in every]
    error = _MILLI * np.array([e.voltage_increment_std[place] for e in every])
    axes.axhline(0.0, color=ZERO, lw=0.8, zorder=1)
    axes.errorbar(where, _MILLI * np.array(left), error, fmt="o", color=BLUE, ms=4, capsize=3, lw=1.2)
    add_grid(axes)
    axes.margins(x=0.06, y=0.12)


def air_increments(result: DragTest, place: int) -> Any:
    """Return the share of the model's air in the voltage increments of an actuator (n,) [V]."""
    value = result.bench.value
    volts = 1.0 / value("coil_constant") if place < 2 else value("motor_resistance") / value("motor_constant")
    found = []
    for own in result.holds:
        torque = {e.segment: float(e.simulated_air_torque[place]) for e in own}
        found += [
            volts * (torque[e.segment] - torque.get(e.reference_segment, torque[e.segment])) for e in own
        ]
    return np.array(found)


def tilts(estimates: Sequence[Estimate]) -> tuple[Any, str]:
    """Return tilts in degrees and their title: along the line on which all lie, else magnitudes."""
    tilt = np.array([[e.tilt_x, e.tilt_y] for e in estimates])
    directions = np.linalg.svd(tilt)[2]
    if np.abs(tilt @ directions[1]).max() > _STRAIGHT:
        return np.hypot(*tilt.T) / DEG, "tilt magnitude, °"
    along = directions[0] * np.sign(directions[0][np.argmax(np.abs(directions[0]))])
    return tilt @ along / DEG, "tilt, °"
