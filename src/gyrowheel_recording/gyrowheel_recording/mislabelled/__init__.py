"""Wrong setups: columns of a recording that cannot be what they are called, by what physics demands; their fixes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError, nearest
from gyrowheel_core.readings import READINGS
from gyrowheel_core.wire import Layout
from gyrowheel_recording.bags import Recording, RecordingWriter
from gyrowheel_recording.mislabelled.blocks import BLOCK, EVERY, NAMES, Averages
from gyrowheel_sim import environment as environments

Array = NDArray[np.float64]

#: What can be wrong: the sign or the unit of columns, columns exchanged, twice the same, shifted in time, that never
#: change, of another recording, held over several samples; a wheel that turns the other way; times that count too fast
#: or too slowly; a recording of another machine.
Kind = Literal[
    "sign",
    "unit",
    "exchanged",
    "same",
    "shifted",
    "stuck",
    "foreign",
    "held",
    "reversed",
    "scale",
    "clock",
    "another_machine",
]


@dataclass(frozen=True)
class Fix:
    """What makes the columns of a recording right."""

    exchange: tuple[tuple[str, str], ...] = ()  # pairs of columns to exchange, before all else
    #: Columns to multiply, then to increase [SI].
    scale: Mapping[str, float] = field(default_factory=dict)
    offset: Mapping[str, float] = field(default_factory=dict)
    shift: Mapping[str, float] = field(default_factory=dict)  # columns to move to later times [s]
    without: tuple[str, ...] = ()  # columns to leave out, as if they had not been measured
    every: float = 1  # of so many samples one is taken: that in which a held reading is new

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that it changes."""
        names = [name for pair in self.exchange for name in pair]
        return tuple(dict.fromkeys([*names, *self.scale, *self.offset, *self.shift, *self.without]))

    def __bool__(self) -> bool:
        """Whether it changes anything."""
        return bool(self.columns) or self.every > 1

    def and_then(self, other: Fix) -> Fix:
        """Return this one together with another one that changes other columns."""
        return Fix(
            self.exchange + other.exchange,
            {**self.scale, **other.scale},
            {**self.offset, **other.offset},
            {**self.shift, **other.shift},
            tuple(dict.fromkeys([*self.without, *other.without])),
            max(self.every, other.every),
        )

    def applied(self, averages: Averages) -> Averages:
        """Return corrected averages; those of an angle that is scaled by its unit must be computed again."""
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
    """A wrong setup that was recognised."""

    kind: Kind  # what is wrong
    columns: tuple[str, ...]  # the columns that are wrong
    cure: Fix = Fix()  # what makes them right; nothing where the recording cannot be mended
    unit: str = ""  # for ``unit``: the unit in which the readings seem to be
    otherwise: tuple[tuple[str, ...], ...] = ()  # other columns that would explain it as well
    #: Part of the readings that physics leaves unexplained, as recorded and corrected.
    before: float = float("nan")
    after: float = float("nan")
    recording: str = ""  # path of the recording
    #: A reading that shows it, in the unit that it should have; NaN where none does.
    value: float = float("nan")

    def to_json(self) -> dict[str, Any]:
        """Return the facts as a JSON object, to which the words are added."""
        cure = {key: value for key, value in asdict(self.cure).items() if value}
        return {"kind": self.kind, "columns": list(self.columns), "change": cure, "recording": self.recording}


_ANGLE: Final = "spin_angle"
_LONGEST_HELD: Final = 1000  # samples
_OFTEN: Final = 1.05  # times as many changes as a held reading can have show that it is another one
NOT_HELD: Final = "every: {every}: no reading is new in one of so many samples only; leave `every` out"
_SELDOM: Final = 0.02  # of them: fewer changes are those of a reading at rest


def correct(recording: Recording, cure: Fix, directory: str | Path) -> int:
    """Write a recording with corrected columns as a new one.

    Measurements are corrected; setpoints, commands, environment and bench are taken over. Drag estimates are left
    out: they were made of the columns as they stood.

    Parameters
    ----------
    recording : Recording
        The recording, which is not changed.
    cure : Cure
        What to do with its columns.
    directory : str or Path
        The new recording, to create.

    Returns
    -------
    int
        Number of samples; those without a value of a shifted column are left out.

    Raises
    ------
    InputError
        If there is no such column, a value is not allowed, nothing is to be done, or the directory cannot be written.
    """
    samples = corrected(recording.measurement, cure)
    columns: list[tuple[topics.Topic, NDArray[np.int64], Any]] = []
    first = np.array([recording.start_ns], dtype=np.int64)
    if recording.bench_text:
        columns.append((topics.BENCH, first, [wire.pack_text(recording.bench_text)]))
    if recording.environment:
        begin = recording.start_ns * 1e-9
        text = environments.to_json(
            [replace(event, time=event.time + begin) for event in recording.environment]
        )
        columns.append((topics.ENVIRONMENT, first, [wire.pack_text(text)]))
    for topic, rows in (
        (topics.SETPOINT, recording.setpoint),
        (topics.MEASUREMENT, samples),
        (topics.COMMAND, recording.command),
    ):
        if len(rows) and topic.layout is not None:
            columns.append((topic, rows["stamp_ns"].astype(np.int64), _messages(topic.layout, rows)))
    with RecordingWriter(directory) as writer:
        writer.write_columns(columns)
    return len(samples)


def corrected(samples: NDArray[Any], cure: Fix) -> NDArray[Any]:
    """Return samples of a recording with corrected columns; see `correct`."""
    _check(cure)
    result = samples.copy()
    for one, other in cure.exchange:
        result[one], result[other] = result[other].copy(), result[one].copy()
    for name, factor in cure.scale.items():
        if name == _ANGLE:
            result[name] = _scaled_angle(result[name], factor)
        else:
            result[name] *= factor
    for name, change in cure.offset.items():
        result[name] += change
    if _ANGLE in cure.columns:
        angle = np.mod(result[_ANGLE], 2.0 * math.pi)
        # a remainder may round up to the divisor itself
        result[_ANGLE] = np.where(angle >= 2.0 * math.pi, 0.0, angle)
    keep = np.ones(len(result), dtype=bool)
    period = float(np.median(np.diff(samples["stamp_ns"]))) * 1e-9 if len(samples) > 1 else 1.0
    # samples may be missing: the sequence shows which one is so much earlier
    sequence = samples["sequence"].astype(np.int64)
    for name, seconds in cure.shift.items():
        steps = round(seconds / period)
        source = np.searchsorted(sequence, sequence - steps)
        found = (source < len(sequence)) & (
            sequence[np.minimum(source, len(sequence) - 1)] == sequence - steps
        )
        keep &= found
        result[name][found] = result[name][source[found]].copy()
    for name in cure.without:
        result[name] = math.nan
    if cure.every > 1:
        taken = new_rows({name: samples[name] for name in NAMES}, sequence, cure.every)
        if not taken.any():
            raise InputError(NOT_HELD.format(every=f"{cure.every:g}"))
        keep &= taken
        result["sequence"][taken] = renumbered(sequence[taken], cure.every)
    if not keep.any():
        raise InputError(f"shift: nothing is left; allowed: less than {len(samples) * period:.6g} s")
    return result[keep]


def new_rows(columns: Mapping[str, Any], numbers: NDArray[np.int64], every: float) -> NDArray[np.bool_]:
    """Return the rows, `every` so many, in which readings that are held so long are new.

    `columns` are readings by name; the one that is held shows the rows. `numbers` are those of the samples. A new value
    that equals the last one does not show: where a value stays longer, rows between are taken at the usual distance.
    None where no reading is held so long.
    """
    shown: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
    most = _OFTEN * float(numbers[-1] - numbers[0] + 1) / every if len(numbers) else 0.0
    for name in (own for own in NAMES if own in columns):
        changed = 1 + np.flatnonzero(np.diff(np.asarray(columns[name], dtype=np.float64)) != 0.0)
        if len(shown) < len(changed) <= most:
            shown = numbers[changed]
    if len(shown) <= _SELDOM * most:
        return np.zeros(len(numbers), dtype=np.bool_)
    ends = np.r_[numbers[0] - 1, shown, numbers[-1] + 1]
    places: list[NDArray[Any]] = [shown]
    for at in np.flatnonzero(np.diff(ends) > 1.5 * every):
        one, other = ends[at], ends[at + 1]
        if at == 0:  # back from the first change
            places.append(np.round(np.arange(other - every, one, -every)))
        else:
            step = every if at == len(shown) else (other - one) / round((other - one) / every)
            places.append(np.round(np.arange(one + step, other - 0.5 * step, step)))
    return np.isin(numbers, np.concatenate(places).astype(np.int64))


def renumbered(numbers: NDArray[np.int64], every: float) -> NDArray[np.int64]:
    """Return the numbers of samples of which one in `every` was taken; those that are missing count on."""
    steps = np.maximum(np.round(np.diff(numbers) / every).astype(np.int64), 1)
    return np.asarray(int(numbers[0] // every) + np.r_[0, np.cumsum(steps)], dtype=np.int64)


def _scaled_angle(angle: NDArray[np.float64], factor: float) -> NDArray[np.float64]:
    """Return an angle times a factor: one that is in radians is counted on over its turns first."""
    if float(np.nanmax(np.abs(angle))) > 2.0 * math.pi * 1.001 or abs(factor) > 2.0 * math.pi * 0.999:
        return np.asarray(factor * angle)  # degrees or turns
    finite = np.isfinite(angle)
    result = np.full_like(angle, np.nan)
    result[finite] = factor * np.unwrap(angle[finite])
    return result


def _check(cure: Fix) -> None:
    if not cure:
        raise InputError("nothing to correct; give exchange, scale, offset, shift, without or every")
    if not 1 <= cure.every <= _LONGEST_HELD:
        raise InputError(f"every: {cure.every} is out of range; allowed: 1 .. {_LONGEST_HELD}")
    for name in cure.columns:
        if name not in READINGS:
            raise InputError(f"column '{name}': no such reading; {nearest(name, READINGS)}")
    for what, values in (("scale", cure.scale), ("offset", cure.offset), ("shift", cure.shift)):
        for name, value in values.items():
            if not math.isfinite(value) or (what == "scale" and value == 0.0):
                raise InputError(f"{what}: {name}: {value:g} is out of range; allowed: any other number")
    for one, other in cure.exchange:
        if one == other:
            raise InputError(f"exchange: {one}: is given twice; allowed: two columns")


def _messages(layout: Layout, rows: NDArray[Any]) -> NDArray[Any]:
    messages = layout.array(len(rows))
    layout.set_stamps(messages, rows["stamp_ns"])
    for name in (*layout.integers, *layout.fields):
        messages[name] = rows[name]
    return messages
