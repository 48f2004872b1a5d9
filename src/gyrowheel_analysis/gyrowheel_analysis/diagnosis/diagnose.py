"""The diagnosis of recordings: verdict, evidence, ties with the test that separates them, the error that falls."""

from __future__ import annotations

import platform
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from gyrowheel_analysis.criteria import (
    CHI2_RANGE,
    DRIFT_OR_MAP,
    MISSTATED,
    RIVAL_LOSS,
    SETTLING_SEPARATION,
    USEFUL_SEPARATION,
)
from gyrowheel_analysis.diagnosis.correction import Corrected, correct, proof_of
from gyrowheel_analysis.diagnosis.estimates import (
    Beyond,
    DetectionLimit,
    Estimate,
    Misstated,
    NuisanceEstimate,
)
from gyrowheel_analysis.diagnosis.events import (
    as_events,
    by_attitude,
    drift_shapes,
    missing_laws,
    unused_events,
    with_sizes,
)
from gyrowheel_analysis.diagnosis.experiment_design import Planner, Separation, detection_limits
from gyrowheel_analysis.diagnosis.explanation import Explanation
from gyrowheel_analysis.diagnosis.findings import (
    EffectFinding,
    FreeForm,
    InstrumentFinding,
    NextTest,
    RivalReport,
    TieReport,
)
from gyrowheel_analysis.diagnosis.free_forms import places, whole_exponents, with_exponents
from gyrowheel_analysis.diagnosis.kept_explanation import code_key, explanation_of
from gyrowheel_analysis.diagnosis.limits import beyond, unusual
from gyrowheel_analysis.diagnosis.proof import lack_of_fit, prove
from gyrowheel_analysis.diagnosis.proof_result import Proof
from gyrowheel_analysis.diagnosis.result import Diagnosis, Verdict
from gyrowheel_analysis.diagnosis.selection import Finding, Tie
from gyrowheel_analysis.diagnosis.support import supported
from gyrowheel_analysis.diagnosis.uncertainty import error_parts, scatter
from gyrowheel_analysis.diagnosis.unknown import Proposal, alternatives, as_found
from gyrowheel_analysis.fitting.fit import ERRORS, Fit, Prior, Term, without_prior
from gyrowheel_analysis.fitting.preparation import Prepared, TooFewWindowsError, prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.windows import concatenate
from gyrowheel_analysis.residuals.error_table import errors_of, window_residuals
from gyrowheel_analysis.residuals.growth import growth
from gyrowheel_analysis.residuals.maps import regions
from gyrowheel_core import cache
from gyrowheel_core.arrays import one_thread
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mislabelled.find import wrong_setups
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import effect_to_mapping, registry, remembering
from gyrowheel_sim.effects.targets import INSTRUMENT_PARAMETERS
from gyrowheel_sim.effects.user_defined_line import effect_to_line
from gyrowheel_sim.parameter import Parameter

#: Channels of the instruments, as the parameters of the bench begin.
_CHANNELS = ("tilt", "spin_angle", "coil_voltage", "motor_voltage", "motor_current")

_MOST = 200  # kept diagnoses; one of an hour has some megabytes


@one_thread()
def diagnose(
    recordings: Sequence[Recording],
    model: Model,
    *,
    validate: Sequence[Recording] = (),
    averages: bool = False,
    mixed: bool = False,
    quick: bool = False,
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
        Further recordings of the machine on which nothing is fitted; the error on them shows whether the findings are
        confirmed.
    averages : bool
        Whether to use averages over whole revolutions alone, for recordings whose filters conceal harmonics.
    mixed : bool
        Whether recordings of different machines are allowed; if not, their inertias must agree.
    quick : bool
        Whether to leave out the next test, and detection limits that do not decide the verdict.
    progress : callable, optional
        Called with a line of text for each step. If it raises `SearchEnded`, the search ends with what it has.
    """
    began = clock.monotonic()
    say = progress or (lambda text: None)
    say("looking at the setup")

    def search() -> Diagnosis:
        return _diagnosed(recordings, model, validate, averages=averages, mixed=mixed, quick=quick, say=say)

    try:
        key = _key(recordings, model, validate, averages, mixed, quick)
    except cache.UNREADABLE:  # an effect of another package, for example
        found = search()
    else:
        found = cache.computed("diagnosis_", key, _MOST, search, lambda own: not own.ended)
    seconds = clock.monotonic() - began
    paths = tuple(str(own.path) for own in recordings)
    return replace(found, recordings=paths, model=model.origin, seconds=seconds, versions=_versions())


def _key(recordings: Sequence[Recording], model: Model, validate: Sequence[Recording], *options: bool) -> str:
    """Return a short name of everything that decides a diagnosis, with the paths, which its events contain."""
    about = [[(str(own.path), own.content) for own in sets] for sets in (recordings, validate)]
    described = (model.stated_bench.stated, model.to_mapping(), options)
    return cache.digest(code_key(model.library, model.declared), repr(about), repr(described))


def _diagnosed(
    recordings: Sequence[Recording],
    model: Model,
    validate: Sequence[Recording],
    *,
    averages: bool,
    mixed: bool,
    quick: bool,
    say: Callable[[str], None],
) -> Diagnosis:
    """Return a diagnosis without recordings, model, time and versions; see `diagnose`."""
    if wrong := wrong_setups([*recordings, *validate], model.reference_bench, mixed=mixed):
        return Diagnosis("insufficient_data", 0, (), "", setup=tuple(wrong))
    try:
        first = prepare(recordings, model, validate=validate, harmonics=not averages, progress=say)
    except TooFewWindowsError as few:
        return Diagnosis("insufficient_data", few.windows, (), "", coverage=few.coverage)
    if wrong_values := misstated(model, first.problem):
        return Diagnosis("insufficient_data", first.windows, (), "", misstated=wrong_values)
    say("looking for missing effects")
    explanation = supported(explanation_of(first, recordings, say), validate)
    say("judging ties" if quick else "judging ties, limits and the next test")
    found = _judged(explanation, recordings, validate, quick=quick)
    if _leaves_something(found) and not found.ended:
        say("fitting a map of the missing torque")
        paths = tuple(str(own.path) for own in recordings)
        if (corrected := correct(explanation, paths)) is not None:
            found = _with_map(found, corrected, validate)
    return found


def _judged(
    explanation: Explanation, recordings: Sequence[Recording], validate: Sequence[Recording], *, quick: bool
) -> Diagnosis:
    """Return the facts of an explanation: error, ties, limits, proof, verdict and the next test.

    Where nothing was found, what could hide decides the verdict, so that limits are part of a `quick` one.
    """
    paths = [str(r.path) for r in recordings]
    fitted, selection, proposal = explanation.fitted, explanation.selection, explanation.proposal
    problem, best = explanation.problem, explanation.best
    before = explanation.before
    windows = concatenate([b.windows for b in problem.balances])
    data = window_residuals(problem.balances, windows, before.residual, problem.noise)
    events = with_sizes(problem, best, explanation.happened, paths, fitted.validation)
    shapes = drift_shapes(problem, best, explanation.happened, paths, fitted.validation)
    events += unused_events(fitted.validation, best, validate)
    planner = Planner(problem, best)
    missing = [_beside(problem, proposal, t) for t in proposal.kept] if proposal else selection.findings
    findings = [_report(fitted, f, best, planner) for f in missing]
    findings.sort(key=lambda f: -f.delta_chi2)
    form = _with_ties(proposal, problem, planner) if proposal else None
    limits = [] if quick and (findings or form) else detection_limits(problem, best, selection.inflation)
    errors = errors_of(before, best, fitted)
    null = selection.null if proposal is None else problem.fit(())
    unused = as_events(events, [str(recording.path) for recording in validate])
    proof = prove(fitted, null, best, errors.table, unused)
    far = beyond(problem, best, [t for t in best.terms if proposal is None or t != proposal.term])
    lack = lack_of_fit(problem, best)
    verdict = _verdict(findings, proposal, limits, far, lack, proof)
    unexplained = verdict in ("nothing_missing", "insufficient_data") or _failed(proof)
    laws = missing_laws(problem, best, explanation.laws, paths)
    if (explanation.rejected or laws) and unexplained:
        verdict = "unknown"
    if explanation.ended:
        if verdict == "nothing_missing":
            verdict = "insufficient_data"
        elif _failed(proof) or max(problem.noise.scales.values(), default=1.0) > DRIFT_OR_MAP:
            verdict = "unknown"
    events, turned = by_attitude(events, [*recordings, *validate])
    if turned and verdict in ("nothing_missing", "insufficient_data"):
        verdict = "ambiguous"
    readings = fitted.readings(problem.bench)
    return Diagnosis(
        verdict=verdict,
        windows=fitted.windows,
        recordings=(),
        model="",
        effects=tuple(f for f in findings if not is_instrument(f.name)),
        instruments=tuple(
            wrong for f in findings if is_instrument(f.name) for wrong in _instruments(f, problem.bench)
        ),
        free_form=(form,) if form else (),
        rejected=explanation.rejected,
        error=errors.table,
        where=tuple(regions(data, problem.bench)),
        next_test=None
        if quick
        else _next_test([*findings, *([form] if form else [])], limits, planner, verdict),
        limits=tuple(limits),
        events=tuple(events),
        turned=tuple(turned),
        laws=tuple(laws),
        drift_shapes=tuple(shapes),
        readings=readings.found,
        hum_unknown=readings.hum_unknown,
        proof=proof,
        beyond=tuple(far),
        ended=explanation.ended,
        lack_of_fit=lack,
        nuisance=nuisance_estimates(problem, best),
        drift_scales=dict(problem.noise.scales),
        residuals=tuple(errors.residuals),
        coverage=fitted.coverage,
    )


def _leaves_something(found: Diagnosis) -> bool:
    """Whether something may be missing beyond what was found.

    An enlarged drift may be it where nothing was found, or a law with a memory, which may follow it slowly.
    """
    names = {f.name for f in found.effects} | {f.name for f in found.instruments}
    open_to_drift = not (names or found.free_form) or names & remembering().keys()
    drifts = max(found.drift_scales.values(), default=1.0) > DRIFT_OR_MAP
    if open_to_drift and drifts:
        return True
    proven = found.proof is not None and found.proof.proven
    if found.free_form and proven and not (drifts or found.beyond or found.lack_of_fit > CHI2_RANGE):
        return False  # the form describes all
    return found.verdict == "unknown" or (found.proof is not None and _failed(found.proof))


def _failed(proof: Proof) -> bool:
    """Whether what was found leaves something in data on which it was not fitted."""
    return proof.proven is False and proof.reason in ("misfit", "channel", "dependence")


def _with_map(found: Diagnosis, corrected: Corrected, validate: Sequence[Recording]) -> Diagnosis:
    """Return a diagnosis with the map in place of all that describes the recordings worse."""
    problem, best, own = corrected.prepared.problem, corrected.after, corrected.map
    kept = {t.name: t for t in best.terms}
    unused = unused_events(corrected.prepared.validation, best, validate)
    paths = [str(recording.path) for recording in validate]
    return replace(
        found,
        verdict="unknown",
        map=own,
        effects=tuple(
            replace(f, coefficients=estimates(problem, kept[f.name], best), ties=())
            for f in found.effects
            if f.name in kept
        ),
        instruments=tuple(f for f in found.instruments if f.name in kept),
        free_form=(),
        rejected=(),
        error=own.error,
        events=tuple(e for e in found.events if problem.events or e.recording in paths),
        drift_shapes=found.drift_shapes if problem.events else (),
        beyond=tuple(b for b in found.beyond if b.name in kept),
        next_test=None,
        proof=proof_of(corrected, as_events(unused, paths)),
        lack_of_fit=lack_of_fit(problem, best),
        nuisance=nuisance_estimates(problem, best),
        drift_scales=dict(problem.noise.scales),
        residuals=tuple(corrected.errors.residuals),
    )


def _beside(problem: Problem, proposal: Proposal, term: Term) -> Finding:
    """Return an effect next to a free form, without ties: while something is unknown they have little meaning."""
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
    """Return the verdict.

    Impossible values, an unexplained part of the recordings, or effects that improve no prediction where they should,
    are no explanation.
    """
    unexplained = lack > CHI2_RANGE
    if proposal is not None or any(b.kind == "impossible" for b in far):
        return "unknown"
    if findings:
        if proof.proven is False and proof.reason == "no_gain":
            return "unknown"
        return _verdict_of(findings, far, unexplained=unexplained)
    missed = proof.proven is False and (
        proof.chi2_per_n > proof.allowed or proof.reason in ("channel", "dependence")
    )
    if unexplained or far or (missed and proof.reason not in ("unfixed", "event")):
        return "unknown"
    blind = bool(limits) and not any(limit.visible for limit in limits)
    return "insufficient_data" if blind or proof.proven is False else "nothing_missing"


def _verdict_of(findings: list[EffectFinding], far: list[Beyond], *, unexplained: bool) -> Verdict:
    """Return the verdict where effects were found.

    Alone, an effect may have any possible size; one of several may only compensate for another. The zero of an encoder,
    or a delay, is set by the builder of the bench: no size of it is unusual.
    """
    odd = {b.name for b in far if b.kind == "unusual" and not is_instrument(b.name)}
    # where something of a usual size is as likely, the tie is the open question
    tied = {f.name for f in findings if any(not tie.unusual for tie in f.ties)}
    if (odd and unexplained) or (odd - tied and len(findings) > 1):
        return "unknown"
    return "ambiguous" if any(f.ties for f in findings) else "effect"


def _report(fitted: Prepared, finding: Finding, best: Fit, planner: Planner) -> EffectFinding:
    problem, term = fitted.problem, finding.term
    windows = concatenate([b.windows for b in problem.balances])
    # the part of the effect alone: everything else stays as fitted with it
    others = {name: values for name, values in best.coefficients.items() if name != term.name}
    alone = problem.measured - problem.predict(replace(best.point, coefficients=others))
    data = window_residuals(problem.balances, windows, alone, problem.noise)
    ties = []
    for tie in finding.ties:
        known = tie.partner is None and tie.term.name in problem.unknowns.known
        title = " + ".join(t.effect.title if t.effect else t.name for t in tie.terms)
        own = _tie(planner, best, tie, " + ".join(t.name for t in tie.terms), title)
        ties.append(replace(own, in_model=known, unusual=any(unusual(tie.fit, t) for t in tie.terms)))
    return EffectFinding(
        name=term.name,
        effect_title=term.effect.title if term.effect else "",
        effect_sentence=term.effect.sentence_for(best.coefficients[term.name]) if term.effect else "",
        coefficients=estimates(problem, term, best),
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


def estimates(problem: Problem, term: Term, fit: Fit) -> dict[str, Estimate]:
    """Return the coefficients of a term as fitted, with the priors of its shapes and the parts of their errors."""
    found = {}
    declared = {c.name: c for c in term.effect.coefficients} if term.effect else {}
    parts = error_parts(problem, fit)
    for name in term.coefficients:
        value, error = fit.coefficients[term.name][name], fit.standard_error(term.name, name)
        own, c = parts[term.name, name], declared.get(name)
        along = np.zeros(len(fit.covariance))
        along[len(fit.nuisance) + fit.columns.index((term.name, name))] = 1.0
        noise = scatter(problem, fit, along)
        if c is None or c.shape is None or c.shape_uncertainty == 0.0:
            found[name] = Estimate(value, error, "1" if c is None else c.unit, parts=own, scatter=noise)
            continue
        prior = Prior(problem.unknowns.null(term)[name], c.shape_uncertainty)
        source = "the model" if term.name in problem.unknowns.known else c.source
        data = without_prior(value, error, prior)
        found[name] = Estimate(
            value, error, c.unit, prior, data, source, own, data and noise * (data[1] / error) ** 2
        )
    return found


def _tie(planner: Planner, best: Fit, tie: Tie, name: str, title: str = "") -> TieReport:
    """Return a term that explains the recordings as well, and the plan that separates the two; none if none does."""
    # of two terms together, more data show that one does not suffice
    found = planner.best(best, tie.fit) if tie.partner is None else planner.best(tie.fit, best)
    if found is None or found.expected < USEFUL_SEPARATION:
        return TieReport(name, title, tie.delta_chi2, None, None, None)
    return TieReport(name, title, tie.delta_chi2, found.plan, found.expected, found.minutes)


def _with_ties(proposal: Proposal, problem: Problem, planner: Planner) -> FreeForm:
    """Return a proposed form with the forms that describe the recordings as well."""
    ties = []
    for tie in alternatives(problem, proposal):
        form = _free_form(Proposal(tie.term, tie.fit, proposal.gain - tie.delta_chi2), problem)
        ties.append(replace(_tie(planner, proposal.fit, tie, form.name), form=form))
    return replace(_free_form(proposal, problem), ties=tuple(ties))


def _free_form(proposal: Proposal, problem: Problem) -> FreeForm:
    effect = as_found(proposal, problem.unknowns.known)
    found = estimates(problem, proposal.term, proposal.fit)
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
    findings: list[EffectFinding | FreeForm], limits: list[DetectionLimit], planner: Planner, verdict: Verdict
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
        # to integrate a state along every plan takes longer than all the rest
        unseen = dict.fromkeys(limit.effect for limit in limits if not limit.visible)
        best: tuple[Separation, str] | None = None
        for effect in (name for name in unseen if name not in remembering()):
            shown = planner.revealing(effect)
            if (
                shown
                and shown.expected >= SETTLING_SEPARATION
                and (best is None or shown.expected / shown.minutes > best[0].expected / best[0].minutes)
            ):
                best = (shown, effect)
        if best is not None:
            return NextTest(best[0].plan, best[0].expected, best[0].minutes, reveals=best[1])
    return None


def is_instrument(name: str) -> bool:
    """Whether a finding of this name is a deviation of an instrument."""
    effect = registry().get(name)
    return effect is not None and effect.category == "instrument"


def _instruments(finding: EffectFinding, bench: Bench) -> list[InstrumentFinding]:
    """Return the findings of an instrument effect, one for each parameter."""
    result = []
    for law in registry()[finding.name].laws:
        if law.target not in INSTRUMENT_PARAMETERS:
            continue
        (symbol,) = law.expression.free_symbols
        estimate, stated = finding.coefficients[symbol.name], bench.value(law.target)
        channel = _channel_of(law.target)
        result.append(
            InstrumentFinding(
                name=finding.name,
                channel=channel,
                quantity=law.target.removeprefix(f"{channel}_"),
                value=stated + estimate.value,
                standard_error=estimate.standard_error,
                stated=stated,
                unit=bench.parameters[law.target].unit,
                delta_chi2=finding.delta_chi2,
                ties=finding.ties,
                title=finding.effect_title,
                sentence=finding.effect_sentence,
            )
        )
    return result


def _channel_of(parameter: str) -> str:
    """Return the channel to which a parameter of an instrument belongs; the encoder reads the angle of the shaft."""
    if parameter.startswith("encoder_"):
        return "spin_angle"
    return next(channel for channel in _CHANNELS if parameter.startswith(f"{channel}_"))


def nuisance_estimates(problem: Problem, fit: Fit) -> dict[str, NuisanceEstimate]:
    """Return the bench's uncertain parameters as fitted, by name; a group's members each.

    What a finding states of a parameter is part of its estimate: the error of the parameter, or what an effect that was
    found adds to it. That has no prior, so their sum has none.
    """
    result = {}
    values = problem.unknowns.values(fit)
    for index, (group, parameters) in enumerate(problem.unknowns.nuisances):
        for p in parameters:
            along = np.zeros(len(fit.covariance))
            along[index] = p.uncertainty
            # the errors of parameters are in the values, effects are not
            value, found = values[p.name], False
            for term in fit.terms:
                null = problem.unknowns.null(term)
                for name, size in _of_parameter(term, group, p, fit).items():
                    found = True
                    along[len(fit.nuisance) + fit.columns.index((term.name, name))] += size
                    if term.effect is not None:
                        value += size * (fit.coefficients[term.name][name] - null[name])
            error = float(np.sqrt(along @ fit.covariance @ along))
            data = (value, error) if found else without_prior(value, error, Prior(p.value, p.uncertainty))
            repeats = data and scatter(problem, fit, along) * (data[1] / error) ** 2
            result[p.name] = NuisanceEstimate(value, error, p.value, p.uncertainty, p.unit, data, repeats)
    return result


def _of_parameter(term: Term, group: str, parameter: Parameter, fit: Fit) -> dict[str, float]:
    """Return the change of a parameter by each coefficient of a term, of those whose deviations the term replaces."""
    if term.effect is None:
        return {"relative_error": parameter.value} if group in ERRORS[term.name] else {}
    if parameter.name not in INSTRUMENT_PARAMETERS:
        return {}
    at = fit.coefficients[term.name]
    return {
        symbol.name: float(law.expression.diff(symbol).subs(at))
        for law in term.effect.laws
        if law.target == parameter.name
        for symbol in law.expression.free_symbols
    }


def misstated(model: Model, problem: Problem) -> tuple[Misstated, ...]:
    """Return the bench parameters that a model file has far from their stated values and those of the recordings."""
    if not model.overrides:
        return ()
    found = nuisance_estimates(problem, problem.fit(()))
    return tuple(
        Misstated(name, own.value, n.value, n.standard_error, n.unit)
        for name, own in model.overrides.items()
        if (n := found.get(name)) is not None
        and n.prior_uncertainty > 0.0
        and min(abs(own.value - n.value), abs(own.value - n.prior_value)) > MISSTATED * n.prior_uncertainty
    )


def _versions() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for name in ("gyrowheel_sim", "gyrowheel_analysis", "numpy", "scipy", "sympy", "numba"):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return versions
