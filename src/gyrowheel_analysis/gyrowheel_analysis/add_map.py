"""Add a correction map to a model: the missing torque as a smooth function, where nobody knows a law."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from gyrowheel_analysis.add import Added, doubts_of, effects_of, overrides_of, restated_by
from gyrowheel_analysis.diagnosis.correction import applied, correct, proof_of
from gyrowheel_analysis.diagnosis.correction_map import CorrectionMap
from gyrowheel_analysis.diagnosis.diagnose import estimates
from gyrowheel_analysis.diagnosis.estimates import Estimate
from gyrowheel_analysis.diagnosis.events import as_events, unused_events
from gyrowheel_analysis.diagnosis.kept_explanation import explanation_of
from gyrowheel_analysis.fitting.preparation import Progress, prepare
from gyrowheel_analysis.model import Model
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording


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
    effects, effect_errors = effects_of(model, problem, after, coefficients)
    entry: dict[str, Any] = {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "what": f"add {', '.join(coefficients)}",
        "fit": paths,
        "validate": [str(r.path) for r in validate],
        "error": found.errors.table.to_json(),
    }
    overrides = overrides_of(problem, after)
    if restated := restated_by(problem, after.terms, overrides):
        entry["restated"] = restated
    changed = model.changed(
        entry,
        overrides=overrides,
        effects=effects,
        effect_errors=effect_errors,
        declared={name: own.effect},
    )
    proof = proof_of(found, as_events(events, [str(r.path) for r in validate]))
    return Added(
        changed,
        coefficients,
        found.errors.table,
        tuple(found.errors.residuals),
        tuple(doubts_of(problem, after, after.terms, {})),
        tuple(events),
        proof,
    )
