"""Predicted rows of all recordings and their derivatives, as functions of the unknowns."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import Balance, Instants
from gyrowheel_analysis.fitting.fit import Point, Term, Unknowns
from gyrowheel_sim.effects.torque_map import TorqueMap

Array = NDArray[np.float64]

_KEPT_STATES = 6
_NUISANCE_STEP = 0.1  # stated uncertainties
_COEFFICIENT_STEP = 1.0e-3  # of `Unknowns.scale`

_State = tuple[dict[str, float], list[Instants], Array]


def _roughly(state: _State) -> _State:
    """Return a state to which further laws with a memory add roughly."""
    values, instants, rows = state
    return values, [replace(at, motion=at.motion.roughly()) for at in instants], rows


class Prediction:
    """Rows of the balances, one a recording, as functions of the unknowns; caches the last few states."""

    def __init__(self, balances: Sequence[Balance], unknowns: Unknowns) -> None:
        self.balances = tuple(balances)
        self.unknowns = unknowns
        self._states: OrderedDict[object, _State] = OrderedDict()
        self._stated_columns: dict[Term, Array] = {}
        self._rough = False

    @property
    def known(self) -> dict[Term, Array]:
        """The derivatives by terms that are known (`stated_columns`)."""
        return self._stated_columns

    def know(self, columns: Mapping[Term, Array]) -> None:
        """Take over derivatives by terms that were computed before."""
        self._stated_columns |= columns

    def rows(self, point: Point) -> Array:
        """Return the predicted rows of all recordings."""
        return self._state(point)[2]

    def with_measured(self, balances: Sequence[Balance]) -> Prediction:
        """Return the prediction for balances that differ only in their measured rows."""
        result = copy(self)
        result.balances, result._states = tuple(balances), self._states.copy()
        return result

    def for_unknowns(self, unknowns: Unknowns) -> Prediction:
        """Return the same prediction for unknowns that have the same nuisances, with separate states."""
        result = copy(self)
        result.unknowns, result._states, result._stated_columns = unknowns, OrderedDict(), {}
        if unknowns.candidates() != self.unknowns.candidates():
            result.__dict__.pop("candidate_columns", None)
        return result

    def with_memory(self) -> Prediction:
        """Return the same prediction where effects with a memory are candidates, too; it shares what is known."""
        result = copy(self)
        result.unknowns, result._states = self.unknowns.with_memory(), self._states.copy()
        result._stated_columns = self._stated_columns.copy()
        result.__dict__.pop("candidate_columns", None)
        return result

    def roughly(self) -> Prediction:
        """Return the same prediction, to whose states further laws with a memory add roughly (`History.rough`)."""
        result = copy(self)
        result._rough, result._stated_columns = True, {}
        result._states = OrderedDict((key, _roughly(state)) for key, state in self._states.items())
        return result

    def split(self, rows: Array) -> list[Array]:
        """Return rows recording by recording."""
        edges = np.cumsum([len(b) for b in self.balances])[:-1]
        return np.split(rows, edges)

    def nuisance_jacobian(self, point: Point, before: Array | None = None) -> Array:
        """Return the derivatives (N, q) of the rows by the nuisance unknowns.

        Given those at another point, `before`, the columns of the instruments are taken from it: they hardly change
        with the state of the machine, and take longest.
        """
        at, columns = self.rows(point), []
        for k in range(self.unknowns.count):
            if before is not None and k in self.unknowns.of_instruments:
                columns.append(before[:, k])
                continue
            moved = point.nuisance.copy()
            moved[k] += _NUISANCE_STEP
            columns.append((self._moved(point, moved) - at) / _NUISANCE_STEP)
        return np.column_stack(columns)

    def term_jacobian(self, term: Term, point: Point, names: Sequence[str] | None = None) -> Array:
        """Return the derivatives of the rows by coefficients of a term (amplitudes zero where not given).

        The term need not be in the point. `names` are the coefficients, by default all of the term.
        """
        at, columns = self.rows(point), []
        for name in term.coefficients if names is None else names:
            own = dict(self.unknowns.present(term, point) or self.unknowns.null(term))
            step = _COEFFICIENT_STEP * self.unknowns.scale(term, name)
            own[name] += step
            columns.append((self._changed(point, term, own) - at) / step)
        return np.column_stack(columns)

    def amplitude_columns(self, term: Term, point: Point, nuisance: Array) -> Array:
        """Return the derivatives by the amplitudes of a term that is absent at a point.

        Those that equal a nuisance unknown are taken from `nuisance` (N, q), its derivatives nearby.
        """
        if same := self.unknowns.same_as(term):
            return np.column_stack([nuisance[:, k] / unit for k, unit in (same[n] for n in term.amplitudes)])
        return self.term_jacobian(term, point, term.amplitudes)

    def known_as_stated(self, rows: Array, jacobian: Array) -> Prediction:
        """Return the prediction with `as_stated` known from elsewhere."""
        result = copy(self)
        result.__dict__["as_stated"] = rows, jacobian
        return result

    @cached_property
    def as_stated(self) -> tuple[Array, Array]:
        """The rows with all unknowns as stated (N,), and their derivatives by the nuisance unknowns (N, q)."""
        stated = self.unknowns.stated()
        return self.rows(stated), self.nuisance_jacobian(stated)

    @cached_property
    def candidate_columns(self) -> Array:
        """Derivatives of the stated rows by the amplitudes of all effects that may be missing.

        Each is multiplied by its `Unknowns.scale`.
        """
        columns = [np.zeros((len(self.as_stated[0]), 0))]
        for term in self.unknowns.candidates():
            if term.effect is not None:
                own = self.stated_columns(term)
                columns.append(own * [self.unknowns.scale(term, name) for name in term.amplitudes])
        return np.hstack(columns)

    def stated_columns(self, term: Term) -> Array:
        """Return the derivatives by the amplitudes of a term with everything as stated.

        They hardly change with the state of the machine, so that they serve to rank terms.
        """
        if term not in self._stated_columns:
            nuisance = self.as_stated[1]
            self._stated_columns[term] = self.amplitude_columns(term, self.unknowns.stated(), nuisance)
        return self._stated_columns[term]

    def states(self, point: Point) -> tuple[dict[str, float], list[Instants]]:
        """Return the bench parameters [SI] and the states of the balances at a point."""
        values, instants, _ = self._state(point)
        return values, instants

    def _state(self, point: Point) -> _State:
        """Return bench parameters, states of the balances and predicted rows."""
        # the name of an effect of the library identifies it; any other effect is part of the key
        foreign = tuple(t.effect for t in point.terms if t.name not in self.unknowns.library)
        key = point.nuisance.tobytes(), repr(point.coefficients), foreign
        if key in self._states:
            self._states.move_to_end(key)
        else:
            values, effects = self.unknowns.values(point), self.unknowns.effects(point)
            # each from the same beginning: what a point predicts must not depend on the points before it
            instants = [b.instants(values, effects) for b in self.balances]
            rows = np.concatenate(
                [b.rows_at(at, values) for b, at in zip(self.balances, instants, strict=True)]
            )
            state = values, instants, rows
            self._states[key] = _roughly(state) if self._rough else state
            if len(self._states) > _KEPT_STATES:
                self._states.popitem(last=False)
        return self._states[key]

    def _changed(self, point: Point, term: Term, own: dict[str, float]) -> Array:
        """Return the predicted rows with slightly other coefficients of one term."""
        terms = point.terms if term in point.terms else (*point.terms, term)
        changed = Point(terms, point.nuisance, {**point.coefficients, term.name: own})
        if term.effect is None:
            return self._stepped(point, changed)
        effect, before = term.effect, self.unknowns.present(term, point)
        values, instants, _ = self._state(point)
        found = self._from(instants, lambda b, at: b.changed(at, values, effect, before, own))
        return self._stepped(point, changed) if found is None else found

    def _moved(self, point: Point, nuisance: Array) -> Array:
        """Return the predicted rows for `nuisance`, a small step away; quickly where the motion does not change."""
        moved = Point(point.terms, nuisance, point.coefficients)
        parameters = len(self.unknowns.nuisances)
        if not np.array_equal(nuisance[parameters:], point.nuisance[parameters:]):
            # a coefficient of a known effect
            return self._stepped_known(point, moved)
        values, instants, _ = self._state(point)
        effects, after = self.unknowns.effects(point), self.unknowns.values(moved)
        found = self._from(instants, lambda b, at: b.moved(at, values, after, effects))
        return self._stepped(point, moved) if found is None else found

    def _stepped_known(self, point: Point, moved: Point) -> Array:
        """Return the predicted rows for another coefficient of a known effect, a small step away."""
        (place,) = np.flatnonzero(moved.nuisance != point.nuisance)
        effect, after = self.unknowns.of_known(moved.nuisance, int(place))
        if not isinstance(effect, TorqueMap) or effect.name in point.coefficients:
            return self._stepped(point, moved)
        # many errors of torques alone
        before = self.unknowns.of_known(point.nuisance, int(place))[1]
        values, instants, _ = self._state(point)
        found = self._from(instants, lambda b, at: b.changed(at, values, effect, before, after))
        return self._stepped(point, moved) if found is None else found

    def _stepped(self, point: Point, there: Point) -> Array:
        """Return the predicted rows `there`, a small step away from a point."""
        _, instants, _ = self._state(point)
        values, effects = self.unknowns.values(there), self.unknowns.effects(there)
        return np.concatenate(
            [
                b.rows_at(b.instants(values, effects, at), values)
                for b, at in zip(self.balances, instants, strict=True)
            ]
        )

    def _from(
        self, instants: Sequence[Instants], rows: Callable[[Balance, Instants], Array | None]
    ) -> Array | None:
        """Return the rows of every balance for its state; None if one of them cannot give them."""
        parts = []
        for balance, at in zip(self.balances, instants, strict=True):
            own = rows(balance, at)
            if own is None:
                return None
            parts.append(own)
        return np.concatenate(parts)
