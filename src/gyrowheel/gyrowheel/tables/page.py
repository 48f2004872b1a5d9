"""A map that is suggested for a table, as a page of the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from gyrowheel.show.layout import heading, sentences, words_table
from gyrowheel_core.quantities import short

if TYPE_CHECKING:
    from gyrowheel.tables.table_map import TableMap

_INDENT = (0, 0, 0, 2)


def suggestion_page(result: TableMap) -> Iterator[RenderableType]:
    """Yield the columns with their ranges and reasons, then what is doubtful, then what is missing."""
    d = result.details
    yield Text.assemble((d.table, "bold cyan"), f"  {d.kind}")
    table = words_table("reading", "column", "range, and why it is taken so")
    for own in d.proposals:
        seen = "" if math.isnan(own.lowest) else f"{short(own.lowest)} .. {short(own.highest)}"
        scale = "" if own.scale == 1.0 else f" × {short(own.scale)}"
        why = own.reason.partition("; ")[2] or own.reason
        table.add_row(own.field, own.column, f"{seen}{scale} {own.unit}; {why}".strip())
    yield Padding(table, _INDENT)
    if d.unused:
        yield Padding(Text(f"not used: {', '.join(d.unused)}", style="dim"), _INDENT)
    if result.questions:
        yield heading("To be answered before anything is diagnosed")
        yield from sentences(result.questions)
    if result.remarks:
        yield heading("Good to know")
        yield from sentences(result.remarks)
