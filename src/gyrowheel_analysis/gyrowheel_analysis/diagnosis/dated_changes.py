"""Changes with time within a recording: events, laws that look like events, and drifts that have a shape."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from gyrowheel_analysis.fitting.events import Kind

#: On what a quantity depends; `history` is that of speed and tilt, `offset` nothing: it is constant.
Variable = Literal["offset", "speed", "tilt", "direction", "rate", "temperature", "time", "history"]


@dataclass(frozen=True)
class DatedEvent:
    """A change in the middle of a recording.

    Attributes
    ----------
    recording : str
        The recording.
    time, time_error : float
        Its start, from the start of that recording, and the standard error [s]; 0 for a step that happened before it.
    end, end_error : float or None
        End of a burst or a trend, and the standard error [s]; None for a step.
    kind : str
        ``step``, ``trend`` or ``burst``.
    channel : str
        The changed quantity, one of `fitting.events.QUANTITIES`.
    size, standard_error : float
        Size of the change and its standard error [`unit`].
    unit : str
        Unit of the size.
    gain : float
        Increase of twice the log likelihood of the recordings.
    ties : tuple of str
        Other quantities whose change explains the recordings equally well.
    still_in : tuple of str
        Other recordings in which it is still there.
    """

    recording: str
    time: float
    time_error: float
    end: float | None
    end_error: float | None
    kind: Kind
    channel: str
    size: float
    standard_error: float
    unit: str
    gain: float
    ties: tuple[str, ...] = ()
    still_in: tuple[str, ...] = ()

    @property
    def before(self) -> bool:
        """Whether it happened before the recording."""
        return self.kind == "step" and self.time == 0.0


@dataclass(frozen=True)
class MissingLaw:
    """What looks like events and is a law of the motion, or an offset.

    Attributes
    ----------
    recording : str
        The recording.
    depends_on : str
        ``speed``, ``tilt``, ``direction``, ``rate`` (of the tilt), ``temperature``, ``time`` (since the start),
        ``history`` (of speed and tilt), or ``offset`` (constant).
    channels : tuple of str
        The quantities that follow it, of `fitting.events.QUANTITIES`.
    gain : float
        Increase of twice the log likelihood of the recording, less that by chance.
    """

    recording: str
    depends_on: Variable
    channels: tuple[str, ...]
    gain: float


@dataclass(frozen=True)
class DriftShape:
    """A drift that has a shape.

    Attributes
    ----------
    recording : str
        The recording.
    kind : str
        ``swing``; ``coil_temperature``, ``motor_temperature`` or ``air_temperature``, which it follows.
    channel : str
        The drifting quantity, one of `fitting.events.QUANTITIES`.
    size, standard_error : float
        Amplitude of the swing; change from the coldest to the warmest window, in `unit`.
    unit : str
        Unit of the size.
    time, time_error : float
        Period of the swing and the standard error [s]; 0 for a temperature.
    temperature_change : float
        From the coldest to the warmest window [K]; 0 for other shapes.
    gain : float
        Increase of twice the log likelihood of the recordings.
    also_in : tuple of str
        Recordings for validation in which it swings with about the same period.
    """

    recording: str
    kind: Kind
    channel: str
    size: float
    standard_error: float
    unit: str
    time: float
    time_error: float
    temperature_change: float
    gain: float
    also_in: tuple[str, ...] = ()
