"""Actuator torque budget: a table of parts for each direction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from gyrowheel.show.layout import figures_table, heading, indented, sentences
from gyrowheel_analysis.torques import BENCH_PARTS, HoldTorques
from gyrowheel_core.quantities import decimal, short
from gyrowheel_core.units import DEG, RPM

_MOST_COLUMNS = 7  # holds side by side on 80 columns
_LEAST = 5e-7  # N m; a part below this in every hold has no line
_MILLI = 1e3
#: Parts of the bench in words; an effect goes by its name.
PART_TITLES = {
    "flexure_stiffness": "springs",
    "gimbal_inertia": "gimbal",
    "joint_ripple": "joint ripple",
    "flexure_damping": "flexure loss",
    "bearing": "bearing",
    "fixed_torque": "fixed torque",
}
assert PART_TITLES.keys() == BENCH_PARTS.keys()
#: Titles of the directions.
ALONG, ACROSS, MOTOR = "Coils, along the tilt", "Coils, across the tilt (90° ahead)", "Motor"


def directions(d: HoldTorques) -> Any:
    """Return the unit complex numbers (n,) of the directions of the tilts; that of the x axis for an upright rotor."""
    upright = np.abs(d.tilt) < 1e-4
    return np.where(upright, 1.0, d.tilt / np.where(upright, 1.0, np.abs(d.tilt)))


def rows_of(d: HoldTorques, direction: str) -> list[tuple[str, Any]]:
    """Return title and torques (n,) [N m] of every part that shows in a direction, the sum last."""
    turn = np.conj(directions(d))

    def component(coil: Any, motor: Any) -> Any:
        if direction == MOTOR:
            return np.asarray(motor)
        return np.real(coil * turn) if direction == ALONG else np.imag(coil * turn)

    rows = [(PART_TITLES.get(part.name, part.name), component(part.coil, part.motor)) for part in d.parts]
    rows = [(title, values) for title, values in rows if np.abs(values).max(initial=0.0) >= _LEAST]
    rows.append(("all", component(d.coil, d.motor)))
    if d.recordings:
        rows.append(("beyond the model", component(d.remainder_coil, d.remainder_motor)))
    return rows


def torques_page(d: HoldTorques) -> Iterator[RenderableType]:
    """Yield the tables of torques, voltages and margins."""
    every = range(len(d))
    blocks = [every[k : k + _MOST_COLUMNS] for k in range(0, len(d), _MOST_COLUMNS)]
    if d.orbit:
        gone = [
            p.name for p in d.parts if p.effect and max(np.abs(p.coil).max(), np.abs(p.motor).max()) < _LEAST
        ]
        without = f", hence no torque of {', '.join(gone)}" if gone else ""
        yield from sentences([f"In orbit: no air, no weight, no rate of the Earth{without}."])
        yield Text()
    for direction in (ALONG, ACROSS, MOTOR):
        yield heading(f"{direction}, mN·m")
        rows = rows_of(d, direction)
        for block in blocks:
            table = figures_table("tilt, °\nspin, rpm", *(_hold_title(d, k) for k in block))
            for title, values in rows:
                if title == "all":
                    table.add_section()
                table.add_row(title, *(decimal(_MILLI * float(values[k]), 3) for k in block))
            yield indented(table)
            yield Text()
    yield heading("Voltages, and margins to the limits")
    for block in blocks:
        table = figures_table("tilt, °\nspin, rpm", *(_hold_title(d, k) for k in block))
        table.add_row("coil x, V", *_numbers(np.real(d.coil_voltage), block))
        table.add_row("coil y, V", *_numbers(np.imag(d.coil_voltage), block))
        table.add_row("motor, V", *_numbers(d.motor_voltage, block))
        for title, margin in (("coils", d.coil_margin), ("motor", d.motor_margin), ("tilt", d.tilt_margin)):
            table.add_row(f"left, {title}", *(f"{decimal(100.0 * float(margin[k]), 0)} %" for k in block))
        yield indented(table)
        yield Text()


def _numbers(values: Any, block: Sequence[int]) -> list[str]:
    return [decimal(float(values[k]), 3) for k in block]


def _hold_title(d: HoldTorques, k: int) -> str:
    return f"{short(round(float(np.abs(d.tilt[k])) / DEG, 2))}\n{d.spin_rate[k] / RPM:.0f}"
