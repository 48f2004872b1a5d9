"""A key that was opened: what was hidden, beside what a model has."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.padding import Padding
from rich.panel import Panel
from rich.text import Text

from gyrowheel.show.layout import heading, words_table
from gyrowheel.show.quantities import decimal, quantity, with_error

if TYPE_CHECKING:
    from gyrowheel.blind_tests.key import Key, Quantity

_INDENT = (0, 0, 0, 2)
_COLOURS = {
    None: "cyan",
    "right": "green",
    "inaccurate": "yellow",
    "described": "yellow",
    "incomplete": "yellow",
    "wrong": "red",
}


def key_page(key: Key) -> Iterator[RenderableType]:
    """Yield what was hidden, and the judgement of the model if there is one."""
    yield Panel(Text(key.sentence, style="bold"), border_style=_COLOURS[key.outcome], expand=False)
    against = key.model is not None
    if key.effects:
        yield heading("Effects")
        table = words_table("", "", "hidden", *(("model", "distance") if against else ()), whole=(0, 1, 2))
        last = ""
        for q in key.effects:
            first = Text("" if q.owner == last else q.owner, style="cyan")
            table.add_row(first, *(row(q) if against else row(q)[:2]))
            last = q.owner
        yield Padding(table, _INDENT)
    if key.parameters:
        yield heading("Bench parameters that were drawn")
        table = words_table(
            "parameter", "hidden", "model" if against else "stated", "distance", whole=(0, 1, 2, 3)
        )
        for q in key.parameters:
            table.add_row(*row(q))
        yield Padding(table, _INDENT)


def row(q: Quantity) -> tuple[str, str, str, str]:
    """Return name, hidden value, value of the model and distance in standard errors, as people read them."""
    hidden = "–" if q.hidden is None else quantity(q.hidden, q.unit, pure=q.pure, digits=4)
    if q.value is None:
        model = "–"
    elif q.standard_error > 0.0:
        model = with_error(q.value, q.standard_error, q.unit, pure=q.pure)
    else:
        model = quantity(q.value, q.unit, pure=q.pure, digits=4)
    distance = "" if q.distance is None else f"{decimal(q.distance, 1, sign=True)} σ"
    return q.name, hidden, model, distance
