"""Two sets of recordings under one model: what changed between two benches, days or versions of a firmware.

Both sets are fitted together. Every unknown of the fit, and every effect of the library that the model lacks, may then
differ between the sets; a difference is accepted if chance would not bring its gain in any of those that are tried.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri

from gyrowheel_analysis.criteria import CHANGED_CHANCE, CHI2_RANGE, MOST_CHANGES, TIE_LOSS
from gyrowheel_analysis.diagnosis.proof import spread_of
from gyrowheel_analysis.diagnosis.selection import expected_chi2
from gyrowheel_analysis.fitting.fit import Point, Term
from gyrowheel_analysis.fitting.preparation import Progress, prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording

Array = NDArray[np.float64]

_STEPS = 3  # of Gauss and Newton: differences are small
_SHOWN = 1e-12  # square of the whitened derivative below which the recordings show nothing
_DETERMINED = 1.0  # of a prior deviation: a difference known no better takes no part in the joint test


@dataclass(frozen=True)
class Difference:
    """The difference of one quantity between the two sets, all else fitted again.

    Attributes
    ----------
    name : str
        A parameter of the bench, or ``EFFECT.COEFFICIENT``.
    unit : str
        SI unit.
    first, second : float
        Its value in each set; 0 in the middle for an effect that the model lacks.
    difference, standard_error : float
        The second less the first.
    gain : float
        Decrease of chi-squared by the difference, or by all of its effect.
    p : float
        Probability that chance gains as much in one of all differences that were tried.
    visible : float
        Difference from which on one is accepted.
    in_model : bool
        Whether the quantity is in the model; else it is a coefficient of an effect that the model lacks.
    """

    name: str
    unit: str
    first: float
    second: float
    difference: float
    standard_error: float
    gain: float
    p: float
    visible: float
    in_model: bool


@dataclass(frozen=True)
class Change:
    """A quantity, or an effect, that changed between the sets.

    Attributes
    ----------
    name : str
        The parameter or the effect.
    differences : tuple of Difference
        Of the parameter or of the coefficients of the effect, fitted with all other changes.
    alternatives : tuple of (str, float)
        What explains the difference nearly as well, with the loss in chi-squared.
    """

    name: str
    differences: tuple[Difference, ...]
    alternatives: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class SetComparison:
    """Outcome of `compare_sets`.

    Attributes
    ----------
    changes : tuple of Change
        What changed, the clearest first.
    tested : tuple of Difference
        Every other quantity of the model with its difference, each tried in addition to the changes.
    tried : int
        Number of differences tried, with those of effects that the model lacks.
    gain, degrees, p : float
        Decrease of chi-squared if all quantities of the model differ, their number as far as the recordings determine
        them, and the probability that chance gains as much.
    chi2_per_n, common_chi2_per_n : float
        Mean square of the whitened residual with the changes, and without any.
    explains : bool
        Whether the model with the changes leaves no more than chance explains.
    first, second : tuple of str
        Paths of the recordings of each set.
    model : str
        File of the model.
    """

    changes: tuple[Change, ...]
    tested: tuple[Difference, ...]
    tried: int
    gain: float
    degrees: int
    p: float
    chi2_per_n: float
    common_chi2_per_n: float
    explains: bool
    first: tuple[str, ...]
    second: tuple[str, ...]
    model: str


@one_thread()
def compare_sets(
    model: Model,
    first: Sequence[Recording],
    second: Sequence[Recording],
    *,
    progress: Progress | None = None,
) -> SetComparison:
    """Compare two sets of recordings under one model, its coefficients fitted again.

    Raises
    ------
    InputError
        If a set is empty, a recording is in both, or they have too little steady motion.
    """
    paths = [tuple(str(r.path) for r in own) for own in (first, second)]
    for name, own in zip(("first", "second"), paths, strict=True):
        if not own:
            raise InputError(f"{name} set: no recording given")
    if both := set(paths[0]) & set(paths[1]):
        raise InputError(f"{min(both)}: is in both sets; allowed: a recording in one of them")
    prepared = prepare([*first, *second], replace(model, effect_errors={}), progress=progress)
    if progress:
        progress("fitting both sets")
    terms = tuple(prepared.problem.unknowns.term(name) for name in model.effects)
    prepared = prepared.reweighed(prepared.problem.fit(terms))
    search = _Search(prepared.problem, terms, len(first))
    start = found = search.fit(())
    alternatives: list[tuple[tuple[str, float], ...]] = []
    tried = search.tried(start)
    while tried and len(found.groups) < MOST_CHANGES:
        best = max(tried, key=lambda own: own.gain)
        if best.p > CHANGED_CHANCE:
            break
        if progress:
            progress(f"{best.group.name} changed")
        near = sorted((best.gain - own.gain, own.group.name) for own in tried if own is not best)
        alternatives.append(tuple((name, loss) for loss, name in near if loss < TIE_LOSS))
        found = search.fit((*found.groups, best.group), found)
        tried = search.tried(found)
    gain, degrees = search.joint(start)
    changes = [
        Change(group.name, search.differences(found, group), own)
        for group, own in zip(found.groups, alternatives, strict=True)
    ]
    n = len(search.problem.measured)
    return SetComparison(
        changes=tuple(sorted(changes, key=lambda own: -own.differences[0].gain)),
        tested=tuple(own.differences[0] for own in tried if own.group.term is None),
        tried=len(search.groups),
        gain=gain,
        degrees=degrees,
        p=float(chdtrc(max(degrees, 1), max(gain, 0.0) / start.inflation)),
        chi2_per_n=found.chi2_rows / n,
        common_chi2_per_n=start.chi2_rows / n,
        explains=found.chi2_rows <= search.expected + CHI2_RANGE * spread_of(search.expected),
        first=paths[0],
        second=paths[1],
        model=model.origin,
    )


class _Group(NamedTuple):
    """What may differ together: a bench parameter, a coefficient of the model, or the amplitudes of a missing effect.

    `names` and `units` are those of its unknowns, `sizes` the values of one unit of the fit, `offset` the value at its
    zero; `place` is its number among the unknowns of the model, `term` a missing effect.
    """

    name: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    sizes: tuple[float, ...]
    offset: float = 0.0
    place: int = -1
    term: Term | None = None


class _Tried(NamedTuple):
    """The differences of a group in addition to those of a fit."""

    group: _Group
    differences: tuple[Difference, ...]

    @property
    def gain(self) -> float:
        return self.differences[0].gain

    @property
    def p(self) -> float:
        return self.differences[0].p


@dataclass(frozen=True)
class _State:
    """A fit of both sets in which some `groups` differ.

    `common` are the unknowns in the middle of both sets, `differing` the differences, the `places` of which among the
    unknowns are given, with their `covariance`; `white` is what is left of the whitened rows and the priors, `basis` an
    orthonormal basis of their derivatives, `columns` (N, unknowns) those of the rows.
    """

    groups: tuple[_Group, ...]
    common: Array
    differing: Array
    places: tuple[int, ...]
    covariance: Array
    white: Array
    basis: Array
    columns: Array
    chi2_rows: float
    inflation: float


class _Search:
    """Fits of both sets with differences of some unknowns."""

    def __init__(self, problem: Problem, terms: tuple[Term, ...], first: int) -> None:
        self._terms = terms
        lengths = [len(b) for b in problem.balances]
        #: -1/2 for rows of the first set, +1/2 for those of the second.
        self._side = np.repeat([-0.5 if k < first else 0.5 for k in range(len(lengths))], lengths)
        self.groups = _groups(problem, terms)
        self._missing = {
            g.name: problem.prediction.stated_columns(g.term) * g.sizes
            for g in self.groups
            if g.term is not None
        }
        self.problem = self._weighed(problem)
        self.expected = expected_chi2(self.problem) - sum(len(t.coefficients) for t in terms)

    def _weighed(self, problem: Problem) -> Problem:
        """Return the problem with the drifts estimated: what may differ between the sets does not count as drift."""
        fit = problem.fit(self._terms)
        rows = fit.residual + fit.jacobian[:, : problem.count] @ fit.nuisance
        every = np.hstack([fit.jacobian * problem.unknowns.widths(fit.terms), *self._missing.values()])
        scales, _ = problem.noise.best_scales(rows, np.hstack([every, self._side[:, None] * every]))
        return problem.with_scales(scales)

    def fit(self, groups: tuple[_Group, ...], before: _State | None = None) -> _State:
        """Return the fit in which some groups differ, from that with all but the last of them."""
        problem, unknowns = self.problem, self.problem.unknowns
        extra = tuple(g.term for g in groups if g.term is not None)
        terms = (*self._terms, *extra)
        inverse, names = unknowns.prior(terms)
        centre = unknowns.centre(terms)
        # of an effect that the model lacks, shapes stay as declared, and the common part is loosely zero
        free = list(range(len(centre)))
        for k, (term, name) in enumerate(((t, n) for t in terms for n in t.coefficients), problem.count):
            if term in extra and name in term.amplitudes:
                inverse[k] = 1.0 / unknowns.scale(term, name)
            elif term in extra:
                free.remove(k)
        where = {f"{term}.{name}": k for k, (term, name) in enumerate(names, problem.count)}
        places = [k for g in groups for k in ([g.place] if g.term is None else [where[n] for n in g.names])]
        if before is None:
            own = problem.refined(problem.fit(terms))
            common = np.concatenate([own.nuisance, [own.coefficients[t][n] for t, n in own.columns]])
        else:
            common = np.concatenate([before.common, centre[len(before.common) :]])
        differing = np.zeros(len(places))
        if before is not None:
            differing[: len(before.differing)] = before.differing
        rows = len(problem.measured)
        for step in range(_STEPS + 1):
            ends = [common.copy(), common.copy()]
            for end, side in zip(ends, (-0.5, 0.5), strict=True):
                end[places] += side * differing
            predicted = np.where(
                self._side < 0.0, *(problem.predict(_point(terms, end, problem)) for end in ends)
            )
            middle = _point(terms, common, problem)
            columns = np.hstack(
                [problem.prediction.nuisance_jacobian(middle, problem.base_jacobian)]
                + [problem.term_jacobian(t, middle) for t in terms]
            )
            both = np.hstack([columns[:, free], self._side[:, None] * columns[:, places]])
            priors = np.hstack([np.diag(inverse)[:, free], np.zeros((len(inverse), len(places)))])
            design = np.vstack([problem.noise.whiten(both), priors])
            target = np.concatenate(
                [problem.noise.whiten(problem.measured - predicted), inverse * (centre - common)]
            )
            size = np.linalg.norm(design, axis=0)
            size[size == 0.0] = 1.0
            if step < _STEPS:
                moved = np.linalg.lstsq(design / size, target, rcond=1e-12)[0] / size
                common[free] += moved[: len(free)]
                differing += moved[len(free) :]
        basis, triangle = np.linalg.qr(design / size)
        root = np.linalg.pinv(triangle)[len(free) :] / size[len(free) :, None]
        chi2 = float(target[:rows] @ target[:rows])
        return _State(
            groups,
            common,
            differing,
            tuple(places),
            root @ root.T,
            target - basis @ (basis.T @ target),
            basis,
            columns,
            chi2,
            max(1.0, chi2 / max(self.expected, 1.0)),
        )

    def tried(self, state: _State) -> list[_Tried]:
        """Return the differences of every group that does not differ yet, each alone in addition to those that do."""
        return [
            own for g in self.groups if g not in state.groups and (own := self._tried(state, g)) is not None
        ]

    def _tried(self, state: _State, group: _Group) -> _Tried | None:
        """Return the differences of a group; None if the recordings do not show them."""
        columns = self._missing[group.name] if group.term is not None else state.columns[:, [group.place]]
        apart, white = self._left(state, self._side[:, None] * columns), state.white
        if group.term is not None:
            # what is the same in both sets is no difference
            count = columns.shape[1]
            basis, _ = np.linalg.qr(np.vstack([self._left(state, columns), np.eye(count)]))
            apart, white = np.vstack([apart, np.zeros((count, count))]), np.append(white, np.zeros(count))
            apart, white = apart - basis @ (basis.T @ apart), white - basis @ (basis.T @ white)
        gram = apart.T @ apart
        if np.any(np.diag(gram) < _SHOWN):
            return None
        covariance = np.asarray(np.linalg.pinv(gram), dtype=np.float64)
        middle = np.zeros(columns.shape[1]) if group.term is not None else state.common[[group.place]]
        return _Tried(
            group,
            self._as_differences(
                state, group, middle, np.asarray(covariance @ (apart.T @ white)), covariance
            ),
        )

    def _left(self, state: _State, columns: Array) -> Array:
        """Return whitened columns, with zero rows for the priors, less what the unknowns of a fit explain."""
        white = self.problem.noise.whiten(columns)
        whole = np.vstack([white, np.zeros((len(state.white) - len(white), white.shape[1]))])
        return np.asarray(whole - state.basis @ (state.basis.T @ whole))

    def _as_differences(
        self, state: _State, group: _Group, middle: Array, steps: Array, covariance: Array
    ) -> tuple[Difference, ...]:
        """Return the differences of a group in SI units, given values and steps of the fit."""
        gain, degrees = float(steps @ np.linalg.pinv(covariance) @ steps), len(group.names)
        p = min(float(chdtrc(degrees, max(gain, 0.0) / state.inflation)) * len(self.groups), 1.0)
        least = state.inflation * float(chdtri(degrees, CHANGED_CHANCE / len(self.groups)))
        found = []
        for k, (name, unit, size) in enumerate(zip(group.names, group.units, group.sizes, strict=True)):
            value, step, error = (
                group.offset + size * middle[k],
                size * steps[k],
                size * math.sqrt(covariance[k, k]),
            )
            found.append(
                Difference(
                    name, unit, value - 0.5 * step, value + 0.5 * step, step, error, gain, p,
                    math.sqrt(least) * error, group.term is None,
                )
            )  # fmt: skip
        return tuple(found)

    def differences(self, state: _State, group: _Group) -> tuple[Difference, ...]:
        """Return the differences of a group that differs in a fit."""
        at = sum(len(g.names) for g in state.groups[: state.groups.index(group)])
        own = slice(at, at + len(group.names))
        # those of an effect that the model lacks are fitted in their own unit
        fitted = group if group.term is None else group._replace(sizes=(1.0,) * len(group.names))
        middle = state.common[list(state.places[own])]
        return self._as_differences(state, fitted, middle, state.differing[own], state.covariance[own, own])

    def joint(self, state: _State) -> tuple[float, int]:
        """Return the gain if all quantities of the model differ, and their number as far as the rows determine them."""
        places = [g.place for g in self.groups if g.term is None]
        columns = state.columns[:, places] * self.problem.unknowns.widths(self._terms)[places]
        directions, sizes, _ = np.linalg.svd(
            self._left(state, self._side[:, None] * columns), full_matrices=False
        )
        known = sizes > _DETERMINED
        return float(np.sum((directions[:, known].T @ state.white) ** 2)), int(known.sum())


def _groups(problem: Problem, terms: tuple[Term, ...]) -> tuple[_Group, ...]:
    """Return everything that may differ between the sets."""
    unknowns = problem.unknowns
    found = [
        _Group(name, (name,), (p[0].unit,), (p[0].uncertainty,), p[0].value, k)
        for k, (name, p) in enumerate(unknowns.nuisances)
    ]
    for term in terms:
        assert term.effect is not None  # the effects of a model
        for c in term.effect.coefficients:
            name = f"{term.name}.{c.name}"
            found.append(
                _Group(
                    name,
                    (name,),
                    (c.unit,),
                    (1.0,),
                    0.0,
                    unknowns.count + len(found) - len(unknowns.nuisances),
                )
            )
    for term in unknowns.candidates():
        if term.effect is None or term.name in unknowns.known or unknowns.same_as(term):
            continue  # the error of a parameter is that parameter
        own = [c for c in term.effect.coefficients if c.name in term.amplitudes]
        names, units = tuple(f"{term.name}.{c.name}" for c in own), tuple(c.unit for c in own)
        found.append(
            _Group(term.name, names, units, tuple(unknowns.scale(term, c.name) for c in own), term=term)
        )
    return tuple(found)


def _point(terms: tuple[Term, ...], x: Array, problem: Problem) -> Point:
    """Return the point of a vector of all unknowns."""
    coefficients: dict[str, dict[str, float]] = {t.name: {} for t in terms}
    for (term, name), value in zip(
        ((t, n) for t in terms for n in t.coefficients), x[problem.count :], strict=True
    ):
        coefficients[term.name][name] = float(value)
    return Point(terms, x[: problem.count], coefficients)
