"""Sentences of a step: its diagnosis, and what it ruled out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from gyrowheel.show.quantities import quantity
from gyrowheel.show.sentences.diagnosis import named, verdict_sentence
from gyrowheel.show.sentences.instruments import instrument_open, instrument_sentence
from gyrowheel_core.quantities import listed

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.result import Diagnosis, EffectFinding


def learned(found: Diagnosis, ruled_out: Sequence[str]) -> list[str]:
    """Return a diagnosis in a sentence or two, and what it ruled out since the previous one."""
    if found.verdict == "unknown":
        formula = f" Proposed formula: {found.free_form[0].formula}." if found.free_form else ""
        said = [f"Something acts that no known effect explains.{formula}"]
    elif found.verdict == "ambiguous":
        said = [_open(finding) for finding in found.effects]
        said += [instrument_open(finding) for finding in found.instruments]
    elif found.verdict == "effect":
        said = [f"Found: {named(finding)}, {_size(finding)}." for finding in found.effects]
        said += [instrument_sentence(finding) for finding in found.instruments]
    else:
        said = [verdict_sentence(found)]
    if ruled_out and (found.effects or found.instruments):
        said.append(f"{listed(ruled_out, 'and')} {'is' if len(ruled_out) == 1 else 'are'} ruled out.")
    return said


def settled_by(open_names: Sequence[str], channel: str, delta_chi2: float, rival: str) -> str:
    """Return which channel settles at once what averages over revolutions leave open."""
    return (
        f"Averages over revolutions alone would not separate {listed(open_names, 'from')}; {channel} does "
        f"(Δχ² {delta_chi2:.0f} against {rival})."
    )


def _open(finding: EffectFinding) -> str:
    if not finding.ties:
        return f"Found: {named(finding)}, {_size(finding)}."
    others = listed([tie.name for tie in finding.ties], "or")
    return f"Most likely {named(finding)}, but {others} would explain it as well."


def _size(finding: EffectFinding) -> str:
    """Return the first amplitude of a finding with its relative error."""
    name, estimate = next(iter(finding.coefficients.items()))
    text = f"{name} = {quantity(estimate.value, estimate.unit)}"
    if estimate.value and math.isfinite(estimate.standard_error):
        text += f", known to {100.0 * abs(estimate.standard_error / estimate.value):.2g} %"
    return text
