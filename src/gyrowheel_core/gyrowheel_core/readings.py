"""Readings of the bench as columns with names: those of the Measurement message, in its order and units."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final, Self, overload

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core import wire

Array = NDArray[np.float64]

#: Names of the columns.
READINGS: Final = wire.MEASUREMENT.fields
#: Largest possible value of any reading, whatever its unit [SI].
LARGEST: Final = 1e12
#: Largest possible magnitude of each reading, even in a wrong unit such as degrees, millivolts or degrees Celsius
#: [SI]. Loggers write 1e30 and the like for a missing value.
POSSIBLE: Final = {
    "tilt_x": 1e6,
    "tilt_y": 1e6,
    "spin_angle": LARGEST,
    "spin_rate": 1e7,
    "coil_voltage_x": 1e7,
    "coil_voltage_y": 1e7,
    "motor_voltage": 1e7,
    "motor_current": 1e7,
    "coil_temperature": 1e5,
    "air_temperature": 1e5,
    "air_pressure": 1e9,
}
_PLACES: Final = {name: place for place, name in enumerate(READINGS)}


def possible(values: NDArray[np.float64], name: str) -> NDArray[np.bool_]:
    """Return which values are possible readings: finite, and within `POSSIBLE` of the quantity, else `LARGEST`."""
    return np.asarray(np.abs(values) <= POSSIBLE.get(name, LARGEST))


class _Column:
    """The column that has the name of the attribute."""

    def __set_name__(self, owner: type[Readings], name: str) -> None:
        self._place = _PLACES[name]

    @overload
    def __get__(self, readings: None, owner: type[Readings]) -> Self: ...

    @overload
    def __get__(self, readings: Readings, owner: type[Readings]) -> Array: ...

    def __get__(self, readings: Readings | None, owner: type[Readings]) -> Self | Array:
        return self if readings is None else readings.array[:, self._place]


class Readings:
    """Readings (n, 11) with named columns; nothing is copied.

    Parameters
    ----------
    array : ndarray (n, 11)
        Readings [SI], columns as in the Measurement message.

    Attributes
    ----------
    array : ndarray (n, 11)
        As given.
    tilt_x, tilt_y, spin_angle : ndarray (n,)
        Angles [rad].
    spin_rate : ndarray (n,)
        Spin rate [rad/s].
    coil_voltage_x, coil_voltage_y, motor_voltage : ndarray (n,)
        Voltages [V].
    motor_current : ndarray (n,)
        Current [A].
    coil_temperature, air_temperature : ndarray (n,)
        Temperatures [K].
    air_pressure : ndarray (n,)
        Pressure [Pa].

    Raises
    ------
    ValueError
        If the array does not have a column for each reading.
    """

    __slots__ = ("array",)

    tilt_x = _Column()
    tilt_y = _Column()
    spin_angle = _Column()
    spin_rate = _Column()
    coil_voltage_x = _Column()
    coil_voltage_y = _Column()
    motor_voltage = _Column()
    motor_current = _Column()
    coil_temperature = _Column()
    air_temperature = _Column()
    air_pressure = _Column()

    def __init__(self, array: Array) -> None:
        if array.ndim != 2 or array.shape[1] != len(READINGS):
            raise ValueError(f"readings have the shape {array.shape}; it must be (n, {len(READINGS)})")
        self.array = array

    def whole(self, names: Iterable[str]) -> NDArray[np.bool_]:
        """Return the samples in which all of some readings are `possible`."""
        taken = np.ones(len(self), dtype=bool)
        for name in names:
            taken &= possible(self.array[:, _PLACES[name]], name)
        return taken

    @staticmethod
    def columns(names: Iterable[str]) -> list[int]:
        """Return the indices of columns, for code that needs several of them as one array."""
        return [_PLACES[name] for name in names]

    def copy(self) -> Readings:
        """Return a copy whose columns may be written to."""
        return Readings(self.array.copy())

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.array)

    @overload
    def __getitem__(self, which: str) -> Array: ...

    @overload
    def __getitem__(self, which: slice | NDArray[Any]) -> Readings: ...

    def __getitem__(self, which: str | slice | NDArray[Any]) -> Array | Readings:
        """Return a column by its name, or some of the samples (slice, mask or indices)."""
        if isinstance(which, str):
            return self.array[:, _PLACES[which]]
        return Readings(self.array[which])

    def __repr__(self) -> str:
        return f"Readings({len(self)} samples)"
