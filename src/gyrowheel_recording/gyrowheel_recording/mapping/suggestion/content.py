"""The map file that goes with what the columns of a table seem to be."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from gyrowheel_recording.mapping.column_names import COIL_CURRENT, SEQUENCE, TIME
from gyrowheel_recording.mapping.fields import READINGS
from gyrowheel_recording.mapping.map_file import SCHEMA
from gyrowheel_recording.mapping.offset import clock_offset
from gyrowheel_recording.mapping.suggestion.records import Problem, Proposal
from gyrowheel_recording.mapping.suggestion.sizes import holes, in_si
from gyrowheel_recording.mapping.suggestion.suspicious import sentinel, words_for_nothing
from gyrowheel_recording.tables import Grid, TextForm
from gyrowheel_sim.bench import Bench

#: Readings that change so slowly that no offset between two clocks counts.
_SLOW = ("coil_temperature", "air_temperature", "air_pressure")


def map_content(
    found: Mapping[str, Proposal],
    grid: Grid,
    form: TextForm | None,
    bench_name: str,
    bench: Bench,
    problems: list[Problem],
) -> dict[str, Any]:
    """Return the content of the map file."""
    content: dict[str, Any] = {"schema": SCHEMA}
    if bench_name:
        content["bench"] = bench_name
    if TIME in found:
        content["time"] = {"column": found[TIME].column, "unit": found[TIME].unit}
    if SEQUENCE in found:
        content["sequence"] = {"column": found[SEQUENCE].column}
    nothing = {name: sentinel(own, grid.columns[own.column]) for name, own in found.items()}
    gone = [
        name
        for name, own in found.items()
        if own.field in READINGS and (holes(grid.columns[own.column]) or not math.isnan(nothing[name]))
    ]
    if gone:
        content["missing"] = "keep"
    columns: dict[str, Any] = {}
    for name in READINGS:
        own = found.get(name)
        if own is None and name.startswith("coil_voltage"):
            own = found.get(name.replace("voltage", "current"))
        if own is None:
            continue
        entry: dict[str, Any] = {"column": own.column} | ({"unit": own.unit} if own.unit else {})
        if own.pulses:
            entry["pulses"] = own.pulses
        if own.scale != 1.0:
            entry["scale"] = own.scale
        if own.clock:
            entry["clock"] = own.clock
        if not math.isnan(nothing[own.field]):
            entry["missing"] = nothing[own.field]
        if own.field in COIL_CURRENT:
            entry["resistance"] = _resistance(found, grid, bench)
        columns[name] = entry
    content["columns"] = columns
    if form is not None:
        usual = TextForm()
        keys = ("delimiter", "decimal", "skip_lines", "unit_lines", "comment", "encoding")
        other = {key: getattr(form, key) for key in keys if getattr(form, key) != getattr(usual, key)}
        if words := words_for_nothing(found, grid):
            other["missing"] = words
        if other:
            content["csv"] = other
    for clock in sorted({own.clock for own in found.values() if own.clock}):
        late = clock_offset(found, grid, clock, bench)
        if late is None:
            if fast := [
                own.column for own in found.values() if own.clock == clock and own.field not in _SLOW
            ]:
                problems.append(
                    Problem(
                        f"the clock '{clock}' of {', '.join(fast)} shows nothing that '{found[TIME].column}' shows "
                        "too: what lies between the two is not known.",
                        f"Put what is to be added to its times into the map, 0 for none: clocks: {{{clock}: 0.0}}.",
                        asks=True,
                    )
                )
            continue
        offset, error = late
        if abs(offset) > 3.0 * error:
            content.setdefault("clocks", {})[clock] = round(offset, 6)
            problems.append(
                Problem(
                    f"the clock '{clock}' is {1e3 * -offset:.4g} ± {1e3 * error:.2g} ms ahead of that of "
                    f"'{found[TIME].column}', by the correlation of what both show.",
                    f"The map adds {1e3 * offset:.4g} ms to it (`clocks:`).",
                    asks=False,
                )
            )
    return content


def _resistance(found: Mapping[str, Proposal], grid: Grid, bench: Bench) -> float:
    """Return the resistance by which the currents of the coils are their voltages [ohm]: that holds up the flexures."""
    tilts, currents = [], []
    for axis in "xy":
        tilt, current = found.get(f"tilt_{axis}"), found.get(f"coil_current_{axis}")
        if tilt is None or current is None or tilt.clock or current.clock:
            continue
        tilts.append(in_si(tilt, grid, "rad"))
        currents.append(in_si(current, grid, "A"))
    if not tilts:
        return 1.0
    x, y = np.concatenate(tilts), np.concatenate(currents)
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known] - x[known].mean(), y[known] - y[known].mean()
    per_rad = float(x @ y) / float(x @ x) if float(x @ x) else 0.0
    stiff = 0.5 * (bench.value("flexure_stiffness_x") + bench.value("flexure_stiffness_y"))
    volts = stiff / bench.value("coil_constant")
    return float(f"{abs(volts / per_rad):.3g}") if per_rad else 1.0
