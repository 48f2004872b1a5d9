"""A fit of chosen parameters as text: estimates and priors, channels, criteria, correlations."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from gyrowheel.show.formulas import is_pure
from gyrowheel.show.layout import figures_table, heading, sentences, words_table
from gyrowheel_analysis.channels import LISTED
from gyrowheel_core.quantities import decimal, short, with_error
from gyrowheel_core.units import Unit, unit_for

if TYPE_CHECKING:
    from gyrowheel_analysis.estimation.result import Estimation, Parameter

_INDENT = (0, 0, 0, 2)
#: Correlation from which on a pair is named, pairs and fixed parameters that are named at most.
CORRELATED = 0.8
_MOST_PAIRS = 5
_MOST_FIXED = 6


def fit_page(fit: Estimation) -> Iterator[RenderableType]:
    """Yield the estimates with their priors, the channels, the criteria and the strongest correlations."""
    effects = [name for name in fit.names if "." in name]
    bench = [name for name in fit.names if "." not in name]
    if effects:
        yield heading("Coefficients")
        table = words_table("", "estimate", "from the data alone", "prior", whole=(0, 1, 2, 3))
        for name in effects:
            own = fit.parameters[name]
            table.add_row(Text(name, style="cyan"), estimate_of(own), alone_of(own), stated_of(own))
        yield Padding(table, _INDENT)
    if bench:
        yield heading("Bench parameters")
        table = words_table("", "estimate", "prior", whole=(0, 1, 2))
        for name in bench:
            own = fit.parameters[name]
            table.add_row(Text(name, style="cyan"), estimate_of(own), stated_of(own))
        yield Padding(table, _INDENT)
    if fixed := [name for name, own in fit.parameters.items() if not own.free]:
        what = ", ".join(fixed) if len(fixed) <= _MOST_FIXED else f"{len(fixed)} parameters"
        yield Padding(Text(f"fixed at the model's values: {what}", style="dim"), _INDENT)
    yield heading("Channels")
    channels = figures_table("", "χ²/N", "N")
    for name, (chi2, n) in fit.channels.items():
        channels.add_row(LISTED[name].title, decimal(chi2 / n, 2), str(n))
    yield Padding(channels, _INDENT)
    yield heading("Fit")
    yield from sentences(_facts(fit))


def _facts(fit: Estimation) -> Iterator[str]:
    yield (
        f"χ² {decimal(fit.chi2, 1)} with {fit.degrees_of_freedom} degrees of freedom: {fit.rows} rows, "
        f"{len(fit.names)} free parameters, {sum(fit.parameters[n].prior is not None for n in fit.names)} of them "
        "with a prior"
    )
    yield (
        f"log likelihood {decimal(fit.log_likelihood, 2)}, log evidence {decimal(fit.log_evidence, 2)}, "
        f"AIC {decimal(fit.aic, 1)}, BIC {decimal(fit.bic, 1)}"
    )
    if fit.loss != "linear":
        yield f"large residuals weighted by the loss {fit.loss}"
    for name in fit.names:
        if fit.parameters[name].at_bound:
            low, high = fit.parameters[name].bounds
            yield f"{name} lies at a bound ({short(low, 3)} .. {short(high, 3)}); its standard error means little"
    for first, second, r in islice(strongest_pairs(fit), _MOST_PAIRS):
        if abs(r) >= CORRELATED:
            yield f"correlation of {first} and {second}: {decimal(r, 3, sign=True)}"


def strongest_pairs(fit: Estimation) -> Iterator[tuple[str, str, float]]:
    """Yield all pairs of free parameters with their correlation, the strongest first."""
    values = fit.correlation.values
    pairs = np.triu_indices(len(values), 1)
    for k in np.argsort(-np.abs(values[pairs])):
        i, j = pairs[0][k], pairs[1][k]
        yield fit.names[i], fit.names[j], float(values[i, j])


def estimate_of(own: Parameter) -> str:
    """Return an estimate with its standard error and unit."""
    return _value(own, own.value, own.standard_error)


def _value(own: Parameter, value: float, error: float) -> str:
    """Return a value of a parameter with its error, in the unit in which people read it."""
    return with_error(value, error, own.unit, pure=_is_pure(own))


def unit_of(own: Parameter) -> Unit:
    """Return the unit in which people read an estimate."""
    return unit_for(max(abs(own.value), own.standard_error), own.unit, pure=_is_pure(own))


def _is_pure(own: Parameter) -> bool:
    effect, _, key = own.name.partition(".")
    return is_pure(effect, key) if key else True


def stated_of(own: Parameter) -> str:
    """Return the prior of a parameter, which is its stated value."""
    return "–" if own.prior is None else _value(own, own.prior.mean, own.prior.deviation)


def alone_of(own: Parameter, without_prior: str = "the same") -> str:
    """Return what the recordings alone determine; `without_prior` where that is the estimate itself."""
    if own.prior is None:
        return without_prior
    return "not determined" if own.data is None else _value(own, *own.data)
