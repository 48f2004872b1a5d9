"""A batch of diagnoses in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from gyrowheel.show.layout import heading, indented, sentences, words_table

if TYPE_CHECKING:
    from rich.console import RenderableType

_VERDICTS = {
    "nothing_missing": "nothing is missing",
    "effect": "an effect is missing",
    "ambiguous": "an effect is missing, a tie is open",
    "unknown": "unknown",
    "insufficient_data": "insufficient data",
    "failed": "failed",
}


def batch_page(rows: Sequence[Mapping[str, Any]]) -> Iterator[RenderableType]:
    """Yield the verdicts with the effects that were found, and the recordings that failed."""
    counts = Counter((row["verdict"], row["effects"] or "", row.get("proven") is False) for row in rows)
    table = words_table("verdict", "effects", "recordings", whole=(0,))
    table.columns[2].justify = "right"
    order = list(_VERDICTS)
    for (verdict, effects, doubtful), count in sorted(
        counts.items(), key=lambda own: (order.index(own[0][0]), -own[1])
    ):
        words = _VERDICTS[verdict]
        if doubtful and effects:
            words = f"{words.replace(' is missing', ' may be missing')}, not proven"
        table.add_row(words, effects, str(count))
    yield indented(table)
    failures = [f"{row['recording']}: {row['error']}" for row in rows if row["error"]]
    if failures:
        yield heading("Failed")
        yield from sentences(failures)
