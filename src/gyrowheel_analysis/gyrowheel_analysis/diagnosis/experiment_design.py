"""Experiment design: detection limits, plans that separate two terms or improve precision, and separating channels."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.channels import CHANNELS
from gyrowheel_analysis.criteria import PRECISE, SETTLING_SEPARATION, VARIATION_BETTER, WORTHWHILE
from gyrowheel_analysis.diagnosis.estimates import DetectionLimit
from gyrowheel_analysis.diagnosis.findings import EffectFinding
from gyrowheel_analysis.diagnosis.result import Diagnosis
from gyrowheel_analysis.diagnosis.selection import threshold
from gyrowheel_analysis.fitting.fit import ERRORS, Fit, Unknowns, candidate_terms
from gyrowheel_analysis.fitting.kept_windows import CODE
from gyrowheel_analysis.fitting.prediction import Prediction
from gyrowheel_analysis.fitting.preparation import Progress, prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.segmentation import planned_windows
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_analysis.residuals.error_table import channel_values
from gyrowheel_control.plans.adaptation import plan_for
from gyrowheel_control.plans.plan import MARK, Plan
from gyrowheel_core import cache
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.effects import registry

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
#: Variations of plans that are offered where they separate two terms clearly better than any unvaried plan.
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
_KEPT = 64  # cached plans, those of two or three benches


@dataclass(frozen=True)
class Separation:
    """Expected separation of two terms by a plan in addition to the present recordings.

    Attributes
    ----------
    plan : str
        Name of the plan, with its variation if it has one (`gyrowheel_control.plans.plan`).
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
    """Return the best per minute among those that settle a tie; else the strongest."""
    settling = [s for s in found if s.expected >= SETTLING_SEPARATION]
    if settling:
        return max(settling, key=lambda s: s.rate)
    return max(found, key=lambda s: s.expected, default=None)


@dataclass(frozen=True)
class _Asked:
    """A requested plan, and all properties that decide its result for a model without effects."""

    plan: str
    stated: tuple[object, ...]
    harmonics: bool
    absent: frozenset[str]
    assumed: tuple[tuple[str, float], ...]
    wider: tuple[tuple[str, float], ...]
    unknowns: Unknowns = field(compare=False)


def planned(problem: Problem, name: str) -> tuple[Problem, float] | None:
    """Return the problem that a plan would give with the present drifts, and the plan's length in minutes.

    It is None where this bench cannot run the plan.
    """
    bench, unknowns = problem.bench, problem.unknowns
    asked = _Asked(
        name,
        bench.stated,
        all(b.harmonics for b in problem.balances),
        frozenset[str]().union(*(b.absent for b in problem.balances)),
        tuple({name: part for b in problem.balances for name, part in b.assumed.items()}.items()),
        tuple(unknowns.assumed.items()),
        unknowns,
    )
    # effects of the model act in the plan as well, and their declarations cannot be compared
    plain = not (unknowns.known or unknowns.declared)
    found = _planned(asked) if plain else _planned.__wrapped__(asked)
    if found is None:
        return None
    kept, minutes = found
    return kept.for_unknowns(unknowns).with_scales(problem.noise.scales), minutes


#: What the user's cache has of a plan.
_OF_WINDOWS = tuple(own.name for own in fields(Windows))
_ARRAYS = {"rows", "jacobian", "minutes", *_OF_WINDOWS}


@functools.lru_cache(maxsize=_KEPT)
def _planned(asked: _Asked) -> tuple[Problem, float] | None:
    """Return the problem of a plan with the drifts as stated; nearly every diagnosis on a bench needs the same.

    Windows, and derivatives with everything as stated, are kept in the user's cache.
    """
    unknowns, bench = asked.unknowns, asked.unknowns.bench
    given = (asked.plan, asked.stated, asked.harmonics, sorted(asked.absent), asked.assumed, asked.wider)
    name = f"plan_{cache.digest(cache.files_of(*CODE), np.__version__, repr(given))}"
    kept = cache.read_arrays(name)
    if kept is None or kept.keys() != _ARRAYS:
        try:
            plan = plan_for(asked.plan, bench)
        except InputError:
            return None
        kept, windows, minutes = None, planned_windows(plan, bench), plan.duration / 60.0
    else:
        windows, minutes = Windows(**{own: kept[own] for own in _OF_WINDOWS}), float(kept["minutes"])
    balance = Balance(
        windows, bench, harmonics=asked.harmonics, absent=asked.absent, assumed=dict(asked.assumed)
    )
    prediction = Prediction([balance], unknowns)
    # the part of effects of the model differs from model to model
    plain = not (unknowns.known or unknowns.declared)
    if plain and kept is not None:
        prediction = prediction.known_as_stated(kept["rows"], kept["jacobian"])
    elif plain:
        rows, jacobian = prediction.as_stated
        own_windows = {own: getattr(windows, own) for own in _OF_WINDOWS}
        cache.write_arrays(name, rows=rows, jacobian=jacobian, minutes=np.array(minutes), **own_windows)
    return Problem.predicted_by(prediction), minutes


class _Rival:
    """A fit to the present recordings of `problem` that plans are to rule out, with what depends on no truth.

    `designs` are the whitened derivatives of the rows by its unknowns, by plan.
    """

    def __init__(self, problem: Problem, fit: Fit) -> None:
        self.fit = fit
        self.designs: dict[str, Array] = {}
        self._problem = problem
        self._seen: tuple[Fit, tuple[Array, Array, float]] | None = None

    @cached_property
    def _known(self) -> tuple[Array, Array, Array, Array]:
        """The rows and the pull of the priors, and the derivatives by the unknowns as Q and R."""
        problem, fit = self._problem, self.fit
        inverse, _ = problem.unknowns.prior(fit.terms)
        values = np.concatenate([fit.nuisance, [fit.coefficients[t][n] for t, n in fit.columns]])
        pull = inverse * (values - problem.unknowns.centre(fit.terms))
        design = np.vstack([problem.noise.whiten(problem.jacobian(fit)), np.diag(inverse)])
        basis, triangle = np.linalg.qr(design)
        return problem.predict(fit), pull, basis, triangle

    def present(self, truth: Fit) -> tuple[Array, Array, float]:
        """Return the difference to a truth by the present recordings and the priors, common to all plans.

        The derivatives by the unknowns (unknowns, unknowns) and the difference (unknowns,), both in the space that the
        former span, and the square of the difference outside of it.
        """
        if self._seen is None or self._seen[0] is not truth:
            at, pull, basis, triangle = self._known
            noise = self._problem.noise
            signal = np.concatenate([noise.whiten(self._problem.predict(truth) - at), -pull])
            along = basis.T @ signal
            self._seen = truth, (triangle, along, float(signal @ signal - along @ along))
        return self._seen[1]


class Planner:
    """Predicts the results of plans in addition to the present recordings of `problem`, which `fit` describes."""

    def __init__(self, problem: Problem, fit: Fit) -> None:
        self._problem = problem
        self._fit = fit
        self._planned: dict[str, tuple[Problem, float] | None] = {}
        self._last: _Rival | None = None  # many effects are asked for next to the same fit

    def separation(self, truth: Fit, rival: Fit, plan: str) -> Separation | None:
        """Return the expected excess of `rival` over `truth` with a plan in addition to the present recordings.

        Both are fits to the present recordings. If the first is right, the second is fitted again to everything. Where
        the bench has its own version of a plan, say ``dtg_cone`` for ``cone``, that is used.
        """
        own = f"{self._problem.bench.name}_{plan}"
        plan = own if own.partition(MARK)[0] in Plan.shipped() else plan
        if plan not in self._planned:
            self._planned[plan] = planned(self._problem, plan)
        if (found := self._planned[plan]) is None:
            return None
        other, minutes = found
        if self._last is None or self._last.fit is not rival:
            self._last = _Rival(self._problem, rival)
        present, along, outside = self._last.present(truth)
        at = other.predict(rival)
        signal = np.concatenate([along, other.noise.whiten(other.predict(truth) - at)])
        designs = self._last.designs
        if plan not in designs:
            designs[plan] = other.noise.whiten(other.jacobian(rival))
        design = np.vstack([present, designs[plan]])
        if not (np.isfinite(signal).all() and np.isfinite(design).all()):
            return None  # fits to absurd readings: the machine of one cannot run the plan
        size = np.linalg.norm(design, axis=0)
        size[size == 0.0] = 1.0
        solution, *_ = np.linalg.lstsq(design / size, signal, rcond=1e-10)
        left = signal - (design / size) @ solution
        expected = outside + float(left @ left) - float(truth.nuisance @ truth.nuisance)
        return Separation(plan, max(expected, 0.0), minutes)

    def revealing(self, name: str) -> Separation | None:
        """Return the plan that would show a registered effect of a middle usual size best per minute."""
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

        A variation of a plan is taken where it is clearly better than every unvaried plan.
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


def detection_limits(problem: Problem, fit: Fit, inflation: float) -> list[DetectionLimit]:
    """Return the detection limits of the registered effects that model and fit lack, all else being estimated.

    What shapes a law has its usual value.
    """
    basis = problem.basis(fit)
    limits = []
    for term in candidate_terms(problem.bench) + problem.memory_terms:
        effect = term.effect
        if effect is None or term in fit.terms or term.name in problem.unknowns.known:
            continue
        own = problem.term_jacobian(term, fit, term.amplitudes)
        columns = np.vstack([problem.noise.whiten(own), np.zeros((len(fit.pull), own.shape[1]))])
        columns = columns - basis @ (basis.T @ columns)
        needed = math.sqrt(threshold(term, inflation))
        for index, c in enumerate(effect.amplitudes):
            norm = float(np.linalg.norm(columns[:, index]))
            value = needed / norm if norm > 0.0 else math.inf
            limits.append(DetectionLimit(term.name, effect.title, c.name, value, c.unit, c.usual))
    return limits


@dataclass(frozen=True)
class PrecisionTest:
    """A `plan` that would improve the precision of an effect.

    `now` and `expected` are the relative standard errors of its best known amplitude, now and after the test; `minutes`
    is the length of the plan.
    """

    effect: str
    plan: str
    now: float
    expected: float
    minutes: float


def relative_error(finding: EffectFinding) -> float:
    """Return the relative standard error of an effect's best known amplitude."""
    effect = registry().get(finding.name)
    shapes = {c.name for c in effect.shapes} if effect else set()
    return min(
        (
            abs(e.standard_error / e.value) if e.value else np.inf
            for key, e in finding.coefficients.items()
            if key not in shapes
        ),
        default=0.0,
    )


@one_thread()
def precision_test(
    recordings: Sequence[Recording],
    model: Model,
    diagnosis: Diagnosis,
    *,
    wanted: float = PRECISE,
    averages: bool = False,
    progress: Progress | None = None,
) -> PrecisionTest | None:
    """Return the shortest test that brings the least certain finding to the wanted precision; None if none helps.

    Parameters
    ----------
    recordings, model, diagnosis
        The recordings, the model, and their diagnosis.
    wanted : float
        Sufficient relative standard error.
    averages : bool
        Whether to use averages over whole revolutions alone, as the diagnosis did.
    """
    loose = [f for f in diagnosis.effects if relative_error(f) > wanted]
    if not loose:
        return None
    weakest = max(loose, key=relative_error)
    problem = prepare(recordings, model, harmonics=not averages, progress=progress).problem
    if progress:
        progress("finding the test that improves the precision most")
    fit = problem.fit([problem.unknowns.term(name) for name in diagnosis.ties])
    now = _relative(fit, weakest.name, fit.covariance)
    tests = [
        PrecisionTest(weakest.name, plan, now, _relative(fit, weakest.name, found[0]), found[1])
        for plan in (*SEPARATING_PLANS, *VARIED_PLANS)
        if (found := _with_plan(problem, fit, plan)) is not None
    ]
    enough = [t for t in tests if t.expected <= wanted]
    if enough:
        return min(enough, key=lambda t: t.minutes)
    useful = [t for t in tests if t.expected < (1.0 - WORTHWHILE) * now]
    return max(useful, key=lambda t: (t.now - t.expected) / t.minutes, default=None)


def _relative(fit: Fit, term: str, covariance: NDArray[np.float64]) -> float:
    """Return the relative standard error of a term's best known amplitude."""
    amplitudes = [c for t in fit.terms if t.name == term for c in t.amplitudes]
    errors = []
    for name in amplitudes:
        index = len(fit.nuisance) + fit.columns.index((term, name))
        value = abs(fit.coefficients[term][name])
        errors.append(float(np.sqrt(covariance[index, index])) / value if value > 0.0 else np.inf)
    return min(errors)


def _with_plan(problem: Problem, fit: Fit, name: str) -> tuple[NDArray[np.float64], float] | None:
    """Return the covariance after a plan in addition to the present recordings, and its length in minutes."""
    found = planned(problem, name)
    if found is None or not len(found[0].measured):
        return None
    other, minutes = found
    jacobian = other.jacobian(fit)
    inverse, _ = problem.unknowns.prior(fit.terms)
    parts = [problem.noise.whiten(fit.jacobian), other.noise.whiten(jacobian), np.diag(inverse)]
    design = np.vstack(parts)
    size = np.linalg.norm(design, axis=0)
    size[size == 0.0] = 1.0
    scaled = design / size
    covariance = np.linalg.pinv(scaled.T @ scaled, rcond=1e-13) / np.outer(size, size)
    return covariance, minutes


@dataclass(frozen=True)
class Discrimination:
    """Separation of two explanations by one channel.

    `part` is the channel (`channels.CHANNELS`), `title` its description, and `delta_chi2` the excess of chi-squared of
    the second explanation over the first there.
    """

    part: str
    title: str
    delta_chi2: float


@one_thread()
def discriminating_channels(
    recordings: Sequence[Recording], model: Model, name: str, rival: str
) -> list[Discrimination]:
    """Return the separation of an effect from another by each channel, the most separating channel first.

    Of the effects or errors of bench parameters, `name` explains the recordings and `rival` does not; `model` is
    without them.
    """
    problem = prepare(recordings, model).problem
    # a rival that may move the very parameter would explain the rows by it, at the price of its stated uncertainty
    others = _with_known(problem, ERRORS.get(name, ()))
    best, worse = problem.fit([problem.unknowns.term(name)]), others.fit([others.unknowns.term(rival)])
    found = [
        Discrimination(part, kind.measured, _chi2(problem, worse, part) - _chi2(problem, best, part))
        for part, kind in CHANNELS.items()
        if all(row in b.rows for row in kind.rows for b in problem.balances)
    ]
    return sorted(found, key=lambda t: -t.delta_chi2)


def _with_known(problem: Problem, groups: Sequence[str]) -> Problem:
    """Return a problem in which some groups of bench parameters are known to be as stated."""
    if not groups:
        return problem
    known = {
        p.name: replace(p, uncertainty=1.0e-3 * p.uncertainty)
        for group, parameters in problem.unknowns.nuisances
        if group in groups
        for p in parameters
    }
    bench = replace(problem.bench, parameters={**problem.bench.parameters, **known})
    return Problem.of(problem.balances, problem.unknowns.on_bench(bench)).with_noise(problem.noise)


def _chi2(problem: Problem, fit: Fit, part: str) -> float:
    white = problem.noise.whiten(fit.residual)
    own = [channel_values(problem.balances, white, row) for row in CHANNELS[part].rows]
    return float(np.sum(np.square(own)))
