"""A correction map for what an explanation leaves open: offered only if it predicts data that were left out."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import FORM_GAIN, MARGIN, NOISE_ERROR
from gyrowheel_analysis.diagnosis.correction_map import (
    NAME,
    CorrectionMap,
    Dependence,
    LeadingTerm,
    Variable,
)
from gyrowheel_analysis.diagnosis.explanation import Explanation
from gyrowheel_analysis.diagnosis.map_choice import CHANNELS, best_map
from gyrowheel_analysis.diagnosis.map_fit import MapFit, fit_map
from gyrowheel_analysis.diagnosis.proof import prove
from gyrowheel_analysis.diagnosis.proof_result import Proof
from gyrowheel_analysis.fitting.events import Event
from gyrowheel_analysis.fitting.fit import Fit, Unknowns
from gyrowheel_analysis.fitting.preparation import Prepared
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.reduction.windows import concatenate
from gyrowheel_analysis.residuals.error_table import ErrorRow, Errors, ErrorTable, errors_of
from gyrowheel_sim.effects import registry
from gyrowheel_sim.effects.torque_map import TARGETS, Target, TorqueMap

Array = NDArray[np.float64]

_UNKNOWN = ErrorRow({}, 0.0)  # until the map is fitted with everything else
_LEADING = 3  # terms that are named
_TURNS = 12  # orders in which a variable is exchanged among the windows


@dataclass(frozen=True)
class Corrected:
    """A map, the recordings with it as a part of the model, the fits without and with it, and their errors."""

    map: CorrectionMap
    prepared: Prepared
    before: Fit
    after: Fit
    errors: Errors


def correct(explanation: Explanation, recordings: tuple[str, ...]) -> Corrected | None:
    """Return the map of what an explanation leaves open; None where it would not predict data that were left out.

    It is fitted with and without the effects that were found, and with and without the events: the likeliest is taken.
    """
    fitted, weighed = explanation.problem, explanation.weighed.problem
    chosen = explanation.selection.best
    options: list[tuple[Problem, Fit]] = [(weighed, weighed.fit_within())]
    if chosen.terms:
        options.append((weighed, weighed.fit(chosen.terms, chosen)))
    if fitted.events:
        options.append((fitted, fitted.fit_within()))
        if chosen.terms:
            options.append((fitted, fitted.fit(chosen.terms, chosen)))
    found = best_map(options, _free_name(explanation.problem.unknowns.known))
    if found is None:
        return None
    if (result := _gaining(explanation, found, recordings)) is None:
        return None
    if not (unsupported := _unsupported(result.map.error, result.map.targets)):
        return result
    left = tuple(target for target in result.map.targets if target not in unsupported)
    if not left:
        return None
    found = fit_map(found.problem, found.base, found.effect.name, left)
    result = _gaining(explanation, found, recordings)
    return None if result is None or _unsupported(result.map.error, left) else result


def _gaining(explanation: Explanation, found: MapFit, recordings: tuple[str, ...]) -> Corrected | None:
    """Return the recordings with a map; None if it does not make them likelier than what was found without it."""
    gain = explanation.problem.evidence(explanation.best) - found.cost
    if gain < FORM_GAIN:
        return None
    return applied(explanation, _facts(found, recordings, gain), found.problem)


def applied(explanation: Explanation, given: CorrectionMap, problem: Problem | None = None) -> Corrected:
    """Return the recordings with a map as a part of the model, everything else fitted again.

    `problem` has the events and the noise that the map leaves; by default those of the explanation.
    """
    fitted = explanation.fitted
    known = problem or explanation.problem
    unknowns = _with_map(known.unknowns, given)
    prepared = replace(fitted, problem=known.for_unknowns(unknowns))
    # what stayed, or follows a temperature, is part of the events
    if (validation := (fitted if known.events else explanation.weighed).validation) is not None:
        other = validation.problem.with_scales(known.noise.scales).for_unknowns(unknowns)
        prepared = replace(prepared, validation=replace(validation, problem=other))
    terms = tuple(unknowns.term(name) for name in given.effects)
    after = prepared.problem.refined(prepared.problem.fit(terms))
    before = explanation.before
    errors = errors_of(before, after, prepared, replace(fitted, problem=known))
    effects = {name: dict(after.coefficients[name]) for name in given.effects}
    return Corrected(replace(given, effects=effects, error=errors.table), prepared, before, after, errors)


def proof_of(found: Corrected, events: Sequence[Event]) -> Proof:
    """Return whether a model with a map predicts recordings for validation, by the errors of the map as well."""
    prepared, after = found.prepared, found.after
    if prepared.validation is None:
        return Proof(", ".join(prepared.names), None, "map")
    problem, other = prepared.problem, prepared.validation.problem
    unknowns = problem.unknowns.with_errors(found.map.effect.name, found.map.errors)
    with_errors = Problem.of(problem.balances, unknowns).with_noise(problem.noise)
    validation = replace(Problem.of(other.balances, unknowns).with_noise(other.noise), stayed=other.stayed)
    more, at = unknowns.count - problem.count, problem.count
    columns = with_errors.base_jacobian[:, at:]
    # an error of the map moves everything else, which was fitted with it
    white = problem.noise.whiten
    moves = -after.covariance @ (white(after.jacobian).T @ white(columns))
    covariance = np.block([[after.covariance + moves @ moves.T, moves], [moves.T, np.eye(more)]])
    count = len(after.covariance)
    order = np.concatenate([np.arange(at), count + np.arange(more), np.arange(at, count)])
    loose = replace(
        after,
        nuisance=np.concatenate([after.nuisance, np.zeros(more)]),
        pull=np.insert(after.pull, [at] * more, 0.0),
        jacobian=np.hstack([after.jacobian, columns])[:, order],
        covariance=covariance[np.ix_(order, order)],
    )
    prepared = replace(
        prepared, problem=with_errors, validation=replace(prepared.validation, problem=validation)
    )
    return prove(prepared, loose, loose, found.errors.table, events)


def _with_map(unknowns: Unknowns, given: CorrectionMap) -> Unknowns:
    """Return unknowns of a model that has a map, its coefficients fixed."""
    name = given.effect.name
    result = Unknowns(
        unknowns.bench,
        {**unknowns.known, name: dict(given.values)},
        unknowns.known_errors,
        {**unknowns.declared, name: given.effect},
        unknowns.assumed,
    )
    return result.with_memory() if unknowns.memory else result


def _free_name(taken: Container[str]) -> str:
    names = [NAME, *(f"{NAME}_{number}" for number in range(2, 100))]
    return next(name for name in names if name not in taken and name not in registry())


def _unsupported(table: ErrorTable, targets: tuple[Target, ...]) -> tuple[Target, ...]:
    """Return the targets by which the map makes the error of unused recordings larger, or not smaller, beyond noise."""
    before, after = table.validation_before, table.validation_after
    if before is None or after is None:
        return ()
    result = []
    for target in targets:
        there = [name for name in CHANNELS[target] if name in after.channels]
        falls = {name: after.channels[name].chi2_per_n / before.channels[name].chi2_per_n for name in there}
        worse = any(falls[name] > 1.0 and not after.is_noise(name, after) for name in there)
        if worse or not any(fall < 1.0 - MARGIN * NOISE_ERROR for fall in falls.values()):
            result.append(target)
    return tuple(result)


def _facts(found: MapFit, recordings: tuple[str, ...], gain: float) -> CorrectionMap:
    effect = replace(found.effect, recordings=recordings)
    nearest, share = _nearest(found)
    return CorrectionMap(
        effect=effect,
        values=found.values,
        errors=found.errors,
        effects={term.name: dict(found.base.coefficients[term.name]) for term in found.base.terms},
        gain=gain,
        orthogonal=found.held,
        dependence=_dependence(found, effect),
        leading=_leading(found, effect),
        nearest=nearest,
        nearest_share=share,
        error=ErrorTable(_UNKNOWN, _UNKNOWN, _UNKNOWN),
    )


def _dependence(found: MapFit, effect: TorqueMap) -> tuple[Dependence, ...]:
    """Return how much of the variance over the windows comes and goes with each variable.

    A variable takes the values of other windows, all others stay: half the mean square of the change is the part of the
    variance that it has a share in. The torque on the rotor is taken along and across the tilt.
    """
    w = concatenate([balance.windows for balance in found.problem.balances])
    magnets = np.concatenate(
        [
            at.quantities["T_motor"].mean(axis=(1, 2)) * np.ones(len(b.windows))
            for b, at in zip(
                found.problem.balances, found.problem.prediction.states(found.base)[1], strict=True
            )
        ]
    )
    size, angle = np.abs(w.mean_tilt), np.angle(w.mean_tilt)
    steps = {round(len(w) * k / (_TURNS + 1)) for k in range(1, _TURNS + 1)} - {0}
    result = []
    for index, law in enumerate(effect.laws):

        def torque(
            own: dict[Variable, int], index: int = index, rotor: bool = law.target == "rotor_torque"
        ) -> Array:
            def of(values: Array, *names: Variable) -> Array:
                return np.roll(values, sum(own.get(name, 0) for name in names))

            turned = np.exp(1j * of(angle, "azimuth"))
            at = {
                "z": of(size, "tilt") * turned,
                "Omega": of(w.mean_spin, "speed"),
                "T_coil": of(w.coil_temperature, "temperature"),
                "T_motor": of(magnets, "temperature"),
            }
            value = np.broadcast_to(effect.law_at(index, {**at, **found.values}), size.shape)
            return np.asarray(value * np.conj(turned) if rotor else value)

        plain = torque({})
        variance = float(np.mean(np.abs(plain - plain.mean()) ** 2))
        if variance == 0.0:
            continue
        variables: tuple[Variable, ...] = ("speed", "tilt", "azimuth", "temperature")
        own = [
            Dependence(
                law.target,  # type: ignore[arg-type]
                name,
                float(np.mean([np.mean(np.abs(torque({name: k}) - plain) ** 2) for k in steps]))
                / (2.0 * variance),
            )
            for name in variables
        ]
        result += sorted(own, key=lambda d: -d.share)
    return tuple(result)


def _leading(found: MapFit, effect: TorqueMap) -> tuple[LeadingTerm, ...]:
    """Return the powers of the tilt that carry most of a map, by their torque over the windows."""
    w = concatenate([balance.windows for balance in found.problem.balances])
    at = {
        "z": w.mean_tilt, "Omega": w.mean_spin, "T_coil": w.coil_temperature, "T_motor": w.coil_temperature,
    }  # fmt: skip
    result = []
    for target in TARGETS:
        groups: dict[tuple[int, int, int], set[str]] = {}
        for term in effect.terms:
            if term.target == target:
                groups.setdefault(term.powers, set()).update(term.names)
        index = next((k for k, law in enumerate(effect.laws) if law.target == target), None)
        if index is None:
            continue
        squares = {}
        for powers, names in groups.items():
            own = {name: value if name in names else 0.0 for name, value in found.values.items()}
            squares[powers] = float(
                np.sum(np.abs(effect.law_at(index, {**at, **own})) ** 2 * np.ones(len(w)))
            )
        total = sum(squares.values()) or 1.0
        best = sorted(squares, key=lambda powers: -squares[powers])[:_LEADING]
        result += [LeadingTerm(target, powers, squares[powers] / total) for powers in best]
    return tuple(result)


def _nearest(found: MapFit) -> tuple[str, float]:
    """Return the known effect that explains most of the rows of a map, given the bench, and its share of them."""
    problem = found.problem
    plain = found.design[:, : found.others]
    response = found.response
    inner = np.linalg.inv(np.eye(found.others) + plain.T @ plain)

    def left(columns: Array) -> Array:
        return np.asarray(columns - plain @ (inner @ (plain.T @ columns)))

    rows = left(response)
    columns = left(problem.noise.whiten(problem.prediction.candidate_columns))
    best, most, at = "", 0.0, 0
    total = float(rows @ rows)
    for term in problem.unknowns.candidates():
        if term.effect is None:
            continue
        own = columns[:, at : at + len(term.amplitudes)]
        at += len(term.amplitudes)
        size = np.linalg.norm(own, axis=0)
        size[size == 0.0] = 1.0
        solution, *_ = np.linalg.lstsq(own / size, rows, rcond=1e-6)
        share = 1.0 - float(np.sum((rows - own / size @ solution) ** 2)) / total if total > 0.0 else 0.0
        if share > most:
            best, most = term.name, share
    return best, most
