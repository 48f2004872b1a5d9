"""The error table: errors before and after a change, next to the noise floor."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

from rich.console import Group, RenderableType
from rich.text import Text

from gyrowheel.show.layout import figures_table
from gyrowheel_analysis.channels import LISTED, TORQUES
from gyrowheel_core.quantities import fixed
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


class _Part(NamedTuple):
    """The errors on the fitted or on the validation recordings."""

    title: str
    before: ErrorRow
    after: ErrorRow
    floor: ErrorRow


class _Column(NamedTuple):
    """A column of each part: its head, its cell of a channel (in the size of a unit), and its cell of all channels."""

    head: str
    of_channel: Callable[[_Part, str, float], Text]
    of_all: Callable[[_Part], Text]


def _after(part: _Part, name: str, size: float) -> Text:
    style = "green" if part.after.is_noise(name, part.floor) else "bold red"
    return Text(fixed(part.after.rms_of(name) / size), style=style)


_COLUMNS = (
    _Column(
        "before",
        lambda part, name, size: Text(fixed(part.before.rms_of(name) / size)),
        lambda part: Text(fixed(part.before.chi2_per_n)),
    ),
    _Column("after", _after, lambda part: Text(fixed(part.after.chi2_per_n), style="bold")),
    _Column(
        "noise",
        lambda part, name, size: Text(fixed(part.floor.rms_of(name) / size), style="dim"),
        lambda part: Text("1", style="dim"),
    ),
)


def error_table(table: ErrorTable) -> RenderableType:
    """Return errors before and after and the noise floor, by channel, for fitted and validation recordings."""
    parts = [_Part("fitted", table.before, table.after, table.noise_floor)]
    if table.validation_before is not None and table.validation_after is not None:
        floor = table.validation_noise_floor or table.noise_floor
        parts.append(_Part("validation", table.validation_before, table.validation_after, floor))
    heads = [
        f"{'' if k else part.title}\n{column.head}" for part in parts for k, column in enumerate(_COLUMNS)
    ]
    result = figures_table("RMS of the\nresidual", "\nunit", *heads)
    result.columns[1].justify = "left"
    shown = units_of(table)
    for name in LISTED:
        if all(name in row for part in parts for row in part[1:]):
            unit = shown[name]
            cells = [column.of_channel(part, name, unit.size) for part in parts for column in _COLUMNS]
            result.add_row(LISTED[name].title, Text(unit.label, style="dim"), *cells)
    result.add_section()
    result.add_row("χ²/N", "", *(column.of_all(part) for part in parts for column in _COLUMNS))
    where = "the validation recordings" if len(parts) == 2 else "the fitted recordings"
    return Group(result, Text(fall(*parts[-1][1:], where, shown)))


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
