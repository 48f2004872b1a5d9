"""The diagnosis of recordings: verdict, evidence, ties with the test that separates them, the error that falls."""

from __future__ import annotations

import platform
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from gyrowheel_analysis.criteria import CHI2_RANGE, RIVAL_LOSS, SETTLING_SEPARATION, USEFUL_SEPARATION
from gyrowheel_analysis.diagnosis.events import (
    as_events,
    drift_shapes,
    explain,
    unused_events,
    with_sizes,
)
from gyrowheel_analysis.diagnosis.experiment_design import Planner, Separation, detection_limits
from gyrowheel_analysis.diagnosis.instruments import (
    instrument_findings,
    is_instrument,
)
from gyrowheel_analysis.diagnosis.limits import beyond, unusual
from gyrowheel_analysis.diagnosis.proof import lack_of_fit, prove
from gyrowheel_analysis.diagnosis.result import (
    Beyond,
    DetectionLimit,
    Diagnosis,
    EffectFinding,
    Estimate,
    FreeForm,
    NextTest,
    NuisanceEstimate,
    Proof,
    RivalReport,
    TieReport,
    Verdict,
)
from gyrowheel_analysis.diagnosis.selection import Finding, select
from gyrowheel_analysis.diagnosis.unknown import (
    Proposal,
    as_found,
    places,
    settled,
    whole_exponents,
    with_exponents,
)
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.preparation import Prepared, TooFewWindowsError, one_thread, prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.fitting.terms import ERRORS, Term, candidate_terms
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction import concatenate
from gyrowheel_analysis.residuals.error_table import errors_of
from gyrowheel_analysis.residuals.growth import growth
from gyrowheel_analysis.residuals.regions import regions
from gyrowheel_analysis.residuals.windows import window_residuals
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mislabelled.find import wrong_setups
from gyrowheel_sim.effects import effect_to_mapping
from gyrowheel_sim.effects.user_defined_line import effect_to_line


@one_thread()
def diagnose(
    recordings: Sequence[Recording],
    model: Model,
    *,
    validate: Sequence[Recording] = (),
    averages: bool = False,
    mixed: bool = False,
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
    mixed : bool
        Whether recordings of different machines are wanted; if not, their inertias must agree.
    progress : callable, optional
        Called with a line of text now and then.
    """
    began = clock.monotonic()
    say = progress or (lambda text: None)
    paths = tuple(str(r.path) for r in recordings)

    def insufficient(**facts: Any) -> Diagnosis:
        return Diagnosis(
            "insufficient_data",
            recordings=paths,
            model=model.origin,
            seconds=clock.monotonic() - began,
            versions=_versions(),
            **facts,
        )

    say("looking at the setup")
    if wrong := wrong_setups([*recordings, *validate], model.reference_bench, mixed=mixed):
        return insufficient(windows=0, setup=tuple(wrong))
    try:
        first = prepare(recordings, model, validate=validate, harmonics=not averages, progress=progress)
    except TooFewWindowsError as few:
        return insufficient(windows=few.windows, coverage=few.coverage)
    say("looking for missing effects")
    selection = select(first.problem, progress=progress)
    fitted = first.reweighed(selection.best)
    if fitted is not first:
        selection = select(fitted.problem, progress=progress)
    outcome = explain(fitted.problem, selection, recordings, progress)
    selection, proposal = outcome.selection, outcome.proposal
    fitted = replace(fitted, problem=outcome.problem)
    if proposal is not None:
        fitted = replace(fitted, problem=fitted.problem.with_drift_estimated(proposal.fit))
        proposal = settled(fitted.problem, proposal)
    problem = fitted.problem
    best = proposal.fit if proposal else selection.best
    before = problem.fit_within() if proposal or selection.findings else best
    data = window_residuals(
        problem.balances,
        concatenate([b.windows for b in problem.balances]),
        before.residual,
        problem.noise.deviation(),
    )
    events = with_sizes(problem, best, outcome.events, paths)
    shapes = drift_shapes(problem, best, outcome.events, paths)
    if fitted.validation is not None:
        events += unused_events(fitted.validation.problem, best, validate)
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
        if limit.term.name not in problem.unknowns.known and limit.term.effect is not None
        for c in limit.term.effect.coefficients
        if c.name == limit.coefficient
    ]
    errors = errors_of(before, best, fitted)
    null = selection.null if proposal is None else problem.fit(())
    unused = as_events(events, [str(recording.path) for recording in validate])
    proof = prove(fitted, null, best, errors.table, unused)
    far = beyond(problem, best, [t for t in best.terms if proposal is None or t != proposal.term])
    lack = lack_of_fit(problem, best)
    verdict = _verdict(findings, proposal, limits, far, lack, proof)
    readings = fitted.readings(problem.bench)
    return Diagnosis(
        verdict=verdict,
        windows=fitted.windows,
        effects=tuple(f for f in findings if not is_instrument(f.name)),
        free_form=(_free_form(proposal, problem),) if proposal else (),
        error=errors.table,
        where=tuple(regions(data, problem.bench)),
        next_test=_next_test(findings, limits, planner, verdict),
        nuisance=nuisance_estimates(problem, best),
        limits=tuple(limits),
        residuals=tuple(errors.residuals),
        recordings=paths,
        model=model.origin,
        drift_scales=dict(problem.noise.scales),
        seconds=clock.monotonic() - began,
        versions=_versions(),
        coverage=fitted.coverage,
        events=tuple(events),
        beyond=tuple(far),
        lack_of_fit=lack,
        proof=proof,
        drift_shapes=tuple(shapes),
        instruments=tuple(
            wrong
            for f in findings
            if is_instrument(f.name)
            for wrong in instrument_findings(f, problem.bench)
        ),
        readings=readings.found,
        hum_unknown=readings.untold,
    )


def _beside(problem: Problem, proposal: Proposal, term: Term) -> Finding:
    """Return an effect that stands beside a free form; what else could is not asked while something is unknown."""
    without = problem.fit(tuple(t for t in proposal.fit.terms if t != term), proposal.fit)
    return Finding(term, without.chi2 - proposal.fit.chi2, (), (), without)


def _verdict(
    findings: list[EffectFinding],
    proposal: Proposal | None,
    limits: list[DetectionLimit],
    far: list[Beyond],
    lack: float,
    proof: Proof,
) -> Verdict:
    """Return the verdict. What is impossible, or does not explain the recordings, is no explanation."""
    unexplained = lack > CHI2_RANGE
    if proposal is not None or any(b.kind == "impossible" for b in far):
        return "unknown"
    if findings:
        # alone, an effect of any possible size may be what it is; several may only make up for another one
        # (the zero of an encoder, or a delay, is set by whoever builds the bench)
        odd = {b.name for b in far if b.kind == "unusual" and not is_instrument(b.name)}
        # where something of a usual size is as likely, the tie is what is open
        tied = {f.name for f in findings if any(not tie.unusual for tie in f.ties)}
        if (odd and unexplained) or (odd - tied and len(findings) > 1):
            return "unknown"
        return "ambiguous" if any(f.ties for f in findings) else "effect"
    missed = proof.proven is False and proof.chi2_per_n > proof.allowed
    if unexplained or far or (missed and proof.reason not in ("unfixed", "event")):
        return "unknown"
    blind = bool(limits) and not any(limit.visible for limit in limits)
    return "insufficient_data" if blind or proof.proven is False else "nothing_missing"


def _report(fitted: Prepared, finding: Finding, best: Fit, planner: Planner) -> EffectFinding:
    problem, term = fitted.problem, finding.term
    windows = concatenate([b.windows for b in problem.balances])
    # what the effect alone explains: everything else stays as fitted with it
    others = {name: values for name, values in best.coefficients.items() if name != term.name}
    alone = problem.measured - problem.predict(replace(best.point, coefficients=others))
    data = window_residuals(problem.balances, windows, alone, problem.noise.deviation())
    ties = []
    for tie in finding.ties:
        separation = planner.best(best, tie.fit)
        useful = separation if separation and separation.expected >= USEFUL_SEPARATION else None
        ties.append(
            TieReport(
                tie.term.name,
                tie.term.effect.title if tie.term.effect else "",
                tie.delta_chi2,
                useful.plan if useful else None,
                useful.expected if useful else None,
                useful.minutes if useful else None,
                in_model=tie.term.name in problem.unknowns.known,
                unusual=bool(unusual(tie.fit, tie.term)),
            )
        )
    return EffectFinding(
        name=term.name,
        effect_title=term.effect.title if term.effect else "",
        effect_sentence=term.effect.sentence if term.effect else "",
        coefficients=estimates(term, best),
        delta_chi2=finding.delta_chi2,
        formula=term.effect.formula
        if term.effect
        else f"{', '.join(ERRORS[term.name])} = stated * (1 + relative_error)",
        growth=tuple(growth(data)),
        rivals=tuple(
            RivalReport(rival.term.name, rival.delta_chi2)
            for rival in finding.rivals
            if rival.delta_chi2 < RIVAL_LOSS * finding.delta_chi2
        ),
        ties=tuple(ties),
        in_model=_in_model(term, problem),
    )


def _in_model(term: Term, problem: Problem) -> dict[str, Estimate] | None:
    if term.effect is None or term.name not in problem.unknowns.known:
        return None
    errors = problem.unknowns.known_errors.get(term.name, {})
    return {
        c.name: Estimate(problem.unknowns.known[term.name][c.name], errors.get(c.name, 0.0), c.unit)
        for c in term.effect.coefficients
    }


def estimates(term: Term, fit: Fit) -> dict[str, Estimate]:
    """Return the coefficients of a term as fitted."""
    units = {c.name: c.unit for c in term.effect.coefficients} if term.effect else {"relative_error": "1"}
    return {
        name: Estimate(fit.coefficients[term.name][name], fit.standard_error(term.name, name), units[name])
        for name in term.coefficients
    }


def _free_form(proposal: Proposal, problem: Problem) -> FreeForm:
    effect = as_found(proposal, problem.unknowns.known)
    found = estimates(proposal.term, proposal.fit)
    whole = whole_exponents(effect, {name: (own.value, own.standard_error) for name, own in found.items()})
    return FreeForm(
        effect_to_line(effect),
        proposal.gain,
        found,
        effect.sentence,
        effect.name,
        effect_to_mapping(effect),
        {
            name: Estimate(found[name].value * size, found[name].standard_error * size, unit)
            for name, (size, unit) in places(proposal.term, problem.bench).items()
        },
        effect_to_line(with_exponents(effect, whole)) if whole else "",
        whole,
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
            separates=(finding.name, tie.name),
        )
    if verdict in ("nothing_missing", "insufficient_data", "effect"):
        # the unseen effect that a test would show most clearly at its usual size
        hidden = [limit for limit in limits if not limit.visible]
        best: tuple[Separation, str] | None = None
        for limit in hidden:
            shown = planner.revealing(limit.effect)
            if (
                shown
                and shown.expected >= SETTLING_SEPARATION
                and (best is None or shown.expected / shown.minutes > best[0].expected / best[0].minutes)
            ):
                best = (shown, limit.effect)
        if best is not None:
            return NextTest(best[0].plan, best[0].expected, best[0].minutes, reveals=best[1])
    return None


def nuisance_estimates(problem: Problem, fit: Fit) -> dict[str, NuisanceEstimate]:
    """Return the bench's uncertain parameters as fitted, by name; a group's members each."""
    result = {}
    values = problem.unknowns.values(fit)
    for index, (_, parameters) in enumerate(problem.unknowns.nuisances):
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
