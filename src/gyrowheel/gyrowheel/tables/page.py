"""Page of a suggested column map."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from rich.console import RenderableType
from rich.text import Text

from gyrowheel.show.layout import heading, indented, sentences, words_table
from gyrowheel_core.quantities import short
from gyrowheel_recording.mapping.suggestion import Suggestion


def suggestion_page(
    d: Suggestion, questions: Sequence[str], remarks: Sequence[str]
) -> Iterator[RenderableType]:
    """Yield the columns with their ranges and reasons, then the questions, then the remarks."""
    yield Text.assemble((d.table, "bold cyan"), f"  {d.kind}")
    table = words_table("reading", "column", "range, and reason")
    for own in d.proposals:
        seen = "" if math.isnan(own.lowest) else f"{short(own.lowest)} .. {short(own.highest)}"
        scale = "" if own.scale == 1.0 else f" × {short(own.scale)}"
        why = own.reason.partition("; ")[2] or own.reason
        table.add_row(own.field, own.column, f"{seen}{scale} {own.unit}; {why}".strip())
    yield indented(table)
    if d.unused:
        yield indented(Text(f"not used: {', '.join(d.unused)}", style="dim"))
    if questions:
        yield heading("Questions to answer before a diagnosis")
        yield from sentences(questions)
    if remarks:
        yield heading("Remarks")
        yield from sentences(remarks)
