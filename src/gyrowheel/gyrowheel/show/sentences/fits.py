"""What a fit gives reason to doubt: effects that may not be there, sizes that moved, models that lack something."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gyrowheel_analysis.add import Doubt
    from gyrowheel_analysis.calibrate import Calibration


def doubt_sentence(doubt: Doubt) -> str:
    """Return what an added effect, or one of the model, gives reason to doubt."""
    name = f"{doubt.effect} {doubt.coefficient}".strip()
    if doubt.kind == "weak":
        return f"{name} is only {doubt.size:.1f} standard errors from zero: it may not be there"
    if doubt.kind == "moved":
        return f"{name} of the model moved by {doubt.size:.1f} of its standard errors: its size there may be wrong"
    if doubt.kind == "off_air_model":
        return f"{name} lies {doubt.size:.1f} uncertainties from the value of the air model"
    if doubt.kind == "impossible":
        return f"{name} is of a size or sign that is impossible: it stands for something else"
    if doubt.kind == "unusual":
        return f"{name} is {abs(doubt.size):.1f} times as large as is usual: it may stand for something else"
    return f"{name} keeps the value of the air model: the recordings do not constrain it"


def calibration_notes(found: Calibration) -> list[str]:
    """Return what a calibration gives reason to doubt."""
    if not found.lacking:
        return []
    return [
        f"The model does not explain these recordings (χ²/N {found.chi2_per_n:.1f}): the standard error of the coil "
        f"constant is widened by {found.widened:.1f}. Diagnose first what the model lacks."
    ]
