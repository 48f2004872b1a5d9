"""How a replay looks when it is over."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType
from rich.text import Text

from gyrowheel.text.layout import figures_table, heading, sentences
from gyrowheel.text.quantities import decimal
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from gyrowheel_bringup.replay_session import Outcome

_MEASUREMENT = "/gyrowheel/measurement"


def replay_page(outcome: Outcome, duration: float) -> Iterator[RenderableType]:
    """Yield the parts of the result; `duration` is the length of the range [s]."""
    total, samples = sum(outcome.counts.values()), outcome.counts.get(_MEASUREMENT, 0)
    pace = ""
    if outcome.wall > 0.0 and outcome.complete:
        pace = f", {outcome.rounds * duration / outcome.wall:.2f} times real time"
    yield Text(f"{total} messages replayed, {samples} of them samples, in {outcome.wall:.1f} s{pace}")
    yield from sentences(f"{name} left out: {why}" for name, why in outcome.left_out.items())
    settled = [estimate for estimate in outcome.estimates if estimate["settled"]]
    if settled:
        yield heading("Drag estimates")
        yield estimates_table(settled)


def estimates_table(estimates: Sequence[Mapping[str, Any]]) -> RenderableType:
    """Return drag estimates as a table, hold by hold."""
    calibrated = any(math.isfinite(value) for row in estimates for value in row["residual"])
    table = figures_table(
        "hold", "tilt x, y\ndeg", "speed\nrpm", "coils x, y\nmV", "motor\nV", "model x, y\nmN·m", "spin\nmN·m",
        *(("residual x, y\nmN·m", "spin\nmN·m") if calibrated else ()),
    )  # fmt: skip
    for row in estimates:
        x, y, motor = row["dc_voltage"]
        cells = [
            f"{decimal(row['tilt_x'] / DEG, 2)}  {decimal(row['tilt_y'] / DEG, 2)}",
            decimal(row["spin_rate"] / RPM, 0),
            f"{decimal(1e3 * x, 2)}  {decimal(1e3 * y, 2)}",
            decimal(motor, 3),
            *_torques(row["simulated_torque"]),
            *(_torques(row["residual"]) if calibrated else ()),
        ]
        table.add_row(str(row["segment"]), *cells)
    return table


def _torques(values: Sequence[float]) -> tuple[str, str]:
    """Return torques of the coils and of the motor in mN·m."""
    x, y, spin = (decimal(1e3 * value, 3) for value in values)
    return f"{x}  {y}", spin
