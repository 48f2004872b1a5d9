"""Tables of the angular momentum that a wheel can reach."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from gyrowheel.show.layout import figures_table, heading, indented
from gyrowheel_core.quantities import fixed, short
from gyrowheel_core.units import DEG, RPM, unit_for
from gyrowheel_sim.mechanics.kinematics import Envelope

_DIGITS = 4


def momentum_page(d: Envelope) -> Iterator[RenderableType]:
    """Yield the momenta at every spin rate, and the error of eq (1) at every tilt."""
    unit = unit_for(d.along[1], "N·m·s")
    limit = f"{short(d.tilt[-1] / DEG)}°"
    yield Text.assemble((d.bench.name, "bold cyan"), f"  {d.bench.title}")
    yield heading(f"Momentum in {unit.label}, eqs (1) and (2)")
    table = figures_table(
        "spin, rpm", "upright", f"{limit}, along\ncase axis", "across\nit", "exact, within\na revolution"
    )
    for s, speed in enumerate(d.speed):
        x, y, along = d.approximate[s, -1, 0]
        values = (d.approximate[s, 0, 0, 2], along, np.hypot(x, y), d.smallest[s, -1, 0], d.largest[s, -1, 0])
        upright, axial, across, low, high = (fixed(float(value) / unit.size, _DIGITS) for value in values)
        table.add_row(f"{speed / RPM:.0f}", upright, axial, across, f"{low} .. {high}")
    yield indented(table)
    yield heading("Largest error of eq (1) within a revolution, % of the exact momentum")
    errors = figures_table("tilt, °", "last form", "middle expression")
    for tilt, last, middle in zip(d.tilt, d.error_last, d.error_middle, strict=True):
        if tilt > 0.0:
            errors.add_row(short(tilt / DEG), *(fixed(100.0 * float(value), 2) for value in (last, middle)))
    yield indented(errors)
