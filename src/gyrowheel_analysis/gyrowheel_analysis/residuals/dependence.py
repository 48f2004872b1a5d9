"""On which variable a residual depends, and whether it is noise at all: tests that know the slow drift.

Rows and patterns are whitened with the covariance of the noise, drift included, before any test: readings that drift
together must not pass for a trend. The share of a variable is judged against the remainder (F test), so that a misfit
of another kind does not make it significant, and against the noise where the remainder is less: part of the noise is
the accuracy of the balance, which is no chance and has patterns of its own. Probabilities are multiplied by the number
of tests (Bonferroni).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.channels import CHANNELS
from gyrowheel_analysis.criteria import (
    DEPENDENCE_SHARE,
    DEPENDENCE_SHARE_LEFT,
    DEPENDENCE_WINDOWS,
    EQUAL_DESCRIPTION,
    MOSTLY_PLAIN,
    NOISE_TRUST,
    SIGNIFICANT,
    STRONG_EVIDENCE,
)
from gyrowheel_analysis.reduction.windows import UPRIGHT, Windows
from gyrowheel_analysis.residuals.error_table import WindowResiduals, channel_parts
from gyrowheel_core.units import DEG, RPM

Array = NDArray[np.float64]

_MOST = 3  # variables together
_LAGS = 4
#: Variables that act on coils and case, and those that act on the motor; those set by plans come first.
_OF_TILT = ("speed", "tilt", "azimuth", "temperature", "air_pressure", "time")
_OF_MOTOR = ("speed", "tilt", "azimuth", "motor_temperature", "air_pressure", "time")
#: Variables, and the smallest range of each over which anything can depend on it.
VARIABLES: dict[str, float] = {
    "speed": 50.0 * RPM,
    "tilt": 0.3 * DEG,
    "azimuth": 0.1,
    "temperature": 2.0,
    "motor_temperature": 2.0,
    "air_pressure": 5e3,
    "time": 5.0,
}


@dataclass(frozen=True)
class Dependence:
    """Dependence of the residual of one part on one variable.

    Attributes
    ----------
    part : str
        Which residual, see `channels.CHANNELS`.
    variable : str
        Of `VARIABLES`.
    share_of_chi2 : float
        Part of the sum of squares (whitened) that the variable alone explains.
    share_of_none : float
        Part of it that needs no variable: constant, or in proportion to the tilt.
    p : float
        Probability that noise explains as much, times the number of tests.
    chosen : bool
        Whether it is among the few variables that together describe the part best.
    instead : str or None
        For one that is not: the chosen variable that it could replace.
    share_beside, p_beside : float
        The same after the other chosen variables.
    """

    part: str
    variable: str
    share_of_chi2: float
    share_of_none: float
    p: float
    chosen: bool
    instead: str | None
    share_beside: float
    p_beside: float

    @property
    def stated(self) -> bool:
        """Whether a dependence on it is stated."""
        enough = min(DEPENDENCE_SHARE, DEPENDENCE_SHARE_LEFT * (1.0 - self.share_of_none))
        return self.chosen and self.p_beside <= SIGNIFICANT and self.share_beside >= enough

    def to_json(self) -> dict[str, Any]:
        """Return the test as a JSON object."""
        return asdict(self)


@dataclass(frozen=True)
class Whiteness:
    """Whether the residual of one part is noise: as large as noise, and without order.

    Attributes
    ----------
    part : str
        Which residual.
    rows : int
        Their number.
    chi2_per_n : float
        Mean square in units of the noise, drift and all.
    p_size : float
        Probability that noise of `NOISE_TRUST` times the stated size is as large.
    correlation : float
        Of whitened neighbours in time.
    p_order : float
        Probability that noise has as much autocorrelation over the next few windows (Ljung and Box).
    """

    part: str
    rows: int
    chi2_per_n: float
    p_size: float
    correlation: float
    p_order: float

    def to_json(self) -> dict[str, Any]:
        """Return the test as a JSON object."""
        return asdict(self)


@dataclass(frozen=True)
class PartDependence:
    """Result of the tests for one part of the residual that is not noise.

    Attributes
    ----------
    part : str
        Which residual.
    stated : tuple of Dependence
        Its dependences, largest share first; empty where no variable accounts for it.
    instead : tuple of str
        Variables that varied along with one of these and could replace it.
    mostly_plain : bool
        Whether most of it is constant or in proportion to the tilt, and needs no variable.
    larger : bool
        Whether it is larger than noise; else only its order in time differs from that of noise.
    whiteness : Whiteness
        The test of size and order.
    """

    part: str
    stated: tuple[Dependence, ...]
    instead: tuple[str, ...]
    mostly_plain: bool
    larger: bool
    whiteness: Whiteness


def dependences(
    data: WindowResiduals, balances: Sequence[Balance], rows: Array, whiten: Callable[[Array], Array]
) -> list[Dependence]:
    """Test every part of the residual `rows` (N,) against every variable.

    `whiten` divides rows (N, ...) by the square root of the covariance of their noise.
    """
    values = _variables(data.windows)
    if len(data.windows) < DEPENDENCE_WINDOWS or not values:
        return []
    white = whiten(rows)
    tests = len(data.parts) * len(_OF_TILT)
    found: list[Dependence] = []
    for name in data.parts:
        columns, place = _patterns(name, data, balances)
        wanted = [v for v in (_OF_TILT if name.startswith("tilt") else _OF_MOTOR) if v in values]
        own = {v: whiten(columns(values[v]))[place] for v in wanted}
        squares = _Squares(white[place], whiten(columns(None))[place], own)
        chosen = squares.best()
        for variable in wanted:
            alone = squares.test(variable, ())
            beside = squares.test(variable, tuple(v for v in chosen if v != variable))
            found.append(
                Dependence(
                    name,
                    variable,
                    alone[0],
                    squares.share_of_base,
                    min(tests * alone[1], 1.0),
                    variable in chosen,
                    squares.instead(variable, chosen),
                    beside[0],
                    min(tests * beside[1], 1.0),
                )
            )
    return found


def whiteness(data: WindowResiduals, balances: Sequence[Balance], white: Array) -> list[Whiteness]:
    """Test whether the residual of every part is noise; `white` are the whitened residual rows (N,)."""
    result = []
    for name, part in data.parts.items():
        pieces = [p for row in part.kind.rows for p in channel_parts(balances, white, row)]
        order = [np.argsort(b.windows.middle, kind="stable") for b in balances] * len(part.kind.rows)
        pieces = [p[o] for p, o in zip(pieces, order, strict=True)]
        n = sum(len(p) for p in pieces)
        square = sum(float(p @ p) for p in pieces)
        if n < DEPENDENCE_WINDOWS or square == 0.0:
            continue
        correlation, statistic, lags = 0.0, 0.0, 0
        for lag in range(1, _LAGS + 1):
            pairs = sum(max(len(p) - lag, 0) for p in pieces)
            if pairs < DEPENDENCE_WINDOWS:
                break
            r = sum(float(p[lag:] @ p[:-lag]) for p in pieces if len(p) > lag) / square
            statistic += n * (n + 2.0) * r**2 / pairs
            correlation, lags = (r if lag == 1 else correlation), lag
        p_order = float(chdtrc(lags, statistic)) if lags else 1.0
        result.append(
            Whiteness(name, n, square / n, float(chdtrc(n, square / NOISE_TRUST**2)), correlation, p_order)
        )
    return result


def judged(found: Sequence[Dependence], white: Sequence[Whiteness]) -> list[PartDependence]:
    """Return the result of the tests for every part of the residual that is not noise."""
    result = []
    parts = max(len(white), 1)
    for test in white:
        if parts * min(test.p_size, test.p_order) > SIGNIFICANT:
            continue
        own = [d for d in found if d.part == test.part]
        stated = tuple(sorted((d for d in own if d.stated), key=lambda d: -d.share_beside))
        names = [d.variable for d in stated]
        larger = parts * test.p_size <= SIGNIFICANT
        if stated or larger or test.correlation > 0.0:
            instead = tuple(d.variable for d in own if d.instead in names)
            plain = bool(own) and own[0].share_of_none >= MOSTLY_PLAIN  # the same for every variable
            result.append(PartDependence(test.part, stated, instead, plain, larger, test))
    return result


def _variables(w: Windows) -> dict[str, Array]:
    """Return the functions (n, k) of each variable that has a range in these windows."""
    z = np.asarray(w.mean_tilt)
    plain = {
        "speed": w.mean_spin,
        "tilt": np.abs(z),
        "temperature": w.coil_temperature,
        "motor_temperature": w.motor_temperatures.mean(axis=1),
        "air_pressure": w.air_pressure,
        "time": w.middle,
    }
    result = {}
    spin = 2.0 * (w.mean_spin - w.mean_spin.min()) / max(float(np.ptp(w.mean_spin)), 1e-9) - 1.0
    turning = float(np.ptp(w.mean_spin)) > VARIABLES["speed"]
    of_speed = np.column_stack([np.ones(len(w)), spin, spin**2])
    for name, least in VARIABLES.items():
        if name == "azimuth":
            tilted = np.abs(z) > UPRIGHT
            if tilted.sum() >= DEPENDENCE_WINDOWS and np.ptp(np.angle(z[tilted])) > least:
                angle = np.angle(z)
                waves = [f(k * angle) for k in (1, 2) for f in (np.cos, np.sin)]
                result[name] = np.where(tilted[:, None], np.column_stack(waves), 0.0)
        elif float(np.ptp(plain[name])) > least:
            x = 2.0 * (plain[name] - plain[name].min()) / np.ptp(plain[name]) - 1.0
            result[name] = np.column_stack([x, x**2])
            if turning and name != "speed":
                # its effect may be larger at a higher speed; for constant variables the product is the speed itself
                beyond = _beyond(of_speed, x * spin)
                result[name] = np.column_stack([result[name], beyond])
    return result


def _beyond(columns: Array, values: Array) -> Array:
    """Return the residual of values (n,) after a fit of columns (n, k)."""
    return values - columns @ np.linalg.lstsq(columns, values, rcond=1e-9)[0]


def _patterns(
    name: str, data: WindowResiduals, balances: Sequence[Balance]
) -> tuple[Callable[[Any], Array], NDArray[np.int64]]:
    """Return a function from functions of a variable to columns over all rows, and the rows of the part.

    The coil torque may be constant, or proportional to the tilt, in phase or across; the motor's rows have their
    own amplitudes. Each of these may change with the variable. None stands for no variable.
    """
    w, kind = data.windows, CHANNELS[name]
    rows: dict[str, list[NDArray[np.int64]]] = {row: [] for row in kind.rows}
    count = 0
    for balance in balances:
        for row in kind.rows:
            own = balance.row(row)
            rows[row].append(np.arange(count + own.start, count + own.stop))
        count += len(balance)
    places = [np.concatenate(rows[row]) for row in kind.rows]
    one, z = np.ones(len(w)), np.asarray(w.mean_tilt)
    shapes: list[Any] = [one]
    if len(kind.rows) == 2:
        z = np.conj(z) if name == "tilt_2n" else z
        turning = [z, 1j * z] if name.startswith("tilt") else []
        shapes = [s for s in (one + 0j, 1j * one, *turning) if np.any(np.abs(s) > UPRIGHT)]

    def columns(basis: Any) -> Array:
        functions = [one] if basis is None else list(np.asarray(basis).T)
        out = np.zeros((count, len(shapes) * len(functions)))
        for k, (shape, f) in enumerate((s, f) for s in shapes for f in functions):
            value = shape * f
            out[places[0], k] = np.real(value)
            if len(places) == 2:
                out[places[1], k] = np.imag(value)
        return out

    return columns, np.sort(np.concatenate(places))


class _Squares:
    """Residual sums of squares of whitened rows (n,) after fits of sets of variables.

    The noise of the rows is 1. `base` (n, k) are whitened columns that belong to no variable, `columns` (n, m) those of
    every variable.
    """

    def __init__(self, rows: Array, base: Array, columns: Mapping[str, Array]) -> None:
        self._n = len(rows)
        self._total = float(rows @ rows)
        # the triangle of the QR decomposition has all sums of squares
        every = np.hstack([base, *columns.values(), rows[:, None]])
        size = np.linalg.norm(every[:, :-1], axis=0)
        every[:, :-1] /= np.where(size > 0.0, size, 1.0)
        triangle: Array = np.asarray(np.linalg.qr(every, mode="r"))
        self._base = triangle[:, : base.shape[1]]
        self._rows = triangle[:, -1]
        self._columns: dict[str, Array] = {}
        at = base.shape[1]
        for name, own in columns.items():
            self._columns[name] = triangle[:, at : at + own.shape[1]]
            at += own.shape[1]
        self._known: dict[frozenset[str], tuple[float, int]] = {}

    def left(self, names: Iterable[str]) -> tuple[float, int]:
        """Return the remaining sum of squares after variables, and their number of columns."""
        key = frozenset(names)
        if key not in self._known:
            design = np.hstack([self._base, *(self._columns[name] for name in sorted(key))])
            solution, _, rank, _ = np.linalg.lstsq(design, self._rows, rcond=1e-6)
            self._known[key] = float(np.sum((self._rows - design @ solution) ** 2)), int(rank)
        return self._known[key]

    def test(self, name: str, beside: Iterable[str]) -> tuple[float, float]:
        """Return the share of the whole that a variable explains besides others, and its probability by chance."""
        rest, used = self.left(beside)
        after, more = self.left({*beside, name})
        k, free = more - used, self._n - more
        if k <= 0 or free < 3 or after <= 0.0 or self._total == 0.0:
            return 0.0, 1.0
        gain = max(rest - after, 0.0)
        return gain / self._total, float(fdtrc(k, free, gain / k / max(after / free, 1.0)))

    @property
    def share_of_base(self) -> float:
        """Part of the sum of squares that belongs to no variable."""
        return 1.0 - self.left(())[0] / self._total if self._total else 0.0

    def criterion(self, names: Iterable[str]) -> float:
        """Return Schwarz's criterion with the correction for few rows (McQuarrie, 1999), the lower the better."""
        names = tuple(names)
        _, used = self.left(names)
        if used > self._n / 2 or used > self._n - 3:
            return math.inf
        return self._misfit(names) + used * math.log(self._n) * self._n / (self._n - used - 2.0)

    def _misfit(self, names: Iterable[str]) -> float:
        """Return the logarithm of the remainder after variables, as the criterion needs it."""
        names = tuple(names)
        rest, _ = self.left(names)
        if rest <= 0.0:
            return math.inf
        return self._n * math.log(rest) + (EQUAL_DESCRIPTION if "time" in names else 0.0)

    def best(self) -> tuple[str, ...]:
        """Return the few variables that describe the rows best; of equally many and good ones, the plainest."""
        sets = [s for k in range(_MOST + 1) for s in itertools.combinations(self._columns, k)]
        best = min(sets, key=self.criterion)
        limit = self.criterion(best) + STRONG_EVIDENCE
        # variables come in the order of how plain they are
        return next(s for s in sets if len(s) == len(best) and self.criterion(s) <= limit)

    def instead(self, name: str, chosen: Sequence[str]) -> str | None:
        """Return the chosen variable that another can replace; None if it can replace none."""
        if name in chosen or not chosen:
            return None
        # a variable was not chosen because it needs more columns, not because it explains less
        trials = {own: self._misfit({*chosen, name} - {own}) for own in chosen}
        nearest = min(trials, key=lambda own: trials[own])
        return nearest if trials[nearest] < self._misfit(chosen) + EQUAL_DESCRIPTION else None
