"""Result of the proof: whether a fit predicts data that were not fitted, channel by channel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Left = Literal["", "recording", "speed", "azimuth", "time"]
Reason = Literal[
    "predicted",
    "unfixed",
    "event",
    "differs",
    "resembles",
    "misfit",
    "channel",
    "dependence",
    "no_gain",
    "not_tried",
    "map",
]


@dataclass(frozen=True)
class ChannelCheck:
    """Test of one channel: its mean squares in units of its noise, and what chance allows.

    Attributes
    ----------
    channel : str
        Which one.
    fitted, fitted_allowed : float
        χ²/N of the fitted rows, and its limit.
    unseen, unseen_allowed : float
        χ²/N of the rows that were predicted, by noise and uncertainty of the prediction, and its limit.
    """

    channel: str
    fitted: float
    fitted_allowed: float
    unseen: float
    unseen_allowed: float

    @property
    def floors(self) -> float:
        """Size of the residual where the channel is over its limit, by the larger of both [noise floors]; else 0."""
        return math.sqrt(max(self.fitted, self.unseen)) if self.over > 1.0 else 0.0

    @property
    def over(self) -> float:
        """The larger of both over its limit; up to 1 the channel passes."""
        return max(self.fitted / self.fitted_allowed, self.unseen / self.unseen_allowed)


@dataclass(frozen=True)
class Proof:
    """Whether a fit predicts data that were not fitted.

    Attributes
    ----------
    recording : str
        Predicted recordings: those for validation, or those of which parts were left out.
    proven : bool or None
        None where no prediction could be made, or none tests the findings.
    reason : str
        ``predicted``: within noise and the uncertainty of the prediction. ``unfixed``: within it only because the fit
        does not determine `causes`. ``event``: within it except for an event there. ``differs``: the unknown in
        `causes` would need another value there. ``resembles``: fit and prediction together look like the term in
        `causes`. ``misfit``: none of these. ``channel``: all rows together are predicted, but those of `channel` are
        not, or do not fit. ``dependence``: what is left of `channel` depends on the variable in `causes`.
        ``no_gain``: the prediction without the findings is as good; `proven` is None where the findings
        predict a difference that is smaller than chance.
        ``not_tried``: no part could be left out. ``map``: a map was fitted to all recordings.
    left_out : str
        Kind of the parts left out in turn: ``recording``, ``speed``, ``azimuth``, ``time``; empty for a validation.
    parts : int
        Number of parts.
    causes : tuple of str
        See `reason`.
    value, fitted : float or None
        For ``differs``: the value of the unknown that the prediction needs, and that of the fit [`unit`].
    unit : str
        Their unit.
    chi2_per_n, allowed : float
        Of the prediction, and its limit by noise and uncertainty of the prediction.
    channel : str
        Channel in which the error falls most, or is largest where nothing was found.
    before, after, noise : float
        Its error without and with the findings, and its noise [SI]; where parts were left out, the noise with the
        uncertainty of their prediction.
    speed : float
        For ``channel``: spin rate at which the misfit is largest [rad/s].
    channels : tuple of ChannelCheck
        The test of every channel.
    smallest : float
        Smallest misfit that the test of every channel would have shown in four of five cases [noise floors].
    stayed : tuple of float
        Times of changes in the fitted recordings that are taken to be still there [s].
    swinging : tuple of float
        Periods of what swings in the fitted recordings and is taken to swing here, too [s].
    otherwise : float
        χ²/N of the prediction if they were not.
    """

    recording: str
    proven: bool | None
    reason: Reason
    left_out: Left = ""
    parts: int = 0
    causes: tuple[str, ...] = ()
    value: float | None = None
    fitted: float | None = None
    unit: str = ""
    chi2_per_n: float = 0.0
    allowed: float = 0.0
    channel: str = ""
    before: float = 0.0
    after: float = 0.0
    noise: float = 0.0
    speed: float = 0.0
    channels: tuple[ChannelCheck, ...] = ()
    smallest: float = 0.0
    stayed: tuple[float, ...] = ()
    swinging: tuple[float, ...] = ()
    otherwise: float = 0.0
