"""The judge of a case: compares the finder's answer with the secret. No other part sees both."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

from gyrowheel.blind_trial import matched
from gyrowheel.campaigns.cases import Case
from gyrowheel.campaigns.hiding import Secret
from gyrowheel_analysis.diagnosis.diagnose import Diagnosis

Outcome = Literal[
    "exact", "tied", "tied_without_test", "partial", "missed", "unknown", "misnamed", "named_right", "failed"
]
#: What each outcome means.
OUTCOMES: dict[Outcome, str] = {
    "exact": "all that was hidden was named, and nothing else",
    "tied": "the truth is among the alternatives named, with the test that separates them",
    "tied_without_test": "the truth is among the alternatives named, but no test that separates them",
    "partial": "one of two was named, and nothing wrong",
    "missed": "nothing was named",
    "unknown": "called unknown, with a formula",
    "misnamed": "an effect was named that is not there",
    "named_right": "outside the library: named as the library effect that is right with another exponent",
    "failed": "the finder failed",
}
#: Smallest size, in detection limits, at which an effect counts as detectable.
DETECTABLE = 2.0
_SAME_EXPONENT = 0.15  # an exponent as near as this is right too


@dataclass(frozen=True)
class Interval:
    """A value that the finder stated with its standard error, and the true one."""

    name: str
    value: float
    standard_error: float
    truth: float

    @property
    def pull(self) -> float:
        """Distance from the truth in standard errors; infinite for a standard error of zero."""
        if self.standard_error > 0.0:
            return (self.value - self.truth) / self.standard_error
        return 0.0 if self.value == self.truth else math.inf


@dataclass(frozen=True)
class Judged:
    """A case, judged.

    Attributes
    ----------
    index : int
        Number of the case.
    kind : str
        What was hidden.
    truth : dict
        {effect: {coefficient: value}}.
    sizes : dict of str to float
        Sizes over the detection limits of this plan.
    detectable : bool
        Whether all that was hidden is at least twice as large as its detection limit.
    verdict : str
        The finder's verdict; empty if it failed.
    named : list of str
        What it named.
    ties : list of (str, str or None)
        The alternatives it named, with the plans that separate them.
    outcome : str
        See `OUTCOMES`.
    intervals : list of Interval
        Coefficients of the effects that were named rightly.
    parameters : list of Interval
        Fitted bench parameters, if nothing wrong was named.
    validation : float or None
        Error on the recording that was not used, in noise floors (root of chi-squared over N).
    validation_before : float or None
        The same for the model without the findings.
    formula : str
        Formula proposed for an unknown effect.
    seconds : float
        Time that the diagnosis took [s].
    error : str
        Why the finder failed.
    """

    index: int
    kind: str
    truth: dict[str, dict[str, float]]
    sizes: dict[str, float]
    detectable: bool
    verdict: str
    named: list[str]
    ties: list[tuple[str, str | None]]
    outcome: Outcome
    intervals: list[Interval] = field(default_factory=list)
    parameters: list[Interval] = field(default_factory=list)
    validation: float | None = None
    validation_before: float | None = None
    formula: str = ""
    seconds: float = math.nan
    error: str = ""

    @property
    def right(self) -> bool:
        """Whether the answer is right: no false finding, and nothing detectable missed or misnamed."""
        if self.kind == "outside":
            return self.outcome in ("unknown", "named_right")
        if self.outcome in ("exact", "tied"):
            return True
        return not self.detectable and self.outcome in ("missed", "partial", "tied_without_test")

    @property
    def beside_unknown(self) -> bool:
        """Whether effects were named in addition to an unknown one: alone they are no answer."""
        return self.verdict == "unknown" and bool(self.named)

    @property
    def truth_label(self) -> str:
        """Hidden effects, as a label of the confusion table."""
        return "+".join(sorted(self.truth)) or "none"

    @property
    def named_label(self) -> str:
        """The answer, as a label of the confusion table."""
        if self.outcome == "failed":
            return "failed"
        names = "+".join(sorted(self.named))
        return f"unknown beside {names}" if self.beside_unknown else names or self.verdict

    def to_json(self) -> dict[str, Any]:
        """Return the case as a JSON object."""
        return {
            "case": self.index,
            "kind": self.kind,
            "truth": self.truth,
            "sizes_in_limits": self.sizes,
            "detectable": self.detectable,
            "verdict": self.verdict,
            "named": self.named,
            "ties": [{"name": name, "separating_plan": plan} for name, plan in self.ties],
            "outcome": self.outcome,
            "right": self.right,
            "coefficients": [
                {"name": i.name, "value": i.value, "standard_error": i.standard_error, "truth": i.truth}
                for i in self.intervals
            ],
            "validation_before": self.validation_before,
            "validation": self.validation,
            "formula": self.formula,
            "seconds": self.seconds,
            "error": self.error,
        }


def judge(case: Case, secret: Secret, answer: Diagnosis) -> Judged:
    """Compare an answer with the secret."""
    named = [finding.name for finding in answer.effects]
    right = {name for name in named if name in secret.truth}
    outcome = _outcome(case, secret, answer)
    intervals = [
        Interval(f"{e.name}.{key}", estimate.value, estimate.standard_error, secret.truth[e.name][key])
        for e in answer.effects
        if e.name in right and outcome in ("exact", "partial")
        for key, estimate in e.coefficients.items()
        if key in secret.truth[e.name]
    ]
    parameters = []
    if outcome == "exact" or (outcome == "missed" and not secret.truth):
        stated = case.campaign.bench
        parameters = [
            Interval(name, n.value, n.standard_error, secret.scenario.values.get(name, stated.value(name)))
            for name, n in answer.nuisance.items()
        ]
    before = after = None
    if answer.error is not None and answer.error.validation_after and answer.error.validation_before:
        before = math.sqrt(answer.error.validation_before.chi2_per_n)
        after = math.sqrt(answer.error.validation_after.chi2_per_n)
    return Judged(
        index=case.index,
        kind=case.kind,
        truth=secret.truth,
        sizes=secret.sizes,
        detectable=_detectable(secret),
        verdict=answer.verdict,
        named=named,
        ties=[(tie.name, tie.separating_plan) for e in answer.effects for tie in e.ties],
        outcome=outcome,
        intervals=intervals,
        parameters=parameters,
        validation=after,
        validation_before=before,
        formula=answer.free_form[0].formula if answer.free_form else "",
        seconds=answer.seconds,
    )


def failed(case: Case, secret: Secret, error: str) -> Judged:
    """Return a case whose finder failed."""
    return Judged(
        case.index,
        case.kind,
        secret.truth,
        secret.sizes,
        _detectable(secret),
        "",
        [],
        [],
        "failed",
        error=error,
    )


def _detectable(secret: Secret) -> bool:
    return all(size >= DETECTABLE for size in secret.sizes.values())


def _outcome(case: Case, secret: Secret, answer: Diagnosis) -> Outcome:
    if answer.verdict == "unknown":
        return "unknown"
    named = [finding.name for finding in answer.effects]
    truth = list(secret.truth)
    if sorted(named) == sorted(truth):
        return "exact"
    if not named:
        return "missed"
    if case.kind == "outside":
        return "named_right" if _right_but_for_exponent(secret, answer) else "misnamed"
    found = matched(answer, truth)
    if found is None:
        return "misnamed"
    left, tests = found
    if left:
        return "partial"
    return "tied" if all(tests) else "tied_without_test"


def _right_but_for_exponent(secret: Secret, answer: Diagnosis) -> bool:
    if secret.resembles is None or len(answer.effects) != 1:
        return False
    name, exponent = secret.resembles
    finding = answer.effects[0]
    if finding.name != name or exponent not in finding.coefficients:
        return False
    (values,) = secret.truth.values()
    estimate = finding.coefficients[exponent]
    return abs(estimate.value - values[exponent]) <= max(_SAME_EXPONENT, 3.0 * estimate.standard_error)
