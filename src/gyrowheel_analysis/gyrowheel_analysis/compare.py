"""Compare a model with recordings: the magnitude of the error, its parts, and where it is largest."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.channels import LISTED
from gyrowheel_analysis.criteria import FAILING_CHI2
from gyrowheel_analysis.diagnosis.dated_changes import DatedEvent
from gyrowheel_analysis.diagnosis.diagnose import misstated
from gyrowheel_analysis.diagnosis.estimates import Misstated
from gyrowheel_analysis.diagnosis.events import with_sizes
from gyrowheel_analysis.diagnosis.explanation import unexplained
from gyrowheel_analysis.diagnosis.kept_explanation import explanation_of
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.preparation import Prepared, Progress, prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.instrument_readings import ReadingFinding
from gyrowheel_analysis.reduction.windows import Coverage, concatenate
from gyrowheel_analysis.residuals.dependence import (
    Dependence,
    PartDependence,
    Whiteness,
    dependences,
    judged,
    whiteness,
)
from gyrowheel_analysis.residuals.error_table import (
    ChannelError,
    ErrorRow,
    Residuals,
    WindowResiduals,
    channel_rms,
    channel_values,
    error_row,
    errors_of,
    window_residuals,
)
from gyrowheel_analysis.residuals.maps import Region, ResidualMap, all_maps, regions
from gyrowheel_core.arrays import one_thread
from gyrowheel_recording.bags import Recording

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ChannelMetrics:
    """Quality of the prediction of one channel.

    Attributes
    ----------
    rms : float
        Root mean square of the residual, of an amplitude its modulus, every window weighted with the inverse variance
        of its noise [unit of the channel, see `channels.LISTED`].
    noise_floor_rms : float
        The same of the noise: what a complete model would leave [the same unit].
    fit_percent : float
        100 (1 - |residual| / |measured - mean|), weighted like the RMS; 100 is perfect.
    theil : float
        Theil's inequality coefficient, 0 (perfect) .. 1, weighted like the RMS.
    theil_bias, theil_variance, theil_covariance : float
        Its parts: difference of means, difference of standard deviations, everything else; they sum to 1.
    chi2_per_n : float
        Mean square of the whitened residual, see `residuals.error_table.ChannelError`.
    """

    rms: float
    noise_floor_rms: float
    fit_percent: float
    theil: float
    theil_bias: float
    theil_variance: float
    theil_covariance: float
    chi2_per_n: float


@dataclass(frozen=True)
class Comparison:
    """Outcome of a comparison.

    Attributes
    ----------
    channels : mapping of str to ChannelMetrics
        By channel of `channels.LISTED`, with the bench's parameters estimated within their stated uncertainties.
    raw_rms : mapping of str to float
        Root mean square of the residual of the model exactly as in its file [unit of the channel].
    error_before : ErrorRow
        The error in the form of the error table.
    where : tuple of Region
        Regions with most of the misfit.
    dependence : tuple of PartDependence
        The variables on which the residual depends.
    tests : tuple of Dependence
        The tests behind it, every part of the residual against every variable.
    whiteness : tuple of Whiteness
        Whether the residuals are noise.
    data : WindowResiduals
        All residuals with their windows, the basis of further maps.
    residuals : tuple of Residuals
        Window by window.
    recordings : tuple of str
        Paths of the recordings.
    model : str
        File of the model.
    coverage : Coverage
        Share of the recordings that is used.
    readings : tuple of ReadingFinding
        Deviations of the instruments that the samples show.
    hum_unknown : tuple of (str, str)
        Recordings in which hum at the stated mains frequency cannot be measured, and why (`hum.unobservable`).
    events : tuple of DatedEvent
        Changes in the middle of a recording; the residual is without them.
    misstated : tuple of Misstated
        Bench parameters that the model file has far from their values.
    """

    channels: Mapping[str, ChannelMetrics]
    raw_rms: Mapping[str, float]
    error_before: ErrorRow
    where: tuple[Region, ...]
    dependence: tuple[PartDependence, ...]
    tests: tuple[Dependence, ...]
    whiteness: tuple[Whiteness, ...]
    data: WindowResiduals
    residuals: tuple[Residuals, ...]
    recordings: tuple[str, ...]
    model: str
    coverage: Coverage
    readings: tuple[ReadingFinding, ...] = ()
    hum_unknown: tuple[tuple[str, str], ...] = ()
    events: tuple[DatedEvent, ...] = ()
    misstated: tuple[Misstated, ...] = ()

    @property
    def worst(self) -> float:
        """Largest χ²/N of all channels; 1 is noise alone."""
        return max(metrics.chi2_per_n for metrics in self.channels.values())

    @property
    def fails(self) -> bool:
        """Whether the error of a channel is visibly more than noise."""
        return self.worst > FAILING_CHI2

    @property
    def maps(self) -> list[ResidualMap]:
        """The residual over every variable, and over speed and tilt."""
        return all_maps(self.data)


@one_thread()
def compare(
    recordings: Sequence[Recording],
    model: Model,
    *,
    explain: bool = True,
    progress: Progress | None = None,
) -> Comparison:
    """Compare a model with recordings.

    The noise is that of the recordings once everything is explained that a diagnosis finds: else a law that the model
    lacks would pass for a drift. Events are taken out of the residual, the effects found are not. The bench's uncertain
    parameters are estimated within their stated uncertainties, so that the remainder is the part that the model cannot
    explain; `Comparison.raw_rms` has the error of the model in its file.

    Without `explain` nothing else is searched for, and the noise is as stated: for recordings whose setup is wrong.

    Raises
    ------
    InputError
        If a recording has too little steady motion to compare anything.
    """
    first = prepare(recordings, model, progress=progress)
    explanation = explanation_of(first, recordings, progress) if explain else unexplained(first)
    prepared, problem, fit = explanation.fitted, explanation.problem, explanation.before
    data = residual_data(prepared, fit)
    errors = errors_of(fit, fit, prepared)
    effects = problem.unknowns.effects(problem.unknowns.stated())
    balances = explanation.weighed.problem.balances
    raw = np.concatenate([b.measured - b.predicted(model.bench.values(), effects) for b in balances])
    white = problem.noise.whiten(fit.residual)
    tests = dependences(data, problem.balances, fit.residual, problem.noise.whiten)
    noise = whiteness(data, problem.balances, white)
    readings = prepared.readings(problem.bench)
    raw_row = error_row(
        balances, raw, explanation.weighed.problem.noise.whiten(raw), problem.noise.deviation()
    )
    paths = [str(r.path) for r in recordings]
    return Comparison(
        channels={
            name: _metrics(problem, fit, error, name) for name, error in errors.table.before.channels.items()
        },
        raw_rms={name: channel.rms for name, channel in raw_row.channels.items()},
        error_before=errors.table.before,
        where=tuple(regions(data, problem.bench)),
        dependence=tuple(judged(tests, noise)),
        tests=tuple(tests),
        whiteness=tuple(noise),
        data=data,
        residuals=tuple(errors.residuals),
        recordings=tuple(paths),
        model=model.origin,
        coverage=prepared.coverage,
        readings=readings.found,
        hum_unknown=readings.hum_unknown,
        events=tuple(with_sizes(problem, explanation.best, explanation.happened, paths)),
        misstated=misstated(model, first.problem),
    )


def residual_data(prepared: Prepared, fit: Fit) -> WindowResiduals:
    """Return the residuals of a fit with their windows."""
    problem = prepared.problem
    windows = concatenate([b.windows for b in problem.balances])
    return window_residuals(problem.balances, windows, fit.residual, problem.noise)


def _metrics(problem: Problem, fit: Fit, error: ChannelError, name: str) -> ChannelMetrics:
    def joined(rows: Array) -> NDArray[Any]:
        own = [channel_values(problem.balances, rows, row) for row in LISTED[name].rows]
        return own[0] if len(own) == 1 else np.asarray(own[0] + 1j * own[1])

    measured, residual = joined(problem.measured), joined(fit.residual)
    deviation = problem.noise.deviation()
    variance = np.sum(
        [channel_values(problem.balances, deviation, row) ** 2 for row in LISTED[name].rows], axis=0
    )
    weight = (1.0 / variance) / np.sum(1.0 / variance)
    predicted = measured - residual

    def spread(values: NDArray[Any]) -> tuple[complex, float]:
        """Return mean and standard deviation, weighted like the RMS."""
        mean = complex(np.sum(weight * values))
        return mean, math.sqrt(float(np.sum(weight * np.abs(values - mean) ** 2)))

    mse = float(np.sum(weight * np.abs(residual) ** 2))
    (own, swing), (its, sp) = spread(measured), spread(predicted)
    size = math.hypot(abs(own), swing) + math.hypot(abs(its), sp)
    bias = abs(own - its) ** 2 / mse if mse else 0.0
    differing = (swing - sp) ** 2 / mse if mse else 0.0
    return ChannelMetrics(
        rms=error.rms,
        noise_floor_rms=channel_rms(problem.balances, deviation, deviation, name),
        fit_percent=100.0 * (1.0 - math.sqrt(mse) / swing) if swing else 0.0,
        theil=math.sqrt(mse) / size if size else 0.0,
        theil_bias=bias,
        theil_variance=differing,
        theil_covariance=max(1.0 - bias - differing, 0.0),
        chi2_per_n=error.chi2_per_n,
    )
