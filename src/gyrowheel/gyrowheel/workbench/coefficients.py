"""Estimated parameters of a model for the page: stated, from the recordings alone and both; correlation, profiles."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel.models.api import Model
from gyrowheel.models.estimation import Fit
from gyrowheel.models.page import (
    CORRELATED,
    alone_of,
    estimate_of,
    stated_of,
    strongest_pairs,
    unit_of,
)
from gyrowheel_analysis.estimation.result import Parameter
from gyrowheel_core.quantities import decimal, pair
from gyrowheel_core.units import Unit

Array = NDArray[np.float64]

_POINTS = 13  # of a profile
_REACH = 3.0  # standard errors to either side of it
_MOST = 9  # rows of the correlation that is shown
_MOST_NAMED = 4
_LINKED = 0.5  # correlation below which a pair counts as determined separately
_MOVED = 2.0  # standard uncertainties from the stated value, from which on a parameter is named
_LEARNED = 0.9  # of the stated uncertainty: what a parameter keeps that the recordings do not improve


@dataclass(frozen=True)
class Profile:
    """Rise of χ² along a parameter [SI], and its 95 % interval."""

    values: Array
    rise: Array
    interval: tuple[float, float]


@dataclass(frozen=True)
class Estimates:
    """A fit of all parameters of a model; `added` are effects that were found and are not in the model of the page."""

    fit: Fit[Model]
    added: tuple[str, ...] = ()
    profiles: Mapping[str, Profile] = field(default_factory=dict)

    def profiled(self, name: str, advance: Callable[[float], None]) -> Profile:
        """Return the profile of a free parameter; `advance` is called with the part that is done."""
        own = self.fit.parameters[name]
        values = own.value + own.standard_error * np.linspace(-_REACH, _REACH, _POINTS)
        values = np.clip(values, *own.bounds)
        rise = []
        for k, value in enumerate(values):
            advance(k / (2 * _POINTS))  # the interval takes as long
            rise.append(self.fit.along(name, [value])[0])
        advance(0.5)
        return Profile(values, np.array(rise), self.fit.interval(name))


def shown(own: Estimates | None) -> dict[str, Any] | None:
    """Return estimates as the page draws them, each parameter in its own unit."""
    if own is None:
        return None
    fit = own.fit
    rows = [_row(own, fit.parameters[name]) for name in fit.names]
    places = _most_correlated(fit)
    return {
        "added": list(own.added),
        "rows": rows,
        "names": [fit.names[k] for k in places],
        "correlation": fit.correlation.values[np.ix_(places, places)].round(3).tolist(),
        "said": list(_sentences(fit)),
    }


def _row(own: Estimates, parameter: Parameter) -> dict[str, Any]:
    name, prior, data = parameter.name, parameter.prior, parameter.data
    effect, _, key = name.partition(".")
    unit = unit_of(parameter)
    declared = own.fit.fitted.library.get(effect)
    usual = (
        next((c.usual for c in declared.coefficients if c.name == key), None) if declared and key else None
    )
    profile = own.profiles.get(name)
    return {
        "name": name,
        "unit": unit.label,
        "both": _numbers(unit, parameter.value, parameter.standard_error),
        "stated": None if prior is None else _numbers(unit, prior.mean, prior.deviation),
        "data": None if data is None else _numbers(unit, *data),
        "usual": None if usual is None or prior is not None else _numbers(unit, *usual),
        "profile": None
        if profile is None
        else {
            "values": _numbers(unit, *profile.values),
            "rise": _numbers(Unit("", 1.0), *profile.rise),
            "interval": _numbers(unit, *profile.interval),
            "words": _interval(unit, *profile.interval),
        },
        "words": {
            "both": estimate_of(parameter),
            "stated": stated_of(parameter),
            "data": alone_of(parameter, estimate_of(parameter)),
        },
    }


def _interval(unit: Unit, low: float, high: float) -> str:
    error = 0.5 * (high - low) / unit.size
    return f"{' … '.join(pair(end / unit.size, error).split(' ± ')[0] for end in (low, high))} {unit.label}".strip()


def _numbers(unit: Unit, *values: float) -> list[float]:
    return [float(f"{value / unit.size:.8g}") for value in values]


def _most_correlated(fit: Fit[Model]) -> list[int]:
    """Return the places of the coefficients of effects and of the most correlated parameters, in order."""
    size = np.max(np.abs(fit.correlation.values - np.eye(len(fit.names))), axis=0, initial=0.0)
    ranked = sorted(range(len(size)), key=lambda k: ("." not in fit.names[k], -size[k]))
    return sorted(ranked[:_MOST])


def _sentences(fit: Fit[Model]) -> Iterator[str]:
    """Yield what the estimates mean: correlation, values that moved, and values that the recordings do not improve."""
    pairs = list(strongest_pairs(fit))
    of_effect = next((own for own in pairs if "." in own[0] + own[1]), None)
    strongest = {"of an effect": of_effect} if of_effect else {}
    if pairs and pairs[0] != of_effect:
        strongest["of all"] = pairs[0]
    for who, (first, second, r) in strongest.items():
        said = f"Strongest correlation {who}: {first} and {second}, {decimal(r, 2, sign=True)}"
        if abs(r) >= CORRELATED:
            other = "larger" if r > 0.0 else "smaller"
            yield f"{said}. A larger value of one with a {other} value of the other fits almost as well."
        elif abs(r) >= _LINKED:
            yield f"{said}. Part of their uncertainty is common."
        else:
            yield f"{said}. The recordings determine each of them separately."
    priors = [(own, own.prior) for name in fit.names if (own := fit.parameters[name]).prior is not None]
    pulls = {
        own.name: (own.value - prior.mean) / prior.deviation for own, prior in priors if prior is not None
    }
    if moved := sorted(
        (name for name in pulls if abs(pulls[name]) > _MOVED), key=lambda name: -abs(pulls[name])
    ):
        named = [f"{name} ({decimal(pulls[name], 1, sign=True)} σ)" for name in moved]
        yield f"More than {_MOVED:g} σ from the stated value: {_listed(named)}."
    kept = [
        own.name
        for own, prior in priors
        if prior is not None and own.standard_error > _LEARNED * prior.deviation
    ]
    if kept:
        yield f"Not known better than stated: {_listed(kept)}."


def _listed(names: list[str]) -> str:
    rest = len(names) - _MOST_NAMED
    return ", ".join(names[:_MOST_NAMED]) + (f" and {rest} more" if rest > 0 else "")
