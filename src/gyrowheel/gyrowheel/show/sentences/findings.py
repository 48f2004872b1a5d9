"""Findings in the readings: deviations of the instruments, changes in the middle of a recording, and drifts."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from gyrowheel_core.quantities import decimal, listed, pair, quantity, short, with_error

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.dated_changes import DatedEvent, DriftShape, MissingLaw
    from gyrowheel_analysis.diagnosis.findings import InstrumentFinding
    from gyrowheel_analysis.reduction.instrument_readings import ReadingFinding

#: Readings in a sentence, by channel.
READINGS = {
    "tilt": "tilt",
    "spin_angle": "angle of the shaft",
    "spin_rate": "spin rate",
    "coil_voltage": "coil voltage",
    "motor_voltage": "motor voltage",
    "motor_current": "motor current",
}
_PARTS = {
    "encoder_once_x": "once a turn, cosine part",
    "encoder_once_y": "once a turn, sine part",
    "encoder_twice_x": "twice a turn, cosine part",
    "encoder_twice_y": "twice a turn, sine part",
}
_NAMES = READINGS | {"temperature": "temperature reading", "pressure": "air pressure"}
_REMARKS = {
    "": "",
    "sampled": "; the angle of the shaft follows: the samples are taken when the stamps say",
    "stamped": "; the angle of the shaft does not follow: the samples are even, and the scatter is taken out",
    "hidden": "; the stamps do not show it, the noise of the angle does, which grows with the speed",
    "stamps_off": "; the reading of the speed goes with the count of the samples, against the stamps",
    "sampling_off": "; the reading of the speed goes with the stamps: it may be the sampling that is off",
}
_MICRO = 1.0e-6
_EXACT = 1.0e-3  # part of a value below which its error is not shown
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
    "coil_gain_x": "a change of {} in the torque per volt of coil x",
    "coil_gain_y": "a change of {} in the torque per volt of coil y",
    "tilt_reading_x": "a shift of {} in the reading of tilt x",
    "tilt_reading_y": "a shift of {} in the reading of tilt y",
    "winding_resistance": "a change of {} in the resistance of the motor's winding",
    "motor_constant": "a change of {} in torque and voltage constant of the motor",
    "encoder_zero": "a slip of {} of the encoder",
    "torque_after_tilt": "a torque of {} against the tilt",
    "coil_voltage_x": "a shift of {} in the reading of coil voltage x",
    "coil_voltage_y": "a shift of {} in the reading of coil voltage y",
    "attitude": "a turning of the rig, whose attitude is not recorded",
}
_DRIFTS = {
    "coil_voltage": "coil voltages",
    "motor_current": "motor current",
    "motor_voltage": "motor voltage",
}
_SIZED = re.compile(r" of \{\}| \(size[^)]*\)")
_MOTION = {
    "speed": "speed",
    "tilt": "tilt",
    "direction": "direction of the tilt",
    "rate": "rate of the tilt",
    "temperature": "temperature of coils, motor or air",
    "time": "time since the start",
    "history": "earlier speeds and tilts",
}
#: Laws of these may look like drifts, too.
_SLOW = ("temperature", "time", "history")
_TEMPERATURES = {
    "coil_temperature": "temperature of the coils",
    "motor_temperature": "temperature of the motor's winding",
    "air_temperature": "temperature of the air",
}
_SHAPELESS = "it is no step, trend, burst or swing, and follows no temperature"
#: Drifts above this multiple of the stated size are reported.
_TOLD = 1.5


def instrument_sentence(found: InstrumentFinding) -> str:
    """Return the deviation of an instrument, for example a voltage whose reading is late."""
    reading = READINGS.get(found.channel, found.channel)
    off = with_error(abs(found.deviation), found.standard_error, found.unit)
    now = with_error(found.value, found.standard_error, found.unit)
    if found.quantity == "delay":
        late = "later" if found.deviation > 0.0 else "earlier"
        return f"The reading of the {reading} is {off} {late} than stated."
    if found.quantity == "filter_time":
        if found.stated == 0.0:
            return f"The {reading} passes a filter of {now} that the bench file does not state."
        return f"The filter of the {reading} has {now}, not {quantity(found.stated, found.unit)} as stated."
    if found.quantity == "encoder_zero":
        where = "ahead of" if found.deviation > 0.0 else "behind"
        return f"The angle reading is {off} {where} the true angle, beyond the stated zero error."
    if found.quantity in _PARTS:
        return f"The angle reading errs {_PARTS[found.quantity]}, by {now}; stated {_stated(found)}."
    if found.quantity == "cubic":
        return f"The tilt sensors are not linear: cubic error {now}; stated {_stated(found)}."
    return f"Each tilt sensor shows {now} of the tilt about the other axis; stated {_stated(found)}."


def instrument_open(found: InstrumentFinding) -> str:
    """Return the deviation of an instrument with its alternatives."""
    if not found.ties:
        return instrument_sentence(found)
    others = listed([tie.name for tie in found.ties], "or")
    return f"{instrument_sentence(found).rstrip('.')}, but {others} would explain it as well."


def every(rows: float) -> str:
    """Return so many samples as words: every 2nd, every 6.7th."""
    text = f"{rows:.3g}"
    teens = "." in text or text[-2:] in ("11", "12", "13")
    return f"every {text}{'th' if teens else {'1': 'st', '2': 'nd', '3': 'rd'}.get(text[-1], 'th')}"


def reading_sentence(found: ReadingFinding) -> str:
    """Return a deviation found in the samples next to the stated value, for example hum of the tilt reading."""
    name, stated = _NAMES.get(found.channel, found.channel), _stated(found)
    value = with_error(found.value, found.standard_error, found.unit)
    if found.quantity == "hum":
        where = f"{found.frequency:.2f} Hz" if found.frequency is not None else "the mains"
        if found.multiple > 1:
            where += f", {found.multiple} times the mains"
        if found.value < 5.0 * found.standard_error:
            return f"The {name} has no hum at {where} ({value}); stated {stated}."
        return f"The {name} has a hum of {value} at {where}; stated {stated}."
    if found.quantity == "frequency":
        return f"The mains has {value}; stated {stated}."
    if found.quantity == "held":
        return f"The {name.replace('_', ' ')} is new in {every(found.value)} sample only."
    if found.quantity == "resolution":
        if found.value == 0.0:
            return f"The {name} does not go in steps; stated {stated}."
        return f"The {name} goes in steps of {quantity(found.value, found.unit)}; stated {stated}."
    if found.quantity == "outliers":
        kind = "come in bursts" if found.remark == "bursts" else "come one by one: the noise has heavy tails"
        share = quantity(found.value, "1", digits=2)
        return f"{share} of the readings of the {name} lie beyond 5 standard deviations of its noise; they {kind}."
    remark = _REMARKS[found.remark]
    if found.quantity == "jitter":
        whose = "The sampling instants" if found.remark == "hidden" else "The stamps"
        declared = f"{short(found.stated / _MICRO)} µs" if found.stated else "0"
        return f"{whose} scatter by {_micro(found)} µs; stated {declared}{remark}."
    way = "fast" if found.value > 0.0 else "slow"
    declared = f"{short(found.stated / _MICRO)} ppm" if found.stated else "0"
    return f"The stamps run {_micro(found)} ppm {way} against the count of the samples; stated {declared}{remark}."


def _micro(found: ReadingFinding) -> str:
    """Return the size of a value in millionths, with its error where it is not exact."""
    value, error = abs(found.value) / _MICRO, found.standard_error / _MICRO
    return pair(value, error) if error > _EXACT * value else short(value)


def untold_sentences(hum_unknown: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Yield the limits of the samples: hum at a multiple of the speed."""
    if any(why == "rotor" for _, why in hum_unknown):
        yield "Hum of the mains cannot be determined: a multiple of the speed has its frequency in all steady motion."


def _stated(found: InstrumentFinding | ReadingFinding) -> str:
    return quantity(found.stated, found.unit) if found.stated else "0"


def event_sentences(events: Sequence[DatedEvent], *, several: bool = False) -> list[str]:
    """Return changes with their times; simultaneous changes share a sentence.

    With `several` recordings each sentence names its recording.
    """
    at_once: dict[tuple[object, ...], list[DatedEvent]] = {}
    for event in events:
        key = event.recording, event.kind, event.time, event.end, event.still_in
        at_once.setdefault(key, []).append(event)
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
    still = f", and is still there in {listed(list(event.still_in), 'and')}" if event.still_in else ""
    if event.before:
        were = "was" if len(events) == 1 else "were"
        return f"From the start{where} there {were} {what.rstrip(',')} that was not there at the start of another."
    if event.kind == "step" or event.end is None:
        return f"At {begin}{where} {what} appeared and stayed{still}."
    end = _time(event.end, event.end_error or 0.0)
    if event.kind == "trend":
        return f"From {begin} to {end}{where} {what} grew, and stayed{still}."
    were = "was" if len(events) == 1 else "were"
    return f"From {begin} to {end}{where} there {were} {what.rstrip(',')}."


def tie_of_event(event: DatedEvent) -> str:
    """Return the alternatives to an event; empty without alternatives."""
    if not event.ties:
        return ""
    names = [_SIZED.sub("", _WHAT[name]).rstrip(",") for name in event.ties]
    begin = "is there from the start" if event.before else f"began at {_time(event.time, event.time_error)}"
    return f"what {begin} could also be {listed(names, 'or')}: these recordings do not tell them apart"


def turned_sentences(events: Sequence[DatedEvent], *, several: bool = False) -> list[str]:
    """Return the changes that a turning of the rig explains as well, where it is not recorded how the rig stood."""
    said = []
    for recording, time in dict.fromkeys((event.recording, event.time) for event in events):
        at_once = [event for event in events if (event.recording, event.time) == (recording, time)]
        where = f" of {recording}" if several else ""
        each = [
            _WHAT[e.channel].format(with_error(e.size, e.standard_error, e.unit, pure=False)) for e in at_once
        ]
        what = listed([part.rstrip(",") for part in each], "and")
        before = at_once[0].before
        begin = "From the start" if before else f"At {_time(time, at_once[0].time_error)}"
        said.append(
            f"{begin}{where} either the rig was turned and its centre of gravity is off the pivot (gravity_offset), or "
            f"{what} {'was there' if before else 'appeared'}: the recording does not state how the rig stood, so "
            "neither can be concluded."
        )
    return said


def law_sentence(law: MissingLaw, *, several: bool = False) -> str:
    """Return a law that looks like events; `several` as in `event_sentences`."""
    names = [_SIZED.sub("", _WHAT[name]) for name in law.channels]
    what = listed([*(name.rstrip(",") for name in names[:-1]), names[-1]], "and")
    where = f" in {law.recording}" if several else ""
    one = len(law.channels) == 1
    verb, pronoun = ("is", "it begins and ends") if one else ("are", "they begin and end")
    if law.depends_on == "offset":
        return f"From the start there {verb} {what.rstrip(',')}{where}: an offset, no event."
    depends = f"depend{'s' if one else ''} on the {_MOTION[law.depends_on]}"
    drifts = law.depends_on in _SLOW
    ends = "a law, not an event or a drift" if drifts else f"{pronoun} with the commands, no event"
    return f"There {verb} {what}{where} that {depends}: {ends}."


def shape_sentences(shapes: Sequence[DriftShape], *, several: bool = False) -> list[str]:
    """Return shapes of drifts; what swings with one period shares a sentence; `several` as in `event_sentences`."""
    together: list[list[DriftShape]] = []
    for shape in shapes:
        known = (own for own in together if _swing_alike(own[0], shape))
        if (same := next(known, None)) is None:
            together.append([shape])
        else:
            same.append(shape)
    return [_shape(own, several) for own in together]


def shape_sentence(shape: DriftShape, *, several: bool = False) -> str:
    """Return the shape of a drift; `several` as in `event_sentences`."""
    return _shape([shape], several)


def _swing_alike(one: DriftShape, other: DriftShape) -> bool:
    """Whether two shapes are swings of one recording, with one period as far as these are known."""
    alike = (one.recording, one.kind, one.also_in) == (other.recording, other.kind, other.also_in)
    errors = math.hypot(one.time_error, other.time_error)
    return alike and one.kind == "swing" and abs(one.time - other.time) < max(3.0 * errors, 0.01 * one.time)


def _shape(shapes: Sequence[DriftShape], several: bool) -> str:
    shape = shapes[0]
    sizes = [with_error(s.size, s.standard_error, s.unit, pure=False) for s in shapes]
    each = [_WHAT[s.channel].format(size).rstrip(",") for s, size in zip(shapes, sizes, strict=True)]
    what = listed(each, "and")
    if shape.kind == "swing":
        also = f", also in {listed(list(shape.also_in), 'and')}" if shape.also_in else ""
        swing = "swings" if len(shapes) == 1 else "swing"
        said = f"{what} {swing} to and fro with a period of {_time(shape.time, shape.time_error)}{also}."
    else:
        warmer = decimal(shape.temperature_change, 1)
        said = f"{what} follows the {_TEMPERATURES[shape.kind]}, which changed by {warmer} K."
    return f"In {shape.recording}, {said}" if several else said[0].upper() + said[1:]


def drift_sentence(scales: Mapping[str, float], *, shaped: bool = False, laws: bool = False) -> str:
    """Return the drifts that are larger than stated; empty otherwise.

    `scales` are their sizes over the stated ones, by reading. If events or shapes of drifts are reported too
    (`shaped`), the remainder has no shape. `laws` that nothing describes may be part of it.
    """
    raised = [
        f"that of the {_DRIFTS.get(name, name)} {decimal(scale, 1)} times"
        for name, scale in scales.items()
        if scale > _TOLD
    ]
    if not raised:
        return ""
    what = "What is left of the slow drift is" if shaped else "The slow drift is"
    why = "the law above may be part of it" if laws else _SHAPELESS
    return f"{what} larger than stated: {listed(raised, 'and')}; {why}."


def _time(time: float, error: float) -> str:
    """Return a time with its standard error, as in 110.20(3) s."""
    places = 2 if error < 0.1 else 1 if error < 1.0 else 0
    digits = max(round(error * 10**places), 1)
    return f"{decimal(time, places)}({digits}) s"
