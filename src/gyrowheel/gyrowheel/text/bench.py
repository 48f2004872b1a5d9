"""The bench: every parameter with its uncertainty and where it comes from."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.text import Text

from gyrowheel.text.layout import heading, sentences, words_table
from gyrowheel.text.quantities import with_error

if TYPE_CHECKING:
    from gyrowheel_sim.bench import Bench


def bench_page(bench: Bench) -> Iterator[RenderableType]:
    """Yield the bench as a table."""
    yield Text.assemble((bench.name, "bold cyan"), f"  {bench.title}\n")
    table = words_table("parameter", "value", "source", whole=(0, 1))
    for p in bench.parameters.values():
        pure = p.unit == "1"
        table.add_row(
            Text(p.name, style="cyan"), with_error(p.value, p.uncertainty, p.unit, pure=pure), p.source
        )
    yield table
    if bench.references:
        yield heading("Sources")
        yield from sentences(f"{key}: {text}" for key, text in bench.references.items())
