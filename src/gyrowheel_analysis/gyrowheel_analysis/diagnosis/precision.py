"""Precision of what was found, and the test that improves it most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import PRECISE, WORTHWHILE
from gyrowheel_analysis.diagnosis.experiment_design import SEPARATING_PLANS, VARIED_PLANS, planned
from gyrowheel_analysis.diagnosis.result import Diagnosis, EffectFinding
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.preparation import Progress, one_thread, prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.effects import registry


@dataclass(frozen=True)
class PrecisionTest:
    """A test that would improve the precision of a finding.

    Attributes
    ----------
    effect : str
        The effect.
    plan : str
        The test.
    now, expected : float
        Relative standard error of its best known amplitude, now and after the test.
    minutes : float
        Length of the plan.
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
    recordings : sequence of Recording
        The recordings that were diagnosed.
    model : Model
        The model that was diagnosed.
    diagnosis : Diagnosis
        What was found in them.
    wanted : float
        Relative standard error that is good enough.
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
    tests = []
    for plan in (*SEPARATING_PLANS, *VARIED_PLANS):
        found = _with_plan(problem, fit, plan)
        if found is not None:
            covariance, minutes = found
            tests.append(
                PrecisionTest(weakest.name, plan, now, _relative(fit, weakest.name, covariance), minutes)
            )
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
    jacobian = other.jacobian(fit, other.predict(fit))
    inverse, _ = problem.unknowns.prior(fit.terms)
    parts = [problem.noise.whiten(fit.jacobian), other.noise.whiten(jacobian), np.diag(inverse)]
    design = np.vstack(parts)
    size = np.linalg.norm(design, axis=0)
    size[size == 0.0] = 1.0
    scaled = design / size
    covariance = np.linalg.pinv(scaled.T @ scaled, rcond=1e-13) / np.outer(size, size)
    return covariance, minutes
