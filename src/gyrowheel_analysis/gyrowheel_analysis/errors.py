"""How large the error of a model is, as tables and as residuals of every window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance import Balance

Array = NDArray[np.float64]

#: The channels whose error is given, all in N m.
TORQUE_CHANNELS = ("tilt_x", "tilt_y", "spin")


@dataclass(frozen=True)
class ErrorRow:
    """Error of a model on some recordings.

    Attributes
    ----------
    rms : dict of str to float
        Root mean square of the residual by channel [N m]; every window counts by its duration.
    chi2_per_n : float
        Mean square of all residuals in units of their noise; about 1 for a complete model.
    """

    rms: dict[str, float]
    chi2_per_n: float

    def to_json(self) -> dict[str, Any]:
        """Return the row as a JSON object."""
        return {"rms": dict(self.rms), "chi2_per_n": self.chi2_per_n}


@dataclass(frozen=True)
class ErrorTable:
    """How the error falls: before and after a change of the model, on fitted and on unused recordings.

    The noise floors are what a complete model would leave: noise, drift and the accuracy of the balance.
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
    """

    name: str
    role: str
    time: Array
    spin_rate: Array
    tilt: NDArray[np.complex128]
    channels: dict[str, tuple[Array, Array, Array]]


def error_row(balances: Sequence[Balance], rows: Array, white: Array) -> ErrorRow:
    """Return the error row of residual `rows` [units of the rows] whose whitened values are `white`."""
    return ErrorRow(_rms(balances, rows), float(white @ white) / max(len(white), 1))


def floor_row(balances: Sequence[Balance], deviation: Array) -> ErrorRow:
    """Return the noise floor belonging to the standard deviations of the rows."""
    return ErrorRow(_rms(balances, deviation), 1.0)


def _rms(balances: Sequence[Balance], rows: Array) -> dict[str, float]:
    return {name: channel_rms(balances, rows, name) for name in TORQUE_CHANNELS}


def channel_rms(balances: Sequence[Balance], rows: Array, name: str) -> float:
    """Return the root mean square of one channel over time: every window counts by its duration."""
    values = np.concatenate(channel_parts(balances, rows, name))
    duration = np.concatenate([balance.windows.duration for balance in balances])
    return float(np.sqrt(np.average(values**2, weights=duration))) if values.size else 0.0


def channel_parts(balances: Sequence[Balance], rows: Array, name: str) -> list[Array]:
    """Return the rows of one channel, an array a recording."""
    parts, at = [], 0
    for balance in balances:
        own = rows[at : at + len(balance)]
        parts.append(own[balance.channel(name)])
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
    channels = {
        name: [channel_parts(balances, rows, name) for rows in (before, after, deviation)]
        for name in TORQUE_CHANNELS
    }
    return [
        Residuals(
            name=recording,
            role=role,
            time=balance.windows.middle,
            spin_rate=balance.windows.mean_spin,
            tilt=balance.windows.mean_tilt,
            channels={
                name: (parts[0][index], parts[1][index], parts[2][index]) for name, parts in channels.items()
            },
        )
        for index, (balance, recording) in enumerate(zip(balances, names, strict=True))
    ]
