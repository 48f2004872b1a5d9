"""What was hidden beside what was found."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from rich.console import RenderableType

from gyrowheel.show.layout import words_table
from gyrowheel.show.quantities import is_pure, quantity, with_error
from gyrowheel_sim.effects import EffectValues, registry

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.result import DetectionLimit, Diagnosis, Estimate


def truth_table(truth: EffectValues, diagnosis: Diagnosis) -> RenderableType:
    """Return a table of what was hidden, what was found, and their distance in standard errors."""
    table = words_table("", "", "hidden", "found", "distance", whole=(0, 1, 2, 4))
    for row in truth_rows(truth, diagnosis):
        table.add_row(*row)
    return table


def truth_rows(truth: EffectValues, diagnosis: Diagnosis) -> Iterator[tuple[str, str, str, str, str]]:
    """Yield rows of effect, coefficient, hidden value, found value, and their distance in standard errors."""
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
            yield (
                first,
                key,
                "–" if hidden is None else quantity(hidden, units.get(key, "1"), pure=pure, digits=4),
                _found(estimate, limits.get((name, key)), pure=pure),
                _apart(hidden, estimate),
            )
            first = ""


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
