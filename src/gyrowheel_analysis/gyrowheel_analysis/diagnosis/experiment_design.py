"""Experiment design: detection limits of recordings, and the plan that separates two terms best per minute."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.criteria import SETTLING_SEPARATION, VARIATION_BETTER
from gyrowheel_analysis.diagnosis.selection import threshold
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.fitting.terms import Term
from gyrowheel_analysis.fitting.unknowns import Unknowns
from gyrowheel_analysis.reduction import planned_windows
from gyrowheel_control.plans.adaptation import plan_for
from gyrowheel_control.plans.plan import Plan
from gyrowheel_control.plans.variation import MARK
from gyrowheel_core.errors import InputError

Array = NDArray[np.float64]

#: Plans that are offered as the next test.
SEPARATING_PLANS = (
    "air_density",
    "inverted",
    "yaw",
    "preheat",
    "cone",
    "coast_down",
    "survey",
    "paper_speed",
    "paper_tilt",
)
#: Variations of plans that are offered where they separate two terms clearly better than any plan as it is.
VARIED_PLANS = tuple(
    f"{plan}{MARK}{setting}"
    for plan in ("check", "cone")
    for setting in (
        "air_density_ratio=0.3",
        "rig=inverted",
        "yaw_deg=90",
        "preheat_k=20",
        "spin_ratio=0.7",
        "tilt_ratio=1.3",
    )
)
_KEPT = 64  # plans, those of two or three benches


@dataclass(frozen=True)
class Separation:
    """How well a plan, in addition to the present recordings, would separate two terms.

    Attributes
    ----------
    plan : str
        Name of the plan, with its variation if it has one (`gyrowheel_control.plans.variation`).
    expected : float
        Expected difference in chi-squared between the two, all else fitted.
    minutes : float
        Length of the plan.
    """

    plan: str
    expected: float
    minutes: float

    @property
    def rate(self) -> float:
        """Expected separation per minute."""
        return self.expected / self.minutes


def _best(found: Sequence[Separation]) -> Separation | None:
    """Return the one that separates most per minute among those that settle a tie; else the one that separates most."""
    settling = [s for s in found if s.expected >= SETTLING_SEPARATION]
    if settling:
        return max(settling, key=lambda s: s.rate)
    return max(found, key=lambda s: s.expected, default=None)


@dataclass(frozen=True)
class _Asked:
    """A plan that is asked for, and all that decides what it would give for a model without effects."""

    plan: str
    stated: tuple[object, ...]
    harmonics: bool
    absent: frozenset[str]
    assumed: tuple[tuple[str, float], ...]
    wider: tuple[tuple[str, float], ...]
    unknowns: Unknowns = field(compare=False)


def planned(problem: Problem, name: str) -> tuple[Problem, float] | None:
    """Return the problem that a plan would give with the drifts as they are, and the plan's length in minutes.

    It is None where this bench cannot run the plan.
    """
    bench, unknowns = problem.bench, problem.unknowns
    asked = _Asked(
        name,
        (bench.name, bench.spin_loop, bench.gains, *bench.parameters.values()),
        all(b.harmonics for b in problem.balances),
        frozenset[str]().union(*(b.absent for b in problem.balances)),
        tuple({name: part for b in problem.balances for name, part in b.assumed.items()}.items()),
        tuple(unknowns.assumed.items()),
        unknowns,
    )
    # what a model has already acts in the plan as well, and its declarations have no name that tells them apart
    plain = not (unknowns.known or unknowns.declared)
    found = _planned(asked) if plain else _planned.__wrapped__(asked)
    if found is None:
        return None
    kept, minutes = found
    return kept.for_unknowns(unknowns).with_scales(problem.noise.scales), minutes


@functools.lru_cache(maxsize=_KEPT)
def _planned(asked: _Asked) -> tuple[Problem, float] | None:
    """Return the problem of a plan with the drifts as stated; nearly every diagnosis on a bench asks for the same."""
    bench = asked.unknowns.bench
    try:
        plan = plan_for(asked.plan, bench)
    except InputError:
        return None
    balance = Balance(
        planned_windows(plan, bench),
        bench,
        harmonics=asked.harmonics,
        absent=asked.absent,
        assumed=dict(asked.assumed),
    )
    return Problem.of([balance], asked.unknowns), plan.duration / 60.0


class Planner:
    """Predicts what plans would show in addition to the present recordings.

    Parameters
    ----------
    problem : Problem
        The present recordings.
    fit : Fit
        What they say so far.
    """

    def __init__(self, problem: Problem, fit: Fit) -> None:
        self._problem = problem
        self._fit = fit
        self._planned: dict[str, tuple[Problem, float] | None] = {}
        self._seen: tuple[Fit, Fit, Array, Array, float] | None = None

    def separation(self, truth: Fit, rival: Fit, plan: str) -> Separation | None:
        """Return by how much a plan, in addition to the present recordings, would make `rival` worse than `truth`.

        Parameters
        ----------
        truth, rival : Fit
            Two fits to the present recordings. If the first is right, the second is fitted again to everything.
        plan : str
            Name of a plan; of the bench's own one where there is one, say ``dtg_cone`` for ``cone``.
        """
        own = f"{self._problem.bench.name}_{plan}"
        # a bench of other speeds has plans of its own
        plan = own if own.partition(MARK)[0] in Plan.shipped() else plan
        if plan not in self._planned:
            self._planned[plan] = planned(self._problem, plan)
        if (found := self._planned[plan]) is None:
            return None
        other, minutes = found
        present, along, beside = self._present(truth, rival)
        at = other.predict(rival)
        signal = np.concatenate([along, other.noise.whiten(other.predict(truth) - at)])
        design = np.vstack([present, other.noise.whiten(other.jacobian(rival, at))])
        size = np.linalg.norm(design, axis=0)
        size[size == 0.0] = 1.0
        solution, *_ = np.linalg.lstsq(design / size, signal, rcond=1e-10)
        left = signal - (design / size) @ solution
        expected = beside + float(left @ left) - float(truth.nuisance @ truth.nuisance)
        return Separation(plan, max(expected, 0.0), minutes)

    def _present(self, truth: Fit, rival: Fit) -> tuple[Array, Array, float]:
        """Return what the present recordings and the priors say of two fits.

        Returns
        -------
        ndarray (unknowns, unknowns), ndarray (unknowns,), float
            Derivatives by the unknowns of `rival` and the difference of the two, both in the space that the former
            span, and the square of the difference beside that space. All plans have them in common.
        """
        if self._seen is not None and self._seen[0] is truth and self._seen[1] is rival:
            return self._seen[2:]
        problem = self._problem
        inverse, _ = problem.unknowns.prior(rival.terms)
        values = np.concatenate([rival.nuisance, [rival.coefficients[t][n] for t, n in rival.columns]])
        pull = inverse * (values - problem.unknowns.centre(rival.terms))
        at = problem.predict(rival)
        signal = np.concatenate([problem.noise.whiten(problem.predict(truth) - at), -pull])
        design = np.vstack([problem.noise.whiten(problem.jacobian(rival, at)), np.diag(inverse)])
        basis, triangle = np.linalg.qr(design)
        along = basis.T @ signal
        self._seen = truth, rival, triangle, along, float(signal @ signal - along @ along)
        return self._seen[2:]

    def revealing(self, name: str) -> Separation | None:
        """Return the plan that would show a registered effect of a middle usual magnitude best per minute."""
        term = self._problem.unknowns.term(name)
        assert term.effect is not None  # the registry holds effects only
        coefficients = {**self._fit.coefficients, name: term.effect.defaults()}
        terms = (*self._fit.terms, term)
        _, columns = self._problem.unknowns.prior(terms)
        assumed = replace(self._fit, terms=terms, coefficients=coefficients, columns=columns)
        found = [
            s for plan in SEPARATING_PLANS if (s := self.separation(assumed, self._fit, plan)) is not None
        ]
        settling = [s for s in found if s.expected >= SETTLING_SEPARATION]
        return max(settling or found, key=lambda s: s.rate, default=None)

    def best(self, truth: Fit, rival: Fit) -> Separation | None:
        """Return the plan that separates two fits best per minute among those that settle a tie; else the strongest.

        A variation of a plan is taken where it is clearly better than every plan as it is.
        """
        plain, other = (
            _best([s for plan in plans if (s := self.separation(truth, rival, plan)) is not None])
            for plans in (SEPARATING_PLANS, VARIED_PLANS)
        )
        if plain is None or other is None:
            return plain or other
        settles = other.expected >= SETTLING_SEPARATION
        if settles and plain.expected >= SETTLING_SEPARATION:
            return other if other.rate > VARIATION_BETTER * plain.rate else plain
        return other if settles or other.expected > VARIATION_BETTER * plain.expected else plain


@dataclass(frozen=True)
class Limit:
    """The smallest magnitude of an effect that the recordings could have shown.

    Attributes
    ----------
    term : Term
        The effect.
    coefficient : str
        Its coefficient.
    value : float
        Magnitude at which it would have been found [unit of the coefficient].
    """

    term: Term
    coefficient: str
    value: float


def detection_limits(problem: Problem, fit: Fit, terms: Sequence[Term], inflation: float) -> list[Limit]:
    """Return the detection limit of every term that is not in the fit, all else fitted along."""
    basis = problem.basis(fit)
    at = problem.measured - fit.residual
    limits = []
    for term in terms:
        if term.effect is None or term in fit.terms:
            continue
        own = problem.term_jacobian(term, fit, at, term.amplitudes)
        columns = np.vstack([problem.noise.whiten(own), np.zeros((len(fit.pull), own.shape[1]))])
        columns = columns - basis @ (basis.T @ columns)
        needed = math.sqrt(threshold(term, inflation))
        for index, name in enumerate(term.amplitudes):
            norm = float(np.linalg.norm(columns[:, index]))
            limits.append(Limit(term, name, needed / norm if norm > 0.0 else math.inf))
    return limits
