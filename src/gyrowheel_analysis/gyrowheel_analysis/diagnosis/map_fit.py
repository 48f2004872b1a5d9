"""The missing torque as a map: a smooth function of tilt, speed and temperature, fitted to recordings.

Every term of the map is linear in its coefficients, which have a normal prior: how far the torque is smooth is a decay
of the prior deviations with the orders of the terms, and magnitude and decays are those of the largest marginal
likelihood. The map is orthogonal to what bench parameters explain within their stated uncertainties, so that neither
takes over what belongs to the other (Plumlee, 2017, doi:10.1080/01621459.2016.1211016; Kennedy and O'Hagan, 2001,
doi:10.1111/1467-9868.00294).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from gyrowheel_analysis.criteria import STATED_RANGE
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.noise import Noise
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.reduction.windows import speed_groups
from gyrowheel_sim.effects.torque_map import (
    TARGETS,
    MapRange,
    MapTerm,
    Target,
    TorqueMap,
    torque_map,
    values_at,
)

Array = NDArray[np.float64]

_ORDER_TILT, _ORDER_SPEED = 5, 7  # at most
_ORDERS = 8  # of a term, together
_ORDERS_WARM = 2  # of a term that depends on temperature
_WARMED = 3.0  # K; a smaller range shows no dependence on temperature
_STEP = 1.0e-4  # N m; rows are linear in a torque of this size
_HELD = 0.3  # prior deviation of the part that bench parameters explain, in noise deviations
#: Magnitude [N m] of the prior deviations, and decays by an order in |tilt|², in the direction of the tilt, in speed
#: and in temperature: start and bounds.
_START = (1.0e-3, 0.6, 0.4, 0.4, 0.3)
_BOUNDS = ((1.0e-6, 0.1), (0.1, 0.9), (0.1, 0.6), (0.1, 0.8), (0.05, 0.9))
_NEGLIGIBLE = 0.05  # noise deviations in all rows together, by the prior: such terms are left out
_DRIFT_CHANGED = 0.1  # in the logarithm of a scale: less does not change a map
_SEEN = 0.05  # noise deviations, by the prior: what the rows show less of is left to the prior
_MODES_LEFT = 0.02  # part of the variance of a map that its stored errors may lack
_POINTS = 300  # of the range of a map, at which its errors are compared


def range_of(problem: Problem, point: Fit) -> MapRange:
    """Return the range of the recordings of a problem."""
    _, instants = problem.prediction.states(point)
    windows = [balance.windows for balance in problem.balances]

    def ends(parts: Sequence[Any]) -> tuple[float, float]:
        every = np.concatenate([np.ravel(part) for part in parts])
        return float(every.min()), float(every.max())

    return MapRange(
        ends([w.mean_spin for w in windows]),
        float(max(np.abs(w.mean_tilt).max() for w in windows)),
        ends([w.coil_temperature for w in windows]),
        ends([at.quantities["T_motor"] for at in instants]),
    )


def terms_for(problem: Problem, within: MapRange) -> list[MapTerm]:
    """Return the terms whose coefficients recordings can tell, by the number of their speeds."""
    spin = np.concatenate([balance.windows.mean_spin for balance in problem.balances])
    most = min(_ORDER_SPEED, len(speed_groups(spin)) - 1)
    result = []
    for target in TARGETS:
        low, high = within.of(target)
        warm = 1 if high - low >= _WARMED else 0
        for temperature, odd, forward, backward, speed in itertools.product(
            range(warm + 1), (0, 1), range(_ORDER_TILT + 1), range(_ORDER_TILT + 1), range(most + 1)
        ):
            of_tilt = forward + backward + 2 * odd
            if of_tilt > _ORDER_TILT or of_tilt + speed > (_ORDERS_WARM if temperature else _ORDERS):
                continue
            if target == "rotor_torque" or forward >= backward:
                result.append(MapTerm(target, forward, backward, odd, speed, temperature))
    return result


def columns_of(problem: Problem, point: Fit, terms: Sequence[MapTerm], within: MapRange) -> Array:
    """Return the derivatives (N, coefficients) of the rows by the coefficients of a map [1 / (N m)].

    A torque of the map hardly changes within a window: its mean there acts like a constant torque.
    """
    values, instants = problem.prediction.states(point)
    parts = []
    for balance, at in zip(problem.balances, instants, strict=True):
        rows = balance.rows_at(at, values)
        constant = [
            (balance.pushed(at, values, {target: _STEP * unit}) - rows).reshape(-1, len(balance.windows))
            / _STEP
            for target, unit in (("rotor_torque", 1.0 + 0.0j), ("rotor_torque", 1.0j), ("shaft_torque", 1.0))
        ]
        own = []
        for term, value in values_at(terms, within, at.quantities):
            mean = np.sum(value * at.weights, axis=(1, 2))
            for k in range(len(term.names)):
                if term.target == "rotor_torque":
                    torque = mean * (1j if k else 1.0)
                    own.append((constant[0] * torque.real + constant[1] * torque.imag).ravel())
                else:
                    own.append((constant[2] * (mean.imag if k else mean.real)).ravel())
        parts.append(np.column_stack(own))
    return np.concatenate(parts)


@dataclass(frozen=True)
class _Normal:
    """Normal equations of the coefficients of a map, with bench parameters and effects at their best for each.

    `matrix` (p, p) and `vector` (p,) are those of the rows, `square` is the sum of squares without a map, `determinant`
    the logarithm of that of the others; `held` (p, p) are normal equations by which the map leaves to the bench what is
    the bench's own.
    """

    matrix: Array
    vector: Array
    square: float
    determinant: float
    held: Array

    @classmethod
    def of(cls, others: Array, columns: Array, rows: Array) -> _Normal:
        """Return the equations of whitened columns and rows; `others` (N, q) are by unit prior deviations."""
        inner = cho_factor(np.eye(others.shape[1]) + others.T @ others)
        with_columns, with_rows = others.T @ columns, others.T @ rows
        return cls(
            columns.T @ columns - with_columns.T @ cho_solve(inner, with_columns),
            columns.T @ rows - with_columns.T @ cho_solve(inner, with_rows),
            float(rows @ rows - with_rows @ cho_solve(inner, with_rows)),
            2.0 * float(np.log(np.diag(inner[0])).sum()),
            np.zeros((columns.shape[1], columns.shape[1])),
        )

    def holding(self, directions: Array, columns: Array) -> _Normal:
        """Return the equations of a map that is orthogonal to directions (N, d) of the whitened rows."""
        taken = (directions.T @ columns) / _HELD
        return replace(self, held=taken.T @ taken)

    def some(self, chosen: NDArray[np.bool_]) -> _Normal:
        """Return the equations of some coefficients alone."""
        both = np.ix_(chosen, chosen)
        return _Normal(self.matrix[both], self.vector[chosen], self.square, self.determinant, self.held[both])

    def solved(self, deviations: Array) -> tuple[Array, Array]:
        """Return the coefficients (p,) and their covariance for prior deviations (p,)."""
        scaled = deviations[:, None] * (self.matrix + self.held) * deviations
        inverse = np.linalg.inv(np.eye(len(scaled)) + scaled)
        covariance = deviations[:, None] * inverse * deviations
        return covariance @ self.vector, covariance

    def cost(self, deviations: Array) -> tuple[float, Array]:
        """Return minus twice the log of the marginal likelihood, and its derivatives by the log variances (p,)."""
        total, slope = _cost(self.matrix + self.held, self.vector, deviations)
        held, of_held = _cost(self.held, np.zeros(len(self.vector)), deviations)
        return total - held + self.square + self.determinant, slope - of_held


def _cost(matrix: Array, vector: Array, deviations: Array) -> tuple[float, Array]:
    root = np.linalg.cholesky(np.eye(len(vector)) + deviations[:, None] * matrix * deviations)
    inverse = solve_triangular(root, np.eye(len(root)), lower=True, check_finite=False)
    best = inverse.T @ (inverse @ (deviations * vector))
    spread = np.einsum("ij,ij->j", inverse, inverse)
    cost = 2.0 * float(np.log(np.diag(root)).sum()) - float((deviations * vector) @ best)
    return cost, 1.0 - spread - best**2


def _orders(terms: Sequence[MapTerm]) -> Array:
    """Return the powers (coefficients, 5) of magnitude and decays in the prior deviation of every coefficient.

    A torque in proportion to the tilt, the same in all directions, is the plainest on the rotor; a constant one is on
    the shaft.
    """
    rows = []
    for t in terms:
        turned = abs(t.forward - t.backward - (t.target == "rotor_torque"))
        rows += [[1, min(t.forward, t.backward) + t.odd, turned, t.speed, t.temperature]] * len(t.names)
    return np.array(rows, dtype=np.float64)


def _places(terms: Sequence[MapTerm], target: Target) -> NDArray[np.bool_]:
    return np.array([t.target == target for t in terms for _ in t.names])


def _smoothness(normal: _Normal, terms: Sequence[MapTerm]) -> dict[Target, Array]:
    """Return the likeliest magnitude and decays of the prior deviations, for every target of its own."""
    from scipy.optimize import minimize  # takes long to load

    found: dict[Target, Array] = {}
    for target in TARGETS:
        chosen = _places(terms, target)
        own, orders = normal.some(chosen), _orders(terms)[chosen]

        def cost(x: Array, own: _Normal = own, orders: Array = orders) -> tuple[float, Array]:
            value, slope = own.cost(np.exp(orders @ x))
            return value, 2.0 * orders.T @ slope

        best = minimize(
            cost,
            np.log(_START),
            jac=True,
            bounds=[(float(np.log(a)), float(np.log(b))) for a, b in _BOUNDS],
            method="L-BFGS-B",
            options={"maxiter": 40},
        )
        found[target] = best.x
    return found


def _deviations(terms: Sequence[MapTerm], smoothness: Mapping[Target, Array]) -> Array:
    orders = _orders(terms)
    result = np.zeros(len(orders))
    for target, x in smoothness.items():
        chosen = _places(terms, target)
        result[chosen] = np.exp(orders[chosen] @ x)
    return result


@dataclass(frozen=True)
class MapFit:
    """A map fitted to recordings.

    Attributes
    ----------
    effect : TorqueMap
        The map, with the errors of its coefficients.
    values, errors : dict of str to float
        Its coefficients and their standard errors [N m].
    problem, base : Problem, Fit
        The recordings, with drifts as the map leaves them; the fit without the map, about which all is linear.
    held : bool
        Whether it is orthogonal to the bench parameters. If not, they would have to leave their stated uncertainties.
    cost : float
        Minus twice the log of the marginal likelihood, the magnitudes of the drifts left free.
    gains : dict of str to float
        Increase of twice the log likelihood by each of its torques, for its magnitudes of the drifts.
    design, rows : ndarray (N, k), ndarray (N,)
        Whitened derivatives by everything else and by the independent parts of the map, each by its prior deviation;
        and what they are fitted to.
    others : int
        Number of columns of everything else, which come first.
    parts : ndarray (coefficients, k - others)
        The coefficients of the independent parts.
    """

    effect: TorqueMap
    values: dict[str, float]
    errors: dict[str, float]
    problem: Problem
    base: Fit
    held: bool
    cost: float
    gains: Mapping[Target, float]
    design: Array
    rows: Array
    others: int
    parts: Array

    @property
    def response(self) -> Array:
        """The whitened rows (N,) that the map adds."""
        own, *_ = np.linalg.lstsq(self.parts, np.array(list(self.values.values())), rcond=None)
        return np.asarray(self.design[:, self.others :] @ own)


def fit_map(problem: Problem, base: Fit, name: str, targets: Sequence[Target] = tuple(TARGETS)) -> MapFit:
    """Fit a map about a fit without it.

    Drifts are taken as stated first: enlarged ones may be the missing torque.
    """
    within = range_of(problem, base)
    terms = [term for term in terms_for(problem, within) if term.target in targets]
    columns = columns_of(problem, base, terms, within)
    unknowns = problem.unknowns
    offset = np.concatenate([base.nuisance, [base.coefficients[t][key] for t, key in base.columns]])
    rows = base.residual + base.jacobian @ (offset - unknowns.centre(base.terms))
    others = base.jacobian * unknowns.widths(base.terms)
    noise = problem.noise.with_scales(dict.fromkeys(problem.noise.scales, 1.0))
    for _ in range(2):
        normal, deviations, held = _settled(noise, others, columns, rows, terms)
        parts = _independent(noise.whiten(columns), deviations)
        scales, cost = noise.best_scales(rows, np.hstack([others, columns @ parts]))
        changed = max(abs(np.log(scales[key] / noise.scales[key])) for key in scales)
        noise = noise.with_scales(scales)
        if changed < _DRIFT_CHANGED:
            break
    kept = np.repeat(
        [
            bool(np.linalg.norm(noise.whiten(columns[:, own]) * deviations[own], axis=0).max() > _NEGLIGIBLE)
            for own in _own_places(terms)
        ],
        [len(term.names) for term in terms],
    )
    left = [term for term, own in zip(terms, _own_places(terms), strict=True) if kept[own[0]]]
    values, covariance = normal.some(kept).solved(deviations[kept])
    effect = torque_map(name, left, within, recordings=())
    effect = replace(effect, modes=_modes(effect, covariance))
    names = [c.name for c in effect.coefficients]
    parts = parts[kept]
    return MapFit(
        effect,
        dict(zip(names, values.tolist(), strict=True)),
        dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        problem.with_noise(noise),
        base,
        held,
        cost,
        {target: _gain(normal, terms, deviations, target) for target in targets},
        np.hstack([noise.whiten(others), noise.whiten(columns[:, kept]) @ parts]),
        noise.whiten(rows),
        others.shape[1],
        parts,
    )


def _settled(
    noise: Noise, others: Array, columns: Array, rows: Array, terms: Sequence[MapTerm]
) -> tuple[_Normal, Array, bool]:
    """Return normal equations and prior deviations of a map, and whether it is orthogonal to the bench.

    It is, unless a map that shares with the bench is likelier: then the bench cannot take its part within its stated
    uncertainties.
    """
    white, design, target = noise.whiten(others), noise.whiten(columns), noise.whiten(rows)
    free = _Normal.of(white, design, target)
    # what the rows tell of the bench: directions of more than one noise deviation
    left, size, turned = np.linalg.svd(white, full_matrices=False)
    bound = free.holding(left[:, size > 1.0], design)
    found = []
    for normal in (bound, free):
        deviations = _deviations(terms, _smoothness(normal, terms))
        found.append((normal.cost(deviations)[0], normal, deviations))
    best, _ = found[0][1].solved(found[0][2])
    bench = turned @ np.linalg.solve(
        np.eye(white.shape[1]) + white.T @ white, white.T @ (target - design @ best)
    )
    held = bool(found[0][0] <= found[1][0] and np.abs(bench).max(initial=0.0) <= STATED_RANGE)
    _, normal, deviations = found[0 if held else 1]
    return normal, deviations, held


def _gain(normal: _Normal, terms: Sequence[MapTerm], deviations: Array, target: Target) -> float:
    """Return the increase of twice the log likelihood by the torque on one target."""
    other = ~_places(terms, target)
    without = (
        normal.some(other).cost(deviations[other])[0] if other.any() else normal.square + normal.determinant
    )
    return without - normal.cost(deviations)[0]


def _own_places(terms: Sequence[MapTerm]) -> list[NDArray[np.int64]]:
    """Return the places of the coefficients of every term."""
    edges = np.cumsum([0, *(len(term.names) for term in terms)])
    return [np.arange(a, b) for a, b in itertools.pairwise(edges)]


def _independent(design: Array, deviations: Array) -> Array:
    """Return the coefficients (p, k) of independent parts of a map, each by its prior deviation, that the rows show."""
    _, size, turned = np.linalg.svd(design * deviations, full_matrices=False)
    return np.asarray(deviations[:, None] * turned[size > _SEEN].T)


def _modes(effect: TorqueMap, covariance: Array) -> tuple[tuple[float, ...], ...]:
    """Return independent errors of the coefficients that make up nearly all of the variance of a map in its range."""
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    at = _points(effect.within)
    lines = []
    for target in TARGETS:
        own = [t for t in effect.terms if t.target == target]
        line = []
        for term, value in values_at(own, effect.within, at):
            line += (
                [value, 1j * value][: len(term.names)]
                if target == "rotor_torque"
                else ([np.real(value), np.imag(value)][: len(term.names)])
            )
        lines.append(np.array(line, dtype=complex).reshape(-1, _POINTS))
    zeros = [np.zeros_like(line) for line in lines]
    design = np.hstack([np.vstack([lines[0], zeros[1]]), np.vstack([zeros[0], lines[1]])]).T
    _, size, turned = np.linalg.svd(np.vstack([design.real, design.imag]) @ root, full_matrices=False)
    shares = np.cumsum(size**2) / max(float(np.sum(size**2)), 1e-300)
    most = int(np.searchsorted(shares, 1.0 - _MODES_LEFT)) + 1
    return tuple(tuple(mode) for mode in (root @ turned[:most].T).T.tolist())


def _points(within: MapRange) -> dict[str, Any]:
    """Return points that fill a range evenly, the quantities by name."""
    # fractional parts of multiples of these numbers are spread evenly (Roberts' sequence in five dimensions)
    steps = (1.0 / 1.1673039782614187) ** np.arange(1, 6)
    share = np.modf(0.5 + np.outer(np.arange(_POINTS), steps))[0].T
    low, high = np.array([within.speed, within.coils, within.magnets]).T
    speed, coils, magnets = low[:, None] + (high - low)[:, None] * share[:3]
    tilt = within.tilt * np.sqrt(share[3]) * np.exp(2j * np.pi * share[4])
    return {"z": tilt, "Omega": speed, "T_coil": coils, "T_motor": magnets}
