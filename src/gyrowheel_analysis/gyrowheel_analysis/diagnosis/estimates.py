"""Estimates of coefficients and bench parameters, with their errors and their limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from gyrowheel_analysis.fitting.fit import Prior

#: Standard deviations of a 95 % interval, on either side.
INTERVAL_95 = 1.96


@dataclass(frozen=True)
class ErrorParts:
    """What the uncertainty of an estimate consists of, each as a standard deviation.

    Attributes
    ----------
    noise : float
        Of the readings' noise and slow drift, with a bench that is known exactly.
    bench : float
        Of the uncertainties of the bench and of known effects; with `noise` it is the standard error.
    undetected : float
        Of effects that these recordings would not show.
    value : float
        The estimate without undetected effects.
    middle : float
        The estimate if the undetected effects have their likeliest sizes.
    """

    noise: float
    bench: float
    undetected: float
    value: float
    middle: float

    @property
    def deviation(self) -> float:
        """The three together."""
        return math.hypot(self.noise, self.bench, self.undetected)

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval from all three; it holds whether or not there are undetected effects."""
        none, some = INTERVAL_95 * math.hypot(self.noise, self.bench), INTERVAL_95 * self.deviation
        return min(self.value - none, self.middle - some), max(self.value + none, self.middle + some)


@dataclass(frozen=True)
class Estimate:
    """A coefficient with its standard error, in `unit`.

    Attributes
    ----------
    value, standard_error : float
        By the data, and the prior if there is one.
    unit : str
        SI unit.
    prior : Prior or None
        Its prior; None where the data alone decide.
    data : tuple of float or None
        Estimate and standard error from the data alone; None without a prior, and where they do not determine it.
    source : str
        Where the prior comes from.
    parts : ErrorParts or None
        What its uncertainty consists of; None where it was not fitted.
    scatter : float or None
        Standard deviation of `data`, or without a prior of `value`, between recordings of one machine; the rest of
        their standard error is the same in all of them. None where it was not fitted.
    """

    value: float
    standard_error: float
    unit: str
    prior: Prior | None = None
    data: tuple[float, float] | None = None
    source: str = ""
    parts: ErrorParts | None = None
    scatter: float | None = None

    @property
    def conflict(self) -> float | None:
        """Distance of the data from the prior in their joint standard errors; None without both."""
        if self.prior is None or self.data is None:
            return None
        return abs(self.data[0] - self.prior.mean) / math.hypot(self.data[1], self.prior.deviation)


@dataclass(frozen=True)
class NuisanceEstimate:
    """Estimate of a bench parameter, with its stated value; `data` and `scatter` as those of `Estimate`."""

    value: float
    standard_error: float
    prior_value: float
    prior_uncertainty: float
    unit: str
    data: tuple[float, float] | None = None
    scatter: float | None = None

    @property
    def pull(self) -> float:
        """Distance from the stated value in stated uncertainties."""
        return (self.value - self.prior_value) / self.prior_uncertainty


@dataclass(frozen=True)
class Misstated:
    """A bench parameter that a model file has far from the value that the recordings show."""

    name: str
    value: float  # in the model file [`unit`]
    found: float  # by the recordings, with its standard error [`unit`]
    standard_error: float
    unit: str

    @property
    def far(self) -> float:
        """Distance [standard errors]."""
        return abs(self.value - self.found) / self.standard_error


@dataclass(frozen=True)
class DetectionLimit:
    """The smallest size of an effect that these recordings could have shown."""

    effect: str
    title: str
    coefficient: str
    value: float
    unit: str
    usual: tuple[float, float]

    @property
    def visible(self) -> bool:
        """Whether an effect of a usual size could have been seen."""
        return self.value <= self.usual[1]


@dataclass(frozen=True)
class Beyond:
    """An impossible value, or one far from usual.

    Attributes
    ----------
    kind : str
        ``impossible``: a bench parameter outside its physical range. ``unusual``: an effect, or the error of a
        parameter, many times its usual size. ``not_as_stated``: an estimated bench parameter, many of its stated
        uncertainties away.
    name, coefficient : str
        The effect, error or bench parameter; of an effect its coefficient.
    value, limit : float
        The fitted value, and the limit that it exceeds [`unit`].
    unit : str
        Their unit.
    times : float
        Multiple of the largest usual size, or stated uncertainties; 0 where it is impossible.
    """

    kind: Literal["impossible", "unusual", "not_as_stated"]
    name: str
    coefficient: str
    value: float
    limit: float
    unit: str
    times: float
