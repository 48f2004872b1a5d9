"""The correction map in sentences: what it does to the error, on what it depends, what it resembles, where it holds."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from gyrowheel_analysis.channels import LISTED
from gyrowheel_analysis.criteria import NOISE_REACHED
from gyrowheel_core.quantities import decimal, listed
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.correction_map import CorrectionMap, LeadingTerm
    from gyrowheel_analysis.residuals.error_table import ErrorRow
    from gyrowheel_sim.effects.torque_map import TorqueMap

#: What a map acts on, and its variables, in words.
PLACES = {"rotor_torque": "torque on the rotor", "shaft_torque": "torque on the shaft"}
_VARIABLES = {
    "speed": "the speed",
    "tilt": "|tilt|",
    "azimuth": "the direction of the tilt",
    "temperature": "the temperature",
}
_NAMED = 0.05  # share from which on a variable or a term is named
_RAISED = "⁰¹²³⁴⁵⁶⁷⁸⁹"


def map_sentences(found: CorrectionMap) -> list[str]:
    """Return what a map is, what it does, and where it holds."""
    places = listed([PLACES[target] for target in found.targets], "and")
    with_it = f", next to {listed(list(found.effects), 'and')}" if found.effects else ""
    said = [
        f"No short law describes what is missing, but a map does{with_it}: the {places} as a smooth function."
    ]
    said += _falls(found)
    said += _dependence(found)
    if found.nearest:
        said.append(
            f"The known effect that is most like it, {found.nearest}, describes {found.nearest_share:.0%} of it."
        )
    if not found.orthogonal:
        said.append(
            "A part of it looks like bench parameters as well; their stated uncertainties decide how much is theirs."
        )
    return [*said, f"It holds {range_text(found.effect)}; a recording beyond that is refused with it."]


def range_text(effect: TorqueMap) -> str:
    """Return the range of a map: ``from 1200 to 4000 rpm, at tilts up to 4.2°``."""
    low, high = (value / RPM for value in effect.within.speed)
    speeds = f"at {low:.0f} rpm" if high - low < 1.0 else f"from {low:.0f} to {high:.0f} rpm"
    return f"{speeds}, at tilts up to {effect.within.tilt / DEG:.1f}°"


def _falls(found: CorrectionMap) -> Iterator[str]:
    """Yield the fall of the error in the channels with most of it, and what is left."""
    e = found.error
    if e.validation_before is not None and e.validation_after is not None:
        yield _fall(e.validation_before, e.validation_after, "On recordings that were not used, the error")
    else:
        yield _fall(e.before, e.after, "The error")
    after = e.after if e.validation_after is None else e.validation_after
    left = {name: _floors(after, name) for name in after.channels}
    over = {name: size for name, size in left.items() if size > NOISE_REACHED}
    if over:
        parts = [f"{decimal(size, 1)} in {LISTED[name].title}" for name, size in over.items()]
        yield f"Noise floors that are left: {listed(parts, 'and')}."


def _fall(before: ErrorRow, after: ErrorRow, what: str) -> str:
    names = [
        name for name in before.channels if name in after.channels and _floors(before, name) > NOISE_REACHED
    ]
    parts = [
        f"{LISTED[name].title} from {decimal(_floors(before, name), 1)} to {decimal(_floors(after, name), 1)}"
        for name in names
    ]
    if not parts:
        return f"{what} is that of noise without it."
    return f"{what} falls in {listed(parts, 'and')} noise floors."


def _floors(row: ErrorRow, name: str) -> float:
    return math.sqrt(row.channels[name].chi2_per_n)


def _dependence(found: CorrectionMap) -> Iterator[str]:
    for target in found.targets:
        own = [d for d in found.dependence if d.target == target and d.share >= _NAMED]
        terms = [t for t in found.leading if t.target == target and t.share >= _NAMED]
        if own:
            parts = [f"{_VARIABLES[d.variable]} ({min(d.share, 1.0):.0%})" for d in own]
            yield f"Shares of the variance of the {PLACES[target]} that go with a variable: {', '.join(parts)}."
        if terms:
            yield f"Its largest terms: {', '.join(f'{_term(t)} ({t.share:.0%})' for t in terms)}."


def _term(term: LeadingTerm) -> str:
    """Return the powers of a term: ``z² z̄``."""
    forward, backward, odd = term.powers
    parts = []
    for sign, power in (("z", forward), ("z̄", backward), ("|z|", odd)):
        if power:
            parts.append(sign + (_RAISED[power] if power > 1 else ""))
    return " ".join(parts) or "constant"
