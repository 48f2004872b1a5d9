"""Sentences for changes in the middle of a recording, and for drifts and what they follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from gyrowheel.show.quantities import decimal, with_error
from gyrowheel_core.quantities import listed

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.result import DatedEvent, DriftShape

#: Description of a change, by the channel of the event.
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
    "motor_constant": "a change of {} in torque and voltage constant of the motor",
    "encoder_zero": "a slip of {} of the encoder",
    "torque_after_tilt": "a torque of {} against it",
    "coil_voltage_x": "a shift in the reading of coil voltage x",
    "coil_voltage_y": "a shift in the reading of coil voltage y",
}
_DRIFTS = {
    "coil_voltage": "coil voltages",
    "motor_current": "motor current",
    "motor_voltage": "motor voltage",
}
_TEMPERATURES = {
    "coil_temperature": "temperature of the coils",
    "motor_temperature": "temperature of the motor's winding",
    "air_temperature": "temperature of the air",
}
_SHAPELESS = (
    "it is no step, trend, burst or swing, and follows neither a temperature nor the moves of the tilt"
)
#: Drifts above this multiple of the stated size are reported.
_TOLD = 1.5


def event_sentences(events: Sequence[DatedEvent], *, several: bool = False) -> list[str]:
    """Return changes with their times; simultaneous changes share a sentence.

    Parameters
    ----------
    events : sequence of DatedEvent
        The events.
    several : bool
        Whether there are several recordings, so that each must be named.
    """
    at_once: dict[tuple[str, str, float, float | None], list[DatedEvent]] = {}
    for event in events:
        at_once.setdefault((event.recording, event.kind, event.time, event.end), []).append(event)
    return [_sentence(own, several) for own in at_once.values()]


def event_sentence(event: DatedEvent, *, several: bool = False) -> str:
    """Return a change with its time, as `event_sentences` does."""
    return _sentence([event], several)


def _sentence(events: Sequence[DatedEvent], several: bool) -> str:
    event = events[0]
    sizes = [with_error(e.size, e.standard_error, e.unit, pure=False) for e in events]
    each = [_WHAT[e.channel].format(size) for e, size in zip(events, sizes, strict=True)]
    what = listed([part.rstrip(",") for part in each[:-1]] + each[-1:], "and")
    where = f" of {event.recording}" if several else ""
    begin = _time(event.time, event.time_error)
    if event.kind == "step" or event.end is None:
        return f"At {begin}{where} {what} appeared and stayed."
    end = _time(event.end, event.end_error or 0.0)
    if event.kind == "trend":
        return f"From {begin} to {end}{where} {what} grew, and stayed."
    were = "was" if len(events) == 1 else "were"
    return f"From {begin} to {end}{where} there {were} {what.rstrip(',')}."


def tie_of_event(event: DatedEvent) -> str:
    """Return the alternatives to an event; empty without alternatives."""
    if not event.ties:
        return ""
    names = [_WHAT[name].replace(" of {}", "").rstrip(",") for name in event.ties]
    begin = _time(event.time, event.time_error)
    return (
        f"what began at {begin} could also be {listed(names, 'or')}: these recordings do not tell them apart"
    )


def shape_sentence(shape: DriftShape, *, several: bool = False) -> str:
    """Return the shape of a drift; `several` as in `event_sentences`."""
    what = _WHAT[shape.channel].format(with_error(shape.size, shape.standard_error, shape.unit, pure=False))
    where = f" In {shape.recording}," if several else ""
    if shape.kind == "after_tilt":
        said = (
            f"after every move of the tilt {what} relaxes with a time constant of about {decimal(shape.time, 0)} s "
            "(size just after a move by the reference tilt)."
        )
    elif shape.kind == "swing":
        period = _time(shape.time, shape.time_error)
        said = f"{what.rstrip(',')} swings to and fro with a period of {period}."
    else:
        warmer = decimal(shape.temperature_change, 1)
        said = f"{what.rstrip(',')} follows the {_TEMPERATURES[shape.kind]}, which changed by {warmer} K."
    return f"{where} {said}".strip() if where else said[0].upper() + said[1:]


def drift_sentence(scales: Mapping[str, float], *, shaped: bool = False) -> str:
    """Return the drifts that are larger than stated; empty otherwise.

    Parameters
    ----------
    scales : mapping
        Sizes of the drifts over the stated ones, by reading.
    shaped : bool
        Whether events or shapes of drifts are reported too: the remainder has no shape.
    """
    raised = [
        f"that of the {_DRIFTS.get(name, name)} {decimal(scale, 1)} times"
        for name, scale in scales.items()
        if scale > _TOLD
    ]
    if not raised:
        return ""
    what = "What is left of the slow drift is" if shaped else "The slow drift is"
    return f"{what} larger than stated: {listed(raised, 'and')}; {_SHAPELESS}."


def _time(time: float, error: float) -> str:
    """Return a time with its standard error, as in 110.20(3) s."""
    places = 2 if error < 0.1 else 1 if error < 1.0 else 0
    digits = max(round(error * 10**places), 1)
    return f"{decimal(time, places)}({digits}) s"
