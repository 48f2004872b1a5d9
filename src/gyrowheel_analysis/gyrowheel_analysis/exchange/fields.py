"""What the fields of the messages take when they come from a table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from gyrowheel_core import wire


@dataclass(frozen=True)
class Field:
    """What a field of a message takes: SI unit, the range of what can be meant, whether a constant will do."""

    unit: str
    low: float
    high: float
    constant: bool = False


_VOLTAGE = Field("V", -1000.0, 1000.0)
READINGS: Final = {
    "tilt_x": Field("rad", -0.2, 0.2),
    "tilt_y": Field("rad", -0.2, 0.2),
    "spin_angle": Field("rad", -1e9, 1e9),
    "spin_rate": Field("rad/s", -2000.0, 2000.0),
    "coil_voltage_x": _VOLTAGE,
    "coil_voltage_y": _VOLTAGE,
    "motor_voltage": _VOLTAGE,
    "motor_current": Field("A", -100.0, 100.0),
    "coil_temperature": Field("K", 150.0, 600.0, constant=True),
    "air_temperature": Field("K", 150.0, 400.0, constant=True),
    "air_pressure": Field("Pa", 0.0, 3e5, constant=True),
}
COMMANDS: Final = dict.fromkeys(wire.COMMAND.fields, _VOLTAGE)
SETPOINTS: Final = {
    "segment": Field("", 0, 2**32 - 1),
    "phase": Field("", 0, 1),
    "tilt_x": READINGS["tilt_x"],
    "tilt_y": READINGS["tilt_y"],
    "tilt_rate_x": Field("rad/s", -100.0, 100.0),
    "tilt_rate_y": Field("rad/s", -100.0, 100.0),
    "spin_rate": READINGS["spin_rate"],
    "spin_acceleration": Field("rad/s^2", -1e4, 1e4),
}
GROUPS: Final = {"columns": READINGS, "command": COMMANDS, "setpoint": SETPOINTS}
