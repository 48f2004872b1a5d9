"""Page one of a report, for the person who decides: what was found, how sure that is, what it means, what to do."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from gyrowheel.report import sections
from gyrowheel.show.formulas import is_pure
from gyrowheel.show.html import Cells
from gyrowheel.show.sentences.diagnosis import purpose, title
from gyrowheel_analysis.channels import LISTED
from gyrowheel_core.quantities import listed, short
from gyrowheel_core.units import DEG, RPM, unit_for

if TYPE_CHECKING:
    from gyrowheel.models.api import Model
    from gyrowheel.report.content import ReportContent
    from gyrowheel_analysis.diagnosis.proof_result import Proof
    from gyrowheel_analysis.diagnosis.result import Diagnosis
    from gyrowheel_analysis.residuals.error_table import ErrorTable

_MOST_NAMED = 4  # effects that a line names; of more it gives the number

#: Uses of a bench, and the quantity whose mean shows an error in each.
_USES = {"pointing": "coil_torque", "mean power": "motor_torque"}


def decision(report: ReportContent, cells: Cells) -> list[dict[str, Any]]:
    """Return the lines of page one: questions, each with its answers; the page has `proved` first in the second."""
    found = report.diagnosis
    return [
        {"asked": "What was found", "lines": _found(found, report.model, cells)},
        {"asked": "How sure", "lines": _sure(report)},
        {"asked": "What it means", "lines": _meaning(report)},
        {"asked": "What to do", "lines": _advice(report)},
    ]


def _found(found: Diagnosis, model: Model, cells: Cells) -> list[Markup | str]:
    lines: list[Markup | str] = []
    for k, effect in enumerate(found.effects):
        known = model.details.library.get(effect.name)
        about = {} if known is None else {c.name: c.description.partition(";")[0] for c in known.coefficients}
        values = Markup(", ").join(
            Markup("{} = {}{}").format(
                _symbol(name),
                cells.estimate(
                    f"diagnosis.effects.{k}.coefficients.{name}", e.unit, pure=is_pure(effect.name, name, e)
                ),
                f" ({about[name]})" if about.get(name) else "",
            )
            for name, e in effect.coefficients.items()
        )
        lines.append(Markup("{}: {}; ± is one standard error.").format(_as_begin(title(effect)), values))
    lines += [f"{item.title}." for item in found.instruments]
    lines += [Markup("An unknown law; a formula that fits: {}.").format(f.formula) for f in found.free_form]
    if found.map is not None:
        lines.append(cells.words("diagnosis.map.sentences.0"))
    if not lines and found.setup:
        lines.append(sections.setup(found.setup)[0]["problem"])
    return lines  # none where the heading says it all


def _as_begin(words: str) -> str:
    """Return words as the beginning of a sentence; names in them keep their letters."""
    return words[:1].upper() + words[1:]


def _symbol(name: str) -> Markup:
    """Return a symbol with what follows its first underscore as an index."""
    symbol, _, index = name.partition("_")
    return Markup("{}<sub>{}</sub>").format(symbol, index) if index else Markup("{}").format(symbol)


def _sure(report: ReportContent) -> list[str]:
    """Return what else could explain the recordings, and what they could not show."""
    found = report.diagnosis
    lines: list[str] = []
    tied = {name: [tie.name for tie in ties] for name, ties in found.ties.items() if ties}
    tied |= {form.name: [tie.name for tie in form.ties] for form in found.free_form if form.ties}
    lines += [
        f"These recordings cannot tell {name} from {listed(ties, 'or')}." for name, ties in tied.items()
    ]
    if found.effects and not tied:
        lines.append("No other known effect explains these recordings equally well.")
    hidden = sorted({limit.effect for limit in found.limits if not limit.visible})
    if len(hidden) > _MOST_NAMED:
        lines.append(
            f"Not excluded: {len(hidden)} known effects, which at their usual size would not show in these recordings "
            "(section Detection limits)."
        )
    elif hidden:
        library = report.model.details.library
        names = [f"{library[name].title} ({name})" if name in library else name for name in hidden]
        lines.append(
            f"Not excluded, because at a usual size they would not show in these recordings: {listed(names, 'and')}."
        )
    return lines


def proved(report: ReportContent) -> tuple[Proof, str] | None:
    """Return the proof of what was found or added, and what it means to a reader who meets its words first."""
    found, proof = report.diagnosis, report.diagnosis.proof
    if report.addition is not None and report.addition.proof is not None:
        proof = report.addition.proof
    if proof is None:
        return None
    if proof.proven is None:
        return proof, "Not tested on data that were not used to fit."
    unused = "each part of the recordings from the others"
    if not proof.left_out:
        unused = f"the data of “{proof.recording}”, which were not used to fit,"
    something = found.effects or found.instruments or found.free_form or found.map or found.events
    model = "With this, the model" if something or report.addition is not None else "The model"
    does = "predicts" if proof.proven else "does not predict"
    return proof, f"{model} {does} {unused} to within the noise of the measurement."


def _meaning(report: ReportContent) -> list[str]:
    """Return the size of the error in units of the bench, and what a torque of that size does to it."""
    found = report.diagnosis
    table = found.error if report.addition is None else report.addition.error
    if table is None:
        return ["The model cannot be judged before these recordings are repeated or corrected."]
    lines = []
    for name in _worst(table):
        error, noise = table.before.rms_of(name), table.noise_floor.rms_of(name)
        unit = unit_for(error, LISTED[name].unit)
        lines.append(
            f"{_as_begin(LISTED[name].subject)}: the model is {short(error / unit.size)} {unit.label} rms off, "
            f"{short(error / noise)} times the noise."
        )
        lines += _consequence(report, name, error)
    if not lines:
        lines.append("The model predicts these recordings to their noise: nothing needs to be corrected.")
    else:
        means = {LISTED[name].quantity for name in _above_noise(table) if LISTED[name].group == "average"}
        spared = [of for of, quantity in _USES.items() if quantity not in means]
        if spared:
            verb = "are" if len(spared) > 1 else "is"
            subject = _as_begin(listed(spared, "and"))
            lines.append(f"{subject} {verb} not affected beyond the noise of these recordings.")
    return lines


def _above_noise(table: ErrorTable) -> list[str]:
    """Return the channels whose error is above their noise."""
    return [
        name for name in LISTED if name in table.before and not table.before.is_noise(name, table.noise_floor)
    ]


def _worst(table: ErrorTable) -> list[str]:
    """Return the two channels whose error is farthest above noise, of those above it; one of a kind, worst first."""
    names = _above_noise(table)
    ratio = {n: table.before.rms_of(n) / (table.noise_floor.rms_of(n) or 1.0) for n in names}
    worst: dict[str, str] = {}
    for name in sorted(names, key=lambda n: -ratio[n]):
        worst.setdefault(LISTED[name].subject, name)
    return list(worst.values())[:2]


def _consequence(report: ReportContent, name: str, size: float) -> list[str]:
    """Return what an uncorrected torque of that size does: power of the motor, or drift of the spin axis."""
    channel, bench = LISTED[name], report.model.bench
    speeds = [recording.info.spin_rate for recording in report.fitted]
    slow, fast = min(low for low, _ in speeds), max(high for _, high in speeds)
    if not (math.isfinite(slow) and math.isfinite(fast)):
        return []
    if channel.quantity == "motor_torque":
        power = unit_for(size * fast, "W")
        return [
            f"At {short(fast / RPM)} rpm that is {short(size * fast / power.size)} {power.label} of power."
        ]
    if channel.quantity == "coil_torque" and channel.group == "average" and slow > 0.0:
        drift = size / (bench.value("rotor_inertia_z") * slow)
        rate, speed = short(drift / DEG), short(slow / RPM)
        return [
            f"Without a correction, a torque of that size makes a free spin axis drift by {rate} °/s at {speed} rpm."
        ]
    return []


def _advice(report: ReportContent) -> list[str]:
    found = report.diagnosis
    if found.setup:
        return [sections.setup(found.setup)[0]["cure"]]
    lines = []
    tied = any(found.ties.values())
    if report.addition is not None:
        saved = report.latest.details.read is not None
        lines.append(f"Use the corrected model{f', {report.latest.origin}' if saved else ''}.")
    elif found.effects and not tied:
        lines.append(
            f"Add {listed([own.name for own in found.effects], 'and')} to the model; the section “How to repeat it” "
            "has the command."
        )
    elif found.map is not None and not found.free_form:
        lines.append("Use the map as a correction within its range, and look for its cause.")
    elif found.instruments and not found.effects:
        lines.append("Correct or calibrate the instrument.")
    test = found.next_test
    if test is not None:
        why = (
            "To settle it"
            if found.verdict not in ("nothing_missing", "effect")
            else "If more certainty is needed"
        )
        lines.append(
            f"{why}, record the test plan “{test.plan}” ({test.minutes:.1f} min): it {purpose(test)}."
        )
    if not lines:
        lines.append(
            "Nothing: use the model as it is."
            if found.verdict == "nothing_missing"
            else "Record more motion."
        )
    return lines
