"""Residuals of a model, window by window and channel by channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.channels import CHANNELS, Channel
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_analysis.residuals.error_table import channel_values

Array = NDArray[np.float64]


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
        Standard deviation of its noise, of one of two rows.
    load : ndarray (n,) or None
        Prediction of the model [unit of the kind]; None where it is not known.
    """

    kind: Channel
    values: NDArray[Any]
    sigma: Array
    load: NDArray[Any] | None = None

    def at(self, mask: NDArray[np.bool_]) -> Part:
        """Return the part in some of the windows."""
        return Part(
            self.kind, self.values[mask], self.sigma[mask], None if self.load is None else self.load[mask]
        )

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.values) * len(self.kind.rows)

    @property
    def weight(self) -> Array:
        """Inverse variance of the noise of each value."""
        return 1.0 / self.sigma**2

    @property
    def mean(self) -> complex | float:
        """Mean residual, weighted with the noise; complex for a kind of two rows."""
        value = np.sum(self.weight * self.values) / np.sum(self.weight)
        return complex(value) if np.iscomplexobj(self.values) else float(value)

    @property
    def squares(self) -> Array:
        """Square of the residual over that of its noise, for all rows together."""
        return np.asarray(np.abs(self.values) ** 2 / self.sigma**2)


@dataclass(frozen=True)
class WindowResiduals:
    """The residuals of all windows of some recordings.

    Attributes
    ----------
    windows : Windows
        The windows.
    recording : ndarray (n,)
        To which recording each belongs, from 0.
    parts : dict of str to Part
        By the names of `CHANNELS`; without what the recordings were not reduced to.
    """

    windows: Windows
    recording: NDArray[np.int64]
    parts: Mapping[str, Part]

    @property
    def chi2(self) -> float:
        """Sum of the squares of all residuals over their noise."""
        return sum(float(part.squares.sum()) for part in self.parts.values())


def window_residuals(
    balances: Sequence[Balance], windows: Windows, rows: Array, deviation: Array
) -> WindowResiduals:
    """Put the residual rows of all recordings together, window by window.

    Parameters
    ----------
    balances : sequence of Balance
        One a recording.
    windows : Windows
        The windows of all of them.
    rows, deviation : ndarray (N,)
        Residual rows and the standard deviation of their noise.
    """
    parts = {}
    for name, kind in CHANNELS.items():
        if not all(row in balance.rows for row in kind.rows for balance in balances):
            continue
        own: list[Any] = [channel_values(balances, rows, row) for row in kind.rows]
        noise = [channel_values(balances, deviation, row) for row in kind.rows]
        values = own[0] + 1j * own[1] if len(own) == 2 else own[0]
        load = None
        if name == "tilt" and np.any(windows.coil_voltage):
            # not what was measured, which has the residual in it
            x, y = (np.concatenate([b.measured[b.row(row)] for b in balances]) for row in kind.rows)
            load = x + 1j * y - values
        parts[name] = Part(kind, values, np.sqrt(np.mean(np.square(noise), axis=0)), load)
    recording = np.repeat(np.arange(len(balances)), [len(balance.windows) for balance in balances])
    return WindowResiduals(windows, recording, parts)
