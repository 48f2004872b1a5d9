"""What the machines of a table share: a mean of every quantity, and how far machines differ in it.

A value is the mean of all machines, plus what its machine differs by, plus its error; the two latter are normal, and
the standard errors are known. A library for such fits would be statsmodels, which the project does not need otherwise.

References
----------
W. Viechtbauer, *J. Educ. Behav. Stat.* 30 (2005) 261: restricted maximum likelihood of the spread.
W. Viechtbauer, *Stat. Med.* 26 (2007) 37: its interval, by the profile of Q.
W. G. Cochran, *Biometrics* 10 (1954) 101: Q, the test of equal machines.
G. Knapp, J. Hartung, *Stat. Med.* 22 (2003) 2693: the error of the mean.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri

from gyrowheel_analysis.criteria import SPREAD_FEWEST

Array = NDArray[np.float64]

_OUTSIDE = 0.025  # probability beyond either end of an interval
_ROUNDING = 1.0e-9  # least gain in twice the log likelihood for which a spread is stated
_SMALLEST = 0.01  # of the smallest error; by less, machines do not differ
_LARGEST = 1.0e60  # of a value, and of the inverse of an error: their squares, multiplied, do not overflow


@dataclass(frozen=True)
class Shared:
    """What machines share in a quantity.

    Attributes
    ----------
    name : str
        The quantity, as a column of the table.
    mean, standard_error : float
        Mean of all machines, also of those that are not in the table [SI]; of one machine its own value.
    spread : float or None
        Standard deviation between machines [SI], without the errors of their values; None for less than
        `SPREAD_FEWEST` machines, as are `interval` and `chance`.
    interval : tuple of float or None
        The 95 % interval of the spread [SI]. The upper end is at least that of machines that differ just as much as the
        errors of their values make expect: differences that are smaller by chance prove no smaller spread.
    chance : float or None
        Probability that equal machines differ as much by the errors of their values.
    repeat_chance : float or None
        Probability that the recordings of the machines scatter as much by the errors of their values; None without
        several recordings of a machine.
    machines, recordings : int
        Number of machines and recordings with a value.
    """

    name: str
    mean: float
    standard_error: float
    spread: float | None
    interval: tuple[float, float] | None
    chance: float | None
    repeat_chance: float | None
    machines: int
    recordings: int


def shared(rows: Sequence[Mapping[str, Any]]) -> tuple[Shared, ...]:
    """Return what machines share in every quantity of a table; first that in which they differ most clearly.

    Parameters
    ----------
    rows : sequence of mapping
        Rows with ``machine`` (a row without one is a separate machine) and, for every quantity, ``NAME.data``,
        ``NAME.data_error`` and ``NAME.data_scatter`` [SI]: the value without its prior, its standard error, and the
        part of it that is new in every recording of a machine. A table without such columns has ``NAME`` and
        ``NAME.error``: values without priors, all of whose errors are new in every recording.
    """
    found = [_shared(name, own) for name, own in values(rows).items() if own]
    return tuple(sorted(found, key=lambda own: math.inf if own.chance is None else own.chance))


class Value(NamedTuple):
    """What a recording says of a quantity: value, standard error, and the part of it that is new in every recording."""

    row: int
    machine: str
    value: float
    error: float
    scatter: float


def values(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Value]]:
    """Return the values of every quantity of a table as `shared` takes them, in the order of the rows.

    A row without a machine has one of a name that no other row has.
    """
    names = dict.fromkeys(n.removesuffix(".error") for row in rows for n in row if n.endswith(".error"))
    if any(f"{name}.data_error" in row for row in rows for name in names):
        columns = (".data", ".data_error", ".data_scatter")
    else:
        columns = ("", ".error", ".error")
    return {name: list(_known(rows, [f"{name}{column}" for column in columns])) for name in names}


def _known(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> Iterator[Value]:
    """Yield what every recording says that has these columns."""
    for number, row in enumerate(rows):
        own = tuple(math.nan if row.get(column) is None else float(row[column]) for column in columns)
        if all(abs(value) < _LARGEST for value in own) and own[1] > 1.0 / _LARGEST:
            value, error, scatter = own
            yield Value(number, str(row.get("machine") or f"\n{number}"), value, error, min(scatter, error))


class MachineMean(NamedTuple):
    """Mean of the recordings of a machine, and the two parts of its standard error."""

    value: float
    scatter: float  # falls with the number of recordings
    repeated: float  # does not: it is the same in all of them


def by_machine(known: Sequence[Value]) -> dict[str, list[Value]]:
    """Return the values of each machine, the machine of the first value first."""
    every: dict[str, list[Value]] = {}
    for own in known:
        every.setdefault(own.machine, []).append(own)
    return every


def machine_mean(known: Sequence[Value]) -> MachineMean:
    """Return the mean of the recordings of a machine."""
    if len(known) == 1:  # as of most machines
        (own,) = known
        return MachineMean(own.value, own.scatter, math.sqrt(own.error**2 - own.scatter**2))
    value, error, scatter = np.array([own[2:] for own in known]).T
    weight = error**-2 / np.sum(error**-2)
    return MachineMean(
        float(weight @ value),
        float(np.linalg.norm(weight * scatter)),
        float(weight @ np.sqrt(error**2 - scatter**2)),
    )


def _shared(name: str, known: Sequence[Value]) -> Shared:
    every = by_machine(known)
    means = {machine: machine_mean(several) for machine, several in every.items()}
    square = sum(((own.value - means[own.machine].value) / own.error) ** 2 for own in known)
    machines, recordings = len(every), len(known)
    fit = _Fit(
        np.array([own.value for own in means.values()]),
        np.array([own.scatter**2 + own.repeated**2 for own in means.values()]),
    )
    spread = fit.spread()
    mean, error = fit.mean(spread)
    few = machines < SPREAD_FEWEST
    return Shared(
        name, mean, error,
        None if few else spread,
        None if few else fit.interval(),
        None if few else float(chdtrc(machines - 1, fit.misfit(0.0))),
        None if recordings == machines else float(chdtrc(recordings - machines, square)),
        machines, recordings,
    )  # fmt: skip


@dataclass(frozen=True)
class _Fit:
    """Values of machines with the variances of their errors, all (n,)."""

    value: Array
    variance: Array

    def misfit(self, spread: float) -> float:
        """Return Cochran's Q: chi-squared about the mean, for a standard deviation between machines."""
        return float(self._misfits(np.array(spread)))

    def _misfits(self, spread: Array) -> Array:
        """Return the misfits (...) of several standard deviations (...)."""
        weight = 1.0 / (self.variance + spread[..., None] ** 2)
        mean = weight @ self.value / weight.sum(-1)
        return np.asarray((weight * (self.value - mean[..., None]) ** 2).sum(-1))

    def expected(self, spread: float) -> float:
        """Return the misfit that is expected for machines that are equal."""
        weight = 1.0 / (self.variance + spread**2)
        return float(weight @ self.variance - weight**2 @ self.variance / np.sum(weight))

    def spread(self) -> float:
        """Return the likeliest standard deviation between machines; it is not above the range of the values."""
        from scipy.optimize import minimize_scalar  # takes long to load

        def unlikely(spread: Array) -> Array:
            """Return minus twice the restricted log likelihood of several standard deviations."""
            variance = self.variance + spread[..., None] ** 2
            return np.log(variance).sum(-1) + np.log((1.0 / variance).sum(-1)) + self._misfits(spread)

        smallest = _SMALLEST * math.sqrt(min(self.variance))
        largest = max(float(np.ptp(self.value)), smallest)
        tried = np.array([0.0, *np.geomspace(smallest, largest, 100), largest])
        place = min(max(int(np.argmin(unlikely(tried))), 1), 100)
        found = minimize_scalar(
            lambda spread: float(unlikely(np.array(spread))),
            bounds=(tried[place - 1], tried[place + 1]),
            method="bounded",
            options={"xatol": 1e-4 * smallest},
        )
        return float(found.x) if unlikely(np.array(0.0)) - found.fun > _ROUNDING else 0.0

    def mean(self, spread: float) -> tuple[float, float]:
        """Return the mean of all machines with its standard error, which grows where they differ by more."""
        weight = 1.0 / (self.variance + spread**2)
        excess = self.misfit(spread) / max(len(weight) - 1, 1)
        return float(np.average(self.value, weights=weight)), math.sqrt(max(excess, 1.0) / np.sum(weight))

    def interval(self) -> tuple[float, float]:
        """Return the 95 % interval of the standard deviation between machines."""
        degrees = len(self.value) - 1

        def smallest(spread: float) -> float:
            return self.misfit(spread) - float(chdtri(degrees, _OUTSIDE))

        def largest(spread: float) -> float:
            return max(self.misfit(spread), self.expected(spread)) - float(chdtri(degrees, 1.0 - _OUTSIDE))

        scale = math.sqrt(min(self.variance))
        return _root(smallest, scale), _root(largest, scale)


def _root(falling: Callable[[float], float], scale: float) -> float:
    """Return where a function that falls becomes zero, from zero on; zero where it is negative already."""
    from scipy.optimize import brentq  # takes long to load

    if falling(0.0) <= 0.0:
        return 0.0
    end = scale
    while falling(end) > 0.0:
        end *= 2.0
    return float(brentq(falling, 0.0, end, xtol=1e-6 * scale))
