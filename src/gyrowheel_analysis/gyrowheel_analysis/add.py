"""Add effects to a model: refit, prove on recordings that were not used, write the history.

Where nobody knows a law, the missing torque is added as a smooth function: a correction map.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any, Literal

import numpy as np

from gyrowheel_analysis.criteria import DOUBTFUL, MOVED, UNCONSTRAINED
from gyrowheel_analysis.diagnosis.correction import applied, correct, proof_of
from gyrowheel_analysis.diagnosis.correction_map import CorrectionMap
from gyrowheel_analysis.diagnosis.dated_changes import DatedEvent
from gyrowheel_analysis.diagnosis.diagnose import estimates, nuisance_estimates
from gyrowheel_analysis.diagnosis.estimates import Estimate
from gyrowheel_analysis.diagnosis.events import (
    accepted,
    as_continued,
    as_events,
    beside_events,
    unused_events,
    with_sizes,
)
from gyrowheel_analysis.diagnosis.kept_explanation import explanation_of
from gyrowheel_analysis.diagnosis.limits import beyond, is_possible
from gyrowheel_analysis.diagnosis.proof import prove
from gyrowheel_analysis.diagnosis.proof_result import Proof
from gyrowheel_analysis.fitting.fit import ERRORS, Fit, Term, Unknowns
from gyrowheel_analysis.fitting.preparation import Progress, prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model, Override
from gyrowheel_analysis.residuals.error_table import ErrorTable, Residuals, errors_of
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.effects import Effect, effect_from_mapping, effect_to_mapping, get, registry
from gyrowheel_sim.effects.targets import INSTRUMENT_PARAMETERS
from gyrowheel_sim.effects.user_defined import check_name

#: Prefix for all effects of a model of the air: ``aero:MODEL``.
AIR = "aero"


@dataclass(frozen=True)
class Doubt:
    """A reason to doubt a result of a fit.

    Attributes
    ----------
    kind : str
        ``weak``: an added effect hardly differs from zero. ``moved``: a coefficient of the model moved farther than
        chance explains. ``off_air_model``: a coefficient lies far from that of the air model. ``unconstrained``: the
        recordings do not determine a coefficient of the air model. ``impossible``: an added effect has a physically
        impossible coefficient. ``unusual``: one is many times its usual size. ``bounded``: a bench parameter or a
        coefficient of the model ends at a limit of what a model file may hold, as the added effect takes its place.
    effect, coefficient : str
        The effect and its coefficient; the latter empty for ``weak`` and ``impossible``, and what ends at a limit for
        ``bounded``.
    size : float
        Distance [standard errors, or uncertainties of the air model], or times the largest usual size; 0 for
        ``unconstrained`` and ``impossible``.
    """

    kind: Literal["weak", "moved", "off_air_model", "unconstrained", "impossible", "unusual", "bounded"]
    effect: str
    coefficient: str = ""
    size: float = 0.0


@dataclass(frozen=True)
class Added:
    """Outcome of adding effects.

    Attributes
    ----------
    model : Model
        The model with the effects, the refitted bench parameters, and an entry in its history.
    coefficients : dict
        {effect: {coefficient: Estimate}}.
    error : ErrorTable
        The error before and after, on the fitted and on the validation recordings.
    residuals : tuple of Residuals
        Window by window, before and after.
    doubts : tuple of Doubt
        Reasons to doubt the result.
    events : tuple of DatedEvent
        Changes in the middle of a recording: part of the fit, but not of the prediction of validation recordings.
    proof : Proof
        Whether the model with the effects predicts data that were not fitted.
    """

    model: Model
    coefficients: dict[str, dict[str, Estimate]]
    error: ErrorTable
    residuals: tuple[Residuals, ...]
    doubts: tuple[Doubt, ...]
    events: tuple[DatedEvent, ...]
    proof: Proof


@one_thread()
def add_effect(
    model: Model,
    names: Sequence[str | Effect],
    fit: Sequence[Recording],
    validate: Sequence[Recording] = (),
    *,
    progress: Progress | None = None,
) -> Added:
    """Add effects to a model and refit it.

    Parameters
    ----------
    model : Model
        The model.
    names : sequence of str or Effect
        Effects, or errors of bench parameters (``stiffness_error`` and the like), to add. One that the model already
        has is fitted again. An `Effect` that is not registered goes into the model with its declaration. ``aero:MODEL``
        adds the effects of a model of the air (`gyrowheel_air.surrogate.MODELS`); their coefficients are fitted within
        the uncertainties that it states.
    fit : sequence of Recording
        Recordings on which coefficients and bench parameters are fitted.
    validate : sequence of Recording
        Recordings on which nothing is fitted.

    Raises
    ------
    InputError
        If an effect is unknown, the name of a formula is already in the model, the bench states as exact a parameter
        whose error is to be added, or the recordings have too little steady motion.
    """
    air = _air(model, [item for item in names if isinstance(item, str)])
    start = _with_air(model, air)
    terms, declared = _asked(model, start, names)
    if not terms and not air:
        raise InputError("no effect given")
    explanation = explanation_of(prepare(fit, start, validate=validate, progress=progress), fit, progress)
    if progress:
        progress("fitting")
    prepared = explanation.weighed
    # a new law may explain what else would pass for an event
    happened = (
        accepted(prepared.problem, prepared.problem.fit(terms), fit) if declared else explanation.happened
    )
    problem = beside_events(prepared.problem, terms, happened).with_scales(explanation.problem.noise.scales)
    before, after = _before(model, explanation.problem, air), problem.refined(problem.fit(terms))
    validation = as_continued(prepared.validation, problem, after, happened)
    prepared = replace(prepared, problem=problem, validation=validation)
    events = with_sizes(problem, after, happened, [str(r.path) for r in fit], validation)
    events += unused_events(prepared.validation, after, validate)
    errors = errors_of(before, after, prepared, explanation.fitted)
    coefficients = {term.name: estimates(problem, term, after) for term in terms}
    doubts = doubts_of(problem, after, terms, air)
    for name, found, own_doubts in _found_air(problem, after, air):
        coefficients[name] = found
        doubts += own_doubts
    what = _what([n for n in names if isinstance(n, str) and is_air(n)], terms, model)
    changed = _changed(model, problem, after, what, fit, validate, errors.table, coefficients, declared)
    null = problem.fit(()) if terms else after
    unused = as_events(events, [str(r.path) for r in validate])
    proof = prove(prepared, null, after, errors.table, unused)
    return Added(
        changed, coefficients, errors.table, tuple(errors.residuals), tuple(doubts), tuple(events), proof
    )


def _changed(
    model: Model,
    problem: Problem,
    after: Fit,
    what: str,
    fit: Sequence[Recording],
    validate: Sequence[Recording],
    table: ErrorTable,
    coefficients: Mapping[str, Mapping[str, Estimate]],
    declared: Mapping[str, Effect],
) -> Model:
    """Return a model with the effects of a fit, its bench parameters, and an entry of its history."""
    overrides = overrides_of(problem, after)
    entry: dict[str, Any] = {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "what": what,
        "fit": [str(r.path) for r in fit],
        "validate": [str(r.path) for r in validate],
        "error": table.to_json(),
    }
    if restated := restated_by(problem, after.terms, overrides):
        entry["restated"] = restated
    effects, errors = effects_of(model, problem, after, coefficients)
    return model.changed(entry, overrides=overrides, effects=effects, effect_errors=errors, declared=declared)


def overrides_of(problem: Problem, after: Fit) -> dict[str, Override]:
    """Return the bench parameters as fitted, without what the added effects add to those of instruments."""
    held = {law.target for term in after.terms if term.effect is not None for law in term.effect.laws}
    held &= set(INSTRUMENT_PARAMETERS)
    return {
        # the effect has the deviation, with its error
        name: Override(n.prior_value) if name in held else Override(n.value, n.standard_error)
        for name, n in nuisance_estimates(problem, after).items()
        if name not in problem.unknowns.assumed  # a property of the air of the day, not of the machine
    }


def doubts_of(
    problem: Problem, after: Fit, terms: Sequence[Term], air: Mapping[str, Mapping[str, tuple[float, float]]]
) -> list[Doubt]:
    """Return the reasons to doubt the added terms and the effects of the model, except those of the air."""
    sizes = [(term.name, after.significance(term.name)) for term in terms]
    doubts = [Doubt("weak", name, size=size) for name, size in sizes if size < DOUBTFUL]
    doubts += [Doubt("impossible", term.name) for term in terms if not is_possible(after, term)]
    doubts += [
        Doubt("unusual", b.name, b.coefficient, b.times)
        for b in beyond(problem, after, terms)
        if b.kind == "unusual"
    ]
    doubts += [Doubt("bounded", *pair) for pair in _bounded(problem, after)]
    doubts += [
        Doubt("moved", name, key, abs(far))
        for (name, key), far in problem.unknowns.moved(after.nuisance).items()
        if abs(far) > MOVED and name not in air
    ]
    return doubts


def _bounded(problem: Problem, after: Fit) -> Iterator[tuple[str, str]]:
    """Yield each nuisance unknown that a fit took to its limit, behind the added effect that is most like it."""
    unknowns = problem.unknowns
    names = [group for group, _ in unknowns.nuisances] + [f"{name} {key}" for name, key, _ in unknowns.loose]
    size = np.sqrt(np.diag(after.covariance))
    for name, at, own, low, high in zip(
        names, range(unknowns.count), after.nuisance, *unknowns.limits(), strict=True
    ):
        if own in (low, high) and after.columns:
            alike = np.abs(after.covariance[at, unknowns.count :]) / size[unknowns.count :]
            yield after.columns[int(np.argmax(alike))][0], name


def effects_of(
    model: Model, problem: Problem, after: Fit, added: Mapping[str, Mapping[str, Estimate]]
) -> tuple[dict[str, dict[str, float]], dict[str, dict[str, float]]]:
    """Return the coefficients of all effects of the new model, and their standard errors."""
    model_effects = problem.unknowns.effects(replace(after.point, coefficients={}))
    effects = {active.effect.name: dict(active.values) for active in model_effects}
    effect_errors = {name: dict(model.effect_errors.get(name, {})) for name in effects}
    for name, found in added.items():
        if name not in ERRORS:
            effects[name] = {key: e.value for key, e in found.items()}
            effect_errors[name] = {key: e.standard_error for key, e in found.items()}
    return effects, effect_errors


def _with_air(model: Model, air: Mapping[str, Mapping[str, tuple[float, float]]]) -> Model:
    """Return the model with the effects of the air as a model of the air states them."""
    values = {name: {key: value for key, (value, _) in own.items()} for name, own in air.items()}
    errors = {name: {key: error for key, (_, error) in own.items()} for name, own in air.items()}
    return replace(
        model, effects={**model.effects, **values}, effect_errors={**model.effect_errors, **errors}
    )


def _asked(model: Model, start: Model, names: Sequence[str | Effect]) -> tuple[list[Term], dict[str, Effect]]:
    """Return the terms that are to be added to a model, and the declarations of those that are not registered.

    `start` is the model with the effects of the air that are added as well.
    """
    terms: list[Term] = []
    declared: dict[str, Effect] = {}
    uncertain = model.reference_bench.groups()
    for item in names:
        name = item.name if isinstance(item, Effect) else item
        if is_air(name):
            continue
        if name in start.effects and (isinstance(item, Effect) or name not in model.effects):
            raise InputError(f"{model.origin}: effects.{name}: the model has it already")
        if any(t.name == name for t in terms):
            raise InputError(f"effect: '{name}' is given twice")
        if exact := [group for group in ERRORS.get(name, ()) if group not in uncertain]:
            raise InputError(
                f"{model.origin}: {name}: the bench states {', '.join(exact)} as exact (uncertainty 0)"
            )
        if isinstance(item, Effect) and item != registry().get(name):
            check_name(name, "effect", registry())
            # as the model file will have it
            declared[name] = effect_from_mapping(name, effect_to_mapping(item), f"effect {name}")
        terms.append(
            Term(name)
            if name in ERRORS
            else Term(name, get(name, declared={**model.declared, **declared}, bench=model.stated_bench))
        )
    return terms, declared


def restated_by(
    problem: Problem, terms: Sequence[Term], overrides: Mapping[str, Override]
) -> dict[str, dict[str, float]]:
    """Return the bench parameters whose errors were added, with their values and standard errors in the new model."""
    groups = {group for term in terms if term.effect is None for group in ERRORS[term.name]}
    return {
        p.name: {"value": float(own.value), "standard_error": float(own.standard_error)}
        for group, parameters in problem.unknowns.nuisances
        if group in groups
        for p in parameters
        for own in (overrides[p.name],)
    }


def _what(air: Sequence[str], terms: Sequence[Term], model: Model) -> str:
    """Return the description of the change, for the history of the model."""
    new = [*air, *(t.name for t in terms if t.name not in model.effects)]
    again = [t.name for t in terms if t.name in model.effects]
    parts = (("add", new), ("fit again", again))
    return "; ".join(f"{verb} {', '.join(those)}" for verb, those in parts if those)


def is_air(name: str) -> bool:
    """Whether a name means the effects of a model of the air."""
    return name.partition(":")[0].strip() == AIR


def _air(model: Model, names: Sequence[str]) -> dict[str, dict[str, tuple[float, float]]]:
    """Return the effects of the models of the air among the names: {effect: {coefficient: (value, uncertainty)}}."""
    from gyrowheel_air.surrogate import air_effects

    found: dict[str, dict[str, tuple[float, float]]] = {}
    for text in names:
        if not is_air(text):
            continue
        given = air_effects(text.partition(":")[2].strip() or "table", bench=model.stated_bench)
        for name, values in given.values.items():
            if name in model.effects:
                raise InputError(f"{model.origin}: effects.{name}: the model has it already")
            if name in found or name in names:
                raise InputError(f"effect: '{name}' is given twice: {text} has it")
            found[name] = {key: (value, given.errors[name][key]) for key, value in values.items()}
    return found


def _before(model: Model, problem: Problem, air: Mapping[str, Mapping[str, tuple[float, float]]]) -> Fit:
    """Return the best fit of the model without the additions, among the unknowns of a problem that has the air."""
    if not air:
        return problem.fit_within()
    unknowns = Unknowns(
        problem.bench, model.effects, model.effect_errors, model.declared, problem.unknowns.assumed
    )
    fit = Problem.of(problem.balances, unknowns).with_noise(problem.noise).fit_within()
    # no air: every size lies as many uncertainties from the stated one as take it to zero
    amplitudes = {name: {c.name for c in get(name).amplitudes} for name in air}
    none = [
        -value / error if key in amplitudes[name] else 0.0
        for name, own in air.items()
        for key, (value, error) in own.items()
        if error > 0.0
    ]
    return replace(fit, nuisance=np.concatenate([fit.nuisance, none]))


def _found_air(
    problem: Problem, after: Fit, air: Mapping[str, Mapping[str, tuple[float, float]]]
) -> Iterator[tuple[str, dict[str, Estimate], list[Doubt]]]:
    """Yield the effects of the air as fitted, with the reasons to doubt them."""
    found = problem.unknowns.effects(replace(after.point, coefficients={}))
    values = {active.effect.name: active.values for active in found}
    at = len(after.nuisance) - sum(error > 0.0 for own in air.values() for _, error in own.values())
    for name, own in air.items():
        effect = get(name)
        units = {c.name: c.unit for c in effect.coefficients}
        estimates: dict[str, Estimate] = {}
        doubts: list[Doubt] = []
        for key, (value, stated) in own.items():
            error = 0.0
            if stated > 0.0:
                left = float(np.sqrt(after.covariance[at, at]))
                error, pull = stated * left, abs(values[name][key] - value) / stated
                if pull > DOUBTFUL:
                    doubts.append(Doubt("off_air_model", name, key, pull))
                elif left > UNCONSTRAINED:
                    doubts.append(Doubt("unconstrained", name, key))
                at += 1
            estimates[key] = Estimate(values[name][key], error, units[key])
        yield name, estimates, doubts


@one_thread()
def add_map(
    model: Model,
    fit: Sequence[Recording],
    validate: Sequence[Recording] = (),
    given: CorrectionMap | None = None,
    *,
    progress: Progress | None = None,
) -> Added:
    """Add a correction map to a model, with the effects that belong to it, and refit the bench parameters.

    Parameters
    ----------
    model : Model
        The model.
    fit, validate : sequence of Recording
        Recordings on which the bench parameters, and a map that is not given, are fitted; and those that are predicted.
    given : CorrectionMap, optional
        The map of a diagnosis.

    Raises
    ------
    InputError
        If no map predicts data that are left out, its name is taken, or the recordings have too little steady motion.
    """
    if given is not None and given.effect.name in model.effects:
        raise InputError(f"{model.origin}: effects.{given.effect.name}: the model has it already")
    explanation = explanation_of(prepare(fit, model, validate=validate, progress=progress), fit, progress)
    if progress:
        progress("fitting a map of the missing torque")
    paths = [str(r.path) for r in fit]
    found = correct(explanation, tuple(paths)) if given is None else applied(explanation, given)
    if found is None:
        raise InputError(
            f"{', '.join(paths)}: no map to add: nothing is missing, a law describes it as well, or no torque that "
            "depends on tilt, speed and temperature predicts the parts of the recordings that are left out"
        )
    own, problem, after = found.map, found.prepared.problem, found.after
    name = own.effect.name
    events = unused_events(found.prepared.validation, after, validate)
    coefficients = {
        name: {
            c.name: Estimate(own.values[c.name], own.errors[c.name], c.unit) for c in own.effect.coefficients
        }
    } | {term.name: estimates(problem, term, after) for term in after.terms}
    table = found.errors.table
    what = f"add {', '.join(coefficients)}"
    changed = _changed(model, problem, after, what, fit, validate, table, coefficients, {name: own.effect})
    proof = proof_of(found, as_events(events, [str(r.path) for r in validate]))
    return Added(
        changed,
        coefficients,
        table,
        tuple(found.errors.residuals),
        tuple(doubts_of(problem, after, after.terms, {})),
        tuple(events),
        proof,
    )
