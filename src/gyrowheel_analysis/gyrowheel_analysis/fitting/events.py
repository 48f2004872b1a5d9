"""Events: something that changes in the middle of a recording, as rows of a balance.

An event changes one quantity (`QUANTITIES`) by a size, following one profile: a step stays, a trend grows from one time
to another and then stays, a burst ends. A drift with a shape follows a temperature, or swings; and a torque may follow
the tilt with a delay. The rows are linear in the size, so that a fit includes it by projecting it out of rows and
derivatives alike (`Noise.with_events`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.channels import in_groups
from gyrowheel_analysis.reduction.mean_rates import Acts, share_of_swing
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.registry import torque_scale

Array = NDArray[np.float64]
Kind = Literal[
    "step",
    "trend",
    "burst",
    "swing",
    "coil_temperature",
    "motor_temperature",
    "air_temperature",
    "after_tilt",
]
#: Time of a step that happened before the recording [s].
BEFORE = 0.0
#: Changes at one time; all other kinds are shapes of a drift.
HAPPENS: tuple[Kind, ...] = ("step", "trend", "burst")
#: Those after which the quantity is another one.
STAYS: tuple[Kind, ...] = ("step", "trend")
#: Shapes that follow a reading.
TEMPERATURES: tuple[Kind, ...] = ("coil_temperature", "motor_temperature", "air_temperature")

#: Quantities of which a jump looks like a motion.
MOTION = ("tilt_reading_x", "tilt_reading_y")
#: Zeros of readings, and torques that are hardly told from them.
OFFSETS = (
    "torque_x", "torque_y", "coil_voltage_x", "coil_voltage_y", "motor_current", "motor_voltage", *MOTION,
    "encoder_zero",
)  # fmt: skip
_STEADY = 0.05  # K; a temperature that varies by less explains nothing
_SHOWS = 1.0e-9  # part of the largest row below which a row is a rounding error
_TORQUE = 1.0e-3  # N m on the default bench: size of a large event


@dataclass(frozen=True)
class EventQuantity:
    """A quantity that an event may change.

    `name` is as in the results' JSON, `unit` that of the size [SI]; `drifts` are the readings whose drifts its rows
    carry. `rows` gives the rows, by name, of a balance in which the quantity is larger by one unit, `width` a large
    size of it on a bench; `acts` is what it acts on.
    """

    name: str
    unit: str
    drifts: tuple[str, ...]
    rows: Callable[[Balance], dict[str, Array]]
    width: Callable[[Bench], float]
    acts: Acts = "reading"


@dataclass(frozen=True)
class Event:
    """A change in the middle of a recording, or a drift that has a shape.

    Attributes
    ----------
    recording : int
        Number of the recording.
    quantity : str
        The changed quantity, one of `QUANTITIES`.
    kind : Kind
        ``step`` (stays), ``trend`` (grows from `time` to `end`, then stays) or ``burst`` (ends at `end`); ``swing``, a
        temperature that it follows, or ``after_tilt`` (relaxes after every move of the tilt).
    time : float
        Start [s from the start of the recording]; maximum of a swing; relaxation time of ``after_tilt`` [s].
    end : float
        End of a trend or a burst [s], infinite for a step; the period of a swing [s].
    """

    recording: int
    quantity: str
    kind: Kind
    time: float = 0.0
    end: float = math.inf

    @property
    def before(self) -> bool:
        """Whether it happened before the recording."""
        return self.kind == "step" and self.time == BEFORE

    @property
    def edges(self) -> tuple[float, ...]:
        """Times of its beginning and, if any, its end [s]."""
        if self.kind in TEMPERATURES:
            return ()
        return (self.time,) if self.kind in ("step", "after_tilt") else (self.time, self.end)

    def at(self, *edges: float) -> Event:
        """Return the event with other `edges`."""
        time, end = (*edges, *(self.time, self.end)[len(edges) :])
        return replace(self, time=time, end=end)

    def profile(self, start: Array, duration: Array) -> Array:
        """Return the mean over intervals of a change at a time, in units of its size."""
        stop = start + duration
        if self.kind == "swing":
            turns = (start + 0.5 * duration - self.time) / self.end
            acts = QUANTITIES[self.quantity].acts if self.quantity else "reading"
            share = share_of_swing(math.pi * duration / self.end, acts)
            return np.asarray(np.cos(2.0 * math.pi * turns) * share)
        if self.kind == "trend":
            return (_risen(stop, *self.edges) - _risen(start, *self.edges)) / duration
        on = np.clip((stop - self.time) / duration, 0.0, 1.0)
        return on if self.kind == "step" else on - np.clip((stop - self.end) / duration, 0.0, 1.0)

    def course(self, windows: Windows) -> Array:
        """Return its mean over windows, in units of its size."""
        if self.kind in TEMPERATURES:
            kelvin = temperature(windows, self.kind)
            return (kelvin - kelvin.mean()) * per_kelvin(kelvin)
        if self.kind == "after_tilt":
            return np.ones(len(windows))  # its rows already follow their course
        return self.profile(windows.start, windows.duration)


def is_law(kind: Kind, quantity: str) -> bool:
    """Whether a shape is a law, which predicts other recordings: a drift of a reading changes its zero."""
    return kind == "after_tilt" or (kind in TEMPERATURES and quantity not in OFFSETS)


def per_kelvin(kelvin: Array) -> float:
    """Return the course per kelvin of what follows the temperatures of all windows."""
    return 1.0 / max(float(np.ptp(kelvin)), _STEADY)


def temperature(windows: Windows, kind: Kind) -> Array:
    """Return a temperature in every window [K]."""
    if kind == "motor_temperature":
        return windows.motor_temperatures[:, 0]
    return windows.coil_temperature if kind == "coil_temperature" else windows.air_temperature


def lead(
    windows: Windows, values: NDArray[Any], time: float, before: complex = 0.0
) -> NDArray[np.complex128]:
    """Return the lead of a quantity over its mean of the past, which fades with a `time` constant [s], (n,).

    `values` (n,) are its values in the windows, `before` is that before the first one. Between two windows it moves at
    once.
    """
    order = np.argsort(windows.start, kind="stable")
    start, duration = windows.start[order], windows.duration[order]
    stop = start + duration
    until = np.r_[0.5 * (stop[:-1] + start[1:]), stop[-1]]
    result, begun, behind = np.zeros(len(order), dtype=np.complex128), float(start[0]), complex(before)
    for k, (place, own) in enumerate(zip(order, values[order], strict=True)):
        ahead = own - behind
        first, last = np.exp(-(start[k] - begun) / time), np.exp(-(stop[k] - begun) / time)
        result[place] = ahead * (first - last) * time / duration[k]
        behind = own - ahead * np.exp(-(until[k] - begun) / time)
        begun = float(until[k])
    return result


def _risen(time: Array, begin: float, end: float) -> Array:
    """Return the integral up to a time of a ramp that rises from 0 to 1 between two times."""
    length = max(end - begin, 1.0e-3)
    return np.asarray(0.5 * np.clip(time - begin, 0.0, length) ** 2 / length + np.maximum(time - end, 0.0))


def unit_rows(balance: Balance, quantity: EventQuantity, lag: float | None = None) -> Array:
    """Return the rows (N,) of a balance in which a quantity is always larger by one unit.

    For a torque that follows the tilt, `lag` is its relaxation time [s].
    """
    rows = np.zeros(len(balance))
    own = quantity.rows(balance) if lag is None else _lagging(balance, lag)
    for name, values in own.items():
        if name in balance.rows:
            rows[balance.row(name)] = values
    return rows


def event_columns(balances: Sequence[Balance], events: Sequence[Event]) -> Array:
    """Return the rows of all recordings by the size of every event, (N, events) [unit of the row per unit]."""
    edges = np.cumsum([0, *(len(b) for b in balances)])
    columns = np.zeros((int(edges[-1]), len(events)))
    for k, event in enumerate(events):
        balance = balances[event.recording]
        profile = np.tile(event.course(balance.windows), len(balance.rows))
        own = unit_rows(balance, QUANTITIES[event.quantity])
        columns[edges[event.recording] : edges[event.recording + 1], k] = profile * own
    return columns


def edge_columns(balances: Sequence[Balance], events: Sequence[Event], deviation: Array) -> Array:
    """Return a column for every row of the windows in which a reading of the tilt jumps, (N, rows).

    A jump disturbs the fit of a smooth motion there. Such a window gets no weight. The columns are standard deviations.
    """
    edges = np.cumsum([0, *(len(b) for b in balances)])
    rows: list[int] = []
    for event in events:
        w, count = balances[event.recording].windows, len(balances[event.recording].rows)
        if event.kind not in ("step", "burst") or event.quantity not in MOTION:
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
    """Return a large size of every event on a bench."""
    return np.array([QUANTITIES[event.quantity].width(bench) for event in events])


def _ones(balance: Balance, size: float = 1.0) -> Array:
    return np.full(len(balance.windows), size)


def _on_shaft(balance: Balance, torque: Array) -> dict[str, Array]:
    """Return the rows of a torque on the shaft: the motor compensates it."""
    v = balance.bench.value
    return {"spin": -torque, "motor_voltage": -torque * v("motor_resistance") / v("motor_constant")}


def _on_case(balance: Balance, torque: NDArray[Any]) -> dict[str, Array]:
    """Return the rows of a torque across the rotor in case axes, x + i y: the coils compensate it.

    They push in case axes, not across the tilted rotor, so that a part of their torque is along its spin axis.
    """
    along = _on_shaft(balance, np.imag(torque * balance.windows.mean_tilt.conj()))
    return {"tilt_x": -torque.real, "tilt_y": -torque.imag, **along}


def _speed(balance: Balance) -> Array:
    return balance.windows.mean_spin / balance.bench.value("spin_rate_reference")


def _tilt(balance: Balance) -> NDArray[np.complex128]:
    return np.asarray(balance.windows.mean_tilt / balance.bench.value("tilt_reference"))


def _lagging(balance: Balance, lag: float) -> dict[str, Array]:
    """Return the rows of a torque against a moved tilt, which relaxes at rest."""
    behind = lead(balance.windows, balance.windows.mean_tilt, lag) / balance.bench.value("tilt_reference")
    return _on_case(balance, -behind)


def _gain(balance: Balance) -> dict[str, Array]:
    """Return the rows of coils that give more torque per volt: they need less voltage, at all harmonics.

    They are predicted, not measured: the measured rows contain the residual, which would explain itself.
    """
    rows = balance.by_parameter("coil_constant") * balance.bench.value("coil_constant")
    turning = [
        row
        for channel in in_groups("average", "revolution")
        if channel.quantity == "coil_torque"
        for row in channel.rows
        if row in balance.rows
    ]
    return {row: rows[balance.row(row)] for row in turning}


def _gain_of_axis(balance: Balance, axis: Literal["x", "y"]) -> dict[str, Array]:
    """Return the rows of a coil that gives more torque per volt: the other axis stays.

    A torque that turns with the rotor comes from both coils alike.
    """
    own, other = (f"tilt_{name}" for name in (axis, "y" if axis == "x" else "x"))
    return {row: rows if row == own else 0.5 * rows for row, rows in _gain(balance).items() if row != other}


def _read_by_coil(balance: Balance, axis: Literal["x", "y"]) -> dict[str, Array]:
    """Return the rows of the voltage of a coil whose reading is larger by a volt."""
    return {f"tilt_{axis}": _ones(balance, balance.bench.value("coil_constant"))}


def _by_parameter(balance: Balance, name: str, unit: float = 1.0) -> dict[str, Array]:
    """Return the rows of a parameter of the bench that is larger by a unit, where it shows."""
    rows = balance.by_parameter(name) * unit
    size = np.abs(rows).max(initial=0.0)
    return {
        row: own
        for row in balance.rows
        if np.abs(own := rows[balance.row(row)]).max(initial=0.0) > _SHOWS * size
    }


def _torque(bench: Bench) -> float:
    return _TORQUE * torque_scale(bench)


def _volts(bench: Bench) -> float:
    return _torque(bench) / bench.value("coil_constant")


_ALL = (
    EventQuantity("torque_x", "N*m", ("coil_voltage",), lambda b: _on_case(b, _ones(b)), _torque, "tilt"),
    EventQuantity("torque_y", "N*m", ("coil_voltage",), lambda b: _on_case(b, 1j * _ones(b)), _torque, "tilt"),
    EventQuantity(
        "spin_torque", "N*m", ("motor_current", "motor_voltage"), lambda b: _on_shaft(b, _ones(b)), _torque, "spin"
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
    EventQuantity("coil_voltage_x", "V", ("coil_voltage",), lambda b: _read_by_coil(b, "x"), _volts),
    EventQuantity("coil_voltage_y", "V", ("coil_voltage",), lambda b: _read_by_coil(b, "y"), _volts),
    EventQuantity(
        "spin_torque_by_speed", "N*m", ("motor_current", "motor_voltage"),
        lambda b: _on_shaft(b, _speed(b)), _torque, "spin",
    ),
    EventQuantity(
        "torque_along_tilt", "N*m", ("coil_voltage",), lambda b: _on_case(b, _tilt(b)), _torque, "tilt"
    ),
    EventQuantity(
        "torque_across_tilt", "N*m", ("coil_voltage",), lambda b: _on_case(b, 1j * _tilt(b) * _speed(b)), _torque,
        "tilt",
    ),
    EventQuantity("coil_gain", "1", ("coil_voltage",), _gain, lambda bench: 0.02, "tilt"),
    EventQuantity(
        "tilt_reading_x", "rad", ("coil_voltage",), lambda b: _by_parameter(b, "tilt_bias_x"),
        lambda bench: 0.02 * bench.value("tilt_reference"),
    ),
    EventQuantity(
        "tilt_reading_y", "rad", ("coil_voltage",), lambda b: _by_parameter(b, "tilt_bias_y"),
        lambda bench: 0.02 * bench.value("tilt_reference"),
    ),
    EventQuantity(
        "winding_resistance", "1", ("motor_voltage",),
        lambda b: {"motor_voltage": b.bench.value("motor_resistance") * b.windows.motor_current},
        lambda bench: 0.1,
    ),
    EventQuantity(
        "motor_constant", "1", ("motor_current", "motor_voltage"),
        lambda b: _by_parameter(b, "motor_constant", b.bench.value("motor_constant")), lambda bench: 0.02,
        "spin",
    ),
    EventQuantity(
        "coil_gain_x", "1", ("coil_voltage",), lambda b: _gain_of_axis(b, "x"), lambda bench: 0.02, "tilt"
    ),
    EventQuantity(
        "coil_gain_y", "1", ("coil_voltage",), lambda b: _gain_of_axis(b, "y"), lambda bench: 0.02, "tilt"
    ),
    EventQuantity("encoder_zero", "rad", (), lambda b: _by_parameter(b, "encoder_zero"), lambda bench: 0.02),
)  # fmt: skip

#: A torque that follows the tilt with a delay; no other event changes it.
AFTER_TILT = EventQuantity(
    "torque_after_tilt", "N*m", ("coil_voltage",), lambda b: _on_case(b, _tilt(b)), _torque
)
#: Quantities that may change, by name: the simplest first.
QUANTITIES: dict[str, EventQuantity] = {quantity.name: quantity for quantity in (*_ALL, AFTER_TILT)}

#: Quantities that may change together: both axes of a torque or of a reading. Any other quantity changes alone.
_PAIRS = (
    ("torque_x", "torque_y"),
    ("coil_voltage_x", "coil_voltage_y"),
    ("tilt_reading_x", "tilt_reading_y"),
)
#: Every quantity once, the simplest first, with the one that may change together with it.
TOGETHER: tuple[tuple[str, ...], ...] = tuple(
    dict.fromkeys(
        next((pair for pair in _PAIRS if name in pair), (name,))
        for name in QUANTITIES
        if name != AFTER_TILT.name
    )
)
