"""Add effects to a model: refit, prove on recordings that were not used, write the history."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from gyrowheel_analysis.discovery.fit import ERRORS, Term
from gyrowheel_analysis.discovery.verdict import Estimate, judge_noise_with, nuisance_estimates
from gyrowheel_analysis.errors import ErrorTable, Residuals
from gyrowheel_analysis.model import Model, Override
from gyrowheel_analysis.pipeline import FEWEST_WINDOWS, Progress, errors_of, one_thread, prepare
from gyrowheel_analysis.recording import Recording
from gyrowheel_sim.effects import Effect, effect_from_mapping, effect_to_mapping, get, registry
from gyrowheel_sim.effects.user import check_name
from gyrowheel_sim.errors import InputError


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
        How the error falls, on the fitted and on the validation recordings.
    residuals : list of Residuals
        Window by window, before and after.
    notes : list of str
        What the user should know: effects that are hardly there.
    """

    model: Model
    coefficients: dict[str, dict[str, Estimate]]
    error: ErrorTable
    residuals: list[Residuals]
    notes: list[str]


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
        The model as it is.
    names : sequence of str or Effect
        Effects, or errors of bench parameters (``stiffness_error`` and the like), to add. An `Effect` that is not
        registered goes into the model with its declaration.
    fit : sequence of Recording
        Recordings on which coefficients and bench parameters are fitted.
    validate : sequence of Recording
        Recordings on which nothing is fitted.

    Raises
    ------
    InputError
        If an effect is unknown or in the model already, or the recordings have too little steady motion.
    """
    terms: list[Term] = []
    declared: dict[str, Effect] = {}
    for item in names:
        name = item.name if isinstance(item, Effect) else item
        if name in model.effects:
            raise InputError(f"{model.origin}: effects.{name}: the model has it already")
        if any(t.name == name for t in terms):
            raise InputError(f"effect: '{name}' is given twice")
        if isinstance(item, Effect) and item != registry().get(name):
            check_name(name, "effect", registry())
            # as the model file will have it
            declared[name] = effect_from_mapping(name, effect_to_mapping(item), f"effect {name}")
        terms.append(
            Term(name)
            if name in ERRORS
            else Term(name, get(name, declared=declared, bench=model.stated_bench))
        )
    if not terms:
        raise InputError("no effect given")
    fitted = prepare(fit, model, progress=progress)
    if fitted.windows < FEWEST_WINDOWS:
        raise InputError(
            f"{', '.join(fitted.names)}: {fitted.windows} steady windows; at least {FEWEST_WINDOWS} are needed"
        )
    validation = prepare(validate, model, progress=progress) if validate else None
    problem = fitted.problem
    if progress:
        progress("fitting")
    problem.estimate_noise()
    if declared:
        judge_noise_with(problem, problem.fit(terms))
    before, after = problem.fit_within(), problem.refined(problem.fit(terms))
    errors = errors_of(before, after, fitted, validation)
    coefficients: dict[str, dict[str, Estimate]] = {}
    notes = []
    for term in terms:
        units = {c.name: c.unit for c in term.effect.coefficients} if term.effect else {"relative_error": "1"}
        coefficients[term.name] = {
            key: Estimate(
                after.coefficients[term.name][key], after.standard_error(term.name, key), units[key]
            )
            for key in term.coefficients
        }
        if after.significance(term.name) < 3.0:
            notes.append(
                f"{term.name} is hardly there: {after.significance(term.name):.1f} standard errors from zero"
            )
    values = problem.effects(after.nuisance, {})
    effects = {active.effect.name: dict(active.values) for active in values}
    effect_errors = {name: dict(model.effect_errors.get(name, {})) for name in effects}
    for name, estimates in coefficients.items():
        if name not in ERRORS:
            effects[name] = {key: e.value for key, e in estimates.items()}
            effect_errors[name] = {key: e.standard_error for key, e in estimates.items()}
    overrides = {
        name: Override(n.value, n.standard_error) for name, n in nuisance_estimates(problem, after).items()
    }
    entry: dict[str, Any] = {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "what": f"add {', '.join(term.name for term in terms)}",
        "fit": [str(r.path) for r in fit],
        "validate": [str(r.path) for r in validate],
        "error": errors.table.to_json(),
    }
    wrong = {group for term in terms if term.effect is None for group in ERRORS[term.name]}
    restated = {
        p.name: {
            "value": float(overrides[p.name].value),
            "standard_error": float(overrides[p.name].standard_error),
        }
        for group, parameters in problem.nuisances
        if group in wrong
        for p in parameters
    }
    if restated:
        entry["restated"] = restated
    changed = model.changed(
        entry, overrides=overrides, effects=effects, effect_errors=effect_errors, declared=declared
    )
    return Added(changed, coefficients, errors.table, errors.residuals, notes)
