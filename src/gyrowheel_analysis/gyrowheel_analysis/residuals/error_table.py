"""The error of a model on fitted and validation recordings, as a table and as residuals of every window."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.channels import CHANNELS, FURTHER, LISTED, TORQUES, Channel
from gyrowheel_analysis.criteria import NOISE_REACHED, NOISY_WINDOW
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.noise import Noise
from gyrowheel_analysis.fitting.preparation import Prepared
from gyrowheel_analysis.reduction.windows import Windows

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ChannelError:
    """Error of one channel.

    Attributes
    ----------
    rms : float
        Root mean square of the residual, of an amplitude its modulus, every window weighted with the inverse variance
        of its noise [unit of the channel].
    chi2_per_n : float
        Mean square of the whitened residual: in units of its noise, less the slow drift that windows share. Where there
        is no drift, this is the square of `rms` over that of the noise floor.
    """

    rms: float
    chi2_per_n: float


@dataclass(frozen=True)
class ErrorRow:
    """Error of a model on some recordings.

    Attributes
    ----------
    rms : dict of str to float
        `ChannelError.rms` of the averaged torques by channel [N m].
    chi2_per_n : float
        Mean square of all residuals in units of their noise; about 1 for a complete model.
    channels : dict of str to ChannelError
        All channels that the recordings have, those of `rms` and of `channels.FURTHER`.
    """

    rms: dict[str, float]
    chi2_per_n: float
    channels: dict[str, ChannelError] = field(default_factory=dict)

    def __contains__(self, channel: str) -> bool:
        """Whether the row has an error of a channel."""
        return channel in self.rms or channel in self.channels

    def rms_of(self, channel: str) -> float:
        """Return the root mean square of a channel's residual [unit of the channel]."""
        return self.rms[channel] if channel in self.rms else self.channels[channel].rms

    def is_noise(self, channel: str, floor: ErrorRow) -> bool:
        """Whether a channel's error is down at its noise floor, within `criteria.NOISE_REACHED`.

        The whitened residual decides where it is known: readings that drift together may be off by chance.
        """
        own = self.channels.get(channel)
        if own is not None:
            return math.sqrt(own.chi2_per_n) <= NOISE_REACHED
        return self.rms_of(channel) / (floor.rms_of(channel) or 1.0) <= NOISE_REACHED

    @classmethod
    def from_json(cls, row: Mapping[str, Any]) -> ErrorRow:
        """Return the row of a JSON object, as `to_json` makes it."""
        channels = {name: ChannelError(e["rms"], e["chi2_per_n"]) for name, e in row["channels"].items()}
        return cls(dict(row["rms"]), row["chi2_per_n"], channels)

    def to_json(self) -> dict[str, Any]:
        """Return the row as a JSON object."""
        return {
            "rms": dict(self.rms),
            "chi2_per_n": self.chi2_per_n,
            "channels": {
                name: {"rms": e.rms, "unit": LISTED[name].unit, "chi2_per_n": e.chi2_per_n}
                for name, e in self.channels.items()
            },
        }


@dataclass(frozen=True)
class ErrorTable:
    """The error before and after an addition.

    Attributes
    ----------
    before, after : ErrorRow
        On the fitted recordings: without and with the addition. Without it, the bench parameters stay within their
        stated uncertainties.
    validation_before, validation_after : ErrorRow or None
        The same on recordings that were not used to fit.
    noise_floor, validation_noise_floor : ErrorRow
        Error of a complete model: noise, drift and the accuracy of the balance.
    """

    before: ErrorRow
    after: ErrorRow
    noise_floor: ErrorRow
    validation_before: ErrorRow | None = None
    validation_after: ErrorRow | None = None
    validation_noise_floor: ErrorRow | None = None
    unit: str = "N·m"

    def to_json(self) -> dict[str, Any]:
        """Return the table as a JSON object."""
        names = [f"{part}{name}" for part in ("", "validation_") for name in ("before", "after")]
        rows = {name: getattr(self, name) for name in (*names, "noise_floor", "validation_noise_floor")}
        return {"unit": self.unit} | {name: row and row.to_json() for name, row in rows.items()}


@dataclass(frozen=True)
class Residuals:
    """Residuals of one recording, window by window.

    Attributes
    ----------
    name, role : str
        Recording; ``fit`` or ``validation``.
    time, spin_rate : ndarray (n,)
        Middle of the window [s]; mean spin rate [rad/s].
    tilt : complex ndarray (n,)
        Mean tilt angles phi_x + i phi_y [rad].
    channels : dict of str to tuple of ndarray
        Before, after, and standard deviation of the noise, of every torque channel [N m].
    further : dict of str to tuple of ndarray
        The same of the `channels.FURTHER` present; amplitudes are complex, their noise is that of one part.
    whitened : dict of str to tuple of ndarray
        Before and after of all these, divided by the square root of the covariance of their noise, slow drift included.
    """

    name: str
    role: str
    time: Array
    spin_rate: Array
    tilt: NDArray[np.complex128]
    channels: dict[str, tuple[Array, Array, Array]]
    further: dict[str, tuple[Any, Any, Any]] = field(default_factory=dict)
    whitened: dict[str, tuple[Any, Any]] = field(default_factory=dict)


def error_row(balances: Sequence[Balance], rows: Array, white: Array, deviation: Array) -> ErrorRow:
    """Return the error row of residual `rows` with their whitened values and the standard deviations of their noise."""
    white_of = {
        n: [channel_values(balances, white, row) for row in LISTED[n].rows] for n in channels_of(balances)
    }
    channels = {
        name: ChannelError(
            channel_rms(balances, rows, deviation, name),
            float(np.mean(np.concatenate(parts) ** 2)) if len(white) else 0.0,
        )
        for name, parts in white_of.items()
    }
    return ErrorRow(_torques(channels), float(white @ white) / max(len(white), 1), channels)


def floor_row(balances: Sequence[Balance], deviation: Array) -> ErrorRow:
    """Return the noise floor belonging to the standard deviations of the rows."""
    channels = {
        name: ChannelError(channel_rms(balances, deviation, deviation, name), 1.0)
        for name in channels_of(balances)
    }
    return ErrorRow(_torques(channels), 1.0, channels)


def _torques(channels: dict[str, ChannelError]) -> dict[str, float]:
    return {name: channels[name].rms for name in TORQUES if name in channels}


def channels_of(balances: Sequence[Balance]) -> list[str]:
    """Return the channels that all recordings have: some are reduced to averages alone."""
    return [
        name
        for name, channel in LISTED.items()
        if all(row in balance.rows for row in channel.rows for balance in balances)
    ]


def channel_rms(balances: Sequence[Balance], rows: Array, deviation: Array, name: str) -> float:
    """Return the weighted RMS of one channel, see `weighted_rms`."""
    own, noise = (
        np.array([channel_values(balances, values, row) for row in LISTED[name].rows])
        for values in (rows, deviation)
    )
    return weighted_rms(own, noise)


def weighted_rms(rows: NDArray[Any], deviation: Array) -> float:
    """Return the root mean square of values, every window weighted with the inverse variance of its noise.

    `rows` and the standard deviations of their noise are (n,), or (rows, n) for the parts of an amplitude, whose
    modulus counts. That of the noise itself is the noise floor: the square of their ratio is the mean square of the
    values in units of their noise.
    """
    weight = 1.0 / np.asarray(deviation) ** 2
    if not weight.size:
        return 0.0
    parts = 1 if weight.ndim == 1 else len(weight)
    return float(np.sqrt(parts * np.sum(weight * np.abs(rows) ** 2) / np.sum(weight)))


def noisy(sigma: Array) -> NDArray[np.bool_]:
    """Return a mask of the windows whose noise is an outlier among that of all, by `criteria.NOISY_WINDOW`."""
    return np.asarray(sigma > NOISY_WINDOW * np.median(sigma)) if len(sigma) else np.zeros(0, dtype=bool)


def channel_values(balances: Sequence[Balance], rows: Array, row: str) -> Array:
    """Return the rows of one channel of `Balance`, all recordings together."""
    return np.concatenate(channel_parts(balances, rows, row))


def channel_parts(balances: Sequence[Balance], rows: Array, row: str) -> list[Array]:
    """Return the rows of one channel of `Balance`, an array a recording; of length 0 for one that lacks it."""
    parts, at = [], 0
    for balance in balances:
        own = rows[at : at + len(balance)]
        parts.append(own[balance.row(row)] if row in balance.rows else own[:0])
        at += len(balance)
    return parts


def residuals(
    balances: Sequence[Balance],
    names: Sequence[str],
    role: str,
    rows: Sequence[Array],
    noises: Sequence[Noise],
) -> list[Residuals]:
    """Return the residuals of every recording: `rows` before and after, and the noise of both."""
    deviation = noises[1].deviation()
    white = [noise.whiten(own) for noise, own in zip(noises, rows, strict=True)]
    parts = {
        name: [
            *(_joined(balances, own, name) for own in rows),
            _noise(balances, deviation, name),
            *(_joined(balances, own, name) for own in white),
        ]
        for name in channels_of(balances)
    }

    def own(index: int, names: Sequence[str]) -> dict[str, tuple[Any, Any, Any]]:
        return {n: (parts[n][0][index], parts[n][1][index], parts[n][2][index]) for n in names if n in parts}

    return [
        Residuals(
            name=recording,
            role=role,
            time=balance.windows.middle,
            spin_rate=balance.windows.mean_spin,
            tilt=balance.windows.mean_tilt,
            channels=own(index, TORQUES),
            further=own(index, FURTHER),
            whitened={name: (own[3][index], own[4][index]) for name, own in parts.items()},
        )
        for index, (balance, recording) in enumerate(zip(balances, names, strict=True))
    ]


def _joined(balances: Sequence[Balance], rows: Array, name: str) -> list[Any]:
    """Return a channel, an array a recording; real and imaginary part put together."""
    parts: list[list[Any]] = [list(channel_parts(balances, rows, row)) for row in LISTED[name].rows]
    return parts[0] if len(parts) == 1 else [a + 1j * b for a, b in zip(*parts, strict=True)]


def _noise(balances: Sequence[Balance], deviation: Array, name: str) -> list[Any]:
    """Return the standard deviation of one part of a channel, an array a recording."""
    own = [channel_parts(balances, deviation, row) for row in LISTED[name].rows]
    return [np.sqrt(np.mean(np.square(parts), axis=0)) for parts in zip(*own, strict=True)]


@dataclass(frozen=True)
class Errors:
    """The error table of two fits, and its residuals."""

    table: ErrorTable
    residuals: list[Residuals]


def errors_of(before: Fit, after: Fit, prepared: Prepared, earlier: Prepared | None = None) -> Errors:
    """Return the errors of two fits on the fitted and on the validation recordings.

    `earlier` has the recordings of the first fit, if it has other events or another model. On validation recordings
    nothing is fitted: parameters and coefficients are those of the fits.
    """
    problem, first = prepared.problem, earlier or prepared
    noises, deviation = (first.problem.noise, problem.noise), problem.noise.deviation()
    fitted = (before.residual, after.residual)
    rows = residuals(problem.balances, prepared.names, "fit", fitted, noises)
    white = [noise.whiten(own) for noise, own in zip(noises, fitted, strict=True)]
    parts: list[ErrorRow | None] = [None, None, None]
    if (validation := prepared.validation) is not None:
        other = validation.problem.with_scales(problem.noise.scales)
        left = [
            other.measured - own.validation.problem.predict(fit)
            for fit, own in ((before, first), (after, prepared))
            if own.validation is not None
        ]
        floor = other.noise.deviation()
        parts = [error_row(other.balances, r, other.noise.whiten(r), floor) for r in left]
        parts.append(floor_row(other.balances, floor))
        rows += residuals(other.balances, validation.names, "validation", left, (other.noise, other.noise))
    table = ErrorTable(
        before=error_row(problem.balances, before.residual, white[0], deviation),
        after=error_row(problem.balances, after.residual, white[1], deviation),
        noise_floor=floor_row(problem.balances, deviation),
        validation_before=parts[0],
        validation_after=parts[1],
        validation_noise_floor=parts[2],
    )
    return Errors(table, rows)


@dataclass(frozen=True)
class Part:
    """The residual of one channel in every window.

    Attributes
    ----------
    kind : Channel
        The channel.
    values : ndarray (n,)
        Residual, complex for a kind of two rows: the averages in case axes x + i y, amplitudes in axes that turn.
    sigma : ndarray (n,)
        Standard deviation of the noise of one row.
    load : ndarray (n,) or None
        Prediction of the model [unit of the kind]; None where unknown.
    chi2 : ndarray (n,)
        The part of chi-squared that belongs to each window, see `Noise.shares`.
    measured : ndarray (n,) or None
        Measured value [unit of the kind]; the prediction is this less `values`. None where it was not kept.
    """

    kind: Channel
    values: NDArray[Any]
    sigma: Array
    chi2: Array
    load: NDArray[Any] | None = None
    measured: NDArray[Any] | None = None

    def at(self, mask: NDArray[np.bool_]) -> Part:
        """Return the part in some of the windows."""
        load, measured = (None if own is None else own[mask] for own in (self.load, self.measured))
        return Part(self.kind, self.values[mask], self.sigma[mask], self.chi2[mask], load, measured)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.values) * len(self.kind.rows)

    @property
    def weight(self) -> Array:
        """Inverse variance of the noise of each value."""
        return 1.0 / self.sigma**2

    @property
    def noisy(self) -> NDArray[np.bool_]:
        """The windows whose noise is an outlier, see `noisy`."""
        return noisy(self.sigma)

    @property
    def mean(self) -> complex | float:
        """Mean residual, weighted with the noise; complex for a kind of two rows."""
        value = np.sum(self.weight * self.values) / np.sum(self.weight)
        return complex(value) if np.iscomplexobj(self.values) else float(value)

    @property
    def squares(self) -> Array:
        """Square of the residual over that of its noise, drift and all, for all rows together."""
        return np.asarray(np.abs(self.values) ** 2 / self.sigma**2)


@dataclass(frozen=True)
class WindowResiduals:
    """The residuals of all windows of some recordings.

    Attributes
    ----------
    windows : Windows
        The windows.
    recording : ndarray (n,)
        Number of the recording of each, from 0.
    parts : dict of str to Part
        By the names of `CHANNELS`; without channels that a recording lacks.
    """

    windows: Windows
    recording: NDArray[np.int64]
    parts: Mapping[str, Part]

    @property
    def chi2(self) -> float:
        """Chi-squared of all residuals."""
        return sum(float(part.chi2.sum()) for part in self.parts.values())


def window_residuals(
    balances: Sequence[Balance], windows: Windows, rows: Array, noise: Noise
) -> WindowResiduals:
    """Put the residual rows (N,) of all recordings, with their noise, together by window."""
    parts = {}
    deviation, shares = noise.deviation(), noise.shares(rows)
    for name, kind in CHANNELS.items():
        if not all(row in balance.rows for row in kind.rows for balance in balances):
            continue
        own: list[Any] = [channel_values(balances, rows, row) for row in kind.rows]
        sigma = [channel_values(balances, deviation, row) for row in kind.rows]
        chi2 = sum(channel_values(balances, shares, row) for row in kind.rows)
        values = own[0] + 1j * own[1] if len(own) == 2 else own[0]
        rows_of = [np.concatenate([b.measured[b.row(row)] for b in balances]) for row in kind.rows]
        measured = rows_of[0] + 1j * rows_of[1] if len(rows_of) == 2 else rows_of[0]
        # the prediction: the measured rows contain the residual
        load = measured - values if name == "tilt" and np.any(windows.coil_voltage) else None
        noise_of = np.sqrt(np.mean(np.square(sigma), axis=0))
        parts[name] = Part(kind, values, noise_of, np.asarray(chi2), load, measured)
    recording = np.repeat(np.arange(len(balances)), [len(balance.windows) for balance in balances])
    return WindowResiduals(windows, recording, parts)
