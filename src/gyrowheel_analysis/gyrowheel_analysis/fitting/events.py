"""Events: something that changes in the middle of a recording, as rows of a balance.

An event changes one quantity (`QUANTITIES`) by a size in the course of one profile: a step stays, a trend grows from
one time to another and then stays, a burst ends. Its rows are linear in the size, so that a fit takes it along by
projecting it out of rows and derivatives alike (`Noise.with_events`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.channels import in_groups
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.sizes import torque_scale

Array = NDArray[np.float64]
Kind = Literal["step", "trend", "burst"]

#: Quantities of which a jump looks like a motion.
_MOTION = ("tilt_reading_x", "tilt_reading_y")
_TORQUE = 1.0e-3  # N m on the default bench: size of a large event


@dataclass(frozen=True)
class EventQuantity:
    """What an event may change.

    Attributes
    ----------
    name : str
        Its name, as in the results' JSON.
    unit : str
        Unit of the size [SI].
    drifts : tuple of str
        Readings whose drifts its rows carry.
    rows : callable
        Gives the rows (by name) of a balance in which the quantity is larger by one unit.
    width : callable
        Gives a large size of it on a bench.
    """

    name: str
    unit: str
    drifts: tuple[str, ...]
    rows: Callable[[Balance], dict[str, Array]]
    width: Callable[[Bench], float]


@dataclass(frozen=True)
class Event:
    """A change in the middle of a recording.

    Attributes
    ----------
    recording : int
        Number of the recording.
    quantity : str
        What changes, one of `QUANTITIES`.
    kind : Kind
        ``step`` (stays), ``trend`` (grows from `time` to `end`, then stays) or ``burst`` (ends at `end`).
    time : float
        When it begins [s from the start of the recording].
    end : float
        When a trend or a burst ends [s]; infinite for a step.
    """

    recording: int
    quantity: str
    kind: Kind
    time: float
    end: float = math.inf

    @property
    def edges(self) -> tuple[float, ...]:
        """The times at which it begins and, if it does, ends [s]."""
        return (self.time,) if self.kind == "step" else (self.time, self.end)

    def at(self, *edges: float) -> Event:
        """Return the event with other `edges`."""
        return replace(self, time=edges[0], end=edges[1] if len(edges) > 1 else self.end)

    def profile(self, start: Array, duration: Array) -> Array:
        """Return its mean over intervals, in units of its size."""
        stop = start + duration
        if self.kind == "trend":
            return (_risen(stop, *self.edges) - _risen(start, *self.edges)) / duration
        on = np.clip((stop - self.time) / duration, 0.0, 1.0)
        return on if self.kind == "step" else on - np.clip((stop - self.end) / duration, 0.0, 1.0)


def _risen(time: Array, begin: float, end: float) -> Array:
    """Return the integral up to a time of what rises from 0 to 1 between two times."""
    length = max(end - begin, 1.0e-3)
    return np.asarray(0.5 * np.clip(time - begin, 0.0, length) ** 2 / length + np.maximum(time - end, 0.0))


def unit_rows(balance: Balance, quantity: EventQuantity) -> Array:
    """Return the rows (N,) of a balance in which a quantity is larger by one unit all the time."""
    rows = np.zeros(len(balance))
    for name, values in quantity.rows(balance).items():
        rows[balance.row(name)] = values
    return rows


def event_columns(balances: Sequence[Balance], events: Sequence[Event]) -> Array:
    """Return the rows of all recordings by the size of every event, (N, events) [unit of the row per unit]."""
    edges = np.cumsum([0, *(len(b) for b in balances)])
    columns = np.zeros((int(edges[-1]), len(events)))
    for k, event in enumerate(events):
        balance = balances[event.recording]
        w = balance.windows
        profile = np.tile(event.profile(w.start, w.duration), len(balance.rows))
        own = unit_rows(balance, QUANTITIES[event.quantity])
        columns[edges[event.recording] : edges[event.recording + 1], k] = profile * own
    return columns


def edge_columns(balances: Sequence[Balance], events: Sequence[Event], deviation: Array) -> Array:
    """Return a column for every row of the windows in which something changes, (N, rows) [standard deviations].

    A jump in a reading of the tilt disturbs what is fitted there as a smooth motion. Such a window counts for nothing.
    """
    edges = np.cumsum([0, *(len(b) for b in balances)])
    rows: list[int] = []
    for event in events:
        w, count = balances[event.recording].windows, len(balances[event.recording].rows)
        if event.kind == "trend" or event.quantity not in _MOTION:
            continue
        for edge in event.edges:
            inside = np.flatnonzero((w.start < edge) & (edge < w.start + w.duration))
            rows += [
                int(edges[event.recording]) + row * len(w) + int(k) for k in inside for row in range(count)
            ]
    rows = sorted(set(rows))
    columns = np.zeros((len(deviation), len(rows)))
    columns[rows, np.arange(len(rows))] = deviation[rows]
    return columns


def event_widths(bench: Bench, events: Sequence[Event]) -> Array:
    """Return a generous size of every event on a bench."""
    return np.array([QUANTITIES[event.quantity].width(bench) for event in events])


def _ones(balance: Balance, size: float = 1.0) -> Array:
    return np.full(len(balance.windows), size)


def _on_shaft(balance: Balance, torque: Array) -> dict[str, Array]:
    """Return the rows of a torque on the shaft: the motor must give as much the other way."""
    v = balance.bench.value
    return {"spin": -torque, "motor_voltage": -torque * v("motor_resistance") / v("motor_constant")}


def _on_case(torque: NDArray[np.complex128]) -> dict[str, Array]:
    """Return the rows of a torque on the rotor in case axes, x + i y: the coils must give as much the other way."""
    return {"tilt_x": -torque.real, "tilt_y": -torque.imag}


def _speed(balance: Balance) -> Array:
    return balance.windows.mean_spin / balance.bench.value("spin_rate_reference")


def _tilt(balance: Balance) -> NDArray[np.complex128]:
    return np.asarray(balance.windows.mean_tilt / balance.bench.value("tilt_reference"))


def _current(balance: Balance) -> Array:
    return balance.windows.motor_current


def _coil(balance: Balance) -> NDArray[np.complex128]:
    return np.asarray(balance.bench.value("coil_constant") * balance.windows.coil_voltage)


def _gain(balance: Balance) -> dict[str, Array]:
    """Return the rows of coils that give more torque per volt: they need less voltage, at all harmonics."""
    turning = [
        row
        for channel in in_groups("revolution")
        if channel.quantity == "coil_torque"
        for row in channel.rows
        if row in balance.rows
    ]
    return _on_case(_coil(balance)) | {row: -balance.measured[balance.row(row)] for row in turning}


def _by_bias(balance: Balance, name: str) -> dict[str, Array]:
    """Return the rows of a reading of the tilt that is larger by one unit."""
    rows = balance.by_parameter(name)
    return {row: rows[balance.row(row)] for row in balance.rows}


def _torque(bench: Bench) -> float:
    return _TORQUE * torque_scale(bench)


_ALL = (
    EventQuantity(
        "torque_x", "N*m", ("coil_voltage",), lambda b: {"tilt_x": _ones(b, -1.0)}, _torque
    ),
    EventQuantity(
        "torque_y", "N*m", ("coil_voltage",), lambda b: {"tilt_y": _ones(b, -1.0)}, _torque
    ),
    EventQuantity(
        "spin_torque", "N*m", ("motor_current", "motor_voltage"), lambda b: _on_shaft(b, _ones(b)), _torque
    ),
    EventQuantity(
        "motor_current", "A", ("motor_current",),
        lambda b: {"spin": _ones(b, b.bench.value("motor_constant"))},
        lambda bench: _torque(bench) / bench.value("motor_constant"),
    ),
    EventQuantity(
        "motor_voltage", "V", ("motor_voltage",), lambda b: {"motor_voltage": _ones(b)},
        lambda bench: _torque(bench) * bench.value("motor_resistance") / bench.value("motor_constant"),
    ),
    EventQuantity(
        "spin_torque_by_speed", "N*m", ("motor_current", "motor_voltage"),
        lambda b: _on_shaft(b, _speed(b)), _torque,
    ),
    EventQuantity("torque_along_tilt", "N*m", ("coil_voltage",), lambda b: _on_case(_tilt(b)), _torque),
    EventQuantity(
        "torque_across_tilt", "N*m", ("coil_voltage",), lambda b: _on_case(1j * _tilt(b) * _speed(b)), _torque
    ),
    EventQuantity(
        "coil_gain", "1", ("coil_voltage",), _gain, lambda bench: 0.02
    ),
    EventQuantity(
        "tilt_reading_x", "rad", ("coil_voltage",), lambda b: _by_bias(b, "tilt_bias_x"),
        lambda bench: 0.02 * bench.value("tilt_reference"),
    ),
    EventQuantity(
        "tilt_reading_y", "rad", ("coil_voltage",), lambda b: _by_bias(b, "tilt_bias_y"),
        lambda bench: 0.02 * bench.value("tilt_reference"),
    ),
    EventQuantity(
        "winding_resistance", "1", ("motor_voltage",),
        lambda b: {"motor_voltage": b.bench.value("motor_resistance") * _current(b)}, lambda bench: 0.1,
    ),
)  # fmt: skip

#: What an event may change, by name: the simplest first.
QUANTITIES: dict[str, EventQuantity] = {quantity.name: quantity for quantity in _ALL}
