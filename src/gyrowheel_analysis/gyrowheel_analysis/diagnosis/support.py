"""Nothing is offered that makes the prediction of data worse on which it was not fitted.

Effects are cross-validated as they are selected. Here the free form is, and on recordings for validation everything.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from gyrowheel_analysis.criteria import CHANNEL_CHANCE, WORSE_ELSEWHERE
from gyrowheel_analysis.diagnosis.events import as_events, unused_events
from gyrowheel_analysis.diagnosis.explanation import Explanation
from gyrowheel_analysis.diagnosis.free_forms import kind_of
from gyrowheel_analysis.diagnosis.proof import Unseen, costs_by_channel, left_out_by_channel, predictive_cost
from gyrowheel_analysis.diagnosis.selection import survives_cross_validation
from gyrowheel_analysis.fitting.fit import Fit, Term
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_recording.bags import Recording


def supported(explanation: Explanation, validate: Sequence[Recording]) -> Explanation:
    """Return an explanation without the terms that make the prediction of unused data worse; `rejected` names these."""
    proposal = explanation.proposal
    if proposal is not None:
        problem = explanation.problem
        without = problem.fit(proposal.kept, proposal.fit)
        if not survives_cross_validation(problem, without, proposal.fit, proposal.term) or any(
            _excess(with_form, plain) > 1.0
            for with_form, plain in zip(
                left_out_by_channel(problem, proposal.fit), left_out_by_channel(problem, without), strict=True
            )
        ):
            explanation = _without(explanation, proposal.term)
    while (term := _worst_elsewhere(explanation, validate)) is not None:
        explanation = _without(explanation, term)
    return explanation


def _worst_elsewhere(explanation: Explanation, validate: Sequence[Recording]) -> Term | None:
    """Return the term that makes the prediction of the recordings for validation worst; None if none does."""
    validation, problem, best = explanation.fitted.validation, explanation.problem, explanation.best
    if validation is None or not best.terms:
        return None
    other = validation.problem.with_scales(problem.noise.scales)
    without = {t: problem.fit(tuple(own for own in best.terms if own != t), best) for t in best.terms}
    form = None if explanation.proposal is None else explanation.proposal.term
    losses = _losses(other, best, without, form)
    if max(losses.values()) > 1.0:
        # what happened there is no fault of the terms
        events = as_events(
            unused_events(replace(validation, problem=other), best, validate), [str(r.path) for r in validate]
        )
        losses = _losses(other.with_events(events), best, without, form) if events else losses
    term = max(losses, key=lambda own: losses[own])
    return term if losses[term] > 1.0 else None


def _losses(other: Problem, best: Fit, without: dict[Term, Fit], form: Term | None) -> dict[Term, float]:
    """Return by how much the prediction of other recordings is less likely with a term, over what chance explains.

    All rows count, and those of every channel alone. A prediction that is vague, as the fit does not determine it, does
    not speak against an effect; nor does a channel in which more is missing. A free form is no physics: it must predict
    by itself, in every channel.
    """

    def plain(fit: Fit) -> float:
        white = other.noise.whiten(other.measured - other.predict(fit))
        return float(white @ white)

    now, error, channels = predictive_cost(other, best), plain(best), costs_by_channel(other, best)
    losses = {}
    for term, fit in without.items():
        loss = (now - predictive_cost(other, fit)) / WORSE_ELSEWHERE
        if term == form:
            loss = max(loss, (error - plain(fit)) / WORSE_ELSEWHERE)
            loss = max(
                loss,
                _excess(costs_by_channel(other, best, exact=True), costs_by_channel(other, fit, exact=True)),
            )
        else:
            loss = max(loss, _excess(channels, costs_by_channel(other, fit), missing=True))
        losses[term] = loss
    return losses


def _excess(with_term: Unseen, without: Unseen, *, missing: bool = False) -> float:
    """Return by how much a term makes the worst channel less likely, over what chance explains.

    Chance makes the right one of two predictions less likely by t in twice the log likelihood with a probability of at
    most exp(-t / 2). With `missing`, a misfit that both leave counts as noise.
    """
    limit = 2.0 * math.log(max(len(with_term), 1) / CHANNEL_CHANCE)
    return max(
        (
            (cost - without[name][0]) / (limit * (max(without[name][0] / n, 1.0) if missing else 1.0))
            for name, (cost, n) in with_term.items()
        ),
        default=0.0,
    )


def _without(explanation: Explanation, term: Term) -> Explanation:
    """Return an explanation without one of its terms."""
    proposal = explanation.proposal
    is_form = proposal is not None and term == proposal.term
    rejected = (*explanation.rejected, kind_of(term.name) if is_form else term.name)
    if proposal is not None and not is_form:
        rest = explanation.problem.fit(tuple(t for t in proposal.fit.terms if t != term), proposal.fit)
        return replace(explanation, proposal=replace(proposal, fit=rest), rejected=rejected)
    base = explanation if explanation.without_form is None else explanation.without_form
    chosen, problem = base.selection, base.problem
    left = tuple(t for t in chosen.best.terms if t != term)
    if is_form:  # its noise may be that of a missing law
        problem = problem.with_drift_estimated()
    best = problem.refined(problem.fit(left, chosen.best))
    pool = tuple(t for t in chosen.pool if t != term)
    return replace(
        base,
        fitted=replace(base.fitted, problem=problem),
        weighed=replace(base.weighed, problem=base.weighed.problem.with_scales(problem.noise.scales)),
        selection=replace(chosen, problem=problem, null=problem.fit(()), best=best, pool=pool),
        rejected=rejected,
        ended=explanation.ended,
    )
