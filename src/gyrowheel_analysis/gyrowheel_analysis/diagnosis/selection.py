"""Selection of missing terms: forward selection with swaps and elimination, cross-validation, ties."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import (
    ACCEPTED_GAIN,
    ACCEPTED_GAIN_FURTHER,
    CROSS_VALIDATION_LOSS,
    CROSS_VALIDATION_PARTS,
    ERROR_LIMIT,
    ERROR_TIE_LIMIT,
    RIVAL_LOSS,
    TIE_LOSS,
)
from gyrowheel_analysis.diagnosis.limits import is_possible
from gyrowheel_analysis.fitting.fit import ERRORS, Fit, Term, is_instrument
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.reduction.windows import direction_groups, masks, speed_groups

Array = NDArray[np.float64]

_MOST_TERMS = 4  # without instruments
_MOST_INSTRUMENTS = 5
_MOST_SEARCHES = 6  # after which terms that fail are only removed
_SHORTLIST = 5
_PAIRED = 3  # terms that are tried in a pair, and others next to each
#: Part of the gain of another term below which the linear gain of one without shapes rules it out without a fit.
_FAR_LESS = 0.5
_EXACT = 10  # foremost candidates whose gain is computed at the fit

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Tie:
    """A term that explains the rows nearly as well as the chosen one, or together with a `partner` as likely."""

    term: Term
    delta_chi2: float
    fit: Fit = field(repr=False)
    partner: Term | None = None

    @property
    def terms(self) -> tuple[Term, ...]:
        """The term, or both."""
        return (self.term,) if self.partner is None else (self.term, self.partner)


@dataclass(frozen=True)
class Finding:
    """A term that is missing in the model by the evidence of the recording.

    `delta_chi2` is the increase of chi-squared without it, everything else fitted again (`without`); `ties` are terms
    that explain the rows equally well, then pairs of terms, `rivals` the next best.
    """

    term: Term
    delta_chi2: float
    ties: tuple[Tie, ...]
    rivals: tuple[Tie, ...]
    without: Fit = field(repr=False)


@dataclass(frozen=True)
class InPlace:
    """The other terms that were `tried` in the place of a selected one, likeliest first.

    `without` is the fit without it; `memory` are the effects with a memory among them, which were no candidates.
    """

    term: Term
    without: Fit
    tried: tuple[Tie, ...]
    memory: tuple[Term, ...]

    @property
    def outdone(self) -> bool:
        """Whether an effect with a memory, which was no candidate, explains the rows better."""
        return any(tie.delta_chi2 < 0.0 and tie.term in self.memory for tie in self.tried)


@dataclass(frozen=True)
class Selection:
    """Outcome of the selection: the fit without and with the findings; `pool` are the terms that were tried."""

    problem: Problem
    null: Fit
    best: Fit
    pool: tuple[Term, ...]
    inflation: float

    @cached_property
    def in_place(self) -> tuple[InPlace, ...]:
        """The other terms that were tried in the place of each selected one."""
        return tuple(_in_place(self.problem, self.best, term, self.pool) for term in self.best.terms)

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """The selected terms with their ties and rivals, each of which takes a fit."""
        return tuple(
            _finding(self.problem, self.best, own, self.pool, self.inflation) for own in self.in_place
        )


def threshold(term: Term, inflation: float) -> float:
    """Return the gain in chi-squared that a term must bring."""
    return ACCEPTED_GAIN * max(1.0, inflation) + ACCEPTED_GAIN_FURTHER * (len(term.amplitudes) - 1)


def expected_chi2(problem: Problem) -> float:
    """Return the expected chi-squared of a complete model: rows less fitted degrees of freedom.

    A parameter with a prior counts as a degree of freedom as far as the rows determine it.
    """
    design = problem.noise.whiten(problem.base_jacobian)
    singular = np.linalg.svd(design, compute_uv=False)
    freed = 0 if problem.noise.events is None else problem.noise.events.shape[1]
    fitted = freed + float((singular**2 / (1.0 + singular**2)).sum())
    return len(problem.measured) - fitted


def select(problem: Problem, start: Fit | None = None, *, progress: Progress | None = None) -> Selection:
    """Select the terms that are missing in the model.

    The selection begins with the terms of `start`, those selected under a noise that hardly differs, by default none.

    A term is selected if it lowers chi-squared by the threshold and, for the error of a bench parameter, if the
    parameter then lies beyond five of its stated uncertainties. An effect of the model is a candidate like any other:
    its coefficients may differ from those of the model. Every selected term is tried against every other (swaps) and
    against none (elimination). When no further term reaches the threshold, each term must pass cross-validation: with
    it, the prediction of a speed, a tilt direction or a recording that was left out must not become worse.
    (Cross-validation comes last: earlier it would judge a term by others that are still missing.) In the final fit
    each term must still reach the threshold, by the noise of this fit, and have possible coefficients. A term that
    fails is removed, and the search continues without it.
    """
    say = progress or (lambda text: None)
    pool = problem.unknowns.candidates()
    null = problem.fit(())
    dof = max(expected_chi2(problem), 1.0)
    current, searching = null, _MOST_SEARCHES
    if start is not None and start.terms:
        current = problem.fit(start.terms, start)
        current = _eliminated(problem, _swapped(problem, current, pool), current.chi2_rows / dof)
    while True:
        if searching:
            current = _extended(problem, current, pool, dof, say)
        failed = _fails_cross_validation(problem, current)
        if failed is None and current.terms:
            current = problem.refined(current)
            failed = unsupported(problem, current, current.chi2_rows / dof)
        if failed is None:
            break
        searching = max(searching - 1, 0)
        pool = [t for t in pool if t != failed]
        current = problem.fit(tuple(t for t in current.terms if t != failed), current)
    return Selection(problem, null, current, tuple(pool), current.chi2_rows / dof)


def unsupported(
    problem: Problem, fit: Fit, inflation: float, among: Collection[Term] | None = None
) -> Term | None:
    """Return the most dispensable or an impossible one of the terms of a fit; None if each is needed.

    `problem` has the final noise; `inflation` is chi-squared over its expectation, by which the threshold grows. Only
    the terms `among` those of the fit are judged, by default all.
    """
    weakest, least = None, 0.0
    for term in fit.terms if among is None else among:
        if implausible(problem, fit) == term:
            return term
        without = problem.fit(tuple(t for t in fit.terms if t != term), fit)
        spare = without.chi2 - fit.chi2 - threshold(term, inflation)
        if spare < least:
            weakest, least = term, spare
    return weakest


def foremost(problem: Problem) -> Fit:
    """Return the fit with the one term that is missing most; without terms if none reaches the threshold."""
    null, dof = problem.fit(()), max(expected_chi2(problem), 1.0)
    return _with_one_more(problem, null, problem.unknowns.candidates(), dof) or null


def _extended(problem: Problem, current: Fit, pool: Sequence[Term], dof: float, say: Progress) -> Fit:
    """Add terms until no further one reaches the threshold."""
    while able := _further(current, pool):
        fit = _with_one_more(problem, current, able, dof)
        if fit is None:
            break
        say(f"{fit.terms[-1].name}: gains {current.chi2 - fit.chi2:.0f} in chi-squared")
        current = _eliminated(problem, _swapped(problem, fit, pool), fit.chi2_rows / dof)
    return current


def _with_one_more(problem: Problem, current: Fit, able: Sequence[Term], dof: float) -> Fit | None:
    """Return the best fit with one more of some terms; None if none of them reaches the threshold."""
    tried: list[tuple[Fit, Term]] = []
    for gain, term in rank(problem, current, able)[:_SHORTLIST]:
        most = current.chi2 - min((fit.chi2 for fit, _ in tried), default=current.chi2)
        shaped = len(term.coefficients) > len(term.amplitudes)
        if gain > 0.4 * threshold(term, 1.0) and (shaped or gain > _FAR_LESS * most):
            fit = problem.fit((*current.terms, term), current)
            if implausible(problem, fit) is None:
                tried.append((fit, term))
    if not tried:
        return None
    fit, term = min(tried, key=lambda pair: pair[0].chi2 + threshold(pair[1], 0.0))
    # the noise is judged with the term: the part that it explains is not noise
    return None if current.chi2 - fit.chi2 < threshold(term, fit.chi2_rows / dof) else fit


def _further(current: Fit, pool: Sequence[Term]) -> list[Term]:
    """Return the terms that may still be added to a fit."""
    instruments = sum(map(is_instrument, current.terms))
    full = {True: instruments >= _MOST_INSTRUMENTS, False: len(current.terms) - instruments >= _MOST_TERMS}
    return [t for t in pool if t not in current.terms and not full[is_instrument(t)]]


def _fails_cross_validation(problem: Problem, fit: Fit) -> Term | None:
    """Return the weakest effect that worsens a prediction of data left out; None if each improves it."""
    failing = []
    for term in fit.terms:
        if term.effect is not None:
            without = problem.fit(tuple(t for t in fit.terms if t != term), fit)
            if not survives_cross_validation(problem, without, fit, term):
                failing.append((without.chi2 - fit.chi2, term))
    return min(failing, key=lambda pair: pair[0])[1] if failing else None


def implausible(problem: Problem, fit: Fit, limit: float = ERROR_LIMIT) -> Term | None:
    """Return a term of a fit that is no explanation; None if each improves it.

    The error of a bench parameter must be more than `limit` stated uncertainties. The coefficients of an effect must be
    possible: one of one sign (it can only brake, push back or heat) that is clearly negative compensates for another
    that is not in the fit.
    """
    for term in fit.terms:
        if not is_possible(fit, term):
            return term
        if term.effect is None and relative_deviation(problem, fit, term) <= limit:
            return term
    return None


def relative_deviation(problem: Problem, fit: Fit, term: Term) -> float:
    """Return how many stated uncertainties a parameter lies from its stated value, less twice its standard error."""
    own = ERRORS[term.name]
    stated = max(p.relative_uncertainty for g, ps in problem.unknowns.nuisances if g in own for p in ps)
    value = abs(fit.coefficients[term.name]["relative_error"])
    return (value - 2.0 * fit.standard_error(term.name, "relative_error")) / stated


def rank(problem: Problem, current: Fit, pool: Sequence[Term]) -> list[tuple[float, Term]]:
    """Return the linear gain in chi-squared of every candidate, best first.

    The derivatives by most are those with everything as stated, which hardly differ from those at the fit; for the
    foremost they are taken at the fit, too, and the larger gain counts: where bench parameters nearly replace a
    candidate, either may be several times too small. A candidate that is linearly dependent on the fit is left out.
    """
    basis = problem.basis(current)
    white = np.concatenate([problem.noise.whiten(current.residual), -current.pull])
    white = white - basis @ (basis.T @ white)

    def ranked(terms: Sequence[Term], columns: Callable[[Term], Array]) -> list[tuple[float, Term]]:
        if not terms:
            return []
        parts = [columns(term) for term in terms]
        edges = np.cumsum([0, *(part.shape[1] for part in parts)])
        rows = problem.noise.whiten(np.hstack(parts))
        total = np.linalg.norm(rows, axis=0)
        every = -basis @ (basis[: len(rows)].T @ rows)
        every[: len(rows)] += rows
        norm = np.linalg.norm(every, axis=0)
        result = []
        for term, first, last in zip(terms, edges, edges[1:], strict=False):
            own = norm[first:last]
            # a column that the others reproduce to a part in ten thousand adds nothing, nor does one that is not finite
            if not np.all(own > 1.0e-4 * np.maximum(total[first:last], 1e-300)):
                continue
            solution = every[:, first:last] / own
            step, *_ = np.linalg.lstsq(solution, white, rcond=1e-8)
            result.append((float(white @ (solution @ step)), term))
        return sorted(result, key=lambda pair: -pair[0])

    def at_the_fit(term: Term) -> Array:
        if known:
            return problem.prediction.amplitude_columns(term, current, current.jacobian)
        return problem.term_jacobian(term, current, term.amplitudes)

    result = ranked(pool, problem.prediction.stated_columns)
    # next to an instrument that is not as stated, another one shows otherwise than in the derivatives that are known
    known = not any(map(is_instrument, current.terms))
    near = dict.fromkeys(term for _, term in result[:_EXACT])
    # with everything as stated, the error of a parameter that the fit moved far looks like that parameter itself
    far = {
        group
        for k, (group, _) in enumerate(problem.unknowns.nuisances)
        if abs(current.nuisance[k]) > 0.5 * ERROR_LIMIT
    }
    near |= dict.fromkeys(t for _, t in result if t.effect is None and far.intersection(ERRORS[t.name]))
    if not known:
        near |= dict.fromkeys(term for _, term in result if is_instrument(term))
    gains = {term: gain for gain, term in result}
    gains |= {term: max(gain, gains[term]) for gain, term in ranked(list(near), at_the_fit)}
    return sorted(((gain, term) for term, gain in gains.items()), key=lambda pair: -pair[0])


def _swapped(problem: Problem, fit: Fit, pool: Sequence[Term]) -> Fit:
    """Replace terms by others while that lowers chi-squared."""
    for _ in range(3):
        improved = False
        for term in fit.terms:
            rest = tuple(t for t in fit.terms if t != term)
            without = problem.fit(rest, fit)
            for gain, other in rank(problem, without, [t for t in pool if t not in fit.terms])[:3]:
                if without.chi2 - gain > fit.chi2 + 20.0:
                    continue
                trial = problem.fit((*rest, other), without)
                if implausible(problem, trial) is None and trial.chi2 < fit.chi2 - 2.0 - (
                    ACCEPTED_GAIN_FURTHER * (len(other.amplitudes) - len(term.amplitudes))
                ):
                    fit, improved = trial, True
                    break
            if improved:
                break
        if not improved:
            break
    return fit


def _eliminated(problem: Problem, fit: Fit, inflation: float) -> Fit:
    """Drop terms that have become superfluous."""
    while len(fit.terms) > 1:
        trials = [(problem.fit(tuple(t for t in fit.terms if t != term), fit), term) for term in fit.terms]
        without, term = min(trials, key=lambda pair: pair[0].chi2 - threshold(pair[1], inflation))
        if without.chi2 - fit.chi2 >= threshold(term, inflation):
            break
        fit = without
    return fit


def _in_place(problem: Problem, fit: Fit, term: Term, pool: Sequence[Term]) -> InPlace:
    rest = tuple(t for t in fit.terms if t != term)
    without = problem.fit(rest, fit)
    others = rank(problem, without, [t for t in pool if t not in fit.terms])
    # where effects without a memory suffice, one with a memory may do as well
    memory = [] if problem.unknowns.memory else [t for t in problem.memory_terms if t not in pool]
    others += rank(problem.roughly(), without, memory)
    tried: list[Tie] = []
    for place, (gain, other) in enumerate(others):
        hopeless = without.chi2 - gain > fit.chi2 + 4.0 * TIE_LOSS + 0.1 * (without.chi2 - fit.chi2)
        if place >= 2 and hopeless:
            continue  # the linear gain rules it out before the full fit
        trial = problem.fit((*rest, other), without)
        if abs(trial.chi2 - fit.chi2) < 2.0 * TIE_LOSS:
            trial = problem.refined(trial)
        if implausible(problem, trial, ERROR_TIE_LIMIT) is None:
            tried.append(Tie(other, trial.chi2 - fit.chi2, trial))
    tried.sort(key=lambda tie: tie.delta_chi2)
    return InPlace(term, without, tuple(tried), tuple(memory))


def _finding(problem: Problem, fit: Fit, own: InPlace, pool: Sequence[Term], inflation: float) -> Finding:
    # a law with a memory that is far likelier was dropped, as it predicts unused data worse
    ties = tuple(
        tie
        for tie in own.tried
        if tie.delta_chi2 < TIE_LOSS and (tie.delta_chi2 > -TIE_LOSS or tie.term not in own.memory)
    )
    rivals = tuple(tie for tie in own.tried if tie.delta_chi2 >= TIE_LOSS)[:2]
    able = [tie for tie in own.tried if tie.term not in own.memory]
    ties += tuple(_pairs(problem, fit, own.without, able, pool, inflation))
    return Finding(own.term, own.without.chi2 - fit.chi2, ties, rivals, own.without)


def _pairs(
    problem: Problem, fit: Fit, without: Fit, alone: Sequence[Tie], pool: Sequence[Term], inflation: float
) -> list[Tie]:
    """Return the pairs that explain the rows as well as a term, given the price of a further one, likeliest first.

    `alone` are the terms tried in its place, likeliest first: one of a pair explains a part by itself. Both must be
    needed.
    """
    gain = without.chi2 - fit.chi2
    found: dict[frozenset[Term], Tie] = {}
    for one in [own for own in alone if own.delta_chi2 < RIVAL_LOSS * gain][:_PAIRED]:
        others = [t for t in pool if t not in fit.terms and t != one.term]
        for least, other in rank(problem, one.fit, others)[:_PAIRED]:
            pair = frozenset({one.term, other})
            most = TIE_LOSS - threshold(other, inflation)
            # next to one of them the linear gain of the other is near the true one
            if one.delta_chi2 - least > most + TIE_LOSS + 0.1 * gain or pair in found:
                continue
            trial = problem.fit((*without.terms, one.term, other), one.fit)
            if abs(trial.chi2 - fit.chi2 - most) < 2.0 * TIE_LOSS:
                trial = problem.refined(trial)
            loss = trial.chi2 - fit.chi2
            if loss < most and not (
                implausible(problem, trial, ERROR_TIE_LIMIT) or unsupported(problem, trial, inflation, pair)
            ):
                found[pair] = Tie(one.term, loss, trial, other)
    return sorted(found.values(), key=lambda tie: tie.delta_chi2)


def groups(problem: Problem) -> dict[str, list[NDArray[np.bool_]]]:
    """Return the rows of every speed, tilt direction and recording, as masks over all rows."""
    speed, tilt, recording = [], [], []
    for number, balance in enumerate(problem.balances):
        w, count = balance.windows, len(balance.rows)
        speed.append(np.tile(w.mean_spin, count))
        tilt.append(np.tile(w.mean_tilt, count))
        recording.append(np.full(len(balance), number))
    recordings = np.concatenate(recording)
    return {
        "speed": masks(speed_groups(np.concatenate(speed)), len(recordings)),
        "azimuth": masks(direction_groups(np.concatenate(tilt)), len(recordings)),
        "recording": [recordings == number for number in range(len(problem.balances))],
    }


def inverse_of(normal: Array) -> Array:
    """Return the inverse of a normal matrix whose parameters differ by orders of magnitude."""
    scale = np.sqrt(np.diag(normal))
    scale[scale == 0.0] = 1.0
    return np.asarray(np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-12) / np.outer(scale, scale))


class LeftOut(NamedTuple):
    """A part of the rows as predicted from the rest.

    `residual` (n,) is the whitened residual of the part; `shift` (p,) and `covariance` (p, p) are those of the unknowns
    without it; `chi2` is that of the part by its noise and the uncertainty of the prediction.
    """

    residual: Array
    shift: Array
    covariance: Array
    chi2: float


def left_out(design: Array, residual: Array, inverse: Array, mask: NDArray[np.bool_]) -> LeftOut:
    """Return the part `mask` (N,) of the rows as predicted from the rest, linear about the fit to all rows.

    `design` (N, p) and `residual` (N,) are the whitened Jacobian and residual of the fit, whose pulls balance its
    gradient; `inverse` (p,) are the inverse prior deviations of the unknowns.
    """
    part, rest = design[mask], design[~mask]
    kept = rest.T @ rest + np.diag(inverse**2)
    covariance = inverse_of(kept)
    shift = covariance @ (part.T @ residual[mask])
    own = residual[mask] + part @ shift
    slope = part.T @ own
    chi2 = float(own @ own - slope @ inverse_of(kept + part.T @ part) @ slope)
    return LeftOut(own, shift, covariance, chi2)


def survives_cross_validation(problem: Problem, without: Fit, with_: Fit, term: Term) -> bool:
    """Whether the prediction of a speed, a tilt direction or a recording that was left out is no worse with a term.

    The prediction is judged by its own uncertainty (the predictive density of the part given the rest). A part is
    skipped where the rest does not determine the term's coefficients, and all are where bench parameters far from their
    stated values explain the rows as well as the term does: then there is nothing to validate.
    """
    if without.chi2_rows - with_.chi2_rows < 0.5 * (without.chi2 - with_.chi2):
        return True
    white = problem.noise.whiten
    inverse_without, inverse_with = (problem.unknowns.prior(fit.terms)[0] for fit in (without, with_))
    amplitudes = [
        problem.count + i
        for i, (name, key) in enumerate(with_.columns)
        if name == term.name and key in term.amplitudes
    ]
    # linear models about the two fits; the rows are whitened once, so that a group's drift is judged with the rest
    pairs = [
        (white(without.jacobian), white(without.residual), inverse_without),
        (white(with_.jacobian), white(with_.residual), inverse_with),
    ]
    for kind, parts in groups(problem).items():
        if len(parts) < CROSS_VALIDATION_PARTS[kind]:
            continue
        errors = np.zeros(2)
        for mask in parts:
            found = [left_out(*pair, mask) for pair in pairs]
            own = found[1].covariance[np.ix_(amplitudes, amplitudes)]
            null = problem.unknowns.null(term)
            values = np.array([with_.coefficients[term.name][name] - null[name] for name in term.amplitudes])
            if not np.all(np.isfinite(own)) or values @ np.linalg.pinv(own) @ values < 4.0 * len(values):
                continue
            errors += [found[0].chi2, found[1].chi2]
        if errors[1] > errors[0] + CROSS_VALIDATION_LOSS:
            return False
    return True
