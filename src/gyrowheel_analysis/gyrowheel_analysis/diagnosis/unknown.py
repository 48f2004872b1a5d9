"""The search for a free form: whether there is an effect that no declaration describes, and which formula does.

The forms are those of `free_forms`, compared by marginal likelihood with what the declared effects explain.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import (
    ANOTHER_SHAPE,
    BESIDE_FORM_GAIN,
    CHI2_RANGE,
    FORM_GAIN,
    FORM_GAIN_FOR_SEVERAL,
    FORM_LOSS,
    SHAPE_CONFLICT,
    TIE_LOSS,
)
from gyrowheel_analysis.diagnosis.free_forms import (
    air_forms,
    forms,
    further_forms,
    kind_of,
    like,
    memory_forms,
)
from gyrowheel_analysis.diagnosis.proof import lack_of_fit
from gyrowheel_analysis.diagnosis.selection import (
    Progress,
    Selection,
    Tie,
    expected_chi2,
    implausible,
    rank,
    unsupported,
)
from gyrowheel_analysis.fitting.fit import Fit, Prior, Term, without_prior
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_sim.effects.declaration import Coefficient, Effect
from gyrowheel_sim.effects.registry import for_bench

Array = NDArray[np.float64]

#: Linear gain in chi-squared from which a form is fitted: the family has the exponents and edges between which a fit
#: would move them, so that a third of what is needed shows at one of them.
_PROMISING = FORM_GAIN / 3.0
#: Part of the missing gain that exponents and edges may add to the linear gain.
_BY_SHAPE = 0.5
#: Square of a drift's scale from which on the drift may conceal a missing effect.
_COVERING = 2.0
_DENSER = 0.1  # part by which the density of the air changes, from which on laws of it are tried
_TRIED = 8
_AS_WELL = 0.9  # of the gain of effects, with which a form begins as they do
_FIRST_STEPS = 3  # of a fit, after which an unpromising form is dropped
_TRIED_OF_A_KIND = 2


@dataclass(frozen=True)
class Proposal:
    """A free form `term` for the unexplained part, the `fit` with it, and its gain in twice the log likelihood."""

    term: Term
    fit: Fit
    gain: float

    @property
    def kept(self) -> tuple[Term, ...]:
        """Registered effects that are kept next to it."""
        return tuple(t for t in self.fit.terms if t != self.term)


def family(problem: Problem, among: Sequence[Term]) -> list[Term]:
    """Return free forms as sized on the bench of a problem, without those that the model has."""
    return [
        Term(t.name, for_bench(t.effect, problem.bench))
        for t in among
        if t.effect is not None and t.name not in problem.unknowns.known
    ]


def _pool(problem: Problem) -> list[Term]:
    """Return the free forms that are tried on a problem."""
    memory = memory_forms() if problem.unknowns.memory else ()
    air = air_forms() if _air_changes(problem) else ()
    return family(problem, (*forms(), *memory, *air))


def _air_changes(problem: Problem) -> bool:
    """Whether the density of the air differs between windows."""
    windows = [balance.windows for balance in problem.balances]
    densities = np.concatenate([w.air_pressure / w.air_temperature for w in windows])
    return bool(np.ptp(densities) > _DENSER * densities.max())


def _loosened(problem: Problem, fit: Fit) -> dict[Term, Effect]:
    """Return the effects of a fit with free shapes, where the data disagree with those of their source: the effects.

    So what only resembles an effect of the library is a formula, and not that effect with a wrong shape.
    """
    result = {}
    for term in fit.terms:
        effect = term.effect
        if effect is None or effect.states or term.name in problem.unknowns.known:
            continue
        free = [c.name for c in effect.shapes if _contradicted(fit, term, c)]
        if free:
            names = itertools.chain([""], (f"_{number}" for number in itertools.count(2)))
            every = (f"{term.name}_like{end}" for end in names)
            name = next(own for own in every if own not in problem.unknowns.library)
            result[Term(name, like(effect, free, name))] = effect
    return result


def _contradicted(fit: Fit, term: Term, shape: Coefficient) -> bool:
    """Whether the data disagree with a shape of the source of an effect."""
    if not shape.shape_uncertainty:
        return False
    prior = Prior(shape.default, shape.shape_uncertainty)
    value, error = fit.coefficients[term.name][shape.name], fit.standard_error(term.name, shape.name)
    data = without_prior(value, error, prior)
    return data is not None and (
        abs(data[0] - prior.mean) > SHAPE_CONFLICT * math.hypot(data[1], prior.deviation)
    )


def _has_shapes(fit: Fit, term: Term, effect: Effect) -> bool:
    """Whether the shapes of a term are near those of an effect: then it is that effect."""
    found = fit.coefficients[term.name]
    return all(
        abs(found[c.name] - c.default) <= ANOTHER_SHAPE * c.shape_uncertainty
        for c in effect.shapes
        if c.shape_uncertainty
    )


def search(
    problem: Problem,
    selection: Selection,
    *,
    among: Sequence[Term] | None = None,
    below: float = math.inf,
    further: bool = False,
    progress: Progress | None = None,
) -> Proposal | None:
    """Look for a free form that describes the rows better than the selected effects; None if there is none.

    The forms are those `among` the family; by default all that the candidates of the problem allow, the `further` ones
    where that is asked for, several effects are selected, or an error is left. `below` is the evidence of another
    explanation, which a form must beat.

    Forms are compared by marginal likelihood with the drifts left free. So a misfit is seen even where an enlarged
    drift concealed it, and a real drift is not mistaken for a form. A form may be added to the selected effects or
    replace one or all of them. A single form that replaces several effects needs a smaller gain, and only about the
    same likelihood where these effects cancel each other.
    """
    if progress:
        progress("comparing with forms that no declared effect has")
    pool = _pool(problem) if among is None else family(problem, among)
    chosen = selection.best.terms
    leaves = _leaves(problem, selection.best)
    if among is None and (further or len(chosen) > 1 or leaves):
        pool += family(problem, further_forms())
    loosened = _loosened(problem, selection.best) if among is None else {}
    pool += loosened
    base = problem.evidence(selection.best)
    starts = [selection.best]
    if chosen:
        starts.append(selection.null)
    if len(chosen) > 1:
        starts += [problem.fit(tuple(t for t in chosen if t != own), selection.best) for own in chosen]
    cancels = cancelling(problem, selection.best)
    added = rank(problem, selection.best, pool)
    # a form that replaces an effect cannot explain more than one that is added to it, unless it begins as that effect
    able = {term.name for gain, term in added if not _hopeless(problem, gain, 0.0)}
    best: Proposal | None = None
    for start in starts:
        needed = FORM_GAIN
        if len(selection.best.terms) - len(start.terms) > 1:
            needed = FORM_GAIN_FOR_SEVERAL
        if cancels and start is not selection.best:
            needed = -FORM_LOSS
        tried = pool
        if best is not None and start.terms and not _leaves(problem, best.fit):
            # only the effects that act next to that form are still open
            tried = [term for term in tried if kind_of(term.name) == kind_of(best.term.name)]
        ranked = added if start is selection.best else rank(problem, start, tried)
        if start is not selection.best and needed == FORM_GAIN:
            as_well = _AS_WELL * (start.chi2 - selection.best.chi2) if leaves else math.inf
            ranked = [(gain, term) for gain, term in ranked if term.name in able or gain >= as_well]
        needed = max(needed, base - below, best.gain if best else -math.inf)
        without = problem.evidence(start)
        for gain, term in _foremost(ranked):
            if _hopeless(problem, gain, without - min(base, below)):
                continue
            fit = _fitted(problem, (*start.terms, term), start, without, without - base + needed)
            if fit is None:
                continue
            found = Proposal(term, fit, base - problem.evidence(fit))
            if not found.gain > needed or implausible(problem, fit) is not None:
                continue
            if term in loosened and _has_shapes(fit, term, loosened[term]):
                continue
            # a form that cancels an effect in the place of another one explains no more than that did
            if found.gain > FORM_GAIN or not (cancels and cancelling(problem, fit)):
                best, needed = found, found.gain
    return None if best is None else _simplest(problem, best, base)


def _leaves(problem: Problem, fit: Fit) -> bool:
    """Whether a fit leaves an error, or needs an enlarged drift."""
    problem = problem.with_drift_estimated(fit)
    return _covered(problem) >= _COVERING or lack_of_fit(problem, fit) > CHI2_RANGE


def _fitted(problem: Problem, terms: tuple[Term, ...], at: Fit, without: float, wanted: float) -> Fit | None:
    """Return the fit of terms, begun at another fit; None if its first steps gain too little.

    `without` is the evidence without the last term, `wanted` the gain in evidence that is needed. Some forms converge
    slowly, and most of them gain too little.
    """
    fit = problem.fit(terms, at, iterations=_FIRST_STEPS)
    return None if without - problem.evidence(fit) < _BY_SHAPE * wanted else problem.fit(terms, fit)


def _hopeless(problem: Problem, gain: float, excess: float) -> bool:
    """Whether the linear gain in chi-squared of a form rules it out without a fit.

    `excess` is the evidence to make up for. Fitting its exponents and edges can still bring a part of that, and the
    part that an enlarged drift conceals counts more once the form explains it.
    """
    return _covered(problem) * gain < max(_PROMISING, (1.0 - _BY_SHAPE) * excess)


def _covered(problem: Problem) -> float:
    """Return the factor by which enlarged drifts may have reduced a gain in chi-squared."""
    return max(problem.noise.scales.values(), default=1.0) ** 2


def fits_with_one(problem: Problem, start: Fit, terms: Sequence[Term], wanted: float) -> Iterator[Fit]:
    """Yield the fits with one more of the terms, those that roughly gain most first.

    Terms that cannot gain half of what is `wanted`, in twice the log likelihood, are passed over.
    """
    without = problem.evidence(start)
    for gain, term in _foremost(rank(problem.roughly(), start, terms)):
        if not _hopeless(problem, gain, wanted):
            fit = _fitted(problem, (*start.terms, term), start, without, wanted)
            if fit is not None:
                yield fit


def _foremost(ranked: Sequence[tuple[float, Term]]) -> list[tuple[float, Term]]:
    """Return the forms with the largest gains, few of each kind."""
    kinds: Counter[str] = Counter()
    result = []
    for gain, term in ranked:
        kind = kind_of(term.name)
        kinds[kind] += 1
        if kinds[kind] <= _TRIED_OF_A_KIND:
            result.append((gain, term))
        if len(result) == _TRIED:
            break
    return result


def as_found(proposal: Proposal, taken: Container[str] = ()) -> Effect:
    """Return the effect of a proposal about the exponents and edges that were found, named after its kind.

    Their uncertainties stay those of the family: a fit to the same recording must not count it twice. Where the name of
    the kind is `taken`, the form keeps its number.
    """
    effect = proposal.term.effect
    assert effect is not None  # every free form is an effect
    found = proposal.fit.coefficients[proposal.term.name]
    coefficients = []
    for c in effect.coefficients:
        if c.shape is not None:
            value = float(f"{found[c.name]:.6g}")  # as in a line of text
            c = replace(c, shape=value, usual=(value - c.shape_uncertainty, value + c.shape_uncertainty))
        coefficients.append(c)
    kind = kind_of(effect.name)
    return replace(effect, name=effect.name if kind in taken else kind, coefficients=tuple(coefficients))


def _simplest(problem: Problem, proposal: Proposal, base: float) -> Proposal:
    """Drop effects that are superfluous next to the form."""
    while len(proposal.fit.terms) > 1:
        trials = []
        for term in proposal.fit.terms:
            if term != proposal.term:
                fit = problem.fit(tuple(t for t in proposal.fit.terms if t != term), proposal.fit)
                if implausible(problem, fit) is None:
                    trials.append(Proposal(proposal.term, fit, base - problem.evidence(fit)))
        if not trials:
            break
        best = max(trials, key=lambda trial: trial.gain)
        if best.gain < proposal.gain - BESIDE_FORM_GAIN:
            break
        proposal = best
    return proposal


def settled(problem: Problem, proposal: Proposal) -> Proposal:
    """Return a proposal fitted to a problem with another noise, without effects that this noise does not support."""
    dof = max(expected_chi2(problem), 1.0)
    before, found = problem.evidence(proposal.fit), proposal
    while True:
        fit = problem.refined(problem.fit(found.fit.terms, found.fit))
        found = Proposal(found.term, fit, proposal.gain + before - problem.evidence(fit))
        failed = unsupported(problem, fit, fit.chi2_rows / dof, found.kept)
        if failed is None:
            return found
        rest = problem.fit(tuple(t for t in fit.terms if t != failed), fit)
        found = Proposal(found.term, rest, found.gain)


def alternatives(problem: Problem, proposal: Proposal) -> tuple[Tie, ...]:
    """Return forms of other kinds that describe the rows as well in the place of the proposed one, likeliest first.

    The loss of each is in twice the log likelihood, with the drifts that suit it best.
    """
    start = problem.fit(proposal.kept, proposal.fit)
    kind, known = kind_of(proposal.term.name), problem.evidence(proposal.fit)
    pool = [*_pool(problem), *family(problem, further_forms())]
    pool = [term for term in pool if kind_of(term.name) != kind]
    without = problem.evidence(start)
    found: dict[str, Tie] = {}
    for gain, term in _foremost(rank(problem, start, pool)):
        if _hopeless(problem, gain, without - known):
            continue
        fit = _fitted(problem, (*start.terms, term), proposal.fit, without, without - known)
        if fit is None:
            continue
        if problem.evidence(fit) - known < 2.0 * TIE_LOSS:
            fit = problem.refined(fit)
        loss, own = problem.evidence(fit) - known, kind_of(term.name)
        better = own not in found or loss < found[own].delta_chi2
        if loss < TIE_LOSS and better and implausible(problem, fit) is None:
            found[own] = Tie(term, loss, fit)
    return tuple(sorted(found.values(), key=lambda tie: tie.delta_chi2))


def cancelling(problem: Problem, fit: Fit) -> bool:
    """Whether two terms of a fit cancel each other to a large part."""
    columns: dict[str, Array] = {}
    for index, (term, name) in enumerate(fit.columns):
        value = fit.coefficients[term][name]
        if any(t.name == term and name in t.amplitudes for t in fit.terms):
            part = fit.jacobian[:, problem.count + index] * value
            columns[term] = columns.get(term, 0.0) + part
    parts = [problem.noise.whiten(part) for part in columns.values()]
    return any(
        float((a + b) @ (a + b)) < 0.5 * float(a @ a + b @ b) for a, b in itertools.combinations(parts, 2)
    )
