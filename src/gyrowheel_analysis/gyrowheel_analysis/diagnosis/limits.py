"""Plausibility: limits of possible and usual values within which a finding is an explanation."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gyrowheel_analysis.criteria import FAR_FROM_STATED, FAR_FROM_USUAL, FAR_RELATIVE_ERROR, MARGIN
from gyrowheel_analysis.diagnosis.estimates import Beyond
from gyrowheel_analysis.fitting.fit import Fit, Term, Unknowns
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_sim.effects import registry
from gyrowheel_sim.parameter import physical_range

_AT_BOUND = 1.0e-6  # of the width of the range that a fit searches


def is_possible(fit: Fit, term: Term) -> bool:
    """Whether the coefficients of a term in a fit are possible: within physics and the declaration of the term.

    A coefficient at the end of the searched range is not possible, as it would go farther.
    """
    if term.effect is None:
        low, high = Unknowns.bounds(term, "relative_error")
        near = _AT_BOUND * (high - low)
        return low + near < fit.coefficients[term.name]["relative_error"] < high - near
    for c in term.effect.coefficients:
        value, error = fit.coefficients[term.name][c.name], fit.standard_error(term.name, c.name)
        low, high = c.physical
        if not low - MARGIN * error <= value <= high + MARGIN * error:
            return False
        near = _AT_BOUND * (c.bounds[1] - c.bounds[0])
        at_end = value <= c.bounds[0] + near or value >= c.bounds[1] - near
        if c.shape is None and value != c.null and at_end:
            return False
    if term.effect.greatest is not None:
        size, error = _size(fit, term)
        return size - MARGIN * error <= term.effect.greatest
    return True


def _size(fit: Fit, term: Term) -> tuple[float, float]:
    """Return the size of all amplitudes of a term together, and its standard error."""
    names = term.amplitudes
    values = np.array([fit.coefficients[term.name][name] for name in names])
    at = [len(fit.nuisance) + fit.columns.index((term.name, name)) for name in names]
    size = float(np.linalg.norm(values))
    along = values / size if size > 0.0 else np.zeros(len(names))
    return size, math.sqrt(max(float(along @ fit.covariance[np.ix_(at, at)] @ along), 0.0))


def beyond(problem: Problem, fit: Fit, terms: Sequence[Term]) -> list[Beyond]:
    """Return impossible or unusual values of a fit, including the coefficients of some terms, the gravest first.

    The terms must not be free forms, which have no usual size.
    """
    found = _parameters(problem, fit)
    for term in terms:
        found += unusual(fit, term)
    order = ("impossible", "unusual", "not_as_stated")
    return sorted(found, key=lambda b: (order.index(b.kind), -b.times))


def unusual(fit: Fit, term: Term) -> list[Beyond]:
    """Return the coefficients of a term in a fit that are far from usual."""
    if term.effect is None:
        value = fit.coefficients[term.name]["relative_error"]
        margin = MARGIN * fit.standard_error(term.name, "relative_error")
        limit = FAR_RELATIVE_ERROR[value > 0.0]
        if abs(value) - margin <= abs(limit):
            return []
        return [Beyond("unusual", term.name, "relative_error", value, limit, "1", value / limit)]
    if term.name not in registry():
        return []  # a user's usual size need not be measured
    result = []
    for c in term.effect.amplitudes:
        value = fit.coefficients[term.name][c.name]
        times = (abs(value) - MARGIN * fit.standard_error(term.name, c.name)) / c.usual[1]
        if times > FAR_FROM_USUAL:
            result.append(
                Beyond("unusual", term.name, c.name, value, c.usual[1], c.unit, abs(value) / c.usual[1])
            )
    return result


def _parameters(problem: Problem, fit: Fit) -> list[Beyond]:
    """Return implausible bench parameters, one a group: its members move together."""
    result = []
    values = problem.unknowns.values(fit)
    for index, (group, parameters) in enumerate(problem.unknowns.nuisances):
        error = math.sqrt(max(float(fit.covariance[index, index]), 0.0))
        away = float(fit.nuisance[index])
        for p in parameters:
            margin = MARGIN * error * p.uncertainty
            low, high = physical_range(p.name)
            value = values[p.name]
            name = p.name if len(parameters) == 1 else group
            if value + margin < low or value - margin > high:
                limit = low if value < low else high
                result.append(Beyond("impossible", name, "", value, limit, p.unit, 0.0))
                break
            if abs(away) - MARGIN * error > FAR_FROM_STATED:
                result.append(Beyond("not_as_stated", name, "", value, p.value, p.unit, abs(away)))
                break
    return result
