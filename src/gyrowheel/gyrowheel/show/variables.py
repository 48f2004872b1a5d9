"""Titles of the variables on which a residual may depend; the one table for terminal, sentences and pictures."""

from __future__ import annotations

TITLES = {
    "speed": "spin rate",
    "tilt": "tilt magnitude",
    "azimuth": "tilt direction",
    "temperature": "coil temperature",
    "motor_temperature": "motor temperature",
    "air_pressure": "air pressure",
    "time": "time",
}
