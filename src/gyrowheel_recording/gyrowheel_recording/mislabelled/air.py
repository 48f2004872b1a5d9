"""Pressures and temperatures that are not in pascals and kelvins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mislabelled.fixes import Cure, WrongSetup
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

#: Pascals in a unit of pressure.
_PRESSURES = {"hPa": 100.0, "kPa": 1000.0, "bar": 1e5, "mmHg": 133.322, "psi": 6894.76}
#: Weather and height above the sea move the pressure by less than this part.
_WEATHER = 0.12
_COLDEST = 150.0  # K; the coldest that a bench is used at
_CELSIUS = 273.15
_ROOM = (-30.0, 120.0)  # deg C
_TEMPERATURES = ("coil_temperature", "air_temperature")


def air(recording: Recording, bench: Bench) -> list[WrongSetup]:
    """Return which readings of pressure and temperature are in another unit."""
    found = []
    pressures = recording.readings.air_pressure / _ratio(recording)
    pressure = _median(pressures)
    if np.isfinite(pressure) and pressure > 0.0 and _steady(pressures):
        stated = bench.value("air_pressure")
        # a reading that is as it should be is never asked for its unit
        if abs(pressure / stated - 1.0) > 3.0 * _WEATHER:
            near = {unit: abs(pressure * size / stated - 1.0) for unit, size in _PRESSURES.items()}
            unit = min(near, key=lambda name: near[name])
            if near[unit] < _WEATHER:
                found.append(
                    WrongSetup(
                        "unit",
                        ("air_pressure",),
                        Cure(scale={"air_pressure": _PRESSURES[unit]}),
                        unit,
                        value=pressure,
                    )
                )
    cold = [name for name in _TEMPERATURES if _is_celsius(recording.readings[name])]
    if cold:
        value = _median(recording.readings[cold[0]])
        found.append(
            WrongSetup("unit", tuple(cold), Cure(offset=dict.fromkeys(cold, _CELSIUS)), "deg C", value=value)
        )
    return found


def _is_celsius(values: Array) -> bool:
    known = values[np.isfinite(values)]
    if not len(known):
        return False
    low, middle = float(known.min()), float(np.median(known))
    return middle < _COLDEST and low > _ROOM[0] - 100.0 and _ROOM[0] < middle < _ROOM[1]


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")


def _ratio(recording: Recording) -> Array:
    """Return the pressure that was planned over the ambient one; NaN for a vacuum."""
    ratio = np.ones(len(recording.time))
    for event in recording.environment:
        ratio[recording.time >= event.time] = event.air_density_ratio or np.nan
    return ratio


def _steady(values: Array) -> bool:
    """Whether a pressure stays: one that is pumped off unplanned is no ambient pressure in another unit."""
    first, last = np.percentile(values[np.isfinite(values)], (20.0, 80.0))
    return bool(last - first < 0.1 * last)
