"""A fit problem: recordings, unknowns and noise. It is immutable."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.criteria import DRIFT_ENLARGED, MEMORY_PAUSE, ROWS_CHANGED, STATED_RANGE
from gyrowheel_analysis.fitting.events import Event, edge_columns, event_columns, event_widths
from gyrowheel_analysis.fitting.fit import Fit, Point, Term, Unknowns, memory_terms
from gyrowheel_analysis.fitting.noise import Noise
from gyrowheel_analysis.fitting.prediction import Prediction
from gyrowheel_analysis.fitting.solver import Objective, bounded, solve
from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

#: Channels whose amplitudes a filter of unknown shape would distort.
FILTERED = ("tilt", "coil_voltage")
#: Fits that are kept: as many as fit into some bytes, at least a few.
_FEWEST_FITS, _FITS_BYTES = 4, 1 << 26
_REACH = 2.0  # standard errors at which the rise of chi-squared shows how far a time may lie
_PARTS = (0.08, 0.3, 3.0)  # of the usual time or way of a law with a memory, with which a fit may begin


@dataclass(frozen=True)
class Stayed:
    """Changes in other recordings of the machine that are still there, and what swings there, too.

    `events` has each of the others with the name of a recording in which it is. `rows` (N,) are what they add to the
    measured rows; `spread` (N, k) are the rows of the standard errors of their sizes.
    """

    events: tuple[tuple[Event, str], ...]
    rows: Array
    spread: Array


@dataclass(frozen=True)
class Problem:
    """Everything that a fit needs; immutable: another noise makes another problem.

    `prediction` predicts the rows of the recordings, `noise` is that of the measured rows; `base` (N,) are the rows
    predicted with everything as stated, `base_jacobian` (N, q) their derivatives by the nuisance unknowns. `events` are
    changes in the middle of a recording, whose sizes are estimated; sizes `removed` are already subtracted from the
    measured rows, as is what `stayed`.
    """

    prediction: Prediction
    noise: Noise
    base: Array
    base_jacobian: Array
    events: tuple[Event, ...] = ()
    removed: tuple[float, ...] = ()
    stayed: Stayed | None = None
    #: The last fits: selection, validation and report ask for the same ones, mostly without one of the terms.
    _fits: OrderedDict[tuple[tuple[Term, ...], int, int], tuple[Fit | None, Fit]] = field(
        default_factory=OrderedDict, init=False, repr=False, compare=False
    )

    @classmethod
    def of(cls, balances: Sequence[Balance], unknowns: Unknowns | Bench) -> Problem:
        """Return the problem of some balances, one a recording, with the noise and drift that their benches state.

        For a bench in place of the unknowns, its parameters alone are unknown.
        """
        unknowns = Unknowns(unknowns) if isinstance(unknowns, Bench) else unknowns
        return cls.predicted_by(Prediction(balances, unknowns))

    @classmethod
    def predicted_by(cls, prediction: Prediction) -> Problem:
        """Return the problem of a prediction, see `of`."""
        base, jacobian = prediction.as_stated
        return cls(prediction, Noise.stated(prediction.balances, prediction.split(base)), base, jacobian)

    def for_unknowns(self, unknowns: Unknowns) -> Problem:
        """Return the same problem for unknowns that have the same nuisances, with separate caches."""
        return replace(self, prediction=self.prediction.for_unknowns(unknowns))

    def with_memory(self) -> Problem:
        """Return the same problem where effects with a memory are candidates, too, with the drifts that they leave."""
        return replace(self, prediction=self.prediction.with_memory()).with_drift_estimated()

    @property
    def memory_terms(self) -> list[Term]:
        """The laws with a memory that the recordings may show; none with a long pause, in which it is unknown."""
        broken = any(balance.motion.history.breaks(MEMORY_PAUSE) for balance in self.balances)
        return [] if broken else memory_terms(self.bench)

    def roughly(self) -> Problem:
        """Return the same problem, to which laws with a memory add quickly what they roughly do.

        To follow the whole motion of a recording takes longer than all else where nothing is missing.
        """
        return replace(self, prediction=self.prediction.roughly())

    @property
    def balances(self) -> tuple[Balance, ...]:
        """The balances, one a recording."""
        return self.prediction.balances

    @property
    def unknowns(self) -> Unknowns:
        """The unknowns, with their priors."""
        return self.prediction.unknowns

    @property
    def bench(self) -> Bench:
        """The bench with the stated values and uncertainties."""
        return self.unknowns.bench

    @property
    def count(self) -> int:
        """Number of nuisance unknowns."""
        return self.unknowns.count

    @cached_property
    def measured(self) -> Array:
        """The measured rows (N,)."""
        return np.concatenate([b.measured for b in self.balances])

    def predict(self, point: Point) -> Array:
        """Return the rows (N,) predicted at a point."""
        return self.prediction.rows(point)

    def term_jacobian(self, term: Term, point: Point, names: Sequence[str] | None = None) -> Array:
        """Return derivatives by the coefficients of a term, see `Prediction.term_jacobian`."""
        return self.prediction.term_jacobian(term, point, names)

    def jacobian(self, point: Point) -> Array:
        """Return the derivatives of the rows by all unknowns, those by the nuisance unknowns taken as stated."""
        return np.hstack([self.base_jacobian, *(self.term_jacobian(t, point) for t in point.terms)])

    def with_noise(self, noise: Noise) -> Problem:
        """Return the problem with another noise."""
        return replace(self, noise=noise)

    def with_scales(self, scales: Mapping[str, float]) -> Problem:
        """Return the problem with other magnitudes of the drifts."""
        return replace(self, noise=self.noise.with_scales(scales))

    def with_events(self, events: Sequence[Event]) -> Problem:
        """Return the problem with other events, whose sizes are estimated."""
        columns = event_columns(self.balances, events) * event_widths(self.bench, events)
        columns = np.hstack([columns, edge_columns(self.balances, events, self.noise.deviation())])
        return replace(
            self, noise=self.noise.with_events(columns), events=tuple(events), removed=(0.0,) * len(events)
        )

    def event_sizes(self, fit: Fit) -> tuple[Array, Array]:
        """Return the sizes of the events (events,) [SI] given a fit, and their covariance."""
        if self.noise.events is None:
            return np.zeros(0), np.zeros((0, 0))
        widths, count = event_widths(self.bench, self.events), len(self.events)
        columns, edges = np.split(self.noise.whitened(self.noise.events), [count], axis=1)
        inverse, _ = self.unknowns.prior(fit.terms)
        rest = np.zeros((len(inverse), edges.shape[1]))
        others = np.hstack(
            [np.vstack([self.noise.whitened(fit.jacobian), np.diag(inverse)]), np.vstack([edges, rest])]
        )
        own = np.vstack([columns, np.zeros((len(inverse), count))])
        size = np.linalg.norm(others, axis=0)
        size[size == 0.0] = 1.0
        basis, _ = np.linalg.qr(others / size)
        own = own - basis @ (basis.T @ own)
        rows = np.concatenate([self.noise.whitened(fit.residual), -fit.pull])
        rows = rows - basis @ (basis.T @ rows)
        covariance = np.linalg.pinv(own.T @ own)
        return (
            np.array(self.removed) + covariance @ (own.T @ rows) * widths,
            covariance * np.outer(widths, widths),
        )

    def without_events(self, fit: Fit) -> Problem:
        """Return the problem with the contribution of the events, given a fit, subtracted from the measured rows."""
        if not self.events:
            return self
        sizes, _ = self.event_sizes(fit)
        done = self.prediction.split(event_columns(self.balances, self.events) @ (sizes - self.removed))
        balances = [b.with_measured(b.measured - own) for b, own in zip(self.balances, done, strict=True)]
        return replace(
            self, prediction=self.prediction.with_measured(balances), removed=tuple(sizes.tolist())
        )

    def fit(self, terms: Sequence[Term], start: Fit | None = None, *, iterations: int = 12) -> Fit:
        """Fit the nuisance unknowns and the coefficients of `terms`, from `start` on, in at most so many iterations."""
        key = tuple(terms), id(start), iterations
        if key in self._fits:
            self._fits.move_to_end(key)
            return self._fits[key][1]
        objective = Objective(self.prediction, self.measured, self.noise, terms)
        columns = self._nuisance_columns(objective.terms, start)
        found = solve(objective, self._begun(objective, start), columns, iterations=iterations)
        self._fits[key] = start, found  # the start is kept, so that no other object takes its identity
        if len(self._fits) > max(_FEWEST_FITS, _FITS_BYTES // found.jacobian.nbytes):
            self._fits.popitem(last=False)
        return found

    def _begun(self, objective: Objective, start: Fit | None) -> Array:
        """Return the vector with which a fit begins.

        Chi-squared may have several minima over the time, or the way, in which the state of a law follows. A law that
        `start` lacks begins with those of some values that linearly explain most.
        """
        x = objective.start(start)
        known = {} if start is None else start.coefficients
        places = {column: self.count + k for k, column in enumerate(objective.columns)}
        for term in objective.terms:
            if term.effect is None or not term.effect.states or term.name in known:
                continue
            if term.name not in self.unknowns.library:
                continue  # a free form, which the family has with several values
            own = self._promising(term, self.fit(()) if start is None else start)
            for name, value in own.items():
                x[places[term.name, name]] = value
        return objective.within_bounds(x)

    def _promising(self, term: Term, at: Fit) -> dict[str, float]:
        """Return the coefficients with which a law linearly explains most of what a fit leaves.

        Its shapes are tried one after the other. With its amplitudes at zero, the first step of a fit would take the
        shapes back to the centre of their prior.
        """
        basis = self.basis(at)
        left = np.concatenate([self.noise.whiten(at.residual), -at.pull])
        left -= basis @ (basis.T @ left)
        null = self.unknowns.null(term)

        def tried(values: Mapping[str, float]) -> tuple[float, dict[str, float]]:
            point = Point((*at.terms, term), at.nuisance, {**at.coefficients, term.name: {**null, **values}})
            rows = self.noise.whiten(self.term_jacobian(term, point, term.amplitudes))
            every = np.vstack([rows, np.zeros((len(left) - len(rows), rows.shape[1]))])
            every -= basis @ (basis.T @ every)
            sizes = np.linalg.lstsq(every, left, rcond=1e-8)[0]
            pull = [(value - null[name]) / self.unknowns.scale(term, name) for name, value in values.items()]
            own = {name: null[name] + float(size) for name, size in zip(term.amplitudes, sizes, strict=True)}
            return float(left @ every @ sizes) - sum(p * p for p in pull), {**null, **values, **own}

        gain, found = tried({})
        shapes: dict[str, float] = {}
        for name in term.coefficients:
            low, high = self.unknowns.bounds(term, name)
            if name in term.amplitudes or low <= 0.0:
                continue
            for part in _PARTS:
                other = {**shapes, name: min(max(null[name] * part, low), high)}
                more, own = tried(other)
                if more > gain:
                    gain, found, shapes = more, own, other
        return found

    def _nuisance_columns(self, terms: Sequence[Term], start: Fit | None) -> Array:
        """Return the derivatives by the nuisance unknowns to start a fit with.

        The coefficients of an effect of the model have no influence where a term replaces it.
        """
        if start is None:
            columns, before = self.base_jacobian, set()
        else:
            columns, before = start.jacobian[:, : self.count], {t.name for t in start.terms}
        replaced = {t.name for t in terms}
        at = len(self.unknowns.nuisances)
        if any(name in replaced | before for name, _, _ in self.unknowns.loose):
            columns = columns.copy()
            for k, (name, _, _) in enumerate(self.unknowns.loose, at):
                if name in replaced:
                    columns[:, k] = 0.0
                elif name in before:
                    columns[:, k] = self.base_jacobian[:, k]
        return columns

    def refined(self, fit: Fit) -> Fit:
        """Return a fit with every derivative taken at the solution itself.

        While terms are compared, the derivatives by the bench parameters are those without any term. That is enough to
        find the terms. A coefficient far above the noise needs exact derivatives: its error is then limited by that of
        a resistance or a heat capacity. The covariance is that of `_widened`.
        """
        fresh = self.prediction.nuisance_jacobian(fit)
        return self._widened(
            self.fit(fit.terms, replace(fit, jacobian=np.hstack([fresh, fit.jacobian[:, self.count :]])))
        )

    def _widened(self, fit: Fit) -> Fit:
        """Return a fit whose covariance reaches as far as chi-squared allows for the shapes of laws with a memory.

        Of a time longer than a recording only the ratio of amplitude to time is determined: chi-squared rises far less
        on one side than its curvature at the fit shows. The time is held at `_REACH` standard errors on either side,
        with all else at its best; the side that rises less sets the error of all unknowns that go with it.
        """
        objective = Objective(self.prediction, self.measured, self.noise, fit.terms)
        shapes = {(t.name, n) for t in fit.terms if t.effect and t.effect.states for n in t.coefficients}
        shapes -= {(t.name, n) for t in fit.terms for n in t.amplitudes}
        x, columns = objective.start(fit), fit.jacobian[:, : self.count]
        for k, column in enumerate(objective.columns, self.count):
            error = math.sqrt(max(float(fit.covariance[k, k]), 0.0))
            if column not in shapes or error == 0.0:
                continue
            along = fit.covariance[:, k] / error
            widest = along
            for side in (-_REACH, _REACH):
                held = objective.within_bounds(x + side * along)
                try:
                    there = solve(objective.holding(k, held[k]), held, columns)
                except InputError:  # so far away nothing is finite
                    continue
                prior = (objective.inverse[k] * (held[k] - objective.centre[k])) ** 2
                rise = there.chi2 + prior - fit.chi2
                if rise > 0.0:
                    one = (objective.start(there) - x) / math.sqrt(rise)
                    widest = one if abs(one[k]) > abs(widest[k]) else widest
            fit = replace(fit, covariance=fit.covariance + np.outer(widest, widest) - np.outer(along, along))
        return fit

    def fit_within(self, bound: float = STATED_RANGE) -> Fit:
        """Fit the nuisance unknowns alone, each within `bound` stated uncertainties of its stated value.

        This is the best fit of the model without further effects. Without bounds a parameter would compensate for a
        missing effect.
        """
        free = self.fit(())
        if np.abs(free.nuisance).max(initial=0.0) <= bound:
            return free
        low, high = self.unknowns.limits()
        low, high = np.maximum(low, -bound), np.minimum(high, bound)
        x, measured = np.zeros(self.count), self.measured
        for _ in range(3):
            residual = measured - self.predict(Point((), x, {}))
            design = np.vstack([self.noise.whiten(self.base_jacobian), np.eye(self.count)])
            target = np.concatenate([self.noise.whiten(residual), -x])
            x = x + bounded(design, target, low - x, high - x)
        residual = measured - self.predict(Point((), x, {}))
        white = self.noise.whiten(residual)
        rows = float(white @ white)
        return replace(free, nuisance=x, chi2=rows + float(x @ x), chi2_rows=rows, residual=residual, pull=x)

    def basis(self, fit: Fit) -> Array:
        """Return an orthonormal basis (rows + priors, unknowns) of the whitened derivatives of a fit."""
        inverse, _ = self.unknowns.prior(fit.terms)
        design = np.vstack([self.noise.whiten(fit.jacobian), np.diag(inverse)])
        size = np.linalg.norm(design, axis=0)
        size[size == 0.0] = 1.0
        basis, _ = np.linalg.qr(design / size)
        return np.asarray(basis)

    def evidence(self, fit: Fit) -> float:
        """Return minus twice the log of the marginal likelihood of a fit, the magnitudes of the drifts left free.

        This weighs the gain of a term against that of a larger drift. The prior of every amplitude is as
        wide as `Unknowns.scale`, which penalises further amplitudes.
        """
        offset = np.concatenate([fit.nuisance, [fit.coefficients[t][name] for t, name in fit.columns]])
        # the rows with everything at its prior centre, to first order
        rows = fit.residual + fit.jacobian @ (offset - self.unknowns.centre(fit.terms))
        return self.noise.best_scales(rows, fit.jacobian * self.unknowns.widths(fit.terms))[1]

    def with_drift_estimated(self, fit: Fit | None = None) -> Problem:
        """Return the problem with the magnitudes of the slow drifts estimated from the rows.

        The part that bench parameters or registered effects can explain does not count as drift, nor, given a fit, the
        part that its terms explain. All effects together may bend to what none of them explains in one channel, at the
        expense of the others: a drift is as large there as the bench and the terms alone leave, if that is less.
        """
        if fit is None:
            rows, own = self.measured - self.base, self.base_jacobian
        else:
            rows = fit.residual + fit.jacobian[:, : self.count] @ fit.nuisance
            own = fit.jacobian * self.unknowns.widths(fit.terms)
        scales, _ = self.noise.best_scales(rows, np.hstack([own, self.prediction.candidate_columns]))
        if max(scales.values()) > DRIFT_ENLARGED:
            alone, _ = self.noise.best_scales(rows, own)
            scales = {name: min(scale, alone[name]) for name, scale in scales.items()}
        return self.with_scales(scales)

    def _found_late(self, fit: Fit) -> dict[str, float]:
        """Return the delays of readings by the terms of a fit [s], by channel."""
        late: dict[str, float] = {}
        for term in fit.terms:
            if term.effect is None:
                continue
            for channel in FILTERED:
                if term.name == f"{channel}_delay":
                    late[channel] = late.get(channel, 0.0) + fit.coefficients[term.name]["d"]
                elif term.name == f"{channel}_filter":
                    poles = self.bench.value(f"{channel}_filter_order")
                    late[channel] = late.get(channel, 0.0) + poles * fit.coefficients[term.name]["t_f"]
        return late

    def reweighed(self, fit: Fit) -> Problem:
        """Return the problem with noise and rows of the machine that a fit describes; itself where they hardly differ.

        See `Noise.on_bench_of` and `Balance.cleared`.
        """
        values = self.unknowns.values(fit)
        effects = self.unknowns.effects(fit)
        rows = self.prediction.split(self.predict(fit))
        noise = self.noise.on_bench_of(self.balances, rows, values, self._found_late(fit))
        balances = [balance.cleared(values, effects) for balance in self.balances]
        change = noise.whitened(np.concatenate([b.measured for b in balances]) - self.measured)
        if noise is self.noise and not float(change @ change) > ROWS_CHANGED:
            return self
        return replace(self, prediction=self.prediction.with_measured(balances), noise=noise)
