"""The error of a model on fitted and validation recordings, as a table and as residuals of every window."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.channels import FURTHER, LISTED, TORQUES
from gyrowheel_analysis.criteria import NOISE_REACHED
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.preparation import Prepared

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ChannelError:
    """Error of one channel.

    Attributes
    ----------
    rms : float
        Root mean square of the residual, of an amplitude its modulus [unit of the channel].
    chi2_per_n : float
        Mean square of the residual in units of its noise.
    """

    rms: float
    chi2_per_n: float


@dataclass(frozen=True)
class ErrorRow:
    """Error of a model on some recordings.

    Attributes
    ----------
    rms : dict of str to float
        Root mean square of the residual of the averaged torques by channel [N m]; every window counts by its duration.
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

        The whitened residual decides where it is known: readings that drift together may lie off by chance.
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
        On the fitted recordings: without and with what was added. Without it, the bench parameters stay within their
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
        result: dict[str, Any] = {"unit": self.unit}
        for name in (
            "before",
            "after",
            "validation_before",
            "validation_after",
            "noise_floor",
            "validation_noise_floor",
        ):
            row = getattr(self, name)
            result[name] = None if row is None else row.to_json()
        return result


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
        The same of those of `channels.FURTHER` that there are; amplitudes are complex, their noise is that of one part.
    """

    name: str
    role: str
    time: Array
    spin_rate: Array
    tilt: NDArray[np.complex128]
    channels: dict[str, tuple[Array, Array, Array]]
    further: dict[str, tuple[Any, Any, Any]] = field(default_factory=dict)


def error_row(balances: Sequence[Balance], rows: Array, white: Array) -> ErrorRow:
    """Return the error row of residual `rows` [units of the rows] whose whitened values are `white`."""
    channels = {
        name: ChannelError(
            channel_rms(balances, rows, name),
            float(
                np.mean(
                    np.concatenate([channel_values(balances, white, row) for row in LISTED[name].rows]) ** 2
                )
            )
            if len(white)
            else 0.0,
        )
        for name in channels_of(balances)
    }
    return ErrorRow(_torques(channels), float(white @ white) / max(len(white), 1), channels)


def floor_row(balances: Sequence[Balance], deviation: Array) -> ErrorRow:
    """Return the noise floor belonging to the standard deviations of the rows."""
    channels = {
        name: ChannelError(channel_rms(balances, deviation, name), 1.0) for name in channels_of(balances)
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


def channel_rms(balances: Sequence[Balance], rows: Array, name: str) -> float:
    """Return the root mean square of one channel over time: every window counts by its duration."""
    squares = sum(channel_values(balances, rows, row) ** 2 for row in LISTED[name].rows)
    duration = np.concatenate([balance.windows.duration for balance in balances])
    return float(np.sqrt(np.average(squares, weights=duration))) if duration.size else 0.0


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
    before: Array,
    after: Array,
    deviation: Array,
) -> list[Residuals]:
    """Return the residuals of every recording."""
    parts = {
        name: [_joined(balances, rows, name) for rows in (before, after)]
        + [_noise(balances, deviation, name)]
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
    """The error table of two fits, and the residuals behind it."""

    table: ErrorTable
    residuals: list[Residuals]


def errors_of(before: Fit, after: Fit, prepared: Prepared) -> Errors:
    """Return the errors of two fits on the fitted and on the validation recordings.

    On validation recordings nothing is fitted: parameters and coefficients are those of the fits.
    """
    problem = prepared.problem
    white, deviation = problem.noise.whiten, problem.noise.deviation()
    rows = residuals(problem.balances, prepared.names, "fit", before.residual, after.residual, deviation)
    parts: list[ErrorRow | None] = [None, None, None]
    if (validation := prepared.validation) is not None:
        other = validation.problem.with_scales(problem.noise.scales)
        left = [other.measured - other.predict(fit) for fit in (before, after)]
        floor = other.noise.deviation()
        parts = [error_row(other.balances, r, other.noise.whiten(r)) for r in left]
        parts.append(floor_row(other.balances, floor))
        rows += residuals(other.balances, validation.names, "validation", left[0], left[1], floor)
    table = ErrorTable(
        before=error_row(problem.balances, before.residual, white(before.residual)),
        after=error_row(problem.balances, after.residual, white(after.residual)),
        noise_floor=floor_row(problem.balances, deviation),
        validation_before=parts[0],
        validation_after=parts[1],
        validation_noise_floor=parts[2],
    )
    return Errors(table, rows)
