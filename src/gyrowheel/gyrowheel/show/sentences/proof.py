"""Test of the findings on data that were not fitted, and doubts about a fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.text import Text

from gyrowheel.show.error_table import unit_of, units_of
from gyrowheel.show.sentences.residuals import TITLES
from gyrowheel_analysis.channels import CHANNELS, LISTED
from gyrowheel_core.quantities import decimal, fixed, listed, quantity
from gyrowheel_core.units import RPM

if TYPE_CHECKING:
    from gyrowheel_analysis.add import Doubt
    from gyrowheel_analysis.calibrate import Calibration
    from gyrowheel_analysis.diagnosis.proof_result import Proof
    from gyrowheel_analysis.residuals.error_table import ErrorTable

_PARTS = {
    "recording": "recordings",
    "speed": "spin rates",
    "azimuth": "tilt directions",
    "time": "stretches of time",
}
#: Advice where nothing could be tested.
HOW = "A recording for validation tests it."


def proof_sentence(proof: Proof | None, table: ErrorTable | None = None) -> str:
    """Return whether the findings are consistent with data that were not fitted, with the reason where they are not.

    The units are those of the table of errors on the same page.
    """
    if proof is None:
        return "NOT tested: nothing could be diagnosed."
    if proof.reason == "map":
        return f"Not tested on anything that was not fitted: the map was fitted to all of it. {HOW}"
    on = f" with {proof.recording}" if not proof.left_out else ""
    given = _given(proof)
    if proof.proven is None and proof.reason == "no_gain":
        hardly = "what was found hardly changes the prediction"
        return f"Not tested{on}{given}: {_parts(proof)}{hardly}, {_error(proof, table)}."
    if proof.proven is None:
        return f"Not tested on anything that was not fitted: too few windows to leave some out. {HOW}"
    if not proof.proven:
        return f"NOT consistent{on}{given}: {_parts(proof)}{_why(proof, table)}."
    power = (
        f"; detection limit: {fixed(proof.smallest)} times the noise of a channel" if proof.smallest else ""
    )
    return f"Consistent{on} in every channel{given}: {_parts(proof)}{_error(proof, table)}{power}."


def proof_line(proof: Proof | None, table: ErrorTable | None = None) -> Text:
    """Return `proof_sentence` as the last line of a verdict: bold, and green or red where there is an answer."""
    colour = "" if proof is None or proof.proven is None else "green" if proof.proven else "red"
    return Text(proof_sentence(proof, table), style=f"bold {colour}".strip())


def left_sentences(proof: Proof | None, rejected: Sequence[str] = (), *, ended: bool = False) -> list[str]:
    """Return what is left in the channels that fail, what is not offered for it, and whether the search ended early."""
    said = []
    if ended:
        said.append("The search ended early: events, laws with a memory and free forms may explain more.")
    if rejected:
        verb = "make" if len(rejected) > 1 else "makes"
        names = listed(list(rejected), "and")
        said.append(f"Not offered: {names} {verb} the prediction of data that were not fitted worse.")
    left = {} if proof is None else {c.channel: c.floors for c in proof.channels if c.floors > 0.0}
    parts = []
    for name, size in left.items():
        largest = proof is not None and name in proof.causes and proof.speed > 0.0
        where = f", largest at {proof.speed / RPM:.0f} rpm" if largest and proof is not None else ""
        parts.append(f"{fixed(size)} noise floors in {LISTED[name].title}{where}")
    if parts:
        said.append(f"Left: {'; '.join(parts)}.")
    return said


def _given(proof: Proof) -> str:
    """Return what of the fitted recordings is taken to be there, too."""
    given = []
    if proof.stayed:
        times = listed([f"{decimal(time, 1)} s" for time in proof.stayed], "and")
        given.append(f"what changed at {times} is still there")
    if proof.swinging:
        periods = listed([f"{decimal(time, 1)} s" for time in proof.swinging], "and")
        given.append(f"what swings with a period of {periods} does so there, too")
    if not given:
        return ""
    return f", given that {' and '.join(given)} (otherwise χ²/N {fixed(proof.otherwise)})"


def _parts(proof: Proof) -> str:
    if not proof.left_out:
        return ""
    return f"each of {proof.parts} {_PARTS[proof.left_out]} predicted from the others, "


def _error(proof: Proof, table: ErrorTable | None) -> str:
    """Return the fall of the error on the predicted samples."""
    if not proof.channel:
        return _chi2(proof)
    channel = LISTED[proof.channel]
    units = {} if table is None else units_of(table)
    unit = units.get(proof.channel) or unit_of({proof.channel: proof.noise})[proof.channel]
    before, after, noise = (fixed(v / unit.size) for v in (proof.before, proof.after, proof.noise))
    fall = after if before == after else f"{before} → {after}"
    floor = "noise" if not proof.left_out else "noise and uncertainty of the prediction"
    return f"error of {channel.title} {fall} {unit.label} ({floor} {noise}), {_chi2(proof)}"


def _chi2(proof: Proof) -> str:
    return f"χ²/N {fixed(proof.chi2_per_n)}"


def _why(proof: Proof, table: ErrorTable | None) -> str:
    misfit = f"{_chi2(proof)}, where chance allows {fixed(proof.allowed)}"
    if proof.reason == "channel":
        return _off(proof)
    if proof.reason == "dependence":
        part, variable = proof.causes
        return f"what is left of the {CHANNELS[part].subject} depends on the {TITLES[variable]}"
    if proof.reason == "no_gain":
        return f"the error does not fall there, {_error(proof, table)}"
    if proof.reason == "unfixed":
        causes = listed(list(proof.causes), "and") or "what was fitted"
        verb = "are" if len(proof.causes) > 1 else "is"
        return f"{misfit}: {causes} {verb} not known well enough from what was fitted"
    if proof.reason == "event":
        return f"{misfit}; something happened in it, without which it is predicted"
    if proof.reason == "differs":
        return f"{misfit}; {_differs(proof)}"
    if proof.reason == "resembles":
        return f"{misfit}; what is left there looks like {proof.causes[0]}"
    return f"{misfit}; no single parameter or known effect accounts for it"


def _off(proof: Proof) -> str:
    """Return the channel that fails alone, its size in noise floors, and where it is largest."""
    (name,) = proof.causes
    check = next(c for c in proof.channels if c.channel == name)
    unseen = check.unseen > check.unseen_allowed
    size, allowed = (check.unseen, check.unseen_allowed) if unseen else (check.fitted, check.fitted_allowed)
    where = "" if unseen else " in the fitted recordings"
    return (
        f"{LISTED[name].subject} {fixed(math.sqrt(size))} times its noise{where}, where chance allows "
        f"{fixed(math.sqrt(allowed))}; largest at {proof.speed / RPM:.0f} rpm"
    )


def _differs(proof: Proof) -> str:
    """Return which unknown would need another value there."""
    (name,) = proof.causes
    if proof.value is None or proof.fitted is None:
        return f"{name} would have to be another one there: the machine may be another one, or have changed"
    there = quantity(proof.value, proof.unit, pure=proof.unit == "1")
    fitted = quantity(proof.fitted, proof.unit, pure=proof.unit == "1")
    return (
        f"it would take {name} {there} there instead of {fitted}: another machine, one that has changed, "
        "or a law that does not hold there"
    )


def doubt_sentence(doubt: Doubt) -> str:
    """Return the doubt about an added effect, or about one of the model."""
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
    if doubt.kind == "bounded":
        return (
            f"{doubt.coefficient} ends at a limit of its possible values: {doubt.effect}, or another effect of the "
            "model, takes too much of its place; fit recordings at more spin rates and tilts as well, or remove that "
            "effect"
        )
    return f"{name} keeps the value of the air model: the recordings do not constrain it"


def calibration_notes(found: Calibration) -> list[str]:
    """Return the doubts about a calibration."""
    if not found.lacking:
        return []
    return [
        f"The model does not explain these recordings (χ²/N {found.chi2_per_n:.1f}): the standard error of the coil "
        f"constant is widened by {found.widened:.1f}. Diagnose first what the model lacks."
    ]
