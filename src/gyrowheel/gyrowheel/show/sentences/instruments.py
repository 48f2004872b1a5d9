"""The findings about the instruments: by the torques, and by the samples alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from gyrowheel.show.quantities import pair, quantity, short, with_error
from gyrowheel_core.quantities import listed

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.result import InstrumentFinding
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


def instrument_sentence(found: InstrumentFinding) -> str:
    """Return the deviation of an instrument, for example a voltage read later than stated."""
    reading = READINGS.get(found.channel, found.channel)
    off = with_error(abs(found.deviation), found.standard_error, found.unit)
    now = with_error(found.value, found.standard_error, found.unit)
    if found.quantity == "delay":
        return f"The {reading} is read {off} {'later' if found.deviation > 0.0 else 'earlier'} than stated."
    if found.quantity == "filter_time":
        if found.stated == 0.0:
            return f"The {reading} passes a filter of {now} that the bench file does not state."
        return f"The filter of the {reading} has {now}, not {quantity(found.stated, found.unit)} as stated."
    if found.quantity == "encoder_zero":
        where = "ahead of" if found.deviation > 0.0 else "behind"
        return f"The zero of the angle reading is {off} {where} where it is stated."
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


_NAMES = READINGS | {"temperature": "temperatures", "pressure": "air pressure"}
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
    if found.quantity == "resolution":
        if found.value == 0.0:
            return f"The {name} does not go in steps; stated {stated}."
        return f"The {name} goes in steps of {quantity(found.value, found.unit)}; stated {stated}."
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
        yield (
            "Hum at the frequency of the mains cannot be told: a multiple of the speed is there in all steady motion."
        )


def _stated(found: InstrumentFinding | ReadingFinding) -> str:
    return quantity(found.stated, found.unit) if found.stated else "0"
