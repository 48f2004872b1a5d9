"""Derived channels: a formula of measured quantities for every sample, its unit checked as that of an effect."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel.recordings.api import Recording
from gyrowheel.show.formulas import plain
from gyrowheel.workbench.library import Envelope
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import unit_for
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.dimensions import unit_of
from gyrowheel_sim.effects.formula import read
from gyrowheel_sim.effects.law_code import array_function
from gyrowheel_sim.effects.quantities import QUANTITIES, REFERENCES

Array = NDArray[np.float64]

MOST = 4  #: derived channels at a time
_BLOCK = 1 << 18  # samples that are computed at once
#: Readings that no law of an effect has, with their units.
READINGS = {"V_x": "V", "V_y": "V", "V_motor": "V"}
#: What is measured, by the columns of a sample and its time [s].
_MEASURED: dict[str, Callable[[NDArray[Any], Array, Bench], Any]] = {
    "z": lambda rows, time, bench: np.tan(rows["tilt_x"]) + 1j * np.tan(rows["tilt_y"]),
    "Omega": lambda rows, time, bench: rows["spin_rate"],
    "theta_z": lambda rows, time, bench: rows["spin_angle"],
    "i_motor": lambda rows, time, bench: rows["motor_current"],
    "V_coil": lambda rows, time, bench: rows["coil_voltage_x"] + 1j * rows["coil_voltage_y"],
    "T_coil": lambda rows, time, bench: rows["coil_temperature"],
    "T_air": lambda rows, time, bench: rows["air_temperature"],
    "rho": lambda rows, time, bench: (
        rows["air_pressure"] / (bench.value("gas_constant") * rows["air_temperature"])
    ),
    "t": lambda rows, time, bench: time,
    "V_x": lambda rows, time, bench: rows["coil_voltage_x"],
    "V_y": lambda rows, time, bench: rows["coil_voltage_y"],
    "V_motor": lambda rows, time, bench: rows["motor_voltage"],
}
#: Names that a derived channel may have, with their units.
NAMES = {name: READINGS.get(name) or QUANTITIES[name].unit for name in (*_MEASURED, *REFERENCES)}


@dataclass(frozen=True)
class Channel:
    """A derived channel, as `channel` reads it."""

    text: str
    unit: str
    expression: Any = field(compare=False)

    @property
    def title(self) -> str:
        """Its formula with the unit, as the title of a panel."""
        return f"{self.text}, {self.unit}"

    def values(self, recording: Recording, bench: Bench) -> Array:
        """Return its value at every sample [SI], NaN where readings are missing."""
        rows, time = recording.measurement, recording.time
        evaluate, names = array_function(self.expression), {s.name for s in self.expression.free_symbols}
        fixed = {name: bench.value(parameter) for name, parameter in REFERENCES.items() if name in names}
        found = np.empty(len(rows))
        with np.errstate(all="ignore"):
            for first in range(0, len(rows), _BLOCK):
                part = slice(first, first + _BLOCK)
                given = {
                    name: make(rows[part], time[part], bench)
                    for name, make in _MEASURED.items()
                    if name in names
                }
                found[part] = np.real(evaluate(given | fixed))
        return found


class Channels:
    """The derived channels that are shown, `MOST` at a time, each computed once for a recording."""

    def __init__(self) -> None:
        self._channels: tuple[Channel, ...] = ()
        self._found: weakref.WeakKeyDictionary[Recording, dict[str, Envelope]] = weakref.WeakKeyDictionary()

    def __iter__(self) -> Iterator[Channel]:
        """Return the channels, in the order in which they were added."""
        return iter(self._channels)

    def add(self, text: str) -> None:
        """Show one more; InputError for an invalid formula, or where `MOST` are shown."""
        own = channel(text)
        if own not in self._channels and len(self._channels) == MOST:
            raise InputError(f"derived channel: {MOST} are shown; remove one first")
        self._channels = tuple(dict.fromkeys((*self._channels, own)))

    def remove(self, text: str) -> None:
        """Remove one."""
        self._channels = tuple(own for own in self._channels if own.text != text)
        for found in self._found.values():
            found.pop(text, None)

    def of(self, recording: Recording, bench: Bench) -> dict[str, Envelope]:
        """Return the channels of a recording by their formulas, ready to be drawn."""
        return {own.text: self.one(own, recording, bench) for own in self._channels}

    def one(self, own: Channel, recording: Recording, bench: Bench) -> Envelope:
        """Return a channel of a recording, also where it was removed meanwhile."""
        known = self._found.setdefault(recording, {})
        if (found := known.get(own.text)) is None:
            found = known[own.text] = Envelope(own.values(recording, bench))
        return found


def channel(text: str) -> Channel:
    """Return the channel of a formula; InputError for one of other quantities, units that differ, or a complex one."""
    line = plain(text.strip())
    formula = read(line, READINGS, "derived channel")
    names = {symbol.name for symbol in formula.expression.free_symbols}
    if stray := sorted(names - NAMES.keys()):
        raise InputError(f"derived channel: {stray[0]} is not measured; allowed: {', '.join(NAMES)}")
    unit = str(unit_of(formula, READINGS))
    shown = unit_for(1.0, unit, pure=True)
    if not formula.real:
        raise InputError("derived channel: the formula is complex; take re(...), im(...) or abs(...) of it")
    # its values are in SI units, which are not always those that are shown
    return Channel(line, (shown.label or "1") if shown.size == 1.0 else unit, formula.expression)
