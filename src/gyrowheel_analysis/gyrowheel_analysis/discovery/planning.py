"""What a test plan would show before it is run: detection limits, and the test that separates two terms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance import Balance
from gyrowheel_analysis.discovery.fit import Fit, Problem, Term
from gyrowheel_analysis.discovery.selection import threshold
from gyrowheel_analysis.reduction import planned_windows
from gyrowheel_control.plans import Plan
from gyrowheel_sim.errors import InputError

Array = NDArray[np.float64]

#: Plans that are offered as the next test.
SEPARATING_PLANS = (
    "air_density",
    "inverted",
    "preheat",
    "cone",
    "coast_down",
    "survey",
    "paper_speed",
    "paper_tilt",
)
#: A separation that settles a tie.
SETTLED = 25.0


@dataclass(frozen=True)
class Separation:
    """How well a plan, added to the recordings at hand, would tell two terms apart.

    Attributes
    ----------
    plan : str
        Name of the plan.
    expected : float
        Expected difference in chi-squared between the two, all else fitted.
    minutes : float
        Length of the plan.
    """

    plan: str
    expected: float
    minutes: float


class Planner:
    """Predicts what plans would show, given the recordings at hand.

    Parameters
    ----------
    problem : Problem
        The recordings at hand.
    fit : Fit
        What they say so far.
    """

    def __init__(self, problem: Problem, fit: Fit) -> None:
        self._problem = problem
        self._fit = fit
        self._problems: dict[str, Problem] = {}
        self._minutes: dict[str, float] = {}

    def _planned(self, name: str) -> Problem | None:
        if name not in self._problems:
            bench = self._problem.bench
            plan = Plan.load(name)
            try:
                plan.check(bench)
            except InputError:
                return None  # this bench cannot run it
            self._minutes[name] = plan.duration / 60.0
            self._problems[name] = Problem(
                [Balance(planned_windows(plan, bench), bench)], bench, self._problem.known
            )
        return self._problems[name]

    def separation(self, truth: Term, fit: Fit, rival: Term | None, plan: str) -> Separation | None:
        """Return how well a plan would tell `rival` (None: nothing at all) from `truth`, of the size that `fit` has."""
        other = self._planned(plan)
        if other is None:
            return None
        rest = [t for t in fit.terms if t != truth and t != rival]
        signals, designs = [], []
        for problem in (self._problem, other):
            rows = problem.predict(fit.nuisance[: problem.count], fit.coefficients)
            white = problem.noise.whiten
            amplitudes = np.array([fit.coefficients[truth.name][name] for name in truth.coefficients])
            null = np.array([problem.null(truth)[name] for name in truth.coefficients])
            nuisance = fit.nuisance[: problem.count]
            own = problem.term_jacobian(truth, nuisance, fit.coefficients, rows)
            count = len(truth.amplitudes)
            signals.append(white(own[:, :count] @ (amplitudes - null)[:count]))
            without = {name: values for name, values in fit.coefficients.items() if name != truth.name}
            at = problem.predict(nuisance, without)
            others = []
            if rival is not None:
                others.append(problem.term_jacobian(rival, nuisance, without, at)[:, : len(rival.amplitudes)])
            others += [
                problem.term_jacobian(t, nuisance, fit.coefficients, rows)[:, : len(t.amplitudes)]
                for t in rest
            ]
            designs.append(white(np.hstack([problem.base_jacobian[:, : len(problem.nuisances)], *others])))
        count = len(self._problem.nuisances)
        prior = np.zeros((count, designs[0].shape[1]))
        prior[:, :count] = np.eye(count)
        design = np.vstack([*designs, prior])
        signal = np.concatenate([*signals, np.zeros(count)])
        size = np.linalg.norm(design, axis=0)
        size[size == 0.0] = 1.0
        solution, *_ = np.linalg.lstsq(design / size, signal, rcond=1e-10)
        left = signal - (design / size) @ solution
        return Separation(plan, float(left @ left), self._minutes[plan])

    def revealing(self, name: str) -> Separation | None:
        """Return the plan that would show a registered effect of the middle usual size most clearly a minute."""
        term = Term(name, self._problem.library[name])
        assert term.effect is not None  # the registry holds effects only
        coefficients = {**self._fit.coefficients, name: term.effect.defaults()}
        terms = (*self._fit.terms, term)
        _, columns = self._problem.prior(terms)
        assumed = replace(self._fit, terms=terms, coefficients=coefficients, columns=columns)
        found = [
            s for plan in SEPARATING_PLANS if (s := self.separation(term, assumed, None, plan)) is not None
        ]
        settling = [s for s in found if s.expected >= SETTLED]
        return max(settling or found, key=lambda s: s.expected / s.minutes, default=None)

    def best(self, truth: Term, fit: Fit, rival: Term) -> Separation | None:
        """Return the plan that separates two terms best a minute, among those that settle it; else the strongest."""
        found = [
            s for plan in SEPARATING_PLANS if (s := self.separation(truth, fit, rival, plan)) is not None
        ]
        settling = [s for s in found if s.expected >= SETTLED]
        if settling:
            return max(settling, key=lambda s: s.expected / s.minutes)
        return max(found, key=lambda s: s.expected, default=None)


@dataclass(frozen=True)
class Limit:
    """The smallest size of an effect that the recordings could have shown.

    Attributes
    ----------
    term : Term
        The effect.
    coefficient : str
        Its coefficient.
    value : float
        Size at which it would have been found [unit of the coefficient].
    """

    term: Term
    coefficient: str
    value: float


def detection_limits(problem: Problem, fit: Fit, terms: Sequence[Term], inflation: float) -> list[Limit]:
    """Return the detection limit of every term that is not in the fit, all else fitted along."""
    inverse, _ = problem.prior(fit.terms)
    design = np.vstack([problem.noise.whiten(fit.jacobian), np.diag(inverse)])
    size = np.linalg.norm(design, axis=0)
    size[size == 0.0] = 1.0
    basis, _ = np.linalg.qr(design / size)
    at = problem.measured - fit.residual
    limits = []
    for term in terms:
        if term.effect is None or term in fit.terms:
            continue
        own = problem.term_jacobian(term, fit.nuisance, fit.coefficients, at)[:, : len(term.amplitudes)]
        columns = np.vstack([problem.noise.whiten(own), np.zeros((len(inverse), own.shape[1]))])
        columns = columns - basis @ (basis.T @ columns)
        needed = math.sqrt(threshold(term, inflation))
        for index, name in enumerate(term.amplitudes):
            norm = float(np.linalg.norm(columns[:, index]))
            limits.append(Limit(term, name, needed / norm if norm > 0.0 else math.inf))
    return limits
