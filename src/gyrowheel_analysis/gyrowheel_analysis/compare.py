"""Compare a model with recordings: the magnitude of the error, its parts, and where it is largest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.channels import LISTED
from gyrowheel_analysis.criteria import FAILING_CHI2
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.preparation import Prepared, Progress, one_thread, prepare
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
    ErrorRow,
    Residuals,
    WindowResiduals,
    channel_rms,
    channel_values,
    channels_of,
    error_row,
    errors_of,
    window_residuals,
)
from gyrowheel_analysis.residuals.maps import Region, ResidualMap, all_maps, regions
from gyrowheel_recording.bags import Recording

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ChannelMetrics:
    """Quality of the prediction of one channel.

    Attributes
    ----------
    rms : float
        Root mean square of the residual, of an amplitude its modulus [unit of the channel, see `channels.LISTED`].
    noise_floor_rms : float
        Residual that a complete model would leave [the same unit].
    fit_percent : float
        100 (1 - |residual| / |measured - mean|); 100 is perfect.
    theil : float
        Theil's inequality coefficient, 0 (perfect) .. 1.
    theil_bias, theil_variance, theil_covariance : float
        Its parts: difference of means, difference of standard deviations, everything else; they sum to 1.
    chi2_per_n : float
        Mean square of the residual in units of its noise.
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
def compare(recordings: Sequence[Recording], model: Model, *, progress: Progress | None = None) -> Comparison:
    """Compare a model with recordings.

    The bench's uncertain parameters are estimated within their stated uncertainties, so that the remainder is
    the part that the model cannot explain; `Comparison.raw_rms` has the error of the model in its file.

    Raises
    ------
    InputError
        If a recording has too little steady motion to compare anything.
    """
    prepared = prepare(recordings, model, progress=progress)
    problem = prepared.problem
    fit = problem.fit_within()
    data = residual_data(prepared, fit)
    errors = errors_of(fit, fit, prepared)
    effects = problem.unknowns.effects(problem.unknowns.stated())
    raw = problem.measured - np.concatenate(
        [b.predicted(model.bench.values(), effects) for b in problem.balances]
    )
    white = problem.noise.whiten(fit.residual)
    tests = dependences(data, problem.balances, fit.residual, problem.noise.whiten)
    noise = whiteness(data, problem.balances, white)
    readings = prepared.readings(problem.bench)
    raw_row = error_row(problem.balances, raw, problem.noise.whiten(raw))
    return Comparison(
        channels={name: _metrics(problem, fit, white, name) for name in channels_of(problem.balances)},
        raw_rms={name: channel.rms for name, channel in raw_row.channels.items()},
        error_before=errors.table.before,
        where=tuple(regions(data, problem.bench)),
        dependence=tuple(judged(tests, noise)),
        tests=tuple(tests),
        whiteness=tuple(noise),
        data=data,
        residuals=tuple(errors.residuals),
        recordings=tuple(str(r.path) for r in recordings),
        model=model.origin,
        coverage=prepared.coverage,
        readings=readings.found,
        hum_unknown=readings.hum_unknown,
    )


def residual_data(prepared: Prepared, fit: Fit) -> WindowResiduals:
    """Return the residuals of a fit with their windows."""
    problem = prepared.problem
    windows = concatenate([b.windows for b in problem.balances])
    return window_residuals(problem.balances, windows, fit.residual, problem.noise.deviation())


def _metrics(problem: Problem, fit: Fit, whitened: Array, name: str) -> ChannelMetrics:
    def joined(rows: Array) -> NDArray[Any]:
        own = [channel_values(problem.balances, rows, row) for row in LISTED[name].rows]
        return own[0] if len(own) == 1 else np.asarray(own[0] + 1j * own[1])

    measured, residual = joined(problem.measured), joined(fit.residual)
    predicted = measured - residual
    white = joined(whitened)
    mse = _square(residual)
    swing = float(np.linalg.norm(measured - measured.mean()))
    size = _square(measured) ** 0.5 + _square(predicted) ** 0.5
    sm, sp = float(np.std(measured)), float(np.std(predicted))
    bias = float(abs(measured.mean() - predicted.mean())) ** 2 / mse if mse else 0.0
    variance = (sm - sp) ** 2 / mse if mse else 0.0
    return ChannelMetrics(
        rms=channel_rms(problem.balances, fit.residual, name),
        noise_floor_rms=channel_rms(problem.balances, problem.noise.deviation(), name),
        fit_percent=100.0 * (1.0 - float(np.linalg.norm(residual)) / swing) if swing else 0.0,
        theil=mse**0.5 / size if size else 0.0,
        theil_bias=bias,
        theil_variance=variance,
        theil_covariance=max(1.0 - bias - variance, 0.0),
        chi2_per_n=_square(white) / len(LISTED[name].rows),
    )


def _square(values: NDArray[Any]) -> float:
    """Return the mean square of real or complex values."""
    return float(np.mean(np.abs(values) ** 2))
