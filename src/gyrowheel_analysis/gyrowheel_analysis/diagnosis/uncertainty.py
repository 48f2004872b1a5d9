"""What the uncertainty of the coefficients of a fit consists of: noise, the bench, and effects too small to be seen."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import UNDETECTED_SIZE
from gyrowheel_analysis.diagnosis.estimates import ErrorParts
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.problem import Problem

Array = NDArray[np.float64]


def error_parts(problem: Problem, fit: Fit) -> dict[tuple[str, str], ErrorParts]:
    """Return the parts of the uncertainty of every coefficient of a fit, by (term, coefficient).

    Everything is linear about the fit. An effect that was not found may be there with a size below its detection limit.
    All of them are nuisance parameters with a prior about zero, over which the coefficients are marginalised: the
    standard errors grow, and the estimate moves with their likeliest sizes.
    """
    inverse, _ = problem.unknowns.prior(fit.terms)
    own = problem.noise.whiten(fit.jacobian)
    others = problem.noise.whiten(_undetected(problem, fit))
    first = len(fit.nuisance)
    _, exact = _solved(own[:, first:], inverse[first:], np.zeros(len(own)), np.zeros(len(fit.columns)))
    step, whole = _solved(
        np.hstack([own, others]),
        np.concatenate([inverse, np.ones(others.shape[1])]),
        problem.noise.whiten(fit.residual),
        np.concatenate([-fit.pull, np.zeros(others.shape[1])]),
    )
    parts = {}
    for k, (term, name) in enumerate(fit.columns):
        noise, error = math.sqrt(exact[k]), fit.standard_error(term, name)
        parts[term, name] = ErrorParts(
            noise=min(noise, error),
            bench=math.sqrt(max(error**2 - noise**2, 0.0)),
            undetected=math.sqrt(max(float(whole[first + k]) - error**2, 0.0)),
            value=fit.coefficients[term][name],
            middle=fit.coefficients[term][name] + float(step[first + k]),
        )
    return parts


def scatter(problem: Problem, fit: Fit, along: Array) -> float:
    """Return how a sum of the unknowns scatters between recordings of one machine, as a standard deviation.

    `along` has the factor of each unknown in it. The standard error has two parts: the noise of the rows, which is new
    in every recording, and the deviations of the machine from the priors, which repeat.
    """
    inverse, _ = problem.unknowns.prior(fit.terms)
    own = fit.covariance @ along
    return math.sqrt(max(float(along @ own - np.sum((inverse * own) ** 2)), 0.0))


def _undetected(problem: Problem, fit: Fit) -> Array:
    """Return the rows (N, p) of every effect that model and fit lack, at the expected size of an undetected one."""
    unknowns, fitted = problem.unknowns, {term.name for term in fit.terms}
    kept = []
    for term in unknowns.candidates():
        if term.effect is not None:
            # deviations of instruments are parameters of the bench already
            new = term.name not in fitted and term.name not in unknowns.known and not unknowns.same_as(term)
            kept += [new] * len(term.amplitudes)
    # `Unknowns.scale` is five usual sizes
    return problem.prediction.candidate_columns[:, kept] * (UNDETECTED_SIZE / 5.0)


def _solved(design: Array, inverse: Array, rows: Array, priors: Array) -> tuple[Array, Array]:
    """Return the solution of a linear problem with priors, of these inverse deviations, and its variances."""
    every = np.vstack([design, np.diag(inverse)])
    size = np.linalg.norm(every, axis=0)
    size[size == 0.0] = 1.0
    every /= size
    covariance = np.linalg.pinv(every.T @ every, rcond=1e-13, hermitian=True)
    return covariance @ (every.T @ np.concatenate([rows, priors])) / size, np.diag(covariance) / size**2
