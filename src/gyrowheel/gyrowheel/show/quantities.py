"""How values of coefficients are read: which of them are pure numbers. The formats are those of `gyrowheel_core`."""

from __future__ import annotations

from gyrowheel_core.quantities import (
    decimal,
    fixed,
    minus,
    pair,
    quantity,
    seconds,
    short,
    span,
    with_error,
)

__all__ = [
    "decimal",
    "fixed",
    "is_pure",
    "minus",
    "pair",
    "quantity",
    "seconds",
    "short",
    "span",
    "with_error",
]


def is_pure(effect: str, coefficient: str) -> bool:
    """Whether a coefficient without unit shapes the law of an effect (an exponent)."""
    from gyrowheel_sim.effects import registry

    known = registry().get(effect)
    return known is not None and any(c.name == coefficient for c in known.shapes)
