"""Proof: whether a fit predicts unseen data, within the noise and the remaining uncertainty of the fit.

Unseen data are recordings for validation, or else parts of the fitted recordings that are left out in turn. Predictions
are linear about the fit. Their uncertainty is the covariance of the fit, propagated to the rows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.channels import LISTED
from gyrowheel_analysis.criteria import (
    CAUSE_SHARE,
    CHI2_RANGE,
    NOISE_ERROR,
    PREDICTING_GAIN,
    PROOF_PARTS,
    PROOF_ROWS,
    VAGUE_PREDICTION,
)
from gyrowheel_analysis.diagnosis.channel_checks import (
    checks,
    dependence_left,
    places_of,
    smallest,
    speed_of_misfit,
)
from gyrowheel_analysis.diagnosis.proof_result import Left, Proof, Reason
from gyrowheel_analysis.diagnosis.selection import expected_chi2, groups, left_out, threshold
from gyrowheel_analysis.fitting.events import STAYS, Event
from gyrowheel_analysis.fitting.fit import Fit, Term
from gyrowheel_analysis.fitting.preparation import Prepared
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.residuals.error_table import ErrorRow, ErrorTable, error_row, floor_row
from gyrowheel_sim.effects.torque_map import TorqueMap

Array = NDArray[np.float64]
#: Chi-squared of the predicted rows of every channel, and their number.
Unseen = dict[str, tuple[float, int]]

_BLOCKS = 4  # of time, where there are too few speeds and directions to leave one out


def lack_of_fit(problem: Problem, fit: Fit) -> float:
    """Return the excess of chi-squared of a fit over its expectation, in standard deviations."""
    free = sum(len(term.coefficients) for term in fit.terms)
    expected = max(expected_chi2(problem) - free, 1.0)
    return (fit.chi2_rows - expected) / spread_of(expected)


def spread_of(degrees: float) -> float:
    """Return the standard deviation of chi-squared of rows whose noise is known to `NOISE_ERROR`."""
    return math.sqrt(2.0 * degrees + (NOISE_ERROR * degrees) ** 2)


def prove(
    prepared: Prepared, null: Fit, best: Fit, table: ErrorTable, happened: Sequence[Event] = ()
) -> Proof:
    """Return whether a fit predicts unseen data.

    `null` and `best` are the fits without and with the findings, both at their minimum, and `table` has the errors of
    both. `happened` are events in the recordings for validation.
    """
    if prepared.validation is None:
        proof, unseen, white = _left_out(prepared, null, best)
        balances = prepared.problem.balances
    else:
        proof, unseen, white = _validated(prepared, null, best, table, happened)
        balances = prepared.validation.problem.balances
    if not unseen:
        return proof
    found = checks(prepared.problem, best, unseen)
    proof = replace(proof, channels=found, smallest=smallest(found, unseen))
    if proof.proven is False:
        return proof
    return _by_channel(prepared.problem, best, proof, balances, white)


def _by_channel(
    problem: Problem, best: Fit, proof: Proof, balances: Sequence[Balance], white: Array
) -> Proof:
    """Return the proof that fails where a channel fails alone, or still depends on a variable.

    `white` are the whitened residuals of the predicted rows.
    """
    worst = max(proof.channels, key=lambda check: check.over, default=None)
    if worst is not None and worst.over > 1.0:
        if worst.unseen <= worst.unseen_allowed:
            balances, white = problem.balances, problem.noise.whiten(best.residual)
        speed = speed_of_misfit(balances, white, worst.channel)
        return replace(proof, proven=False, reason="channel", causes=(worst.channel,), speed=speed)
    left = dependence_left(problem, best)
    if left is not None:
        return replace(proof, proven=False, reason="dependence", causes=(left.part, left.variable))
    return proof


# --- on recordings for validation ---


def _root(covariance: Array) -> Array:
    """Return a square root of a covariance, which may be singular."""
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    size[size == 0.0] = 1.0
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    return np.asarray(size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def _by_both(white: Array, spread: Array) -> float:
    """Return chi-squared of whitened residuals by noise and the uncertainty `spread` of their prediction."""
    inner = np.linalg.solve(np.eye(spread.shape[1]) + spread.T @ spread, spread.T @ white)
    return float(white @ (white - spread @ inner))


class _Prediction:
    """Residual of a validation, whitened, and its derivatives by the unknowns of the fit."""

    def __init__(self, problem: Problem, fit: Fit) -> None:
        self.rows = problem.measured - problem.predict(fit)
        self.white = problem.noise.whiten(self.rows)
        jacobian = problem.jacobian(fit)
        self.slopes = problem.noise.whiten(jacobian)
        self.covariance = fit.covariance
        root = _root(fit.covariance)
        self._spread = self.slopes @ root
        if problem.stayed is not None:
            self._spread = np.hstack([self._spread, problem.noise.whiten(problem.stayed.spread)])
        self._inner = np.linalg.inv(np.eye(self._spread.shape[1]) + self._spread.T @ self._spread)

    @property
    def count(self) -> int:
        return len(self.white)

    @property
    def plain(self) -> float:
        """Chi-squared, the prediction taken as exact."""
        return float(self.white @ self.white)

    @property
    def vagueness(self) -> float:
        """Variance of the prediction over that of the noise, on average."""
        return float(np.sum(self._spread**2)) / self.count

    @property
    def spread_deviation(self) -> float:
        """Standard deviation of the plain chi-squared."""
        gram = self._spread.T @ self._spread
        predicted = 2.0 * (2.0 * float(np.trace(gram)) + float(np.sum(gram**2)))
        return math.sqrt(spread_of(self.count) ** 2 + predicted)

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the covariance of noise and prediction, over that of the noise."""
        return -float(np.linalg.slogdet(self._inner)[1])

    def solved(self, columns: Array) -> Array:
        """Return columns times the inverse of the covariance of noise and prediction."""
        return np.asarray(columns - self._spread @ (self._inner @ (self._spread.T @ columns)))

    def by_channel(self, balances: Sequence[Balance]) -> Unseen:
        """Return chi-squared by noise and uncertainty of the prediction, and the number of rows, by channel."""
        return {
            name: (_by_both(self.white[own], self._spread[own]), own.size)
            for name, own in places_of(balances).items()
        }

    def cost_of(self, rows: NDArray[np.int64], *, exact: bool) -> float:
        """Return minus twice the log likelihood of some rows; `exact` takes the prediction as such."""
        white, spread = self.white[rows], self._spread[rows]
        if exact:
            return float(white @ white)
        inner = np.eye(spread.shape[1]) + spread.T @ spread
        return _by_both(white, spread) + float(np.linalg.slogdet(inner)[1])

    @property
    def judged(self) -> float:
        """Chi-squared by noise and uncertainty of the prediction."""
        return float(self.white @ self.solved(self.white))


def predictive_cost(problem: Problem, fit: Fit) -> float:
    """Return minus twice the log likelihood of unseen recordings, by noise and the uncertainty of a fit to others."""
    seen = _Prediction(problem, fit)
    return seen.judged + seen.log_determinant


def sizes_elsewhere(problem: Problem, fit: Fit, columns: Array) -> tuple[Array, Array, float]:
    """Return the sizes (k,) of changes in unseen recordings, their covariance, and the fall of chi-squared by them.

    `columns` (N, k) are the rows of each change of one unit. Noise and the uncertainty of a fit to others count.
    """
    seen = _Prediction(problem, fit)
    white = problem.noise.whiten(columns)
    unit = np.linalg.norm(white, axis=0)
    unit[unit == 0.0] = 1.0
    white = white / unit
    weighed = seen.solved(white)
    covariance = np.linalg.pinv(white.T @ weighed)
    sizes = covariance @ (weighed.T @ seen.white)
    return sizes / unit, covariance / np.outer(unit, unit), float(sizes @ (weighed.T @ seen.white))


def costs_by_channel(problem: Problem, fit: Fit, *, exact: bool = False) -> Unseen:
    """Return the same for the rows of every channel alone, with their number.

    `exact` takes the prediction as exact: a vague one is not excused.
    """
    seen = _Prediction(problem, fit)
    places = places_of(problem.balances)
    return {name: (seen.cost_of(own, exact=exact), own.size) for name, own in places.items()}


def left_out_by_channel(problem: Problem, fit: Fit) -> list[Unseen]:
    """Return chi-squared of every channel as predicted from the rest of a recording, for each kind of its parts."""
    return [_predicted(problem, fit, parts).channels for parts in parts_left_out(problem).values()]


def _without_gain(proof: Proof, gain: float, expected: float) -> Proof:
    """Return the proof where the findings do not improve the prediction.

    They decrease chi-squared by `gain`, where they predict a decrease by `expected`. If chance explains the difference,
    the recordings test nothing: the model is neither confirmed nor refuted.
    """
    short = expected - gain > 2.0 * CHI2_RANGE * math.sqrt(expected)
    return replace(proof, proven=False if short else None, reason="no_gain")


def _validated(
    prepared: Prepared, null: Fit, best: Fit, table: ErrorTable, happened: Sequence[Event]
) -> tuple[Proof, Unseen, Array]:
    validation, problem = prepared.validation, prepared.problem
    assert validation is not None
    other = validation.problem.with_scales(problem.noise.scales)
    seen = _Prediction(other, best)
    name = ", ".join(validation.names)
    n = seen.count
    slack = CHI2_RANGE * spread_of(n)
    before, after = table.validation_before, table.validation_after
    floor = table.validation_noise_floor
    shown: dict[str, Any] = {
        "chi2_per_n": seen.plain / n,
        "allowed": (n * (1.0 + min(seen.vagueness, VAGUE_PREDICTION)) + CHI2_RANGE * seen.spread_deviation)
        / n
        if seen.vagueness < VAGUE_PREDICTION
        else (n + slack) / n,
    }
    if before is not None and after is not None and floor is not None:
        shown |= _channel(before, after, floor, found=bool(best.terms))
    if other.stayed is not None:
        white = other.noise.whiten(seen.rows + other.stayed.rows)
        shown |= {
            "stayed": tuple(dict.fromkeys(e.time for e, _ in other.stayed.events if e.kind in STAYS)),
            "swinging": tuple(dict.fromkeys(e.end for e, _ in other.stayed.events if e.kind == "swing")),
            "otherwise": float(white @ white) / n,
        }
    if seen.plain <= n + slack or (
        seen.vagueness < VAGUE_PREDICTION
        and seen.judged <= n + slack
        and seen.plain <= n * (1.0 + seen.vagueness) + CHI2_RANGE * seen.spread_deviation
    ):
        proof = Proof(name, True, "predicted", **shown)
        if best.terms and before is not None:
            gain = before.chi2_per_n * n - seen.plain
            if gain < PREDICTING_GAIN:
                change = other.noise.whiten(other.predict(best) - other.predict(null))
                proof = _without_gain(proof, gain, float(change @ change))
    elif seen.judged <= n + slack:
        proof = Proof(name, False, "unfixed", causes=_unfixed(problem, best, seen), **shown)
    elif happened and _Prediction(other.with_events(happened), best).judged <= n + slack:
        proof = Proof(name, False, "event", **shown)
    else:
        proof = _misfit(problem, other, best, seen, name, shown)
    return proof, seen.by_channel(other.balances), seen.white


def _labels(problem: Problem, fit: Fit) -> list[str]:
    """Return the names of the unknowns of a fit."""
    library = problem.unknowns.library
    loose = [
        effect if isinstance(library[effect], TorqueMap) else f"{effect} {key}"
        for effect, key, _ in problem.unknowns.loose
    ]
    registered = {t.name for t in fit.terms if t.effect is None or t.name in problem.unknowns.library}
    terms = [
        f"{key} of the formula"
        if term not in registered
        else term
        if key == "relative_error"
        else f"{term} {key}"
        for term, key in fit.columns
    ]
    return [*(group for group, _ in problem.unknowns.nuisances), *loose, *terms]


def _unfixed(problem: Problem, best: Fit, seen: _Prediction) -> tuple[str, ...]:
    """Return the unknowns whose uncertainty accounts for a misfit: the fewest that do."""
    shift = seen.covariance @ (seen.slopes.T @ seen.solved(seen.white))
    deviation = np.sqrt(np.maximum(np.diag(seen.covariance), 1e-300))
    # the shift of the rows by each unknown once the validation is fitted too
    moved = np.linalg.norm(seen.slopes * shift, axis=0)
    moved[np.abs(shift) < 0.5 * deviation] = 0.0
    order = np.argsort(-moved)
    labels = _labels(problem, best)
    most = [labels[k] for k in order[:2] if moved[k] > 0.3 * moved[order[0]] and moved[k] > 0.0]
    return tuple(dict.fromkeys(most))


def _misfit(
    problem: Problem, other: Problem, best: Fit, seen: _Prediction, name: str, shown: dict[str, Any]
) -> Proof:
    """Return the proof for a misfit beyond the uncertainty of the prediction, with its likeliest cause."""
    excess = seen.judged - seen.count
    left = seen.solved(seen.white)
    slopes = seen.solved(seen.slopes)
    own = np.einsum("ij,ij->j", seen.slopes, slopes)
    gains = np.where(own > 0.0, (seen.slopes.T @ left) ** 2 / np.where(own > 0.0, own, 1.0), 0.0)
    k = int(np.argmax(gains))
    found, share = _resembling(problem, other, best, seen)
    if gains[k] >= CAUSE_SHARE * excess and gains[k] >= share * excess:
        step = float(seen.slopes[:, k] @ left) / float(seen.slopes[:, k] @ slopes[:, k])
        value, fitted, unit = _there(problem, best, k, step)
        label = _labels(problem, best)[k]
        return Proof(name, False, "differs", causes=(label,), value=value, fitted=fitted, unit=unit, **shown)
    if found is not None and share >= CAUSE_SHARE:
        return Proof(name, False, "resembles", causes=(found.name,), **shown)
    return Proof(name, False, "misfit", **shown)


def _there(problem: Problem, best: Fit, k: int, step: float) -> tuple[float | None, float | None, str]:
    """Return the value of an unknown after a step, the fitted one, and their unit."""
    groups = problem.unknowns.nuisances
    if k < len(groups):
        p = groups[k][1][0]
        fitted = problem.unknowns.values(best)[p.name]
        return fitted + step * p.uncertainty, fitted, p.unit
    at = k - len(best.nuisance)
    if at >= 0:
        term, key = best.columns[at]
        effect = next(t.effect for t in best.terms if t.name == term)
        unit = "1" if effect is None else next(c.unit for c in effect.coefficients if c.name == key)
        fitted = best.coefficients[term][key]
        return fitted + step, fitted, unit
    return None, None, ""


def _resembling(problem: Problem, other: Problem, best: Fit, seen: _Prediction) -> tuple[Term | None, float]:
    """Return the term that fit and validation together resemble most, and the share of their misfit it accounts for.

    A missing effect has biased the parameters of the fit, so that the validation alone does not identify it.
    """
    white = problem.noise.whiten
    inverse, _ = problem.unknowns.prior(best.terms)
    design = np.vstack([white(best.jacobian), seen.slopes, np.diag(inverse)])
    size = np.linalg.norm(design, axis=0)
    size[size == 0.0] = 1.0
    basis, _ = np.linalg.qr(design / size)

    def left(columns: Array) -> Array:
        return np.asarray(columns - basis @ (basis.T @ columns))

    rows = left(np.concatenate([white(best.residual), seen.white, -best.pull]))
    excess = float(rows @ rows) - len(best.residual) - seen.count
    found: tuple[Term | None, float] = (None, 0.0)
    most = 0.0
    for term in problem.unknowns.candidates():
        if term in best.terms:
            continue
        own = [p.noise.whiten(p.term_jacobian(term, best, term.amplitudes)) for p in (problem, other)]
        columns = left(np.vstack([*own, np.zeros((len(inverse), own[0].shape[1]))]))
        norm = np.linalg.norm(columns, axis=0)
        norm[norm == 0.0] = 1.0
        solution, *_ = np.linalg.lstsq(columns / norm, rows, rcond=1e-8)
        gain = float(rows @ (columns / norm @ solution))
        if gain - threshold(term, 1.0) > most:
            most, found = gain - threshold(term, 1.0), (term, gain / excess if excess > 0.0 else 0.0)
    return found


# --- on parts that are left out ---


class _Predicted(NamedTuple):
    """Predicted rows: residuals, the same whitened by the noise, and their standard deviations and chi-squared.

    The latter two, and the chi-squared of every channel, include the uncertainty of the prediction.
    """

    rows: Array
    white: Array
    deviation: Array
    chi2: float
    channels: Unseen


def _left_out(prepared: Prepared, null: Fit, best: Fit) -> tuple[Proof, Unseen, Array]:
    problem = prepared.problem
    name = ", ".join(prepared.names)
    tried: list[tuple[Proof, _Predicted]] = []
    for kind, parts in parts_left_out(problem).items():
        after = _predicted(problem, best, parts)
        before = _predicted(problem, null, parts) if best.terms else after
        n = sum(int(mask.sum()) for mask in parts)
        floor = floor_row(problem.balances, after.deviation)
        rows = [error_row(problem.balances, own.rows, own.white, after.deviation) for own in (before, after)]
        proven = after.chi2 <= n + CHI2_RANGE * spread_of(n)
        reason: Reason = "predicted" if proven else "misfit"
        proof = Proof(
            name,
            proven,
            reason,
            left_out=kind,
            parts=len(parts),
            chi2_per_n=after.chi2 / n,
            allowed=1.0 + CHI2_RANGE * spread_of(n) / n,
            **_channel(rows[0], rows[1], floor, found=bool(best.terms)),
        )
        if proven and best.terms and before.chi2 - after.chi2 < PREDICTING_GAIN:
            change = (before.rows - after.rows) / after.deviation
            proof = _without_gain(proof, before.chi2 - after.chi2, float(change @ change))
        tried.append((proof, after))
        if proof.proven:
            break
    if not tried:
        return Proof(name, None, "not_tried"), {}, np.zeros(0)
    # the proof if there is one; a misfit is reported before a prediction without gain
    proof, after = min(tried, key=lambda p: (not p[0].proven, p[0].reason != "misfit", p[0].proven is None))
    return proof, after.channels, after.white * (problem.noise.deviation() / after.deviation)


def parts_left_out(problem: Problem) -> dict[Left, list[NDArray[np.bool_]]]:
    """Return the parts that can be left out in turn, as masks over all rows; each kind covers all of them."""
    own = groups(problem)
    kinds: tuple[Left, ...] = ("recording", "speed", "azimuth")
    found = {kind: own[kind] for kind in kinds}
    times, at = [], 0.0
    for balance in problem.balances:
        middle = balance.windows.middle
        times.append(np.tile(middle + at, len(balance.rows)))
        at += float(middle.max(initial=0.0)) + 1.0
    time = np.concatenate(times)
    edges = np.quantile(time, np.linspace(0.0, 1.0, _BLOCKS + 1)[1:-1])
    block = np.searchsorted(edges, time, side="right")
    found["time"] = [block == number for number in range(_BLOCKS)]
    return {
        kind: parts
        for kind, parts in found.items()
        if len(parts) >= PROOF_PARTS[kind]
        and all(mask.sum() >= PROOF_ROWS for mask in parts)
        and sum(int(mask.sum()) for mask in parts) == len(time)
    }


def _predicted(problem: Problem, fit: Fit, parts: Sequence[NDArray[np.bool_]]) -> _Predicted:
    """Return every part as predicted from the rest."""
    design, white = problem.noise.whiten(fit.jacobian), problem.noise.whiten(fit.residual)
    inverse, _ = problem.unknowns.prior(fit.terms)
    rows, left, chi2 = fit.residual.copy(), white.copy(), 0.0
    variance = problem.noise.deviation() ** 2
    places = places_of(problem.balances)
    channels = dict.fromkeys(places, 0.0)
    for mask in parts:
        part = left_out(design, white, inverse, mask)
        chi2 += part.chi2
        slopes = fit.jacobian[mask]
        rows[mask] += slopes @ part.shift
        variance[mask] += np.einsum("ij,ij->i", slopes @ part.covariance, slopes)
        left[mask] = part.residual
        root = _root(part.covariance)
        for name, own in places.items():
            inside = own[mask[own]]
            channels[name] += _by_both(left[inside], design[inside] @ root)
    unseen = {name: (total, places[name].size) for name, total in channels.items()}
    return _Predicted(rows, left, np.sqrt(variance), chi2, unseen)


def _channel(before: ErrorRow, after: ErrorRow, floor: ErrorRow, *, found: bool) -> dict[str, Any]:
    """Return the channel in which the error falls most, in noise floors, or is largest where nothing was found."""
    names = [n for n in LISTED if all(n in row.channels for row in (before, after, floor))]
    if not names:
        return {}

    def size(row: ErrorRow, name: str) -> float:
        return row.channels[name].rms / (floor.channels[name].rms or 1.0)

    most = max(names, key=lambda n: size(before, n) ** 2 - size(after, n) ** 2 if found else size(after, n))
    return {
        "channel": most,
        "before": before.channels[most].rms,
        "after": after.channels[most].rms,
        "noise": floor.channels[most].rms,
    }
