"""The effects that the project knows: as a list, and one in full."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from gyrowheel.show.formulas import pretty
from gyrowheel.show.layout import command, heading, sentences, words_table
from gyrowheel.show.quantities import minus, span

if TYPE_CHECKING:
    from gyrowheel_sim.effects import Coefficient, Effect


def effect_list(effects: Iterable[Effect]) -> Iterator[RenderableType]:
    """Yield all effects, a line each, those of a category together."""
    table = words_table("effect", "what it is", whole=(0,))
    shown = list(effects)
    for category in dict.fromkeys(effect.category for effect in shown):
        table.add_row(Text(category, style="bold"), "")
        for effect in shown:
            if effect.category == category:
                table.add_row(Text(f"  {effect.name}", style="cyan"), effect.title)
    yield table
    yield Text("\nMore about one:", style="dim")
    yield command("gyrowheel effects windage")


def effect_page(effect: Effect) -> Iterator[RenderableType]:
    """Yield all that is known about an effect."""
    yield Text.assemble((effect.name, "bold cyan"), f"  {effect.title}")
    yield Text(f"\n{effect.sentence}\n")
    for part in pretty(effect.formula).split("; "):
        yield Padding(Text(part, style="bold"), (0, 0, 0, 2))
    yield heading("Coefficients")
    table = words_table("", "usual size", "what it is")
    for c in effect.coefficients:
        sign = ", either sign" if c.signed else ""
        table.add_row(
            Text(c.name, style="bold"),
            f"{span(*c.usual, c.unit, pure=c.shape is not None)}{sign}",
            minus(f"{c.description} [{c.source}]"),
        )
    yield Padding(table, (0, 0, 0, 2))
    facts = words_table("", "")
    for text in possible_sizes(effect):
        facts.add_row("possible", minus(text))
    facts.add_row("holds for", Text(effect.validity))
    facts.add_row("source", Text(effect.source))
    yield Text()
    yield facts
    if effect.look_alikes:
        yield heading("Confounders, and how to separate them")
        yield from sentences(f"{name}: {test}" for name, test in effect.look_alikes.items())


def possible_sizes(effect: Effect) -> list[str]:
    """Return what is possible, a text for each range that coefficients have."""
    names: dict[str, list[str]] = {}
    for c in effect.coefficients:
        low, high = c.physical
        if low > -math.inf or high < math.inf:
            shown = "0 or more" if (low, high) == (0.0, math.inf) else span(low, high, c.unit)
            names.setdefault(f"{shown}: {c.why_possible}", []).append(c.name)
    return [f"{', '.join(own)} {text}" for text, own in names.items()]


def effect_json(effect: Effect) -> dict[str, Any]:
    """Return all that is known about an effect, SI units."""
    return {
        "name": effect.name,
        "title": effect.title,
        "category": effect.category,
        "sentence": effect.sentence,
        "formula": effect.formula,
        "coefficients": {c.name: _coefficient_json(c) for c in effect.coefficients},
        "validity": effect.validity,
        "source": effect.source,
        "look_alikes": dict(effect.look_alikes),
    }


def _coefficient_json(c: Coefficient) -> dict[str, Any]:
    return {
        "unit": c.unit,
        "description": c.description,
        "usual": list(c.usual),
        "bounds": list(c.bounds),
        "possible": [value if math.isfinite(value) else None for value in c.physical],
        "signed": c.signed,
        "shape": c.shape is not None,
        "default": c.default,
        "source": c.source,
    }
