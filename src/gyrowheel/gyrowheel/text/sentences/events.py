"""What happened in the middle of a recording, and what its drifts are, in sentences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from gyrowheel.text.quantities import decimal, with_error
from gyrowheel_core.quantities import listed

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.events import DatedEvent

#: What changed, by the channel of an event.
_WHAT = {
    "torque_x": "a torque of {} about case x",
    "torque_y": "a torque of {} about case y",
    "spin_torque": "a torque of {} on the spin",
    "motor_current": "a shift of {} in the reading of the motor current",
    "motor_voltage": "a shift of {} in the reading of the motor voltage",
    "spin_torque_by_speed": "a torque of {} on the spin, in proportion to the speed (size at the reference speed),",
    "torque_along_tilt": "a torque of {} along the tilt, in proportion to it (size at the reference tilt),",
    "torque_across_tilt": (
        "a torque of {} across the tilt, in proportion to tilt and speed (size at the reference tilt and speed),"
    ),
    "coil_gain": "a change of {} in the torque per volt of the coils",
    "tilt_reading_x": "a shift of {} in the reading of tilt x",
    "tilt_reading_y": "a shift of {} in the reading of tilt y",
    "winding_resistance": "a change of {} in the resistance of the motor's winding",
    "coil_voltage_x": "a shift in the reading of coil voltage x",
    "coil_voltage_y": "a shift in the reading of coil voltage y",
}
_DRIFTS = {
    "coil_voltage": "coil voltages",
    "motor_current": "motor current",
    "motor_voltage": "motor voltage",
}
#: Size of a drift over the stated one from which on it is told.
_TOLD = 1.5


def event_sentence(event: DatedEvent, *, several: bool = False) -> str:
    """Return what happened, and when.

    Parameters
    ----------
    event : DatedEvent
        The event.
    several : bool
        Whether there are several recordings, so that its own must be named.
    """
    what = _WHAT[event.channel].format(with_error(event.size, event.standard_error, event.unit, pure=False))
    where = f" of {event.recording}" if several else ""
    begin = _time(event.time, event.time_error)
    if event.kind == "step" or event.end is None:
        return f"At {begin}{where} {what} appeared and stayed."
    end = _time(event.end, event.end_error or 0.0)
    if event.kind == "trend":
        return f"From {begin} to {end}{where} {what} grew, and stayed."
    return f"From {begin} to {end}{where} there was {what.rstrip(',')}."


def tie_of_event(event: DatedEvent) -> str:
    """Return what else could have changed; empty where nothing else could."""
    if not event.ties:
        return ""
    names = [_WHAT[name].replace(" of {}", "").rstrip(",") for name in event.ties]
    begin = _time(event.time, event.time_error)
    return (
        f"what began at {begin} could also be {listed(names, 'or')}: these recordings do not tell them apart"
    )


def drift_sentence(scales: Mapping[str, float]) -> str:
    """Return which drifts are larger than stated; empty where none is."""
    raised = [
        f"that of the {_DRIFTS.get(name, name)} {decimal(scale, 1)} times"
        for name, scale in scales.items()
        if scale > _TOLD
    ]
    return f"The slow drift is larger than stated: {listed(raised, 'and')}." if raised else ""


def _time(time: float, error: float) -> str:
    """Return a time with its standard error, as in 110.20(3) s."""
    places = 2 if error < 0.1 else 1 if error < 1.0 else 0
    digits = max(round(error * 10**places), 1)
    return f"{decimal(time, places)}({digits}) s"
