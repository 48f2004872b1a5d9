"""What recordings hold: how much of them takes part, and what is missing in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gyrowheel_analysis.reduction import Coverage


def coverage_sentence(found: Coverage) -> str:
    """Return how much of the recordings takes part, and why the rest does not."""
    return found.sentence()
