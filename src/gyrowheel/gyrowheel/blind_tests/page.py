"""An opened key: hidden values next to those of a model, or of a diagnosis."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.panel import Panel
from rich.text import Text

from gyrowheel.show.formulas import is_pure
from gyrowheel.show.layout import heading, indented, words_table
from gyrowheel_core.quantities import decimal, quantity, with_error
from gyrowheel_sim.effects import EffectValues, registry

if TYPE_CHECKING:
    from gyrowheel.blind_tests.judge import OpenedKey, Quantity
    from gyrowheel_analysis.diagnosis.estimates import DetectionLimit, Estimate
    from gyrowheel_analysis.diagnosis.result import Diagnosis

_COLOURS = {None: "cyan", "exact": "green", "misnamed": "red"}


def key_page(key: OpenedKey) -> Iterator[RenderableType]:
    """Yield the hidden effects and parameters, compared with the model if there is one."""
    colour = _COLOURS.get(key.judged, "yellow")
    yield Panel(Text(key.sentence, style="bold"), border_style=colour, expand=False)
    against = key.model is not None
    if key.effects:
        yield heading("Effects")
        table = words_table("", "", "hidden", *(("model", "distance") if against else ()), whole=(0, 1, 2))
        last = ""
        for q in key.effects:
            first = Text("" if q.owner == last else q.owner, style="cyan")
            table.add_row(first, *(_row(q) if against else _row(q)[:2]))
            last = q.owner
        yield indented(table)
    if key.parameters:
        yield heading("Drawn bench parameters")
        table = words_table(
            "parameter", "hidden", "model" if against else "stated", "distance", whole=(0, 1, 2, 3)
        )
        for q in key.parameters:
            table.add_row(*_row(q))
        yield indented(table)


def _row(q: Quantity) -> tuple[str, str, str, str]:
    """Return name, hidden value, value of the model and distance in standard errors, formatted."""
    hidden = "–" if q.hidden is None else quantity(q.hidden, q.unit, pure=q.pure, digits=4)
    if q.value is None:
        model = "–"
    elif q.standard_error > 0.0:
        model = with_error(q.value, q.standard_error, q.unit, pure=q.pure)
    else:
        model = quantity(q.value, q.unit, pure=q.pure, digits=4)
    distance = "" if q.distance is None else f"{decimal(q.distance, 1, sign=True)} σ"
    return q.name, hidden, model, distance


def truth_table(truth: EffectValues, diagnosis: Diagnosis) -> RenderableType:
    """Return a table of hidden and found coefficients, and their distance in standard errors."""
    table = words_table("", "", "hidden", "found", "distance", whole=(0, 1, 2, 4))
    found = {finding.name: finding.coefficients for finding in diagnosis.effects}
    limits = {(limit.effect, limit.coefficient): limit for limit in diagnosis.limits}
    for name in dict.fromkeys([*truth, *found]):
        units = _units(name)
        estimates = found.get(name, {})
        first = name
        for key in dict.fromkeys([*truth.get(name, {}), *estimates]):
            pure = is_pure(name, key)
            hidden = truth.get(name, {}).get(key)
            estimate = estimates.get(key)
            table.add_row(
                first,
                key,
                "–" if hidden is None else quantity(hidden, units.get(key, "1"), pure=pure, digits=4),
                _found(estimate, limits.get((name, key)), pure=pure),
                _apart(hidden, estimate),
            )
            first = ""
    return table


def _units(name: str) -> Mapping[str, str]:
    effect = registry().get(name)
    return {} if effect is None else {c.name: c.unit for c in effect.coefficients}


def _found(estimate: Estimate | None, limit: DetectionLimit | None, *, pure: bool) -> str:
    if estimate is not None:
        return with_error(estimate.value, estimate.standard_error, estimate.unit, pure=pure)
    if limit is not None and math.isfinite(limit.value):
        return f"nothing (limit {quantity(limit.value, limit.unit, digits=2)})"
    return "nothing"


def _apart(hidden: float | None, estimate: Estimate | None) -> str:
    if hidden is None or estimate is None or estimate.standard_error <= 0.0:
        return ""
    return f"{abs(estimate.value - hidden) / estimate.standard_error:.1f} σ"
