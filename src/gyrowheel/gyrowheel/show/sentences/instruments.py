"""What is said of an instrument that is not as the bench states it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gyrowheel.show.quantities import quantity, with_error
from gyrowheel_core.quantities import listed

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.result import InstrumentFinding

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
    """Return what is wrong with an instrument, say that a voltage is read later than stated."""
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
    """Return what is wrong with an instrument, and what else it could be."""
    if not found.ties:
        return instrument_sentence(found)
    others = listed([tie.name for tie in found.ties], "or")
    return f"{instrument_sentence(found).rstrip('.')}, but {others} would explain it as well."


def _stated(found: InstrumentFinding) -> str:
    return quantity(found.stated, found.unit) if found.stated else "0"
