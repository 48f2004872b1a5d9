"""The judge of a case: compares diagnosis and secret. No other part sees both."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from gyrowheel.blind_tests.judge import Outcome, imitated, judge_names
from gyrowheel.campaigns.cases import Case
from gyrowheel.campaigns.hidden import Secret
from gyrowheel_analysis.diagnosis.estimates import INTERVAL_95, Estimate
from gyrowheel_analysis.diagnosis.findings import TieReport
from gyrowheel_analysis.diagnosis.result import Diagnosis
from gyrowheel_sim.effects import registry
from gyrowheel_sim.effects.targets import INSTRUMENT_PARAMETERS

#: Smallest size, in detection limits, at which an effect counts as detectable.
DETECTABLE = 2.0
_SAME_EXPONENT = 0.15  # tolerance of an exponent, where its standard error is smaller
#: Tolerance of the date of an event [s]; for the beginning of a trend at least three standard errors.
DATED = 2.0


@dataclass(frozen=True)
class Interval:
    """A fitted value with its standard error, and the true value."""

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
class InstrumentJudged:
    """A wrong instrument: name, size over its detection limit, and whether it was found.

    `found` is ``named``, ``tied`` (it is an alternative of something named) or ``missed``.
    """

    name: str
    size: float
    found: Literal["named", "tied", "missed"]

    @property
    def detectable(self) -> bool:
        """Whether it is at least `DETECTABLE` times its detection limit."""
        return self.size >= DETECTABLE


@dataclass(frozen=True)
class EventJudged:
    """A hidden event: name, beginning [s], size over its detection limit, and whether it was dated.

    `off` is the distance to the nearest reported event [s]; infinite without one.
    """

    name: str
    begin: float
    size: float
    off: float
    dated: bool

    @property
    def detectable(self) -> bool:
        """Whether it is at least `DETECTABLE` times its detection limit."""
        return self.size >= DETECTABLE


@dataclass(frozen=True)
class Judged:
    """A judged case.

    Attributes
    ----------
    index : int
        Number of the case.
    kind : str
        Kind of the case.
    truth : dict
        {effect: {coefficient: value}}.
    sizes : dict of str to float
        Sizes over the detection limits of this plan.
    detectable : bool
        Whether every hidden effect, or the event, is at least `DETECTABLE` times its detection limit.
    verdict : str
        Verdict; empty if the diagnosis failed.
    named : list of str
        Named effects.
    ties : list of (str, str or None)
        Named alternatives, with the plans that separate them.
    outcome : str
        See `gyrowheel.blind_tests.judge.OUTCOMES`.
    intervals : list of Interval
        Coefficients of the rightly named effects.
    parameters : list of Interval
        Fitted bench parameters, if no wrong effect was named.
    validation : float or None
        Error on the validation recording, in noise floors (root of chi-squared over N).
    validation_before : float or None
        The same for the model without the findings.
    formula : str
        Formula proposed for an unknown effect.
    seconds : float
        Duration of the diagnosis [s].
    error : str
        Why the diagnosis failed.
    instruments : list of InstrumentJudged
        The wrong instruments.
    instruments_named : list of str
        Named instruments.
    instruments_wrong : list of str
        Named instruments that are as stated, as are all their alternatives.
    event : EventJudged or None
        The hidden event.
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
    instruments: list[InstrumentJudged] = field(default_factory=list)
    instruments_named: list[str] = field(default_factory=list)
    instruments_wrong: list[str] = field(default_factory=list)
    event: EventJudged | None = None

    @property
    def right(self) -> bool:
        """Whether the answer is right: no false finding, and nothing detectable missed or misnamed.

        Missed instruments do not count here; see `instruments`.
        """
        if self.instruments_wrong:
            return False
        if self.kind == "outside":
            return self.outcome in ("unknown", "named_right")
        if self.outcome in ("exact", "tied"):
            return True
        return not self.detectable and self.outcome in ("missed", "partial", "tied_without_test")

    @property
    def too_small(self) -> bool:
        """Whether it is right only because what is hidden is too small to be found."""
        return self.right and self.kind != "outside" and self.outcome not in ("exact", "tied")

    @property
    def beside_unknown(self) -> bool:
        """Whether effects were named next to an unknown one: alone they are no answer."""
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
        return f"unknown with {names}" if self.beside_unknown else names or self.verdict

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
            "instruments": [asdict(item) for item in self.instruments],
            "instruments_named": self.instruments_named,
            "instruments_wrong": self.instruments_wrong,
            "event": None if self.event is None else asdict(self.event),
        }


def judge(case: Case, secret: Secret, answer: Diagnosis) -> Judged:
    """Compare a diagnosis with the secret."""
    named = [finding.name for finding in answer.effects]
    right = {name for name in named if name in secret.truth}
    outcome = _outcome(case, secret, answer)
    intervals = [
        _interval(f"{e.name}.{key}", estimate, secret.truth[e.name][key])
        for e in answer.effects
        if e.name in right and outcome in ("exact", "partial")
        for key, estimate in e.coefficients.items()
        if key in secret.truth[e.name]
    ]
    parameters = []
    if outcome == "exact" or (outcome == "missed" and not secret.truth):
        parameters = _parameters(case, secret, answer)
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
        instruments=_instruments(secret, answer),
        instruments_named=list(dict.fromkeys(finding.name for finding in answer.instruments)),
        instruments_wrong=[
            name
            for name, alternatives in _alternatives(secret, answer).items()
            if not alternatives & _hidden(secret)
        ],
        event=_event(secret, answer),
    )


def _parameters(case: Case, secret: Secret, answer: Diagnosis) -> list[Interval]:
    """Return fitted and true bench parameters.

    A wrong instrument changes the true value of its parameter. A parameter that a finding or its ties change is left
    out: where they are tied, its deviation may be in that of another one.
    """
    stated, known = case.campaign.bench, registry()
    truth = {name: secret.scenario.values.get(name, stated.value(name)) for name in answer.nuisance}
    for name, values in secret.instruments.items():
        for law in known[name].laws:
            if law.target in truth and law.target in INSTRUMENT_PARAMETERS:
                (symbol,) = law.expression.free_symbols
                truth[law.target] += values[symbol.name]
    named = {*answer.ties, *(name for ties in answer.ties.values() for tie in ties for name in tie.names)}
    changed = {law.target for name in named if name in known for law in known[name].laws}
    return [
        Interval(name, n.value, n.standard_error, truth[name])
        for name, n in answer.nuisance.items()
        if name not in changed
    ]


def _hidden(secret: Secret) -> set[str]:
    """Return the names of the hidden effects and of the instruments that are not as stated."""
    return {*secret.instruments, *secret.truth}


def _right(secret: Secret, ties: Iterable[TieReport]) -> set[str]:
    """Return the alternatives that are hidden; of two together both must be."""
    return {name for tie in ties if _hidden(secret).issuperset(tie.names) for name in tie.names}


def _alternatives(secret: Secret, answer: Diagnosis) -> dict[str, set[str]]:
    """Return the named instruments, each with itself and its right alternatives; it may be named several times."""
    result: dict[str, set[str]] = {}
    for finding in answer.instruments:
        result.setdefault(finding.name, {finding.name}).update(_right(secret, finding.ties))
    return result


def _instruments(secret: Secret, answer: Diagnosis) -> list[InstrumentJudged]:
    named = {f.name for f in answer.instruments}
    every = [*(f.ties for f in answer.effects), *(f.ties for f in answer.instruments)]
    tied = _right(secret, [tie for ties in every for tie in ties])
    return [
        InstrumentJudged(
            name, secret.sizes[name], "named" if name in named else "tied" if name in tied else "missed"
        )
        for name in secret.instruments
    ]


def _event(secret: Secret, answer: Diagnosis) -> EventJudged | None:
    if secret.event is None:
        return None
    begin, off, dated = secret.event.begin, math.inf, False
    for event in answer.events:
        distance = abs(event.time - begin)
        off = min(off, distance)
        within = max(DATED, 3.0 * event.time_error) if secret.event.shape == "trend" else DATED
        dated |= distance <= within
    return EventJudged(secret.event.name, begin, secret.sizes[secret.event.name], off, dated)


def failed(case: Case, secret: Secret, error: str) -> Judged:
    """Return a case whose diagnosis failed."""
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
        instruments=[InstrumentJudged(name, secret.sizes[name], "missed") for name in secret.instruments],
        event=None
        if secret.event is None
        else EventJudged(
            secret.event.name, secret.event.begin, secret.sizes[secret.event.name], math.inf, dated=False
        ),
    )


def _detectable(secret: Secret) -> bool:
    """Return whether all effects, or the event, are detectable; wrong instruments are counted separately."""
    return all(size >= DETECTABLE for name, size in secret.sizes.items() if name not in secret.instruments)


def _interval(name: str, estimate: Estimate, truth: float) -> Interval:
    """Return the stated interval of a coefficient, from all its uncertainties."""
    if estimate.parts is None:
        return Interval(name, estimate.value, estimate.standard_error, truth)
    low, high = estimate.parts.interval
    return Interval(name, 0.5 * (low + high), (high - low) / (2.0 * INTERVAL_95), truth)


def _outcome(case: Case, secret: Secret, answer: Diagnosis) -> Outcome:
    if answer.verdict == "unknown":
        return "unknown"
    # a look-alike below its limit may be named as well
    findings = [finding for finding in answer.effects if finding.name not in secret.alike]
    named = [finding.name for finding in findings]
    truth = list(secret.truth)
    if secret.event is not None and not named:
        event = _event(secret, answer)
        return "exact" if event is not None and event.dated else "missed"
    if sorted(named) == sorted(truth):
        return "exact"
    alternatives = imitated(answer, _hidden(secret))
    if not named and not secret.instruments and not alternatives.keys() & secret.truth.keys():
        return "missed"
    if case.kind == "outside":
        return "named_right" if _right_but_for_exponent(secret, answer) else "misnamed"
    outcome, _ = judge_names(findings, truth, instruments=secret.instruments, imitated=alternatives)
    return outcome


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
