"""A model file: what has been learned about a bench, and how."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from gyrowheel_bringup.render.formulas import pretty
from gyrowheel_bringup.render.layout import heading, words_table
from gyrowheel_bringup.render.quantities import with_error

if TYPE_CHECKING:
    from gyrowheel_analysis.model import Model

_INDENT = (0, 0, 0, 2)


def model_page(model: Model, path: str) -> Iterator[RenderableType]:
    """Yield a model: its effects, its parameters and its history."""
    yield Text.assemble((path, "bold cyan"), f"  bench {model.bench_source}")
    yield from content(model)
    yield heading("History")
    history = words_table("time", "what", "recordings")
    for entry in model.history:
        history.add_row(str(entry.get("time", "")), str(entry.get("what", "")), _recordings(entry))
    yield Padding(history if model.history else Text("none", style="dim"), _INDENT)


def content(model: Model) -> Iterator[RenderableType]:
    """Yield what has been learned: effects, and parameters of the bench."""
    yield heading("Effects")
    yield Padding(_effects(model) if model.effects else Text("none", style="dim"), _INDENT)
    yield heading("Bench parameters learned from recordings")
    yield Padding(
        _overrides(model, model.overrides) if model.overrides else Text("none", style="dim"), _INDENT
    )


def changes(model: Model) -> Iterator[RenderableType]:
    """Yield what is worth a look after a fit: the effects, and the parameters far from what the bench file says."""
    yield heading("Effects")
    yield Padding(_effects(model) if model.effects else Text("none", style="dim"), _INDENT)
    stated = model.stated_bench.parameters
    far = [
        name
        for name, override in model.overrides.items()
        if abs(override.value - stated[name].value) > stated[name].uncertainty
    ]
    if far:
        yield heading("Parameters of the bench that moved more than their stated uncertainty")
        yield Padding(_overrides(model, far), _INDENT)


def difference(lines: list[str]) -> Iterator[RenderableType]:
    """Yield the differences of two models, coloured as a diff."""
    styles = {"+": "green", "-": "red", "~": "yellow"}
    for line in lines:
        yield Text(line, style=styles.get(line[:1], ""))
    if not lines:
        yield Text("no difference", style="dim")


def _effects(model: Model) -> RenderableType:
    table = words_table("", "", "")
    for name, values in model.effects.items():
        effect = model.library[name]
        units = {c.name: (c.unit, c.shape is not None) for c in effect.coefficients}
        first = Text(name, style="cyan")
        for key, value in values.items():
            unit, pure = units[key]
            error = model.effect_errors.get(name, {}).get(key, 0.0)
            table.add_row(first, key, with_error(value, error, unit, pure=pure))
            first = Text()
        table.add_row("", "law", pretty(effect.formula))
    return table


def _overrides(model: Model, names: Iterable[str]) -> RenderableType:
    table = words_table("parameter", "learned", "stated")
    for name in names:
        override = model.overrides[name]
        p = model.stated_bench.parameters[name]
        table.add_row(
            Text(name, style="cyan"),
            with_error(override.value, override.standard_error, p.unit, pure=True),
            with_error(p.value, p.uncertainty, p.unit, pure=True),
        )
    return table


def _recordings(entry: Mapping[str, Any]) -> str:
    parts = []
    for key, words in (("fit", "fitted"), ("validate", "proven on")):
        paths = entry.get(key)
        if isinstance(paths, list) and paths:
            parts.append(f"{words} {', '.join(map(str, paths))}")
    return "; ".join(parts)
