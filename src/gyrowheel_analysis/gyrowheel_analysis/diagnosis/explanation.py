"""The explanation of recordings that a model leaves open: effects, a free form, events, and the noise that is left.

What is noise depends on what else explains the recordings: a law that a model lacks looks like a drift. Comparison,
diagnosis and addition therefore take the noise of the same explanation, so that their numbers agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from gyrowheel_analysis.criteria import (
    ACCEPTED_GAIN_FURTHER,
    CHI2_RANGE,
    DRIFT_ENLARGED,
    DRIFT_OR_MAP,
    EVENT_GAIN,
    MACHINE_SHARE,
    MEMORY_ALONE,
    MEMORY_LACKS,
    MEMORY_MOST,
    MEMORY_REACH,
    MEMORY_ROUGH,
    MEMORY_SHARE,
    NOISE_CHANGED,
    TIE_LOSS,
)
from gyrowheel_analysis.diagnosis.event_dating import Found
from gyrowheel_analysis.diagnosis.events import Outcome, as_continued, explain
from gyrowheel_analysis.diagnosis.free_forms import memory_forms
from gyrowheel_analysis.diagnosis.motion_laws import MotionLaw
from gyrowheel_analysis.diagnosis.proof import lack_of_fit, spread_of
from gyrowheel_analysis.diagnosis.selection import (
    Progress,
    Selection,
    expected_chi2,
    foremost,
    rank,
    select,
    threshold,
)
from gyrowheel_analysis.diagnosis.unknown import Proposal, family, fits_with_one, search, settled
from gyrowheel_analysis.fitting.fit import Fit, Term
from gyrowheel_analysis.fitting.preparation import Prepared
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_recording.bags import Recording

_MOST_BEGINNINGS = 3  # machines on which the term that is missing most is sought


class SearchEnded(KeyboardInterrupt):
    """Ends a search with what it has: raised by `progress`, or by a handler of a signal."""


@dataclass(frozen=True)
class Explanation:
    """The explanation of recordings: effects, an optional free form, and events.

    `fitted` has the noise and the events; `weighed` the same noise without events, their part still in the rows.
    `rejected` are terms that were found and make the prediction of unused data worse. `laws` are functions of the
    motion that look like events, and that nothing found describes. `ended` is whether `SearchEnded` ended the search
    early. `without_form` is the explanation without the free form, with the noise that it had then.
    """

    fitted: Prepared
    weighed: Prepared
    selection: Selection
    proposal: Proposal | None
    happened: list[Found]
    rejected: tuple[str, ...] = ()
    laws: tuple[MotionLaw, ...] = ()
    ended: bool = False
    without_form: Explanation | None = None

    def validated_by(self, validation: Prepared | None) -> Explanation:
        """Return the explanation with recordings for validation, which have the same noise."""
        if validation is None:
            return self
        by = self.weighed.weighed_by
        own = validation if by is None else validation.reweighed(by)
        weighed = replace(self.weighed, validation=own)
        plain = as_continued(own, self.problem, self.best, self.happened)
        base = self.without_form and self.without_form.validated_by(validation)
        return replace(
            self, fitted=replace(self.fitted, validation=plain), weighed=weighed, without_form=base
        )

    @property
    def problem(self) -> Problem:
        """The problem with the events."""
        return self.fitted.problem

    @property
    def best(self) -> Fit:
        """The fit with everything found."""
        return self.proposal.fit if self.proposal else self.selection.best

    @property
    def before(self) -> Fit:
        """The fit of the model alone: if it lacks something, the bench stays within its stated uncertainties."""
        missing = self.proposal is not None or self.selection.best.terms
        return self.problem.fit_within() if missing else self.best


def unexplained(first: Prepared) -> Explanation:
    """Return prepared recordings with nothing that explains them: the noise is as prepared."""
    plain = first.problem.fit(())
    return Explanation(first, first, Selection(first.problem, plain, plain, (), 1.0), None, [])


def explained(first: Prepared, recordings: Sequence[Recording], progress: Progress | None) -> Explanation:
    """Return the explanation of prepared recordings, with the noise that it leaves.

    Where the term that is missing most changes the noise or the rows, the selection begins on the machine with it.
    `SearchEnded` ends the search with the explanation found so far, once the first effects are selected.
    """
    for _ in range(_MOST_BEGINNINGS):
        most = foremost(first.problem)
        begun, first = first, _with_drift(_on_machine(first, most), most)
        if first is begun:
            break
    selection = select(first.problem, progress=progress)
    found = [Explanation(first, first, selection, None, [])]
    try:
        return _searched(first, selection, recordings, progress, found)
    except SearchEnded:
        return replace(found[-1], ended=True)


def _with_drift(prepared: Prepared, fit: Fit) -> Prepared:
    """Return recordings with the drifts that a fit leaves; themselves where these hardly differ.

    An error of a bench parameter by half is nothing that the derivatives of the stated bench explain: it looks like
    drift until it is fitted.
    """
    now = prepared.problem.noise.scales
    if not fit.terms or max(now.values()) < DRIFT_ENLARGED:
        return prepared
    problem = prepared.problem.with_drift_estimated(prepared.problem.fit(fit.terms, fit))
    change = max(abs(math.log(scale / now[name])) for name, scale in problem.noise.scales.items())
    return prepared if change < NOISE_CHANGED else replace(prepared, problem=problem)


def _on_machine(prepared: Prepared, fit: Fit) -> Prepared:
    """Return recordings with noise and rows of the machine that a fit describes, where they show hardly an error there.

    Terms that take the place of something else may describe a machine whose noise conceals what is missing.
    """
    before, after = prepared, prepared.reweighed(fit)
    if after is before or not fit.terms:
        return after
    own = after.problem.fit(fit.terms, fit)
    errors = (p.fit(()).chi2_rows - expected_chi2(p) for p in (before.problem, after.problem))
    left, chance = own.chi2_rows - expected_chi2(after.problem), spread_of(len(after.problem.measured))
    return after if left < (1.0 - MACHINE_SHARE) * max(errors) + CHI2_RANGE * chance else before


def _searched(
    first: Prepared,
    selection: Selection,
    recordings: Sequence[Recording],
    progress: Progress | None,
    so_far: list[Explanation],
) -> Explanation:
    """Return the explanation of prepared recordings, of which some effects without a memory are selected.

    Effects with a memory are candidates where one of them roughly gains enough, or where those of an instant leave
    something. One of them is taken if it makes the recordings likelier than all that explains them without it; a free
    form must be likelier than the law. Events and forms are not sought where a law with a memory explains very much and
    leaves nothing. Where a form without a memory leaves nothing, one law with a memory must nearly reach it alone, and
    what remembers must beat it without events. Explanations are added to `so_far` as they are found.
    """
    remembering, other = None, None
    remembers = _remembers(first.problem, selection.best, selection.inflation)
    if remembers and _explains_most(first.problem, selection):
        remembering = _with_memory(first, progress)
        if _suffices(*remembering):
            other = _explained(first, *remembering, recordings, progress)
            gain = first.problem.evidence(selection.best) - other.problem.evidence(other.best)
            if _has_memory(other.best) and not _leaves_something(other) and gain > MEMORY_ALONE:
                return other
    found = _explained(first, first.problem, selection, recordings, progress)
    so_far.append(found)
    closed = found.proposal is not None and not _is_open(found)
    if remembering is None:
        if not (remembers or (_leaves_something(found) and _may_remember(found)) or _lags(found)):
            return found
        if closed and not _one_reaches(found):
            return found
        remembering = _with_memory(first, progress)
    if other is None:
        # forms without a state explain as much as without these candidates, but next to a law with a memory
        among = memory_forms() if closed or not _has_memory(remembering[1].best) else None
        below = _cost(found) if closed else None
        other = _explained(first, *remembering, recordings, progress, among, below)
    if not _has_memory(other.best):
        return found
    least = TIE_LOSS if found.proposal is not None and other.proposal is None else 0.0
    return other if _cost(other) < _cost(found) + least else found


def _with_memory(first: Prepared, progress: Progress | None) -> tuple[Problem, Selection]:
    """Return the problem where laws with a memory are candidates, too, and what is selected among them."""
    if progress:
        progress("comparing with laws that have a memory")
    problem = first.problem.with_memory()
    selection = select(problem, progress=progress)
    if _has_memory(selection.best):
        # a time or way of a law that is not the usual one looks like drift until it is fitted
        problem = problem.with_drift_estimated(selection.best)
        selection = select(problem, selection.best, progress=progress)
    return problem, selection


def _suffices(problem: Problem, selection: Selection) -> bool:
    """Whether effects with a memory are selected and leave no error."""
    return _has_memory(selection.best) and lack_of_fit(problem, selection.best) <= CHI2_RANGE


def _has_memory(fit: Fit) -> bool:
    return any(t.effect is not None and t.effect.states for t in fit.terms)


def _lags(found: Explanation) -> bool:
    """Whether a law with a memory explains more than an effect that was found: in its place, or next to one like it."""
    if found.proposal is None and any(own.outdone for own in found.selection.in_place):
        return True
    names = {term.name for term in found.best.terms}
    alike = [
        t for t in found.problem.memory_terms if t.effect is not None and names & set(t.effect.look_alikes)
    ]
    rough = rank(found.problem.roughly(), found.best, alike)
    able = [term for gain, term in rough if gain > MEMORY_ROUGH * ACCEPTED_GAIN_FURTHER]
    return any(gain > ACCEPTED_GAIN_FURTHER for gain, _ in rank(found.problem, found.best, able))


def _leaves_something(found: Explanation) -> bool:
    """Whether an explanation needs a form, or is open."""
    return found.proposal is not None or _is_open(found)


def _is_open(found: Explanation) -> bool:
    """Whether an explanation needs an event, leaves an error, or needs a drift large enough to hide a law."""
    return (
        bool(found.happened or found.laws)
        or max(found.problem.noise.scales.values(), default=1.0) > DRIFT_OR_MAP
        or lack_of_fit(found.problem, found.best) > CHI2_RANGE
    )


def _may_remember(found: Explanation) -> bool:
    """Whether a law with a memory may explain some of what the effects of an instant leave, or the model alone."""
    problem = found.weighed.problem
    known = dict.fromkeys(((), found.selection.best.terms))
    return any(_remembers(problem, problem.fit(terms)) for terms in known)


def _remembers(problem: Problem, fit: Fit, inflation: float = 0.0) -> bool:
    """Whether a law with a memory may explain some of what a fit leaves.

    If nothing need be left, `inflation` is that of the gain that a term must bring.
    """
    share = MEMORY_SHARE * (fit.chi2_rows - expected_chi2(problem))
    ranked = rank(problem.roughly(), fit, _lagging(problem))
    return any(
        gain > MEMORY_ROUGH * max(threshold(term, inflation) if inflation else ACCEPTED_GAIN_FURTHER, share)
        for gain, term in ranked
    )


def _lagging(problem: Problem) -> list[Term]:
    """Return the laws and free forms with a memory; none after a long pause."""
    laws = problem.memory_terms
    return [*laws, *family(problem, memory_forms())] if laws else []


def _explains_most(problem: Problem, selection: Selection) -> bool:
    """Whether a law with a memory roughly explains most of an error, next to the effects selected or in their place."""
    if lack_of_fit(problem, selection.best) <= CHI2_RANGE:
        return False
    for fit in (selection.best, selection.null):
        ranked = rank(problem.roughly(), fit, _lagging(problem))
        if any(gain > MEMORY_MOST * (fit.chi2_rows - expected_chi2(problem)) for gain, _ in ranked):
            return True
    return False


def _one_reaches(found: Explanation) -> bool:
    """Whether one law or form with a memory explains nearly as much as the free form of an explanation in its place."""
    assert found.proposal is not None
    problem = found.problem
    start = problem.fit(found.proposal.kept, found.best)
    without = problem.evidence(start)
    wanted = without - problem.evidence(found.best)
    enough = max(MEMORY_REACH * wanted, wanted - MEMORY_LACKS)
    return any(
        without - problem.evidence(fit) > enough
        for fit in fits_with_one(problem, start, _lagging(problem), wanted)
    )


def _cost(found: Explanation) -> float:
    """Return minus twice the log likelihood of an explanation, with the price of its events."""
    return found.problem.evidence(found.best) + EVENT_GAIN * len(found.happened)


def _explained(
    first: Prepared,
    problem: Problem,
    selection: Selection,
    recordings: Sequence[Recording],
    progress: Progress | None,
    among: Sequence[Term] | None = None,
    below: float | None = None,
) -> Explanation:
    """Return the explanation of prepared recordings by the candidates of a problem, from the effects selected.

    `among` are the free forms that are compared, by default all. `below` is the evidence of another explanation, which
    leaves nothing and has no events: a form must beat it, and no events are sought.
    """
    own = replace(first, problem=problem)
    weighed = _on_machine(own, selection.best)
    if weighed is not own:
        selection = select(weighed.problem, selection.best, progress=progress)
    if below is None:
        outcome = explain(weighed.problem, selection, recordings, progress, among)
    else:
        proposal = search(weighed.problem, selection, among=among, below=below, progress=progress)
        outcome = Outcome(weighed.problem, selection, proposal, [])
    fitted, proposal = replace(weighed, problem=outcome.problem), outcome.proposal
    base = Explanation(
        fitted, _scaled(weighed, fitted), outcome.selection, None, outcome.events, laws=outcome.laws
    )
    if proposal is None:
        return base
    if not outcome.events:
        # the effects selected in its place may have described another machine
        fitted = weighed = fitted.reweighed(proposal.fit)
    fitted = replace(fitted, problem=fitted.problem.with_drift_estimated(proposal.fit))
    proposal = settled(fitted.problem, proposal)
    return replace(
        base, fitted=fitted, weighed=_scaled(weighed, fitted), proposal=proposal, laws=(), without_form=base
    )


def _scaled(prepared: Prepared, by: Prepared) -> Prepared:
    """Return recordings with the drifts of others."""
    return replace(prepared, problem=prepared.problem.with_scales(by.problem.noise.scales))
