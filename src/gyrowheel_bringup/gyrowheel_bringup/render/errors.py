"""The table that shows the error of a model falling, beside the noise floor that it cannot pass."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gyrowheel_bringup.render.layout import figures_table
from gyrowheel_bringup.render.quantities import Edge, fixed, torque_edge

if TYPE_CHECKING:
    from gyrowheel_analysis.errors import ErrorRow, ErrorTable

CHANNELS = {"tilt_x": "tilt x", "tilt_y": "tilt y", "spin": "spin"}


def error_table(table: ErrorTable) -> RenderableType:
    """Return the errors before and after, on fitted and unused recordings, with the noise floor."""
    shown = torque_edge(table.noise_floor.rms.values())
    result = figures_table(
        "\nRMS of the residual", *(f"{title}\n{shown.label}" for title in CHANNELS.values()), "χ²/N\n"
    )
    _part(result, "fitted", table.before, table.after, table.noise_floor, shown)
    rows = (table.validation_before, table.validation_after, table.validation_noise_floor)
    if rows[0] is not None and rows[1] is not None:
        result.add_section()
        _part(result, "not used to fit", rows[0], rows[1], rows[2], shown)
        return Group(result, Text(fall(rows[0], rows[1], rows[2], "a recording that was not used to fit")))
    return Group(result, Text(fall(table.before, table.after, table.noise_floor, "the fitted recordings")))


def _part(
    result: Table, title: str, before: ErrorRow, after: ErrorRow, floor: ErrorRow | None, shown: Edge
) -> None:
    for label, row, style in (("before", before, ""), ("after", after, "bold"), ("noise", floor, "dim")):
        if row is not None:
            result.add_row(
                f"{title}, {label}",
                *(fixed(row.rms[name] / shown.size) for name in CHANNELS),
                fixed(row.chi2_per_n) if label != "noise" else "",
                style=style,
            )


def fall(before: ErrorRow, after: ErrorRow, floor: ErrorRow | None, where: str) -> str:
    """Return in a sentence how the error falls, and where it falls most; or rises, where it falls nowhere."""
    text = f"On {where} χ²/N goes from {fixed(before.chi2_per_n)} to {fixed(after.chi2_per_n)}"
    gain = {name: before.rms[name] ** 2 - after.rms[name] ** 2 for name in CHANNELS}
    falls = max(gain.values()) > 0.0
    most = (max if falls else min)(gain, key=lambda name: gain[name])
    shown = torque_edge((floor or after).rms.values())
    was, now = (fixed(row.rms[most] / shown.size) for row in (before, after))
    verb = "falls" if falls else "rises"
    text += f"; {CHANNELS[most]}, where the error {verb} most, from {was} to {now} {shown.label}"
    if floor is not None:
        text += f" (noise {fixed(floor.rms[most] / shown.size)})"
    return f"{text}."
