"""Weighted least squares of a model on the rows of recordings, the bench's uncertain parameters fitted along."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from gyrowheel_analysis.balance.balance import ActiveEffect, Balance, Instants
from gyrowheel_analysis.fitting.noise import Noise
from gyrowheel_analysis.fitting.terms import ERRORS, Term, candidate_terms
from gyrowheel_analysis.reduction import MOTOR_THERMAL
from gyrowheel_sim.bench import Bench, Parameter
from gyrowheel_sim.effects import Effect, EffectValues, registry
from gyrowheel_sim.effects.sizes import for_bench

Array = NDArray[np.float64]

#: Bench parameters that are fitted along, by the name of their group in the bench file.
NUISANCE_GROUPS = (
    "flexure_stiffness_x",
    "flexure_stiffness_y",
    "gimbal_inertia",
    "rotor_inertia_transverse",
    "rotor_inertia_z",
    "shaft_inertia",
    "flexure_damping_x",
    "flexure_damping_y",
    "bearing_coulomb",
    "bearing_viscous",
    "coil_constant",
    "motor_constant",
    "motor_resistance",
    *MOTOR_THERMAL,
    "fixed_torque_x",
    "fixed_torque_y",
    "tilt_bias_x",
    "tilt_bias_y",
    "tilt_scale",
)
#: What counts as within the stated uncertainty of a parameter [standard uncertainties].
STATED_RANGE = 3.0
_KEPT_STATES = 6
_FAR = 5.0  # stated uncertainties after which the derivatives by the bench parameters are taken anew
_BOLD_STEPS = 3
_WORTH = 5.0  # gain in chi-squared that a step must promise to be followed uphill
_HELD = 1.0e4  # inverse prior deviation of an unknown that is not to move
#: Shares of a step that are tried, the whole one first.
_SHORTENINGS = (1.0, 0.5, 0.2, 0.05, 0.01)


@dataclass(frozen=True)
class Fit:
    """Result of a fit.

    Attributes
    ----------
    terms : tuple of Term
        What was in the fit beside the bench parameters.
    nuisance : ndarray (q,)
        Deviations of the bench parameters from their stated values, in stated uncertainties.
    coefficients : dict
        {term: {coefficient: value}}.
    chi2 : float
        Weighted sum of squares of the rows plus that of the deviations of parameters with a prior.
    chi2_rows : float
        The part of the rows alone.
    covariance : ndarray
        Of all unknowns: the nuisance deviations, then the coefficients in the order of `columns`.
    columns : list of (term, coefficient)
        What the unknowns after the nuisance ones are.
    residual : ndarray (N,)
        Rows measured minus predicted.
    pull : ndarray (unknowns,)
        Deviation of every unknown from its prior, in prior deviations; 0 where it has none.
    jacobian : ndarray (N, unknowns)
        Derivatives of the predicted rows.
    """

    terms: tuple[Term, ...]
    nuisance: Array
    coefficients: EffectValues
    chi2: float
    chi2_rows: float
    covariance: Array
    columns: list[tuple[str, str]]
    residual: Array
    pull: Array
    jacobian: Array = field(repr=False)

    def standard_error(self, term: str, coefficient: str) -> float:
        """Return the standard error of one coefficient."""
        index = len(self.nuisance) + self.columns.index((term, coefficient))
        return float(np.sqrt(self.covariance[index, index]))

    def significance(self, term: str) -> float:
        """Return the size of a term's amplitudes in standard errors (square root of its Wald statistic)."""
        names = [c for t in self.terms if t.name == term for c in t.amplitudes]
        index = [len(self.nuisance) + self.columns.index((term, name)) for name in names]
        values = np.array([self.coefficients[term][name] for name in names])
        return float(np.sqrt(values @ np.linalg.solve(self.covariance[np.ix_(index, index)], values)))


@dataclass(frozen=True)
class _Point:
    """Where a fit stands: coefficients, predicted rows, whitened residual, deviations from the priors, chi-squared."""

    coefficients: EffectValues
    predicted: Array
    white: Array
    pull: Array
    chi2_rows: float
    chi2: float


class Problem:
    """Recordings, bench and noise put together: everything that a fit needs.

    Parameters
    ----------
    balances : sequence of Balance
        One a recording.
    bench : Bench
        The bench as its file describes it: the stated values and uncertainties.
    known : EffectValues
        Effects that the model has already. A term of the same name stands in the place of one.
    known_errors : dict
        Standard errors of their coefficients; a coefficient that has none is held.
    declared : dict of str to Effect
        Declarations of those effects that are not registered.
    """

    def __init__(
        self,
        balances: Sequence[Balance],
        bench: Bench,
        known: EffectValues | None = None,
        known_errors: EffectValues | None = None,
        declared: Mapping[str, Effect] | None = None,
    ) -> None:
        self.balances = list(balances)
        self.bench = bench
        #: Effects by name; forms that no declaration contains are added while they are tried.
        self.library: dict[str, Effect] = {
            name: for_bench(effect, bench) for name, effect in registry().items()
        }
        self.library |= declared or {}
        self.known = {name: dict(values) for name, values in (known or {}).items()}
        self.known_errors = {name: dict(errors) for name, errors in (known_errors or {}).items()}
        self._loose = [
            (name, key, error)
            for name, errors in self.known_errors.items()
            for key, error in errors.items()
            if name in self.known and error > 0.0
        ]
        groups = bench.groups()
        self.nuisances: list[tuple[str, list[Parameter]]] = [
            (g, groups[g]) for g in NUISANCE_GROUPS if g in groups
        ]
        self.measured = np.concatenate([b.measured for b in self.balances])
        self._states: OrderedDict[str, tuple[dict[str, float], list[Instants], Array]] = OrderedDict()
        self.count = len(self.nuisances) + len(self._loose)
        self.base = self.predict(np.zeros(self.count), {})
        self.noise = Noise(self.balances, self._split(self.base))
        self.base_jacobian = self._nuisance_jacobian(np.zeros(self.count), {}, self.base)

    def _split(self, rows: Array) -> list[Array]:
        edges = np.cumsum([len(b) for b in self.balances])[:-1]
        return np.split(rows, edges)

    def values(self, nuisance: Array, coefficients: EffectValues | None = None) -> dict[str, float]:
        """Return the bench parameters for deviations `nuisance` and the parameter errors among `coefficients`."""
        values = self.bench.values()
        for (_, parameters), u in zip(self.nuisances, nuisance[: len(self.nuisances)], strict=True):
            for p in parameters:
                values[p.name] = p.value + u * p.uncertainty
        for name, groups in ERRORS.items():
            if coefficients and name in coefficients:
                for group, parameters in self.nuisances:
                    if group in groups:
                        for p in parameters:
                            values[p.name] += p.value * coefficients[name]["relative_error"]
        return values

    def effects(self, nuisance: Array, coefficients: EffectValues) -> list[ActiveEffect]:
        """Return all effects with their coefficients: those known and those of the terms."""
        every = self.library
        present = {**self._known_at(nuisance), **coefficients}
        return [ActiveEffect(every[name], v) for name, v in present.items() if name in every]

    def _known_at(self, nuisance: Array) -> EffectValues:
        """Return the coefficients of the known effects for deviations `nuisance`."""
        known = {name: dict(v) for name, v in self.known.items()}
        for (name, key, error), u in zip(self._loose, nuisance[len(self.nuisances) :], strict=True):
            known[name][key] += u * error
        return known

    def moved(self, nuisance: Array) -> dict[tuple[str, str], float]:
        """Return by how many of its standard errors each coefficient of the known effects has moved."""
        names = [(name, key) for name, key, _ in self._loose]
        return dict(zip(names, nuisance[len(self.nuisances) :].tolist(), strict=True))

    def _present(self, term: Term, nuisance: Array, coefficients: EffectValues) -> dict[str, float] | None:
        """Return the coefficients that a term has in a state; None if the state is without it."""
        if term.name in coefficients:
            return coefficients[term.name]
        return self._known_at(nuisance).get(term.name)

    def candidates(self) -> list[Term]:
        """Return what the rows may ask for: every registered effect, every parameter error that is a finding.

        An effect that the model has is among them: its coefficients may be wrong. As a term it stands in the place of
        what the model has of it.
        """
        own = [Term(name, self.library[name]) for name in self.known if name not in registry()]
        return candidate_terms(self.bench) + own

    def predict(self, nuisance: Array, coefficients: EffectValues) -> Array:
        """Return the predicted rows of all recordings."""
        return self._state(nuisance, coefficients)[2]

    def _state(
        self, nuisance: Array, coefficients: EffectValues
    ) -> tuple[dict[str, float], list[Instants], Array]:
        """Return bench parameters, states of the balances and predicted rows; the last few are kept."""
        key = repr((nuisance.tolist(), coefficients))
        if key in self._states:
            self._states.move_to_end(key)
        else:
            values, effects = self.values(nuisance, coefficients), self.effects(nuisance, coefficients)
            instants = [b.instants(values, effects) for b in self.balances]
            rows = np.concatenate([b.rows(at, values) for b, at in zip(self.balances, instants, strict=True)])
            self._states[key] = values, instants, rows
            if len(self._states) > _KEPT_STATES:
                self._states.popitem(last=False)
        return self._states[key]

    def _predict_changed(
        self, nuisance: Array, coefficients: EffectValues, term: Term, own: Mapping[str, float]
    ) -> Array:
        """Return the predicted rows with slightly other coefficients of one term."""
        changed: EffectValues = {**coefficients, term.name: dict(own)}
        if term.effect is None:
            return self._predict_step(nuisance, coefficients, nuisance, changed)
        effect = self.library[term.name] = term.effect
        before = self._present(term, nuisance, coefficients)
        values, instants, _ = self._state(nuisance, coefficients)
        found = self._from(instants, lambda b, at: b.changed(at, values, effect, before, own))
        return self._predict_step(nuisance, coefficients, nuisance, changed) if found is None else found

    def _predict_step(
        self, nuisance: Array, coefficients: EffectValues, moved: Array, changed: EffectValues
    ) -> Array:
        """Return the predicted rows for `moved` and `changed`, a small step from `nuisance` and `coefficients`."""
        _, instants, _ = self._state(nuisance, coefficients)
        values, effects = self.values(moved, changed), self.effects(moved, changed)
        return np.concatenate(
            [
                b.rows(b.instants(values, effects, at), values)
                for b, at in zip(self.balances, instants, strict=True)
            ]
        )

    def _from(
        self, instants: Sequence[Instants], rows: Callable[[Balance, Instants], Array | None]
    ) -> Array | None:
        """Return the rows that every balance makes of its state; None if one of them cannot."""
        parts = []
        for balance, at in zip(self.balances, instants, strict=True):
            own = rows(balance, at)
            if own is None:
                return None
            parts.append(own)
        return np.concatenate(parts)

    def _nuisance_jacobian(self, nuisance: Array, coefficients: EffectValues, at: Array) -> Array:
        columns = []
        for k in range(self.count):
            moved = nuisance.copy()
            moved[k] += 0.1
            columns.append((self._predict_moved(nuisance, moved, coefficients) - at) / 0.1)
        return np.column_stack(columns)

    def _predict_moved(self, nuisance: Array, moved: Array, coefficients: EffectValues) -> Array:
        """Return the predicted rows for `moved`, a small step; quick where the motion is that for `nuisance`."""
        if not np.array_equal(moved[len(self.nuisances) :], nuisance[len(self.nuisances) :]):
            # a coefficient of a known effect
            return self._predict_step(nuisance, coefficients, moved, coefficients)
        values, instants, _ = self._state(nuisance, coefficients)
        effects, after = self.effects(nuisance, coefficients), self.values(moved, coefficients)
        found = self._from(instants, lambda b, at: b.moved(at, values, after, effects))
        if found is None:
            return self._predict_step(nuisance, coefficients, moved, coefficients)
        return found

    def term_jacobian(
        self,
        term: Term,
        nuisance: Array,
        coefficients: EffectValues,
        at: Array,
        names: Sequence[str] | None = None,
    ) -> Array:
        """Return the derivatives of the rows by coefficients of a term (amplitudes zero where not given).

        Parameters
        ----------
        term : Term
            The term.
        nuisance, coefficients : ndarray, dict
            Where the derivatives are taken.
        at : ndarray (N,)
            The predicted rows there.
        names : sequence of str, optional
            The coefficients; all of the term's unless given.
        """
        if term.effect is not None:
            self.library[term.name] = term.effect
        columns = []
        for name in term.coefficients if names is None else names:
            own = dict(self._present(term, nuisance, coefficients) or self.null(term))
            step = self._step(term, name)
            own[name] += step
            columns.append((self._predict_changed(nuisance, coefficients, term, own) - at) / step)
        return np.column_stack(columns)

    def null(self, term: Term) -> dict[str, float]:
        """Return the coefficients for which a term changes nothing: those of the model if it has the effect."""
        if term.name in self.known:
            return dict(self.known[term.name])
        return term.effect.nulls() if term.effect else {"relative_error": 0.0}

    @staticmethod
    def scale(term: Term, name: str) -> float:
        """Return a generous size of a coefficient: several times the usual amplitude, the uncertainty of a shape."""
        if term.effect is None:
            return 1.0
        c = next(c for c in term.effect.coefficients if c.name == name)
        return c.shape_uncertainty if c.shape is not None else 5.0 * c.usual[1]

    def _step(self, term: Term, name: str) -> float:
        return 1.0e-3 * self.scale(term, name)

    def prior(self, terms: Sequence[Term]) -> tuple[Array, list[tuple[str, str]]]:
        """Return the inverse prior deviations of all unknowns and the list of the coefficients among them.

        A parameter error frees its parameter: the relative error has no prior, and the parameter's own deviation is
        held at zero, where the two are the same thing. Shapes keep the uncertainty that their declaration states.
        """
        columns = [(t.name, name) for t in terms for name in t.coefficients]
        inverse = [1.0] * self.count
        for term in terms:
            groups = ERRORS[term.name] if term.effect is None else ()
            if len(groups) == 1:
                inverse[[name for name, _ in self.nuisances].index(groups[0])] = _HELD
            for name in term.coefficients:
                shape = term.effect is not None and name not in term.amplitudes
                inverse.append(1.0 / self.scale(term, name) if shape else 0.0)
        return np.array(inverse), columns

    def fit(self, terms: Sequence[Term], start: Fit | None = None, *, iterations: int = 12) -> Fit:
        """Fit the bench parameters and the coefficients of `terms` (Gauss-Newton, steps shortened where they fail).

        Parameters
        ----------
        terms : sequence of Term
            What is fitted beside the bench parameters.
        start : Fit, optional
            Where to start from.
        """
        terms = tuple(terms)
        self.library.update({t.name: t.effect for t in terms if t.effect is not None})
        inverse, columns = self.prior(terms)
        centre = np.concatenate(
            [np.zeros(self.count), [self.null(t)[n] for t in terms for n in t.coefficients]]
        )
        x = centre.copy()
        if start is not None:
            x[: self.count] = start.nuisance
            for index, (term, name) in enumerate(columns):
                x[self.count + index] = start.coefficients.get(term, {}).get(name, x[self.count + index])
        # The derivatives by the bench parameters change little; they are taken anew where a parameter has moved far.
        nuisance_jacobian = self._nuisance_columns(terms, start)
        taken_at = start.nuisance if start is not None else np.zeros(self.count)
        at = self._at(x, terms, inverse, centre)
        bold = True
        for _ in range(iterations):
            if np.abs(x[: self.count] - taken_at).max() > _FAR:
                nuisance_jacobian = self._nuisance_jacobian(x[: self.count], at.coefficients, at.predicted)
                taken_at = x[: self.count].copy()
            jacobian, design, size, step, promised = self._linear(terms, x, at, nuisance_jacobian, inverse)
            for shortening in _SHORTENINGS:
                trial = self._within_bounds(x + shortening * step, terms)
                there = self._at(trial, terms, inverse, centre)
                if there.chi2 <= at.chi2:
                    break
                if bold and promised > _WORTH and np.abs(step[: self.count]).max() > 1.0:
                    bold = False
                    trial, there = self._boldly(terms, trial, there, inverse, centre)
                    if there.chi2 <= at.chi2:
                        break
            else:
                break  # no step along this direction helps: x is the best there is
            gain, x, at = at.chi2 - there.chi2, trial, there
            if gain < 1.0e-3 * max(1.0, 1e-3 * at.chi2):
                break
        scaled = design / size
        covariance = np.linalg.pinv(scaled.T @ scaled, rcond=1e-13) / np.outer(size, size)
        return Fit(
            terms,
            x[: self.count].copy(),
            at.coefficients,
            at.chi2,
            at.chi2_rows,
            covariance,
            columns,
            self.measured - at.predicted,
            at.pull,
            jacobian,
        )

    def _nuisance_columns(self, terms: Sequence[Term], start: Fit | None) -> Array:
        """Return the derivatives by the bench parameters, and the coefficients of known effects, to start a fit with.

        What the model has of an effect does nothing where a term stands in its place.
        """
        if start is None:
            columns, before = self.base_jacobian, set()
        else:
            columns, before = start.jacobian[:, : self.count], {t.name for t in start.terms}
        replaced = {t.name for t in terms}
        at = len(self.nuisances)
        if any(name in replaced | before for name, _, _ in self._loose):
            columns = columns.copy()
            for k, (name, _, _) in enumerate(self._loose, at):
                if name in replaced:
                    columns[:, k] = 0.0
                elif name in before:
                    columns[:, k] = self.base_jacobian[:, k]
        return columns

    def _linear(
        self, terms: Sequence[Term], x: Array, at: _Point, nuisance_jacobian: Array, inverse: Array
    ) -> tuple[Array, Array, Array, Array, float]:
        """Return derivatives, whitened design, sizes of its columns, and the step to the minimum if all were linear.

        The last number is the gain in chi-squared that the step then promises.
        """
        parts = [nuisance_jacobian]
        parts += [self.term_jacobian(t, x[: self.count], at.coefficients, at.predicted) for t in terms]
        jacobian = np.hstack(parts)
        design = np.vstack([self.noise.whiten(jacobian), np.diag(inverse)])
        # columns of very different size: scale before solving
        size = np.linalg.norm(design, axis=0)
        size[size == 0.0] = 1.0
        now = np.concatenate([at.white, -at.pull])
        step, *_ = np.linalg.lstsq(design / size, now, rcond=1e-12)
        then = now - (design / size) @ step
        return jacobian, design, size, step / size, float(now @ now - then @ then)

    def _boldly(
        self, terms: Sequence[Term], x: Array, at: _Point, inverse: Array, centre: Array
    ) -> tuple[Array, _Point]:
        """Go on from where a whole step has led, uphill though it was, by whole steps with new derivatives.

        A scale that is wrong by much bends everything else along: a whole step lands beside the valley, the next ones
        lead into it, while steps short enough to go downhill would hardly move.
        """
        for _ in range(_BOLD_STEPS):
            if not np.isfinite(at.chi2):
                break
            nuisance_jacobian = self._nuisance_jacobian(x[: self.count], at.coefficients, at.predicted)
            *_, step, _ = self._linear(terms, x, at, nuisance_jacobian, inverse)
            x = self._within_bounds(x + step, terms)
            at = self._at(x, terms, inverse, centre)
        return x, at

    def refined(self, fit: Fit) -> Fit:
        """Return a fit with every derivative taken at the solution itself.

        While terms are compared, the derivatives by the bench parameters are those without any of them. That finds
        the terms, but a coefficient that shows far above the noise needs them exactly: there the uncertainty of a
        resistance or of a heat capacity is what limits it.
        """
        at = self.predict(fit.nuisance, fit.coefficients)
        fresh = self._nuisance_jacobian(fit.nuisance, fit.coefficients, at)
        return self.fit(fit.terms, replace(fit, jacobian=np.hstack([fresh, fit.jacobian[:, self.count :]])))

    def _at(self, x: Array, terms: Sequence[Term], inverse: Array, centre: Array) -> _Point:
        """Return what the unknowns `x` predict, and how well."""
        coefficients = self._unpack(x, terms)
        predicted = self.predict(x[: self.count], coefficients)
        white, pull = self.noise.whiten(self.measured - predicted), inverse * (x - centre)
        rows = float(white @ white)
        chi2 = rows + float(pull @ pull)
        return _Point(coefficients, predicted, white, pull, rows, chi2 if np.isfinite(chi2) else np.inf)

    def fit_within(self, bound: float = STATED_RANGE) -> Fit:
        """Fit the bench parameters alone, none further than `bound` stated uncertainties from its stated value.

        This is the best that the model as it stands can do: an unbounded fit would bend a parameter as far as it
        takes to make up for an effect that is missing.
        """
        free = self.fit(())
        if np.abs(free.nuisance).max(initial=0.0) <= bound:
            return free
        x = np.zeros(self.count)
        for _ in range(3):
            residual = self.measured - self.predict(x, {})
            design = np.vstack([self.noise.whiten(self.base_jacobian), np.eye(self.count)])
            target = np.concatenate([self.noise.whiten(residual), -x])
            x = x + lsq_linear(design, target, bounds=(-bound - x - 1e-9, bound - x + 1e-9)).x
        residual = self.measured - self.predict(x, {})
        white = self.noise.whiten(residual)
        rows = float(white @ white)
        return replace(free, nuisance=x, chi2=rows + float(x @ x), chi2_rows=rows, residual=residual, pull=x)

    def _unpack(self, x: Array, terms: Sequence[Term]) -> EffectValues:
        coefficients: EffectValues = {}
        at = self.count
        for term in terms:
            coefficients[term.name] = {}
            for name in term.coefficients:
                coefficients[term.name][name] = float(x[at])
                at += 1
        return coefficients

    def _within_bounds(self, x: Array, terms: Sequence[Term]) -> Array:
        at = self.count
        for term in terms:
            for name in term.coefficients:
                low, high = -0.9, 10.0
                if term.effect is not None:
                    low, high = next(c.bounds for c in term.effect.coefficients if c.name == name)
                x[at] = min(max(x[at], low), high)
                at += 1
        return x

    def evidence(self, fit: Fit) -> float:
        """Return minus twice the log of the marginal likelihood of a fit, the size of the drifts left free.

        What a term explains and what a larger drift would explain are thus weighed against each other. Every
        amplitude pays for its freedom, being spread over the generous size of `scale` beforehand.
        """
        width = [1.0] * self.count + [self.scale(t, name) for t in fit.terms for name in t.coefficients]
        offset = np.concatenate([fit.nuisance, [fit.coefficients[t][name] for t, name in fit.columns]])
        # the rows as they would be with everything at its prior centre, to first order
        centre = np.concatenate(
            [np.zeros(self.count), [self.null(t)[n] for t in fit.terms for n in t.coefficients]]
        )
        rows = fit.residual + fit.jacobian @ (offset - centre)
        return self.noise.best_scales(rows, fit.jacobian * np.array(width))[1]

    def reweigh(self, fit: Fit) -> bool:
        """Take the noise of the machine that a fit describes; return whether it is another one (see `Noise.weigh`)."""
        predicted = self.predict(fit.nuisance, fit.coefficients)
        values = self.values(fit.nuisance, fit.coefficients)
        if not self.noise.weigh(self.balances, self._split(predicted), values):
            return False
        effects = self.effects(fit.nuisance, fit.coefficients)
        for balance in self.balances:
            balance.clear_noise(values, effects)
        self.measured = np.concatenate([b.measured for b in self.balances])
        return True

    def estimate_noise(self) -> None:
        """Estimate the size of the slow drifts, leaving out whatever bench parameters or effects can explain."""
        columns = np.hstack([self.base_jacobian, self._candidate_columns()])
        self.noise.estimate_scales(self.measured - self.base, columns)

    def estimate_noise_with(self, fit: Fit) -> None:
        """Estimate it anew, leaving out also what the terms of a fit can: forms that no registered effect has."""
        width = [1.0] * self.count + [self.scale(t, n) for t in fit.terms for n in t.coefficients]
        rows = fit.residual + fit.jacobian[:, : self.count] @ fit.nuisance
        columns = np.hstack([fit.jacobian * np.array(width), self._candidate_columns()])
        self.noise.use_scales(self.noise.best_scales(rows, columns)[0])

    def _candidate_columns(self) -> Array:
        """Return the derivatives of the rows by the amplitudes of all candidates, each of its generous size."""
        zero = np.zeros(self.count)
        columns: list[Any] = []
        for term in self.candidates():
            if term.effect is not None:
                own = self.term_jacobian(term, zero, {}, self.base, term.amplitudes)
                columns.append(own * [self.scale(term, name) for name in term.amplitudes])
        return np.hstack(columns)
