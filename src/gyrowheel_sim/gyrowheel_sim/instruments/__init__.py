"""The instruments of the bench: their frequency response; one sample of all of them is a row.

The layout of the arrays for compiled code stands here, too: named indices, readings of a sample, drifts, memory of
delays and filters. The memory is one block of the plant's state: a flag, the filters (`Chain`), then the rows of
`Past`, newest first. `kernel` computes the readings as part of the compiled plant.

Tilts and angles change smoothly, so their readings have the response of the analogue chain. Voltages are held between
latches. Their converters give the mean over one sampling period, which without delay is the held voltage itself; over
time, that mean is the straight line from each held voltage to the next, and what is delayed and filtered is that line.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_sim.parameter import HIGHEST_ORDER

_ALIASES = np.arange(-16, 17)


def smooth_response(omega: Any, delay: Any, time: Any = 0.0, order: Any = 1) -> NDArray[np.complex128]:
    """Return the response of a reading of a smooth quantity: tilt, angle.

    Parameters
    ----------
    omega : array
        Angular frequency [rad/s].
    delay, time : float
        Delay, and time constant of each pole of the filter [s].
    order : int
        Number of poles.
    """
    omega = np.asarray(omega, dtype=np.float64)
    response: NDArray[np.complex128] = np.exp(-1j * omega * delay) / (1.0 + 1j * omega * time) ** order
    return response


def held_response(
    omega: Any, delay: float, time: float = 0.0, order: int = 1, *, period: float
) -> NDArray[np.complex128]:
    """Return the response of a reading of a quantity that is held for each sampling period: voltages, motor current.

    Parameters are those of `smooth_response`; `period` is the sampling period [s]. It is 1 without delay and filter,
    and differs from `smooth_response` by a part of (omega period)^2 / 8 at most.
    """
    omega = np.asarray(omega, dtype=np.float64)
    if time == 0.0:
        samples, part = divmod(delay / period, 1.0)
        mixed = (1.0 - part) + part * np.exp(-1j * omega * period)
        response: NDArray[np.complex128] = np.exp(-1j * omega * samples * period) * mixed
        return response
    # the spectrum of the straight lines between samples, folded back by the sampling
    at = omega[..., None] + 2.0 * np.pi / period * _ALIASES
    lines = np.sinc(0.5 * at * period / np.pi) ** 2
    return np.asarray((lines * smooth_response(at, delay, time, order)).sum(axis=-1), dtype=np.complex128)


def held_factor(order: Any, turn: Any) -> Any:
    """Return the factor from the amplitude of a sampled voltage to that of the held voltage.

    A voltage is read at the end of the interval in which it acts; `turn` is the spin angle of an interval [rad].
    """
    half = 0.5 * order * turn
    return np.exp(1j * half) * np.sinc(half / np.pi)


class Column(IntEnum):
    """An index into an array, with unit, meaning and, for a state, initial value.

    Subclasses list their members as ``name = (index, unit, description)`` or with a fourth item, the initial value: a
    number in SI units, or the name of a bench parameter.
    """

    unit: str
    description: str
    initial: float | str

    def __new__(cls, place: int, unit: str, description: str, initial: float | str = 0.0) -> Column:
        """Make the member of an index."""
        member = int.__new__(cls, place)
        member._value_ = place
        member.unit, member.description, member.initial = unit, description, initial
        return member


def names(columns: type[Column]) -> tuple[str, ...]:
    """Return the names of the indices, in order.

    Raises
    ------
    ValueError
        If the indices are not 0, 1, 2 ... in the order of their declaration.
    """
    if [int(column) for column in columns] != list(range(len(columns))):
        raise ValueError(f"{columns.__name__}: the indices are not 0 .. {len(columns) - 1} in order")
    return tuple(column.name for column in columns)


def source(columns: type[Column]) -> str:
    """Return the indices as source for compiled code: a named tuple, which every numba takes for an index."""
    own, fields = columns.__name__, names(columns)
    return f'{own} = namedtuple("{own}", "{" ".join(fields)}")(*range({len(fields)}))\n'


class Reading(Column):
    """Indices into a sample, in the order of the Measurement message."""

    tilt_x = 0, "rad", "tilt about case x"
    tilt_y = 1, "rad", "tilt about case y"
    spin_angle = 2, "rad", "angle of the shaft, 0 .. 2 pi"
    spin_rate = 3, "rad/s", "spin rate of the shaft"
    coil_voltage_x = 4, "V", "voltage of the coils that turn the rotor about case x"
    coil_voltage_y = 5, "V", "the same about case y"
    motor_voltage = 6, "V", "voltage of the motor"
    motor_current = 7, "A", "current of the motor"
    coil_temperature = 8, "K", "temperature of the torque coils"
    air_temperature = 9, "K", "temperature of the air in the case"
    air_pressure = 10, "Pa", "air pressure in the case"


class Drift(Column):
    """Slow drifts of the instruments, part of the state of the plant; the bench states their standard deviations."""

    coil_voltage_x = 0, "V", "drift of the reading of coil voltage x"
    coil_voltage_y = 1, "V", "drift of the reading of coil voltage y"
    motor_voltage = 2, "V", "drift of the reading of the motor voltage"
    motor_current = 3, "A", "drift of the reading of the motor current"


#: Bench parameter that states the standard deviation of each drift.
DRIFT_SIZES = {
    Drift.coil_voltage_x: "coil_voltage_drift",
    Drift.coil_voltage_y: "coil_voltage_drift",
    Drift.motor_voltage: "motor_voltage_drift",
    Drift.motor_current: "motor_current_drift",
}
#: Standard normal numbers that one sample takes: one a reading, then one a drift.
N_NOISE = len(Reading) + len(Drift)


class Past(Column):
    """Indices into a row of the memory: motion, voltages and current at one sample."""

    n_x = 0, "1", "spin axis: component along case x"
    n_y = 1, "1", "spin axis: component along case y"
    n_x_rate = 2, "1/s", "rate of n_x"
    n_y_rate = 3, "1/s", "rate of n_y"
    spin_angle = 4, "rad", "angle of the shaft, 0 .. 2 pi"
    spin_rate = 5, "rad/s", "spin rate of the shaft"
    coil_voltage_x = 6, "V", "voltage of coil x in the interval that ends at the sample"
    coil_voltage_y = 7, "V", "the same of coil y"
    motor_voltage = 8, "V", "the same of the motor"
    motor_current = 9, "A", "current of the motor"


class Chain(Column):
    """The filters before the converters, each with its last input and the outputs of its poles."""

    tilt_x = 0, "rad", "filter of the tilt about case x"
    tilt_y = 1, "rad", "filter of the tilt about case y"
    coil_voltage_x = 2, "V", "filter of coil voltage x"
    coil_voltage_y = 3, "V", "filter of coil voltage y"
    motor_voltage = 4, "V", "filter of the motor voltage"
    motor_current = 5, "A", "filter of the motor current"


#: Longest delay [samples] that the memory reaches; a delay below zero reaches one sample ahead at most.
LONGEST = 10
#: The next sample (voltages alone), the present one, those before; a filter looks one sample further back.
N_ROWS = LONGEST + 4
#: Numbers stored for one filter: its last input and one output for each pole.
N_FILTER = 1 + HIGHEST_ORDER
FILTERS = 1
ROWS = FILTERS + N_FILTER * len(Chain)
WIDTH = len(Past)
N_MEMORY = ROWS + N_ROWS * WIDTH
