"""What an investigation does and learns: why a test is run, what it has brought, how it ended."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from gyrowheel.show.quantities import quantity, seconds
from gyrowheel.show.sentences.diagnosis import named, verdict_sentence
from gyrowheel.show.sentences.instruments import instrument_open, instrument_sentence
from gyrowheel_core.quantities import listed

if TYPE_CHECKING:
    from gyrowheel.investigation.procedure import Investigation
    from gyrowheel_analysis.diagnosis.result import Diagnosis, EffectFinding


def learned(found: Diagnosis, ruled_out: Sequence[str]) -> list[str]:
    """Return in a sentence or two what a diagnosis says, and what it has ruled out since the one before."""
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
    """Return which rows settle at once what averages over revolutions leave open."""
    return (
        f"Averages over revolutions alone would not separate {listed(open_names, 'from')}; {channel} does "
        f"(Δχ² {delta_chi2:.0f} against {rival})."
    )


def end_sentence(done: Investigation) -> str:
    """Return how an investigation ended."""
    took = seconds(60.0 * done.minutes)
    state = "Settled" if done.settled else "Not settled"
    left = seconds(60.0 * max(done.budget - done.minutes, 0.0))
    return f"{state} after {took} of bench time, {left} left: {done.reason or 'interrupted'}."


def unseen_sentence(found: Diagnosis) -> str:
    """Return which effects of a usual size would not have shown although a test can show them; empty if none."""
    if found.next_test is None:
        return ""
    hidden = dict.fromkeys(limit.effect for limit in found.limits if not limit.visible)
    if not hidden:
        return ""
    return f"At a usual size these recordings would not have shown {listed(list(hidden), 'or')}. To look for more:"


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
