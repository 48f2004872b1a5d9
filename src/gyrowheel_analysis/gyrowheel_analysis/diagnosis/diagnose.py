"""The diagnosis of recordings: verdict, evidence, ties with the test that separates them, the error that falls."""

from __future__ import annotations

import platform
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Literal

import numpy as np

from gyrowheel_analysis.diagnosis.selection import Finding, select
from gyrowheel_analysis.diagnosis.test_design import SETTLED, Planner, Separation, detection_limits
from gyrowheel_analysis.diagnosis.unknown import Proposal, search
from gyrowheel_analysis.fitting.preparation import FEWEST_WINDOWS, Prepared, errors_of, one_thread, prepare
from gyrowheel_analysis.fitting.problem import Fit, Problem
from gyrowheel_analysis.fitting.terms import ERRORS, Term, candidate_terms
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.recording import Recording
from gyrowheel_analysis.reduction import Coverage, concatenate
from gyrowheel_analysis.residuals.error_table import ErrorTable, Residuals
from gyrowheel_analysis.residuals.growth import growth
from gyrowheel_analysis.residuals.regions import Region, regions
from gyrowheel_analysis.residuals.windows import window_residuals
from gyrowheel_sim.effects import effect_to_mapping
from gyrowheel_sim.effects.typed import effect_to_line

Verdict = Literal["nothing_missing", "effect", "ambiguous", "unknown", "insufficient_data"]

#: A rival this part of the evidence worse explains nothing.
_EXPLAINS_NOTHING = 0.95
_ERROR_TITLES = {
    "stiffness_error": "flexure stiffness differs from the bench file",
    "gimbal_inertia_error": "gimbal inertia differs from the bench file",
    "shaft_inertia_error": "shaft inertia differs from the bench file",
    "rotor_inertia_error": "rotor spin inertia differs from the bench file",
    "coil_gain_error": "torque constant of the coils differs from the bench file",
    "motor_constant_error": "motor constant differs from the bench file",
}


@dataclass(frozen=True)
class Estimate:
    """A coefficient with its standard error, in `unit`."""

    value: float
    standard_error: float
    unit: str


@dataclass(frozen=True)
class TieReport:
    """A term that explains the recordings as well, and the test that would tell.

    `separating_plan` is None where no shipped plan separates the two.
    """

    name: str
    title: str
    delta_chi2: float
    separating_plan: str | None
    expected_separation: float | None
    minutes: float | None


@dataclass(frozen=True)
class EffectFinding:
    """An effect that the recordings ask for.

    `in_model` has the coefficients with which the model has it already; None where it is missing.
    """

    name: str
    title: str
    coefficients: dict[str, Estimate]
    delta_chi2: float
    formula: str
    sentence: str
    evidence: list[str]
    ties: list[TieReport]
    in_model: dict[str, Estimate] | None = None


@dataclass(frozen=True)
class FreeForm:
    """A formula that describes what no declared effect does.

    `formula` has law and coefficients in one line, as ``gyrowheel model add --formula`` takes it; `declaration` goes
    into a model file as it is, under `name`.
    """

    formula: str
    delta_chi2: float
    coefficients: dict[str, Estimate]
    description: str
    name: str = ""
    declaration: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class NextTest:
    """The test to run next."""

    plan: str
    expected_separation: float
    minutes: float
    reason: str


@dataclass(frozen=True)
class NuisanceEstimate:
    """A bench parameter as fitted along, beside its stated value."""

    value: float
    standard_error: float
    prior_value: float
    prior_uncertainty: float
    unit: str

    @property
    def pull(self) -> float:
        """Distance from the stated value in stated uncertainties."""
        return (self.value - self.prior_value) / self.prior_uncertainty


@dataclass(frozen=True)
class DetectionLimit:
    """The smallest size of an effect that these recordings could have shown."""

    effect: str
    title: str
    coefficient: str
    value: float
    unit: str
    usual: tuple[float, float]

    @property
    def visible(self) -> bool:
        """Whether an effect of a usual size could have been seen."""
        return self.value <= self.usual[1]


@dataclass(frozen=True)
class Diagnosis:
    """What is missing in a model, by the evidence of recordings.

    Attributes
    ----------
    verdict : str
        ``nothing_missing``, ``effect``, ``ambiguous``, ``unknown`` or ``insufficient_data``.
    summary : str
        The verdict as one sentence.
    effects : list of EffectFinding
        What is missing, strongest first.
    free_form : list of FreeForm
        For ``unknown``: a formula that describes it.
    error : ErrorTable or None
        The error without and with what was found; None for ``insufficient_data``.
    where : list of Region
        Where the model fails without it.
    next_test : NextTest or None
        The test that settles what is open.
    nuisance : dict of str to NuisanceEstimate
        The bench's uncertain parameters as fitted along.
    detection_limits : list of DetectionLimit
        What could not have been seen.
    residuals : list of Residuals
        Window by window, without and with what was found.
    recordings, model : list of str, str
        What was diagnosed.
    drift_scales : dict of str to float
        Size of the slow drifts over the stated size.
    seconds : float
        How long it took [s].
    versions : dict of str to str
        Of the programs that found it.
    coverage : Coverage
        How much of the recordings takes part.
    """

    verdict: Verdict
    summary: str
    effects: list[EffectFinding]
    free_form: list[FreeForm]
    error: ErrorTable | None
    where: list[Region]
    next_test: NextTest | None
    nuisance: dict[str, NuisanceEstimate]
    detection_limits: list[DetectionLimit]
    residuals: list[Residuals]
    recordings: list[str]
    model: str
    drift_scales: dict[str, float]
    seconds: float
    versions: dict[str, str] = field(default_factory=dict)
    coverage: Coverage = field(default_factory=Coverage)

    def to_json(self) -> dict[str, Any]:
        """Return the diagnosis as a JSON object."""

        def coefficients(values: dict[str, Estimate]) -> dict[str, Any]:
            return {
                name: {"value": e.value, "standard_error": e.standard_error, "unit": e.unit}
                for name, e in values.items()
            }

        return {
            "schema": 1,
            "verdict": self.verdict,
            "summary": self.summary,
            "effects": [
                {
                    "name": e.name,
                    "coefficients": coefficients(e.coefficients),
                    "delta_chi2": e.delta_chi2,
                    "formula": e.formula,
                    "evidence": e.evidence,
                    "in_model": None if e.in_model is None else coefficients(e.in_model),
                    "ties": [
                        {
                            "name": tie.name,
                            "delta_chi2": tie.delta_chi2,
                            "separating_plan": tie.separating_plan,
                            "expected_separation": tie.expected_separation,
                        }
                        for tie in e.ties
                    ],
                }
                for e in self.effects
            ],
            "free_form": [
                {
                    "name": f.name,
                    "formula": f.formula,
                    "delta_chi2": f.delta_chi2,
                    "coefficients": coefficients(f.coefficients),
                    "declaration": f.declaration,
                }
                for f in self.free_form
            ],
            "error": None if self.error is None else self.error.to_json(),
            "where": [region.to_json() for region in self.where],
            "next_test": None
            if self.next_test is None
            else {
                "plan": self.next_test.plan,
                "expected_separation": self.next_test.expected_separation,
                "minutes": self.next_test.minutes,
            },
            "nuisance": {
                name: {
                    "value": n.value,
                    "standard_error": n.standard_error,
                    "prior_value": n.prior_value,
                    "prior_uncertainty": n.prior_uncertainty,
                }
                for name, n in self.nuisance.items()
            },
            "detection_limits": [
                {
                    "effect": limit.effect,
                    "coefficient": limit.coefficient,
                    "value": limit.value if np.isfinite(limit.value) else None,
                    "unit": limit.unit,
                    "visible": limit.visible,
                }
                for limit in self.detection_limits
            ],
            "recordings": self.recordings,
            "model": self.model,
            "coverage": self.coverage.to_json(),
            "versions": self.versions,
        }


@one_thread()
def diagnose(
    recordings: Sequence[Recording],
    model: Model,
    *,
    validate: Sequence[Recording] = (),
    averages: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Find out which physical effect is missing in a model.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings of one machine.
    model : Model
        The model that disagrees with them.
    validate : sequence of Recording
        Further recordings of the machine on which nothing is fitted; the error on them shows whether what was
        found holds.
    averages : bool
        Whether to use averages over whole revolutions alone: for recordings in which filters hide what happens within
        one.
    progress : callable, optional
        Called with a line of text now and then.
    """
    began = clock.monotonic()
    say = progress or (lambda text: None)
    fitted = prepare(recordings, model, harmonics=not averages, progress=progress)
    validation = prepare(validate, model, harmonics=not averages, progress=progress) if validate else None
    paths = [str(r.path) for r in recordings]
    if fitted.windows < FEWEST_WINDOWS:
        text = (
            f"{fitted.windows} steady windows; at least {FEWEST_WINDOWS} are needed to tell anything; "
            f"{fitted.coverage.sentence()}"
        )
        return Diagnosis(
            "insufficient_data", text, [], [], None, [], None, {}, [], [], paths, model.origin, {},
            clock.monotonic() - began, _versions(), fitted.coverage,
        )  # fmt: skip
    problem = fitted.problem
    say("estimating noise and drift")
    problem.estimate_noise()
    say("looking for missing effects")
    selection = select(problem, progress=progress)
    if problem.reweigh(selection.best):
        if validation:
            validation.problem.reweigh(selection.best)
        selection = select(problem, progress=progress)
    proposal = search(problem, selection, progress=progress)
    if proposal is not None:
        problem.estimate_noise_with(proposal.fit)
    best = proposal.fit if proposal else selection.best
    before = problem.fit_within() if proposal or selection.findings else best
    data = window_residuals(
        problem.balances,
        concatenate([b.windows for b in problem.balances]),
        before.residual,
        problem.noise.deviation(),
    )
    say("judging ties, limits and the next test")
    planner = Planner(problem, best)
    if proposal:
        findings = [_report(fitted, _beside(problem, proposal, t), best, planner) for t in proposal.kept]
    else:
        findings = [_report(fitted, f, best, planner) for f in selection.findings]
    findings.sort(key=lambda f: -f.delta_chi2)
    limits = [
        DetectionLimit(
            limit.term.name,
            limit.term.effect.title if limit.term.effect else "",
            limit.coefficient,
            limit.value,
            c.unit,
            c.usual,
        )
        for limit in detection_limits(problem, best, candidate_terms(problem.bench), selection.inflation)
        if limit.term.name not in problem.known and limit.term.effect is not None
        for c in limit.term.effect.coefficients
        if c.name == limit.coefficient
    ]
    verdict, summary = _verdict(findings, proposal, limits)
    errors = errors_of(before, best, fitted, validation)
    return Diagnosis(
        verdict=verdict,
        summary=summary,
        effects=findings,
        free_form=[_free_form(proposal)] if proposal else [],
        error=errors.table,
        where=regions(data, problem.bench),
        next_test=_next_test(findings, limits, planner, verdict),
        nuisance=nuisance_estimates(problem, best),
        detection_limits=limits,
        residuals=errors.residuals,
        recordings=paths,
        model=model.origin,
        drift_scales=dict(problem.noise.scales),
        seconds=clock.monotonic() - began,
        versions=_versions(),
        coverage=fitted.coverage,
    )


def _beside(problem: Problem, proposal: Proposal, term: Term) -> Finding:
    """Return an effect that stands beside a free form; what else could is not asked while something is unknown."""
    without = problem.fit(tuple(t for t in proposal.fit.terms if t != term), proposal.fit)
    return Finding(term, without.chi2 - proposal.fit.chi2, (), (), without)


def _verdict(
    findings: list[EffectFinding], proposal: Proposal | None, limits: list[DetectionLimit]
) -> tuple[Verdict, str]:
    if proposal is not None:
        what = proposal.term.effect.sentence if proposal.term.effect else ""
        text = f"something is missing that no declared effect describes; a formula that does: {what}"
        if findings:
            text += f"; beside it: {' and '.join(f.name for f in findings)}"
        return "unknown", text
    if not findings:
        if limits and not any(limit.visible for limit in limits):
            return (
                "insufficient_data",
                "nothing was found, but these recordings could not have shown any usual effect",
            )
        return "nothing_missing", "the model explains the recordings within noise and stated uncertainties"
    missing = [f.name for f in findings if f.in_model is None]
    wrong = [f.name for f in findings if f.in_model is not None]
    names = "; ".join(
        f"{what}: {' and '.join(those)}"
        for what, those in (("missing", missing), ("of another size than in the model", wrong))
        if those
    )
    if any(f.ties for f in findings):
        tied = "; ".join(
            f"{f.name} cannot be told from {', '.join(t.name for t in f.ties)}" for f in findings if f.ties
        )
        return "ambiguous", f"{names}, but {tied}"
    return "effect", names


def _report(fitted: Prepared, finding: Finding, best: Fit, planner: Planner) -> EffectFinding:
    problem, term = fitted.problem, finding.term
    windows = concatenate([b.windows for b in problem.balances])
    # what the effect alone explains: everything else stays as fitted with it
    others = {name: values for name, values in best.coefficients.items() if name != term.name}
    alone = problem.measured - problem.predict(best.nuisance, others)
    data = window_residuals(problem.balances, windows, alone, problem.noise.deviation())
    evidence = [f"all else accounted for, {sentence}" for sentence in growth(data)]
    evidence.append(f"leaving it out worsens chi-squared by {finding.delta_chi2:.0f}, all else fitted again")
    evidence += [
        f"{rival.term.name} in its place is {rival.delta_chi2:.0f} worse"
        for rival in finding.rivals
        if rival.delta_chi2 < _EXPLAINS_NOTHING * finding.delta_chi2
    ]
    ties = []
    for tie in finding.ties:
        separation = planner.best(best, tie.fit)
        useful = separation if separation and separation.expected >= 9.0 else None
        ties.append(
            TieReport(
                tie.term.name,
                _title(tie.term, problem),
                tie.delta_chi2,
                useful.plan if useful else None,
                useful.expected if useful else None,
                useful.minutes if useful else None,
            )
        )
    return EffectFinding(
        name=term.name,
        title=_title(term, problem),
        coefficients=_estimates(term, best),
        delta_chi2=finding.delta_chi2,
        formula=term.effect.formula
        if term.effect
        else f"{', '.join(ERRORS[term.name])} = stated * (1 + relative_error)",
        sentence=term.effect.sentence
        if term.effect
        else "The parameter lies beyond five of its stated uncertainties.",
        evidence=evidence,
        ties=ties,
        in_model=_in_model(term, problem),
    )


def _title(term: Term, problem: Problem) -> str:
    if term.effect is None:
        return _ERROR_TITLES[term.name]
    return f"another size of the {term.effect.title}" if term.name in problem.known else term.effect.title


def _in_model(term: Term, problem: Problem) -> dict[str, Estimate] | None:
    if term.effect is None or term.name not in problem.known:
        return None
    errors = problem.known_errors.get(term.name, {})
    return {
        c.name: Estimate(problem.known[term.name][c.name], errors.get(c.name, 0.0), c.unit)
        for c in term.effect.coefficients
    }


def _estimates(term: Term, fit: Fit) -> dict[str, Estimate]:
    units = {c.name: c.unit for c in term.effect.coefficients} if term.effect else {"relative_error": "1"}
    return {
        name: Estimate(fit.coefficients[term.name][name], fit.standard_error(term.name, name), units[name])
        for name in term.coefficients
    }


def _free_form(proposal: Proposal) -> FreeForm:
    effect = proposal.term.effect
    assert effect is not None  # every free form is an effect
    return FreeForm(
        effect_to_line(effect),
        proposal.gain,
        _estimates(proposal.term, proposal.fit),
        effect.sentence,
        effect.name,
        effect_to_mapping(effect),
    )


def _next_test(
    findings: list[EffectFinding], limits: list[DetectionLimit], planner: Planner, verdict: Verdict
) -> NextTest | None:
    open_ties = [(f, tie) for f in findings for tie in f.ties if tie.separating_plan is not None]
    if open_ties:
        finding, tie = max(
            open_ties, key=lambda pair: (pair[1].expected_separation or 0.0) / (pair[1].minutes or 1.0)
        )
        return NextTest(
            str(tie.separating_plan),
            float(tie.expected_separation or 0.0),
            float(tie.minutes or 0.0),
            f"tells {finding.name} from {tie.name}",
        )
    if verdict in ("nothing_missing", "insufficient_data", "effect"):
        # the unseen effect that a test would show most clearly at its usual size
        hidden = [limit for limit in limits if not limit.visible]
        best: tuple[Separation, str] | None = None
        for limit in hidden:
            shown = planner.revealing(limit.effect)
            if (
                shown
                and shown.expected >= SETTLED
                and (best is None or shown.expected / shown.minutes > best[0].expected / best[0].minutes)
            ):
                best = (shown, limit.effect)
        if best is not None:
            return NextTest(
                best[0].plan,
                best[0].expected,
                best[0].minutes,
                f"would show a usual {best[1]}, which these recordings cannot",
            )
    return None


def nuisance_estimates(problem: Problem, fit: Fit) -> dict[str, NuisanceEstimate]:
    """Return the bench's uncertain parameters as fitted, by name; a group's members each."""
    result = {}
    values = problem.values(fit.nuisance, fit.coefficients)
    for index, (_, parameters) in enumerate(problem.nuisances):
        error = float(np.sqrt(fit.covariance[index, index]))
        for p in parameters:
            result[p.name] = NuisanceEstimate(
                values[p.name], error * p.uncertainty, p.value, p.uncertainty, p.unit
            )
    return result


def _versions() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for name in ("gyrowheel_sim", "gyrowheel_analysis", "numpy", "scipy", "sympy", "numba"):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return versions
