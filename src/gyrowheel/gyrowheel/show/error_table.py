"""The error table: errors before and after a change, next to the noise floor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from gyrowheel.show.layout import figures_table
from gyrowheel.show.quantities import fixed
from gyrowheel_analysis.channels import LISTED, TORQUES
from gyrowheel_core.units import Unit, column_unit

if TYPE_CHECKING:
    from gyrowheel_analysis.residuals.error_table import ErrorRow, ErrorTable

_MILLIVOLT = Unit("mV", 1e-3)


def unit_of(noise: Mapping[str, float]) -> dict[str, Unit]:
    """Return the unit in which each channel is shown, given its noise [SI]; the averaged torques share one."""
    averages = column_unit(
        [value for name, value in noise.items() if _unit(name) == "N·m" and _average(name)], "N·m"
    )
    return {
        name: _MILLIVOLT
        if _unit(name) == "V"
        else averages
        if _average(name)
        else column_unit([value], _unit(name))
        for name, value in noise.items()
    }


def units_of(table: ErrorTable) -> dict[str, Unit]:
    """Return the unit of each channel on a page with this table: in the table and in every sentence."""
    floor = table.noise_floor
    return unit_of({name: floor.rms_of(name) for name in LISTED if name in floor})


def _unit(name: str) -> str:
    return LISTED[name].unit if name in LISTED else "N·m"


def _average(name: str) -> bool:
    return name in (*TORQUES, "tilt")


def error_table(table: ErrorTable) -> RenderableType:
    """Return errors before and after and the noise floor, by channel, for fitted and validation recordings."""
    parts = [("fitted", table.before, table.after, table.noise_floor)]
    if table.validation_before is not None and table.validation_after is not None:
        floor = table.validation_noise_floor or table.noise_floor
        parts.append(("validation", table.validation_before, table.validation_after, floor))
    titles = [f"{part[0] if not k else ''}\n{what}" for part in parts for k, what in enumerate(_COLUMNS)]
    result = figures_table("RMS of the\nresidual", "\nunit", *titles)
    result.columns[1].justify = "left"
    channels = [name for name in LISTED if all(name in row for part in parts for row in part[1:])]
    shown = units_of(table)
    for name in channels:
        cells: list[str | Text] = []
        for _, before, after, floor in parts:
            sizes = [row.rms_of(name) for row in (before, after, floor)]
            style = "green" if after.is_noise(name, floor) else "bold red"
            texts = [fixed(size / shown[name].size) for size in sizes]
            cells += [texts[0], Text(texts[1], style=style), Text(texts[2], style="dim")]
        result.add_row(LISTED[name].title, Text(shown[name].label, style="dim"), *cells)
    result.add_section()
    chi2 = [
        cell
        for _, before, after, _floor in parts
        for cell in (
            fixed(before.chi2_per_n),
            Text(fixed(after.chi2_per_n), style="bold"),
            Text("1", style="dim"),
        )
    ]
    result.add_row("χ²/N", "", *chi2)
    where = "the validation recordings" if len(parts) == 2 else "the fitted recordings"
    return Group(result, Text(fall(*parts[-1][1:], where, shown)))


_COLUMNS = ("before", "after", "noise")


def fall(
    before: ErrorRow,
    after: ErrorRow,
    floor: ErrorRow | None,
    where: str,
    units: Mapping[str, Unit] | None = None,
) -> str:
    """Return in a sentence how the error falls, and where it falls most; or rises, where it falls nowhere.

    The units are those of the page (`units_of`); without them each channel has that of its noise.
    """
    text = f"On {where}, χ²/N goes from {fixed(before.chi2_per_n)} to {fixed(after.chi2_per_n)}"
    if before == after:
        return f"On {where}, χ²/N is {fixed(after.chi2_per_n)} (1: nothing but noise)."
    names = [name for name in LISTED if name in before and name in after]
    # errors of several units are compared in noise floors
    level = {name: floor.rms_of(name) if floor is not None and name in floor else 1.0 for name in names}
    gain = {
        name: (before.rms_of(name) ** 2 - after.rms_of(name) ** 2) / (level[name] ** 2 or 1.0)
        for name in names
    }
    falls = after.chi2_per_n < before.chi2_per_n
    most = (max if falls else min)(gain, key=lambda name: gain[name])
    if (gain[most] > 0.0) != falls:
        return f"{text}."  # the channel with the largest change contradicts the sum of all channels
    shown = (units or unit_of({name: (floor or after).rms_of(name) for name in names}))[most]
    was, now = (fixed(row.rms_of(most) / shown.size) for row in (before, after))
    verb = "falls" if falls else "rises"
    text += f"; {LISTED[most].title}, where the error {verb} most, from {was} to {now} {shown.label}"
    if floor is not None:
        text += f" (noise {fixed(floor.rms_of(most) / shown.size)})"
    return f"{text}."
