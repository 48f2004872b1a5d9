"""The diagnosis: verdict, evidence for each finding, ties, proposed formulas, and the test to run next."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from gyrowheel.show.formulas import is_pure
from gyrowheel.show.sentences.findings import (
    drift_sentence,
    event_sentences,
    instrument_sentence,
    law_sentence,
    shape_sentences,
    turned_sentences,
)
from gyrowheel.show.sentences.residuals import growth_sentence
from gyrowheel.show.sentences.setup import misstated_sentence, problem
from gyrowheel_analysis.criteria import CHI2_RANGE
from gyrowheel_core.errors import with_article
from gyrowheel_core.quantities import decimal, interval, listed, pair, quantity, with_error

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.estimates import Beyond, Estimate
    from gyrowheel_analysis.diagnosis.findings import EffectFinding, FreeForm, NextTest, TieReport
    from gyrowheel_analysis.diagnosis.result import Diagnosis
    from gyrowheel_analysis.reduction.windows import MissedVoltages

_EXPONENT = re.compile(r"\^([kqnm])\b")


def form_sentence(form: FreeForm) -> str:
    """Return a form with its estimates: exponents as numbers, edges in degrees, speeds in rpm."""
    found = form.coefficients

    def exponent(match: re.Match[str]) -> str:
        name = match[1]
        return f"^{decimal(found[name].value, 2)}" if name in found else match[0]

    text = _EXPONENT.sub(exponent, form.description)
    at = {name: place_text(form, name) for name in form.places}
    text = text.replace("beyond an edge", f"beyond {at.get('p', 'an edge')}")
    if "p" in at:
        within = f", within {at['w']} to either side" if "w" in at else ""
        text = text.replace("near one speed", f"near {at['p']}{within}")
        text = text.replace("beyond one speed", f"beyond {at['p']}{within}")
    if "s" in found:
        text += f" (time constant {with_error(found['s'].value, found['s'].standard_error, 's')})"
    return text


def simple_sentence(form: FreeForm) -> str:
    """Return that a form equals a simple law within the errors of its exponents; empty otherwise."""
    if not form.simple:
        return ""
    found = ", ".join(
        f"{name} = {number} ({pair(form.coefficients[name].value, form.coefficients[name].standard_error)})"
        for name, number in form.whole.items()
    )
    return (
        f"The exponents are whole numbers within their errors, {found}: it may as well be the simple law below, which "
        "`gyrowheel model add` takes in place of the other."
    )


def place_text(form: FreeForm, name: str) -> str:
    """Return an edge, a centre or a width in the unit in which people read it."""
    place = form.places[name]
    return with_error(place.value, place.standard_error, place.unit)


#: Titles of the errors of bench parameters.
ERROR_TITLES = {
    "stiffness_error": "flexure stiffness differs from the bench file",
    "gimbal_inertia_error": "gimbal inertia differs from the bench file",
    "shaft_inertia_error": "shaft inertia differs from the bench file",
    "rotor_inertia_error": "rotor spin inertia differs from the bench file",
    "transverse_inertia_error": "moment of inertia of the rotor across its axis differs from the bench file",
    "coil_gain_error": "coil torque constant differs from the bench file",
    "motor_constant_error": "motor constant differs from the bench file",
    "motor_resistance_error": "winding resistance of the motor differs from the bench file",
}
#: Bench parameters far from their stated values that are named one by one.
_NAMED = 3
_COUNTS = {2: "Two", 3: "Three", 4: "Four"}


def title(item: EffectFinding | TieReport) -> str:
    """Return the title of a finding or of a tie."""
    if item.name in ERROR_TITLES:
        return ERROR_TITLES[item.name]
    in_model = item.in_model not in (None, False)
    return f"{item.effect_title} of another size than in the model" if in_model else item.effect_title


def named(item: EffectFinding | TieReport) -> str:
    """Return title and name: ``drag of the air on the spin (windage)``."""
    return f"{title(item)} ({item.name})"


def physics(finding: EffectFinding) -> str:
    """Return the physics of a finding in a sentence."""
    return finding.effect_sentence or "The parameter lies beyond five of its stated uncertainties."


def verdict_sentence(found: Diagnosis) -> str:
    """Return the verdict in plain words; the same in terminal, notebook, pictures and JSON.

    What is impossible or far from usual comes first, then what happened in the middle of a recording and what shape its
    drifts have; how large drifts without a shape are comes last.
    """
    said = beyond_sentences(found.beyond)
    said += turned_sentences(found.turned, several=several(found))
    said += event_sentences(found.events, several=several(found))
    said += [law_sentence(law, several=several(found)) for law in found.laws]
    said += shape_sentences(found.drift_shapes, several=several(found))
    drift = drift_sentence(
        found.drift_scales, shaped=bool(found.drift_shapes or found.events), laws=bool(found.laws)
    )
    conflicts = (
        text for finding in found.effects for text in conflict_sentences(finding.name, finding.coefficients)
    )
    missed = missed_sentence(found.coverage.missed)
    return " ".join(filter(None, [*said, _verdict(found), *conflicts, drift, missed]))


def missed_sentence(missed: MissedVoltages | None) -> str:
    """Return what a rate below that of the loop costs; empty where all voltages are recorded."""
    if missed is None:
        return ""
    return (
        f"{missed.part:.0%} of the voltages that the loop gave are not recorded ({missed.samples:.5g} samples a "
        f"second, {missed.voltages:.5g} voltages): that adds a noise of {quantity(missed.noise, 'N·m', digits=2)} to "
        "the torque of the coils in a window, which hides small effects. Record averages over each sample, or at the "
        "rate of the loop."
    )


def beyond_sentences(items: Sequence[Beyond]) -> list[str]:
    """Return the values that are impossible or far from usual, a sentence each.

    Where a law is missing, many parameters of the bench go astray together: only the furthest are then named.
    """
    astray = [item for item in items if item.kind == "not_as_stated"]
    if len(astray) <= _NAMED:
        return [beyond_sentence(item) for item in items]
    furthest = sorted(astray, key=lambda item: -item.times)[:_NAMED]
    names = listed(
        [
            f"{item.name} ({quantity(item.value, item.unit)}, {item.times:.0f} uncertainties)"
            for item in furthest
        ],
        "and",
    )
    more = (
        f"{len(astray)} bench parameters would have to lie at least {min(item.times for item in astray):.0f} stated "
        f"uncertainties from their stated values, furthest {names}."
    )
    return [*(beyond_sentence(item) for item in items if item not in astray), more]


def beyond_sentence(item: Beyond) -> str:
    """Return a value that is impossible or far from usual, in a sentence."""
    name = f"{item.name} {item.coefficient}".strip()
    pure = item.unit == "1" and is_pure(item.name, item.coefficient)
    value, limit = (quantity(v, item.unit, pure=pure) for v in (item.value, item.limit))
    if item.kind == "impossible":
        return f"{name} would have to be {value}, which is impossible: the limit is {limit}."
    if item.kind == "not_as_stated":
        return (
            f"{name} would have to be {value}, {item.times:.1f} stated uncertainties from the stated {limit}."
        )
    if item.coefficient == "relative_error":
        return f"{item.name} of {value} is far beyond what a bench file can be wrong by."
    return f"{name} of {value} is {item.times:.1f} times the largest usual size."


def several(found: Diagnosis) -> bool:
    """Whether events must name their recording."""
    return len({*found.recordings, *(event.recording for event in found.events)}) > 1


def _verdict(found: Diagnosis) -> str:
    if found.setup:
        wrong = "; ".join(dict.fromkeys(problem(item).rstrip(".") for item in found.setup))
        return f"Nothing was diagnosed, the setup is wrong: {wrong}."
    if found.misstated:
        wrong = "; ".join(misstated_sentence(item, found.model) for item in found.misstated)
        return f"Nothing was diagnosed, the model contradicts the recordings: {wrong}."
    if found.verdict == "insufficient_data":
        return f"These recordings do not show whether anything is missing: {_too_little(found)}."
    if found.verdict in (
        by_verdict := {"nothing_missing": _nothing, "unknown": _unknown, "ambiguous": _ties}
    ):
        return by_verdict[found.verdict](found)
    said = [instrument_sentence(f) for f in found.instruments]
    doubt = ["This is not proven."] if unproven(found) else []
    return " ".join([*_named_effects(found.effects, doubtful=bool(doubt)), *said, *doubt])


def unproven(found: Diagnosis) -> bool:
    """Whether data that were not fitted disagree with what was found."""
    return found.proof is not None and found.proof.proven is False


def _nothing(found: Diagnosis, *, also: bool = False) -> str:
    explained = "the model explains the recordings within noise and stated uncertainties."
    hidden = dict.fromkeys(limit.effect for limit in found.limits if not limit.visible)
    nothing = "Besides, nothing" if found.events or found.drift_shapes or also else "Nothing"
    if not hidden:
        return f"{nothing} is missing: {explained}"
    return f"{nothing} shows: {explained} {_some(list(hidden))} of a usual size could hide in them."


def _unknown(found: Diagnosis) -> str:
    if _fails_elsewhere(found):
        nothing = "Besides, nothing" if found.events or found.drift_shapes else "Nothing"
        return (
            f"{nothing} shows in these recordings, but something is missing: "
            f"the model does not predict {found.proof.recording if found.proof else 'others'}."
        )
    named_only = (found.effects or found.instruments) and not found.free_form
    if any(b.kind == "impossible" for b in found.beyond) or (named_only and found.beyond):
        return "That is no explanation: something is missing that no known effect explains."
    known = listed([named(f) for f in found.effects], "and") if found.effects else ""
    # what describes a part of something else looks like an effect
    like = "what looks like " if unproven(found) else ""
    what = f"Besides {like}{known}, something" if known else "Something"
    formula = f"; proposed formula: {_formulas(found.free_form[0])}" if found.free_form else ""
    mapped = "; a map of the missing torque describes it" if found.map is not None else ""
    return f"{what} is missing that no known effect explains{formula.rstrip('.')}{mapped}."


def _formulas(form: FreeForm) -> str:
    """Return the proposed formula, and that others describe the recordings as well."""
    text = form_sentence(form).rstrip(".")
    if not form.ties:
        return text
    others = (
        "another formula describes" if len(form.ties) == 1 else f"{len(form.ties)} other formulas describe"
    )
    return f"{text}; {others} these recordings as well"


def _ties(found: Diagnosis) -> str:
    if not found.effects and not found.instruments:
        return _nothing(found, also=True)
    choices = [_either(named(f), f.ties) for f in found.effects]
    choices += [
        _either(f"{f.title} ({f.name})", f.ties) for f in {f.name: f for f in found.instruments}.values()
    ]
    begin = "Missing" if found.effects else "Not as stated"
    doubt = " This is not proven." if unproven(found) else ""
    return f"{begin}: {'; and '.join(choices)}. These recordings do not separate them.{doubt}"


def _fails_elsewhere(found: Diagnosis) -> bool:
    """Whether nothing was found or is left, and the model does not predict a recording for validation."""
    proof = found.proof
    missed = proof is not None and proof.proven is False and not proof.left_out
    something = found.effects or found.free_form or found.map is not None or found.lack_of_fit > CHI2_RANGE
    return missed and not something


def _some(names: Sequence[str], most: int = 4) -> str:
    """Return some names as a subject, and how many more there are."""
    if len(names) <= most:
        text = with_article(names[0]) if len(names) == 1 else listed(names, "or")
        return f"{text[0].upper()}{text[1:]}" if len(names) == 1 else text
    return f"{', '.join(names[: most - 1])} or one of {len(names) - most + 1} more"


def _named_effects(findings: Sequence[EffectFinding], *, doubtful: bool) -> list[str]:
    """Return missing effects, effects of another size, and bench parameters that are not as stated."""
    one, more = ("may be", "may be") if doubtful else ("is", "are")
    missing = [named(f) for f in findings if f.in_model is None and f.name not in ERROR_TITLES]
    wrong = [f.name for f in findings if f.in_model is not None]
    said = []
    if len(missing) == 1:
        said.append(f"An effect {one} missing: {missing[0]}.")
    elif missing:
        said.append(
            f"{_COUNTS.get(len(missing), str(len(missing)))} effects {more} missing: {listed(missing, 'and')}."
        )
    if wrong:
        sizes, verb = ("size", "disagrees") if len(wrong) == 1 else ("sizes", "disagree")
        said.append(f"The {sizes} of {listed(wrong, 'and')} in the model {verb} with these recordings.")
    said += [f"The {named(f)}." for f in findings if f.name in ERROR_TITLES]
    return said


def _too_little(found: Diagnosis) -> str:
    """Return why recordings are not enough."""
    from gyrowheel_analysis.criteria import FEWEST_WINDOWS
    from gyrowheel_analysis.fitting.preparation import too_few_windows

    if found.windows < FEWEST_WINDOWS:
        return too_few_windows(found.windows, found.coverage)
    if found.proof is not None and found.proof.proven is False:
        return f"nothing shows in them, but the model does not predict {found.proof.recording}"
    return "nothing was found, but no effect of a usual size would have shown"


def evidence(finding: EffectFinding) -> list[str]:
    """Return the evidence for a finding, a sentence each."""
    return [
        *error_sentences(finding.name, finding.coefficients),
        *prior_sentences(finding.name, finding.coefficients),
        *(f"with all else fitted, {growth_sentence(law)}" for law in finding.growth),
        f"without it χ² is {finding.delta_chi2:.0f} worse, all else fitted again",
        *(f"with {r.name} in its place χ² is {r.delta_chi2:.0f} worse" for r in finding.rivals),
    ]


def error_sentences(effect: str, coefficients: Mapping[str, Estimate]) -> list[str]:
    """Return what the standard error of every fitted coefficient consists of, and its 95 % interval from all."""
    said = []
    for name, e in coefficients.items():
        if e.parts is None:
            continue
        parts = {
            "standard deviations: noise": e.parts.noise,
            "bench": e.parts.bench,
            "effects too small to be seen": e.parts.undetected,
        }
        text = interval(*e.parts.interval, parts, e.unit, pure=is_pure(effect, name, e))
        said.append(f"95 % interval of {name}: {text}")
    return said


def conflict_sentences(effect: str, coefficients: Mapping[str, Estimate]) -> list[str]:
    """Return the coefficients whose prior disagrees with the data."""
    from gyrowheel_analysis.criteria import PRIOR_CONFLICT

    return [
        f"The prior of {name} disagrees with the data by {e.conflict:.1f} standard errors; without the prior: "
        f"gyrowheel model fit --prior {effect}.{name}=none."
        for name, e in coefficients.items()
        if e.conflict is not None and e.conflict > PRIOR_CONFLICT
    ]


def prior_sentences(effect: str, coefficients: Mapping[str, Estimate]) -> list[str]:
    """Return what the data alone give of every coefficient that has a prior, and the prior."""
    said = []
    for name, e in coefficients.items():
        if e.prior is None:
            continue
        prior, *data = (
            with_error(*pair_of, e.unit, pure=is_pure(effect, name, e))
            for pair_of in (e.prior, e.data)
            if pair_of
        )
        source = f" ({e.source})" if e.source else ""
        if data:
            said.append(
                f"{name} is {data[0]} by the data alone; the estimate includes the prior {prior}{source}"
            )
        else:
            said.append(f"{name} is the prior {prior}{source}: these recordings do not determine it")
    return said


def tie_sentence(tie: TieReport) -> str:
    """Return an alternative to a finding, and the test that separates the two."""
    what = named(tie) if tie.form is None else f"{tie.name}, {form_sentence(tie.form)}"
    # a form may turn out likelier than the one that was proposed by its first fit
    worse = f"only {tie.delta_chi2:.1f}" if tie.form is None or tie.delta_chi2 > 0.05 else "no"
    text = f"could also be {what}: χ² is {worse} worse"
    if len(tie.names) > 1:
        better = f"χ² is {-tie.delta_chi2:.1f} better, about what one more term must bring"
        text = f"could also be {_both(tie)} ({tie.effect_title}): {better}"
    if tie.separating_plan is not None:
        gain = "" if tie.expected_separation is None else f", expected Δχ² {tie.expected_separation:.0f}"
        return f"{text}. Plan {tie.separating_plan} separates them{gain}."
    return f"{text}. No test on this bench separates them."


def purpose(test: NextTest) -> str:
    """Return the purpose of a test."""
    if test.separates is not None:
        return "separates {} from {}".format(*test.separates)
    return f"would show {with_article(str(test.reveals))} of usual size, which these recordings do not"


def _both(tie: TieReport) -> str:
    """Return two effects that explain the recordings together."""
    return f"both {listed(list(tie.names), 'and')}"


def _either(name: str, ties: Sequence[TieReport]) -> str:
    """Return what was found or its alternatives: every single one, and the likeliest pair."""
    pairs = [tie for tie in ties if len(tie.names) > 1]
    names = [name, *(named(tie) for tie in ties if tie not in pairs), *map(_both, pairs[:1])]
    if len(pairs) > 1:
        names.append("another pair" if len(pairs) == 2 else f"one of {len(pairs) - 1} other pairs")
    return f"{'either ' if len(names) > 1 else ''}{listed(names, 'or')}"
