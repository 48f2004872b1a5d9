"""Measured DC voltages next to simulated torques: a table of holds for each coil and for the motor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from gyrowheel.show.layout import figures_table, heading, sentences
from gyrowheel.show.sentences.residuals import probability
from gyrowheel_analysis.drag.agreement import agreement
from gyrowheel_core.quantities import decimal, listed
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from gyrowheel_analysis.drag.agreement import Agreement
    from gyrowheel_analysis.drag.estimate import Estimate
    from gyrowheel_analysis.drag.stream import DragTest
    from gyrowheel_sim.bench import Bench

_ACTUATORS = ("coil x", "coil y", "motor")
_MILLI = 1e3
#: Standard errors within which a hold agrees with the others.
AGREEING = 3.0
_MOST_HOLDS = 5
#: Part of the error of a hold that is shared from which on a sentence says so.
_MOSTLY = 0.7


def drag_test_page(found: DragTest) -> Iterator[RenderableType]:
    """Yield `drag_page` of every recording."""
    for path, own in zip(found.recordings, found.holds, strict=True):
        if len(found.recordings) > 1:
            yield heading(path)
        yield from drag_page(own, found.bench)


def disagreeing(found: DragTest) -> str:
    """Return in which actuators measured and simulated torque disagree, as what follows their names."""
    names = [
        name
        for place, name in enumerate(_ACTUATORS)
        if not all(own[place].agrees for own in found.agreements)
    ]
    return f"disagree in {listed(names, 'and')}" if names else "agree"


def drag_page(estimates: Sequence[Estimate], bench: Bench | None = None) -> Iterator[RenderableType]:
    """Yield the tables of the settled drag estimates, and a legend of their columns; nothing without any.

    Without a bench, as for estimates from messages, the errors of the holds count as independent.
    """
    settled = [estimate for estimate in estimates if estimate.settled]
    if not settled:
        return
    for place, title in enumerate(_ACTUATORS):
        judged = agreement(settled, place, bench)
        yield heading(f"Drag estimates, {title}")
        yield _table(settled, place, judged)
        yield Text(agreement_sentence(settled, judged, place))
    calibrated = all(estimate.calibrated for estimate in settled)
    constants = (
        "The constants of coils and motor are calibrated."
        if calibrated
        else "The constants of coils and motor are not calibrated: those stated by the bench are used."
    )
    yield from sentences(
        [
            "DC: mean voltage. change: from the reference hold (ref). model: what the model predicts.",
            "diff: measured less simulated torque, in standard errors of one hold, with all that the model states.",
            "apart: the same beyond what all other holds predict: most of the error of a hold is the same in all.",
            constants,
        ]
    )


def agreement_sentence(estimates: Sequence[Estimate], judged: Agreement, place: int) -> str:
    """Return a sentence on whether measured and simulated torque of an actuator agree, all holds together."""
    count = len(estimates)
    about = (
        f"χ² {decimal(judged.chi2, 0)} of {count} hold{'s' * (count > 1)} together, p {probability(judged.p)}"
    )
    if judged.agrees:
        return f"Measured and simulated torque agree: {about}."
    text = f"Measured and simulated torque disagree: {about}."
    total = np.array([e.residual_std[place] for e in estimates])
    if np.median(judged.shared / total) > _MOSTLY:
        text += (
            " Most of the error of a hold is shared with others, so that one hold alone may seem to agree."
        )
    order = np.argsort(-np.abs(judged.apart))
    worst = [str(estimates[k].segment) for k in order if abs(judged.apart[k]) > AGREEING]
    if worst:
        more = f" and {len(worst) - _MOST_HOLDS} more" if len(worst) > _MOST_HOLDS else ""
        some = ", ".join(worst[:_MOST_HOLDS]) if more else listed(worst, "and")
        text += f" Farthest from what the others predict: hold{'s' * (len(worst) > 1)} {some}{more}."
    return text


def _table(estimates: Sequence[Estimate], place: int, judged: Agreement) -> RenderableType:
    """Return the table of one actuator."""
    air = any(np.any(estimate.simulated_air_torque) for estimate in estimates)
    table = figures_table(
        "hold", "tilt x, y\ndeg", "speed\nrpm", "DC\nV", "ref", "change\nmV", "model\nmV", "torque\nmN·m",
        "model\nmN·m", *(["air\nmN·m"] if air else []), "diff\nSE", "apart\nSE",
    )  # fmt: skip
    for e, apart in zip(estimates, judged.apart, strict=True):
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
            decimal(float(e.residual[place] / e.residual_std[place]), 1),
            _distance(float(apart)),
        )
    return table


def _distance(value: float) -> Text:
    return Text(decimal(value, 1), style="bold red" if abs(value) > AGREEING else "green")
