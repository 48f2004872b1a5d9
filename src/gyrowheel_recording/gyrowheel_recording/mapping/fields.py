"""Units and ranges of the fields of the messages in tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from gyrowheel_core import wire


@dataclass(frozen=True)
class Reading:
    """A field of a message.

    SI unit, plausible range, whether a constant is allowed in place of a column, whether it may be missing, and another
    unit that a resistance turns into its own; whether pulses may stand for it.
    """

    unit: str
    low: float
    high: float
    constant: bool = False
    optional: bool = False
    current: bool = False
    pulsed: bool = False


_VOLTAGE = Reading("V", -1000.0, 1000.0)
_COIL = Reading("V", -1000.0, 1000.0, optional=True, current=True)
_SLOW = {"constant": True, "optional": True}
READINGS: Final = {
    "tilt_x": Reading("rad", -0.2, 0.2),
    "tilt_y": Reading("rad", -0.2, 0.2),
    "spin_angle": Reading("rad", -1e9, 1e9, optional=True, pulsed=True),
    "spin_rate": Reading("rad/s", -2000.0, 2000.0, optional=True),
    "coil_voltage_x": _COIL,
    "coil_voltage_y": _COIL,
    "motor_voltage": Reading("V", -1000.0, 1000.0, optional=True),
    "motor_current": Reading("A", -100.0, 100.0, optional=True),
    "coil_temperature": Reading("K", 150.0, 600.0, **_SLOW),
    "air_temperature": Reading("K", 150.0, 400.0, **_SLOW),
    "air_pressure": Reading("Pa", 0.0, 3e5, **_SLOW),
}
COMMANDS: Final = dict.fromkeys(wire.COMMAND.fields, _VOLTAGE)
SETPOINTS: Final = {
    "segment": Reading("", 0, 2**32 - 1),
    "phase": Reading("", 0, 1),
    "tilt_x": READINGS["tilt_x"],
    "tilt_y": READINGS["tilt_y"],
    "tilt_rate_x": Reading("rad/s", -100.0, 100.0),
    "tilt_rate_y": Reading("rad/s", -100.0, 100.0),
    "spin_rate": READINGS["spin_rate"],
    "spin_acceleration": Reading("rad/s^2", -1e4, 1e4),
}
GROUPS: Final = {"columns": READINGS, "command": COMMANDS, "setpoint": SETPOINTS}
