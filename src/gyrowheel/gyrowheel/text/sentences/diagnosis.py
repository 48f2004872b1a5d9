"""What a diagnosis says: the verdict, the evidence for each finding, its ties, and the test to run next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from gyrowheel.text.sentences.events import drift_sentence, event_sentence
from gyrowheel.text.sentences.forms import form_sentence
from gyrowheel.text.sentences.residuals import growth_sentence
from gyrowheel.text.sentences.setup import problem
from gyrowheel_core.quantities import listed

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.diagnose import Diagnosis, EffectFinding, NextTest, TieReport

_ERROR_TITLES = {
    "stiffness_error": "flexure stiffness differs from the bench file",
    "gimbal_inertia_error": "gimbal inertia differs from the bench file",
    "shaft_inertia_error": "shaft inertia differs from the bench file",
    "rotor_inertia_error": "rotor spin inertia differs from the bench file",
    "coil_gain_error": "torque constant of the coils differs from the bench file",
    "motor_constant_error": "motor constant differs from the bench file",
}
_COUNTS = {2: "Two", 3: "Three", 4: "Four"}


def title(item: EffectFinding | TieReport) -> str:
    """Return what a finding, or what ties with it, is called."""
    if item.name in _ERROR_TITLES:
        return _ERROR_TITLES[item.name]
    in_model = item.in_model not in (None, False)
    return f"{item.effect_title} of another size than in the model" if in_model else item.effect_title


def named(item: EffectFinding | TieReport) -> str:
    """Return title and name: ``drag of the air on the spin (windage)``."""
    return f"{title(item)} ({item.name})"


def physics(finding: EffectFinding) -> str:
    """Return in a sentence what physics a finding stands for."""
    return finding.effect_sentence or "The parameter lies beyond five of its stated uncertainties."


def verdict_sentence(found: Diagnosis) -> str:
    """Return the verdict in plain words; the same in terminal, notebook, pictures and JSON.

    What happened in the middle of a recording comes first, what its drifts are last.
    """
    happened = [event_sentence(event, several=several(found)) for event in found.events]
    return " ".join(filter(None, [*happened, _verdict(found), drift_sentence(found.drift_scales)]))


def several(found: Diagnosis) -> bool:
    """Whether events must name their recording."""
    return len({*found.recordings, *(event.recording for event in found.events)}) > 1


def _verdict(found: Diagnosis) -> str:
    if found.setup:
        wrong = "; ".join(dict.fromkeys(problem(item).rstrip(".") for item in found.setup))
        return f"Nothing was diagnosed, the setup is wrong: {wrong}."
    if found.verdict == "nothing_missing":
        besides = "Besides, nothing" if found.events else "Nothing"
        return (
            f"{besides} is missing: the model explains the recordings within noise and stated uncertainties."
        )
    if found.verdict == "unknown":
        known = listed([named(f) for f in found.effects], "and") if found.effects else ""
        what = f"Besides {known}, something" if known else "Something"
        formula = f"; proposed formula: {form_sentence(found.free_form[0])}" if found.free_form else ""
        return f"{what} is missing that no known effect explains{formula.rstrip('.')}."
    if found.verdict == "ambiguous":
        choices = [_either([named(f), *(named(tie) for tie in f.ties)]) for f in found.effects]
        return f"Missing: {'; and '.join(choices)}. These recordings do not separate them."
    if found.verdict == "insufficient_data":
        return f"These recordings do not show whether anything is missing: {_too_little(found)}."
    return " ".join(_named_effects(found.effects))


def _named_effects(findings: Sequence[EffectFinding]) -> list[str]:
    """Return what is missing, what has another size, and which parameters of the bench are not as stated."""
    missing = [named(f) for f in findings if f.in_model is None and f.name not in _ERROR_TITLES]
    wrong = [f.name for f in findings if f.in_model is not None]
    said = []
    if len(missing) == 1:
        said.append(f"An effect is missing: {missing[0]}.")
    elif missing:
        said.append(
            f"{_COUNTS.get(len(missing), str(len(missing)))} effects are missing: {listed(missing, 'and')}."
        )
    if wrong:
        sizes, verb = ("size", "disagrees") if len(wrong) == 1 else ("sizes", "disagree")
        said.append(f"The {sizes} of {listed(wrong, 'and')} in the model {verb} with these recordings.")
    said += [f"The {named(f)}." for f in findings if f.name in _ERROR_TITLES]
    return said


def _too_little(found: Diagnosis) -> str:
    """Return why recordings are not enough."""
    from gyrowheel_analysis.fitting.preparation import FEWEST_WINDOWS, too_few_windows

    if found.windows < FEWEST_WINDOWS:
        return too_few_windows(found.windows, found.coverage)
    return "nothing was found, but no effect of a usual size would have shown"


def evidence(finding: EffectFinding) -> list[str]:
    """Return the evidence for a finding, a sentence each."""
    return [
        *(f"with all else fitted, {growth_sentence(law)}" for law in finding.growth),
        f"without it χ² is {finding.delta_chi2:.0f} worse, all else fitted again",
        *(f"with {r.name} in its place χ² is {r.delta_chi2:.0f} worse" for r in finding.rivals),
    ]


def tie_sentence(tie: TieReport) -> str:
    """Return what else a finding could be, and the test that separates the two."""
    text = f"could also be {named(tie)}: χ² is only {tie.delta_chi2:.1f} worse"
    if tie.separating_plan is not None:
        gain = "" if tie.expected_separation is None else f", expected Δχ² {tie.expected_separation:.0f}"
        return f"{text}. Plan {tie.separating_plan} separates them{gain}."
    return f"{text}. No test on this bench separates them."


def purpose(test: NextTest) -> str:
    """Return what a test is for."""
    if test.separates is not None:
        return "separates {} from {}".format(*test.separates)
    return f"would show a {test.reveals} of usual size, which these recordings do not"


def _either(names: list[str]) -> str:
    return f"{'either ' if len(names) > 1 else ''}{listed(names, 'or')}"
