"""What is wrong with the columns of a recording, and what to do about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gyrowheel_recording.mislabelled.blocks import BLOCK, EVERY, NAMES, Averages

Array = NDArray[np.float64]

#: What can be wrong: the sign or the unit of columns, columns exchanged, twice the same, shifted in time, that never
#: change, of another recording; a wheel that turns the other way; a recording of another machine.
Kind = Literal[
    "sign", "unit", "exchanged", "same", "shifted", "stuck", "foreign", "reversed", "scale", "another_machine"
]


@dataclass(frozen=True)
class Cure:
    """What makes the columns of a recording right.

    Attributes
    ----------
    exchange : tuple of (str, str)
        Pairs of columns to exchange, before all else.
    scale, offset : dict of str to float
        Columns to multiply, then to increase [SI].
    shift : dict of str to float
        Columns to move to later times [s].
    """

    exchange: tuple[tuple[str, str], ...] = ()
    scale: Mapping[str, float] = field(default_factory=dict)
    offset: Mapping[str, float] = field(default_factory=dict)
    shift: Mapping[str, float] = field(default_factory=dict)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that it changes."""
        names = [name for pair in self.exchange for name in pair]
        return tuple(dict.fromkeys([*names, *self.scale, *self.offset, *self.shift]))

    def __bool__(self) -> bool:
        """Whether it changes anything."""
        return bool(self.columns)

    def and_then(self, other: Cure) -> Cure:
        """Return this one together with another one that changes other columns."""
        return Cure(
            self.exchange + other.exchange,
            {**self.scale, **other.scale},
            {**self.offset, **other.offset},
            {**self.shift, **other.shift},
        )

    def applied(self, averages: Averages) -> Averages:
        """Return averages with the cure; those of an angle that is scaled by its unit must be made anew."""
        return averages.changed(self._on)

    def _on(self, columns: Array) -> Array:
        result = columns.copy()
        for pair in self.exchange:
            one, other = (NAMES.index(name) for name in pair)
            result[:, [one, other]] = result[:, [other, one]]
        for name, factor in self.scale.items():
            if name in NAMES:
                result[:, NAMES.index(name)] *= factor
        for name, seconds in self.shift.items():
            place = NAMES.index(name)
            result[:, place] = moved(result[:, place], round(seconds / (EVERY * BLOCK)))
        return result


def moved(values: Array, steps: int) -> Array:
    """Return values moved to later places, NaN where none is left."""
    result = np.full_like(values, np.nan)
    if abs(steps) >= len(values):
        return result
    if steps >= 0:
        result[steps:] = values[: len(values) - steps]
    else:
        result[:steps] = values[-steps:]
    return result


@dataclass(frozen=True)
class WrongSetup:
    """A wrong setup that was recognised.

    Attributes
    ----------
    kind : Kind
        What is wrong.
    columns : tuple of str
        The columns that are wrong.
    cure : Cure
        What makes them right; nothing where the recording cannot be mended.
    unit : str
        For ``unit``: the unit in which the readings seem to be.
    otherwise : tuple of tuple of str
        Other columns that would explain it as well.
    before, after : float
        Part of the readings that physics leaves unexplained as they stand and with the cure.
    recording : str
        Path of the recording.
    value : float
        A reading that shows it, in the unit that it should have; NaN where none does.
    """

    kind: Kind
    columns: tuple[str, ...]
    cure: Cure = Cure()
    unit: str = ""
    otherwise: tuple[tuple[str, ...], ...] = ()
    before: float = float("nan")
    after: float = float("nan")
    recording: str = ""
    value: float = float("nan")

    def to_json(self) -> dict[str, Any]:
        """Return the facts as a JSON object, to which the words are added."""
        cure = {key: value for key, value in asdict(self.cure).items() if value}
        return {
            "kind": self.kind,
            "columns": list(self.columns),
            "change": cure,
            "recording": self.recording,
        }
