"""Measured DC voltages next to simulated torques: a table of holds for each coil and for the motor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from gyrowheel.show.layout import figures_table, heading, sentences
from gyrowheel_core.quantities import decimal, listed
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from gyrowheel_analysis.drag.estimate import Estimate
    from gyrowheel_analysis.drag.stream import DragTest

_ACTUATORS = ("coil x", "coil y", "motor")
_MILLI = 1e3
#: Standard errors within which two torques agree.
AGREEING = 3.0


def drag_test_page(found: DragTest) -> Iterator[RenderableType]:
    """Yield `drag_page` of every recording."""
    for path, own in zip(found.recordings, found.holds, strict=True):
        if len(found.recordings) > 1:
            yield heading(path)
        yield from drag_page(own)


def drag_page(estimates: Sequence[Estimate]) -> Iterator[RenderableType]:
    """Yield the tables of the settled drag estimates, and a legend of their columns; nothing without any."""
    settled = [estimate for estimate in estimates if estimate.settled]
    if not settled:
        return
    for place, title in enumerate(_ACTUATORS):
        yield heading(f"Drag estimates, {title}")
        yield _table(settled, place)
        yield Text(agreement(settled, place))
    calibrated = all(estimate.calibrated for estimate in settled)
    constants = (
        "The constants of coils and motor are calibrated."
        if calibrated
        else "The constants of coils and motor are not calibrated: those stated by the bench are used."
    )
    yield from sentences(
        [
            "DC: mean voltage. change: from the reference hold (ref). model: what the model predicts.",
            "diff: measured less simulated torque, in standard errors (of noise, and of all that the model states).",
            constants,
        ]
    )


def agreement(estimates: Sequence[Estimate], place: int) -> str:
    """Return a sentence about the holds in which measured and simulated torque of an actuator agree or disagree."""
    apart = [str(e.segment) for e in estimates if abs(e.residual[place]) > AGREEING * e.residual_std[place]]
    text = f"Measured and simulated torque agree within {AGREEING:g} SE"
    if not apart:
        return f"{text} in all holds."
    holds = f"hold{'s' if len(apart) > 1 else ''} {listed(apart, 'and')}"
    return f"{text} in {len(estimates) - len(apart)} of {len(estimates)} holds; they disagree in {holds}."


def _table(estimates: Sequence[Estimate], place: int) -> RenderableType:
    """Return the table of one actuator."""
    air = any(np.any(estimate.simulated_air_torque) for estimate in estimates)
    table = figures_table(
        "hold", "tilt x, y\ndeg", "speed\nrpm", "DC\nV", "ref", "change\nmV", "model\nmV", "torque\nmN·m",
        "model\nmN·m", *(["air\nmN·m"] if air else []), "diff\nSE",
    )  # fmt: skip
    for e in estimates:
        table.add_row(
            str(e.segment),
            f"{decimal(e.tilt_x / DEG, 2)} {decimal(e.tilt_y / DEG, 2)}",
            decimal(e.spin_rate / RPM, 0),
            decimal(float(e.dc_voltage[place]), 3),
            str(e.reference_segment),
            decimal(_MILLI * float(e.voltage_increment[place]), 1),
            decimal(_MILLI * float(e.simulated_voltage_increment[place]), 1),
            decimal(_MILLI * float(e.measured_torque[place]), 3),
            decimal(_MILLI * float(e.simulated_torque[place]), 3),
            *([decimal(_MILLI * float(e.simulated_air_torque[place]), 3)] if air else []),
            _distance(float(e.residual[place] / e.residual_std[place])),
        )
    return table


def _distance(value: float) -> Text:
    return Text(decimal(value, 1), style="bold red" if abs(value) > AGREEING else "green")
