"""Two models on the same rows: which one the recordings prefer, where they differ, and the test that decides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gyrowheel_analysis.criteria import CHI2_RANGE, TIE_LOSS, USEFUL_SEPARATION
from gyrowheel_analysis.diagnosis.diagnose import estimates
from gyrowheel_analysis.diagnosis.estimates import Estimate
from gyrowheel_analysis.diagnosis.events import accepted, beside_events
from gyrowheel_analysis.diagnosis.experiment_design import Planner
from gyrowheel_analysis.diagnosis.findings import NextTest
from gyrowheel_analysis.diagnosis.proof import lack_of_fit
from gyrowheel_analysis.fitting.fit import Fit, Term
from gyrowheel_analysis.fitting.preparation import Progress, prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.residuals.error_table import error_row
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording

Preference = Literal["first", "second", "none"]


@dataclass(frozen=True)
class ModelSide:
    """One of the two models on the recordings.

    Attributes
    ----------
    name : str
        Its file, or ``model``.
    coefficients : dict
        {effect: {coefficient: Estimate}}, fitted again to these recordings.
    chi2_per_n : float
        Mean square of the residual in units of its noise, fitted again.
    stated_chi2_per_n : float
        The same with the coefficients of the file; the bench parameters stay within their stated uncertainties.
    explains : bool
        Whether the fit leaves no more than chance explains.
    channels : dict of str to float
        χ²/N by channel, fitted again.
    """

    name: str
    coefficients: dict[str, dict[str, Estimate]]
    chi2_per_n: float
    stated_chi2_per_n: float
    explains: bool
    channels: dict[str, float]


@dataclass(frozen=True)
class ModelComparison:
    """Outcome of `compare_models`.

    Attributes
    ----------
    first, second : ModelSide
        The two models.
    evidence : float
        Natural log of the Bayes factor of the first over the second, the magnitudes of the drifts left free.
    preferred : str
        ``first`` or ``second`` where twice the evidence exceeds `criteria.TIE_LOSS`; else ``none``.
    test : NextTest or None
        The test that separates the two best per minute; None where one is preferred, or no plan separates them.
    recordings : tuple of str
        Their paths.
    """

    first: ModelSide
    second: ModelSide
    evidence: float
    preferred: Preference
    test: NextTest | None
    recordings: tuple[str, ...]


@one_thread()
def compare_models(
    first: Model, second: Model, recordings: Sequence[Recording], *, progress: Progress | None = None
) -> ModelComparison:
    """Compare two models of one bench on the same rows, their coefficients fitted again.

    Raises
    ------
    InputError
        If the models have different benches or the same effects, or the recordings have too little steady motion.
    """
    _require_comparable(first, second)
    plain = replace(first, effects={}, effect_errors={}, declared={**first.declared, **second.declared})
    prepared = prepare(recordings, plain, progress=progress)
    if progress:
        progress("fitting both models")
    sides = [_terms(prepared.problem, model) for model in (first, second)]
    fits = [prepared.problem.fit(terms) for terms in sides]
    # the noise of the machine that the better one describes; events that neither explains
    best = int(fits[1].chi2 < fits[0].chi2)
    prepared = prepared.reweighed(fits[best])
    problem = beside_events(
        prepared.problem,
        sides[best],
        accepted(prepared.problem, prepared.problem.fit(sides[best]), recordings),
    )
    one, two = (problem.refined(problem.fit(terms)) for terms in sides)
    evidence = 0.5 * (problem.evidence(two) - problem.evidence(one))
    preferred: Preference = "none"
    if 2.0 * abs(evidence) > TIE_LOSS:
        preferred = "first" if evidence > 0.0 else "second"
    return ModelComparison(
        _side(problem, first, sides[0], one),
        _side(problem, second, sides[1], two),
        evidence,
        preferred,
        _separating(problem, one, two) if preferred == "none" else None,
        tuple(str(r.path) for r in recordings),
    )


def _require_comparable(first: Model, second: Model) -> None:
    own, its = first.reference_bench, second.reference_bench
    if own.values() != its.values() or own.name != its.name:
        changed = [name for name, value in own.values().items() if value != its.values().get(name)]
        raise InputError(
            f"{second.origin}: is of another bench than {first.origin} ({', '.join(changed[:3]) or its.name}); "
            "allowed: models of one bench"
        )
    if first.effects.keys() == second.effects.keys() and all(
        first.declared.get(name) == second.declared.get(name) for name in first.effects
    ):
        raise InputError(
            f"{second.origin}: has the same effects as {first.origin}; allowed: models that differ in their effects"
        )
    for name in first.declared.keys() & second.declared.keys():
        if first.declared[name] != second.declared[name]:
            raise InputError(
                f"{second.origin}: effects.{name}: is another law than in {first.origin}; allowed: another name for it"
            )


def _terms(problem: Problem, model: Model) -> tuple[Term, ...]:
    return tuple(problem.unknowns.term(name) for name in model.effects)


def _side(problem: Problem, model: Model, terms: Sequence[Term], fit: Fit) -> ModelSide:
    white = problem.noise.whiten(fit.residual)
    row = error_row(problem.balances, fit.residual, white, problem.noise.deviation())
    stated = problem.measured - problem.predict(
        replace(
            fit.point, terms=tuple(terms), nuisance=np.zeros(problem.count), coefficients=dict(model.effects)
        )
    )
    within = problem.noise.whiten(stated)
    # the bench parameters take what they can, within their priors
    design = np.vstack([problem.noise.whiten(problem.base_jacobian), np.eye(problem.count)])
    moved, *_ = np.linalg.lstsq(design, np.concatenate([within, np.zeros(problem.count)]), rcond=1e-12)
    left = within - design[: len(within)] @ moved
    return ModelSide(
        model.origin,
        {term.name: estimates(problem, term, fit) for term in terms},
        row.chi2_per_n,
        float(left @ left) / len(left),
        lack_of_fit(problem, fit) <= CHI2_RANGE,
        {name: error.chi2_per_n for name, error in row.channels.items()},
    )


def _separating(problem: Problem, one: Fit, two: Fit) -> NextTest | None:
    """Return the plan that separates the two, whichever is right."""
    planner = Planner(problem, one)
    found = [planner.best(truth, rival) for truth, rival in ((one, two), (two, one))]
    useful = [s for s in found if s is not None and s.expected >= USEFUL_SEPARATION]
    if not useful:
        return None
    worst = min(useful, key=lambda s: s.expected)
    return NextTest(worst.plan, worst.expected, worst.minutes)
