"""A calibration: the constants before and after."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from gyrowheel.show.layout import figures_table, heading, indented, sentences
from gyrowheel.show.sentences.proof import calibration_notes
from gyrowheel_analysis.calibrate import Calibration
from gyrowheel_core.quantities import decimal, pair, short
from gyrowheel_core.units import unit_for

_FAR = 3.0  # stated uncertainties


def calibration_page(result: Calibration) -> Iterator[RenderableType]:
    """Yield the constants before and after, and what limits them."""
    yield heading("Constants")
    yield indented(_table(result))
    yield Text()
    yield from sentences(_remarks(result))


def written() -> Iterator[RenderableType]:
    """Yield where the constants went."""
    yield heading("Written into the model file")
    yield from sentences(
        ["as overrides with their standard errors; gyrowheel model undo restores the old values"]
    )


def _table(result: Calibration) -> Table:
    table = figures_table("", "", "before", "after", "change")
    table.columns[1].justify = "left"
    for c in result.constants.values():
        unit = unit_for(1.0, c.unit)
        before, after = (
            pair(value.value / unit.size, value.standard_error / unit.size) for value in (c.before, c.after)
        )
        far = abs(c.after.value - c.stated.value) > _FAR * c.stated.standard_error
        change = f"{decimal(100.0 * (c.after.value / c.before.value - 1.0), 2, sign=True)} %"
        table.add_row(
            c.name, unit.label, before, Text(after, style="bold"), Text(change, style="yellow" if far else "")
        )
    return table


def _remarks(result: Calibration) -> Iterator[str]:
    for c in result.constants.values():
        relative = 100.0 * c.after.standard_error / c.after.value
        distance = abs(c.after.value - c.stated.value) / c.stated.standard_error
        text = (
            f"{c.name}: known to {short(relative, 2)} %, "
            f"{short(distance, 2)} stated uncertainties from the stated value"
        )
        if c.limited_by:
            text += f"; limited by the uncertainty of {c.limited_by}"
        yield text
    for name, reason in result.undetermined.items():
        yield f"{name}: not determined: {reason}"
    yield from calibration_notes(result)
