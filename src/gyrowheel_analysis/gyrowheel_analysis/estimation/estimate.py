"""Estimation of chosen parameters of a model: which are free, their priors and bounds.

The rows, their noise and their events are those of `add.add_effect`. What differs is that the user decides what is
estimated. The minimum is that of `scipy.optimize.least_squares`.
"""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.channels import LISTED
from gyrowheel_analysis.diagnosis.events import accepted, beside_events
from gyrowheel_analysis.estimation.cost import LOSSES, ROUGH, Cost, Minimum, Unknown, log_determinant
from gyrowheel_analysis.estimation.result import STEP, Estimation, Matrix, Parameter
from gyrowheel_analysis.fitting.fit import Prior, Term, without_prior
from gyrowheel_analysis.fitting.preparation import Prepared, Progress, prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model, Override
from gyrowheel_analysis.residuals.error_table import channel_values, channels_of
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError, nearest
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.parameter import physical_range

Array = NDArray[np.float64]

#: Step of central differences before the standard errors are known, in widths of the unknowns.
_FIRST_STEP = 1e-3


@one_thread()
def estimate(
    model: Model,
    recordings: Sequence[Recording],
    *,
    free: str | Sequence[str] | None = None,
    fixed: str | Sequence[str] = (),
    priors: Mapping[str, tuple[float, float] | None] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    loss: str = "linear",
    progress: Progress | None = None,
) -> Estimation:
    """Estimate parameters of a model from recordings.

    Parameters
    ----------
    model : Model
        The model; where nothing else is given, its values are where the search begins and what is fixed.
    recordings : sequence of Recording
        Recordings of one machine.
    free, fixed : sequence of str, optional
        Parameters to estimate, all unless given; and those of them to hold. ``windage.w`` is a coefficient, ``windage``
        all coefficients of an effect, ``bench`` all uncertain bench parameters; ``*`` stands for any letters.
    priors : mapping, optional
        {parameter: (mean, standard deviation)} or {parameter: None} for no prior. Unless given, bench parameters have
        their stated uncertainty, and shapes of laws that of their declaration.
    bounds : mapping, optional
        {parameter: (lowest, highest)} [SI]; unless given, what a model file may hold.
    loss : str
        ``linear`` (least squares), or ``soft_l1``, ``huber``, ``cauchy`` for noise with heavy tails.
    progress : callable, optional
        Called with a line of text now and then.

    Raises
    ------
    InputError
        If a name is unknown, a prior or bound is impossible, or the recordings do not determine a free parameter.
    """
    if loss not in LOSSES:
        raise InputError(f"loss: {loss!r} is not allowed; allowed: {', '.join(LOSSES)}")
    prepared = prepare(recordings, replace(model, effect_errors={}), progress=progress)
    terms = [prepared.problem.unknowns.term(name) for name in model.effects]
    if progress:
        progress("fitting")
    prepared = prepared.reweighed(prepared.problem.fit(terms))
    happened = accepted(prepared.problem, prepared.problem.fit(terms), recordings)
    prepared = replace(prepared, problem=beside_events(prepared.problem, terms, happened))
    problem = prepared.problem
    unknowns = _limited(_unknowns(model, problem, terms), priors or {}, bounds or {})
    chosen = _chosen([u.name for u in unknowns], free, fixed)
    if not chosen:
        raise InputError("free: no parameter is left to estimate")
    cost = Cost(problem, terms, unknowns, chosen, loss)
    found, covariance = _minimised(cost)
    return _estimation(model, recordings, prepared, cost, found, covariance)


def _unknowns(model: Model, problem: Problem, terms: Sequence[Term]) -> list[Unknown]:
    """Return all unknowns in the order of the fit, with what the bench and the declarations state."""
    result = []
    for group, parameters in problem.unknowns.nuisances:
        p = parameters[0]
        own = model.overrides.get(p.name)
        start = p.value if own is None else own.value
        prior = Prior(p.value, p.uncertainty)
        result.append(
            Unknown(
                group,
                p.value,
                p.uncertainty,
                p.unit,
                start,
                prior,
                physical_range(p.name),
                p.value,
                100.0 * p.uncertainty,
            )
        )
    for term in terms:
        assert term.effect is not None  # the effects of a model
        for c in term.effect.coefficients:
            shaped = c.shape is not None and c.shape_uncertainty > 0.0
            result.append(
                Unknown(
                    f"{term.name}.{c.name}",
                    0.0,
                    1.0,
                    c.unit,
                    model.effects[term.name][c.name],
                    Prior(float(c.shape or 0.0), c.shape_uncertainty) if shaped else None,
                    c.bounds,
                    c.null,
                    problem.unknowns.scale(term, c.name) or abs(model.effects[term.name][c.name]) or 1.0,
                )
            )
    return result


def _limited(
    unknowns: Sequence[Unknown],
    priors: Mapping[str, tuple[float, float] | None],
    bounds: Mapping[str, tuple[float, float]],
) -> list[Unknown]:
    """Return the unknowns with the priors and bounds that the user gave."""
    own = {u.name: u for u in unknowns}
    for name in (*priors, *bounds):
        if name not in own:
            raise InputError(f"{name}: no such parameter; {nearest(name, own)}")
    for name, prior in priors.items():
        if prior is not None and not (len(prior) == 2 and np.isfinite(prior).all() and prior[1] > 0.0):
            raise InputError(
                f"priors.{name}: {prior} is not allowed; allowed: (mean, standard deviation > 0)"
            )
        own[name] = own[name]._replace(prior=None if prior is None else Prior(*map(float, prior)))
    for name, given in bounds.items():
        low, high = own[name].bounds
        if len(given) != 2 or not low <= given[0] < given[1] <= high:
            raise InputError(
                f"bounds.{name}: {given} is not allowed; allowed: (lowest, highest) within {low:g} .. {high:g} "
                f"{own[name].unit}"
            )
        own[name] = own[name]._replace(bounds=(float(given[0]), float(given[1])))
    return list(own.values())


def _chosen(names: Sequence[str], free: str | Sequence[str] | None, fixed: str | Sequence[str]) -> list[int]:
    """Return the numbers of the unknowns that are free."""

    def matching(field: str, patterns: str | Sequence[str]) -> set[str]:
        found: set[str] = set()
        for pattern in [patterns] if isinstance(patterns, str) else patterns:
            own = {
                name
                for name in names
                if fnmatch.fnmatchcase(name, pattern)
                or name.startswith(f"{pattern}.")
                or (pattern == "bench" and "." not in name)
            }
            if not own:
                raise InputError(f"{field}: {pattern}: no such parameter; {nearest(pattern, names)}")
            found |= own
        return found

    wanted = set(names) if free is None else matching("free", free)
    wanted -= matching("fixed", fixed)
    free_ones = [k for k, name in enumerate(names) if name in wanted]
    return sorted(free_ones, key=lambda k: "." not in names[k])  # coefficients of effects first


def _minimised(cost: Cost) -> tuple[Minimum, Array]:
    """Return the minimum of a cost, and the covariance of the free parameters there."""
    steps = _FIRST_STEP * np.array([u.width for u in cost.free])
    first = cost.minimum(cost.start, steps, tolerance=ROUGH)
    jacobian = cost.jacobian(first.values, steps)
    size = np.linalg.norm(jacobian, axis=0)
    for unknown, own in zip(cost.free, size, strict=True):
        if own == 0.0:
            raise InputError(
                f"{unknown.name}: these recordings do not depend on it; allowed: fixed, or with a prior"
            )
    inverse = np.linalg.pinv((jacobian / size).T @ (jacobian / size), rcond=1e-13) / np.outer(size, size)
    steps = np.minimum(STEP * np.sqrt(np.diag(inverse)), STEP * (cost.bounds[1] - cost.bounds[0]))
    found = cost.minimum(first.values, steps)
    inside = np.clip(found.values, cost.bounds[0] + 2.0 * steps, cost.bounds[1] - 2.0 * steps)
    curvature = cost.hessian(inside, steps)
    covariance = np.linalg.pinv(curvature * np.outer(steps, steps)) * np.outer(steps, steps)
    if not (np.isfinite(covariance).all() and np.all(np.diag(covariance) > 0.0)):
        raise InputError(
            "fit: the recordings do not determine all free parameters; allowed: fewer free ones, or priors for them"
        )
    return found, np.asarray(covariance, dtype=np.float64)


def _estimation(
    model: Model,
    recordings: Sequence[Recording],
    prepared: Prepared,
    cost: Cost,
    found: Minimum,
    covariance: Array,
) -> Estimation:
    """Return the facts of a minimum."""
    problem, chi2 = prepared.problem, float(np.sum(cost.residuals(found.values) ** 2))
    white = cost.white(found.values)
    errors = np.sqrt(np.diag(covariance))
    parameters = {
        u.name: Parameter(
            u.name, float(x), float(error), u.unit, u.start, True, u.prior, u.bounds, k in found.at_bound,
            None if k in found.at_bound else without_prior(float(x), float(error), u.prior),
        )
        for k, (u, x, error) in enumerate(zip(cost.free, found.values, errors, strict=True))
    }  # fmt: skip
    parameters |= {
        u.name: Parameter(u.name, u.start, 0.0, u.unit, u.start, False, u.prior, u.bounds)
        for u in cost.unknowns
        if u.name not in parameters
    }
    events = 0 if problem.noise.events is None else problem.noise.events.shape[1]
    likelihood = -0.5 * (
        float(white @ white)
        + log_determinant(problem.noise)
        + (len(white) - events) * math.log(2.0 * math.pi)
    )
    evidence = likelihood + 0.5 * float(np.linalg.slogdet(covariance / np.outer(errors, errors))[1])
    for u, value, error in zip(cost.free, found.values, errors, strict=True):
        mean, deviation = u.prior or (u.centre, u.width)
        evidence += math.log(error / deviation) - 0.5 * ((value - mean) / deviation) ** 2
    names = channels_of(problem.balances)
    by_channel = {
        name: np.concatenate([channel_values(problem.balances, white, row) for row in LISTED[name].rows])
        for name in names
    }
    return Estimation(
        parameters=parameters,
        covariance=Matrix(tuple(u.name for u in cost.free), covariance),
        chi2=chi2,
        chi2_rows=float(white @ white),
        rows=len(white),
        degrees_of_freedom=len(white) - events - sum(u.prior is None for u in cost.free),
        channels={name: (float(own @ own), len(own)) for name, own in by_channel.items()},
        log_likelihood=likelihood,
        log_evidence=evidence,
        loss=cost.loss,
        recordings=tuple(str(r.path) for r in recordings),
        fitted=_changed(model, recordings, problem, parameters),
        cost=cost,
        _prepared=prepared,
    )


def _summary(parameters: Mapping[str, Parameter]) -> list[str]:
    """Return the names of the free parameters; those of the bench counted where they are many."""
    free = [name for name, own in parameters.items() if own.free]
    bench = [name for name in free if "." not in name]
    if len(bench) <= 3:
        return free
    return [*(name for name in free if "." in name), f"{len(bench)} bench parameters"]


def _changed(
    model: Model, recordings: Sequence[Recording], problem: Problem, parameters: Mapping[str, Parameter]
) -> Model:
    """Return the model with the estimates."""
    overrides = dict(model.overrides)
    for group, members in problem.unknowns.nuisances:
        own, first = parameters[group], members[0]
        for p in members if own.free and group not in problem.unknowns.assumed else ():
            scale = p.uncertainty / first.uncertainty
            overrides[p.name] = Override(
                p.value + scale * (own.value - first.value), scale * own.standard_error
            )
    effects, errors = ({n: dict(v) for n, v in own.items()} for own in (model.effects, model.effect_errors))
    for name, own in parameters.items():
        effect, dot, key = name.partition(".")
        if dot and own.free:
            effects[effect][key] = own.value
            errors.setdefault(effect, {})[key] = own.standard_error
    entry = {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "what": f"fit {', '.join(_summary(parameters))}",
        "fit": [str(r.path) for r in recordings],
    }
    return model.changed(entry, overrides=overrides, effects=effects, effect_errors=errors)
