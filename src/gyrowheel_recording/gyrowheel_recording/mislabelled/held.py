"""Held readings: those of a slower instrument, repeated row by row until there is a new one."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.readings import Readings
from gyrowheel_recording.mislabelled import Fix, WrongSetup, new_rows
from gyrowheel_recording.mislabelled.blocks import NAMES
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

_PIECES, _LENGTH = 24, 8000  # pieces that are looked at, and rows in each
_FEWEST: Final = 30  # new values
#: Part of the values that are there more than once, from which on a reading is held. One with noise repeats by chance
#: only where its steps are coarse: with steps of 1/r of a usual change in one of four r times.
_REPEATED: Final = 0.15
_BY_CHANCE: Final = 4.0 * 0.27
_COARSE: Final = (
    3.0  # steps in a usual change; where it has fewer, only rows at even distances show that it is held
)
_EVEN: Final = 0.98  # part of the changes that are in such rows
_JUMPS: Final = (
    0.02  # part of the changes that are more than one step: a coarse reading that moves evenly has none
)
_SIZES: Final = 5  # of changes; the sectors of an encoder change by one, and by all of them at a turn
_MOST: Final = 400  # rows
_PAUSES: Final = 4.0  # usual lengths; longer stretches without a change are those of something at rest
_WHOLE: Final = 0.02  # of a row
_SAME_PERIOD: Final = 0.05  # part
#: Changes in a piece, and the scatter of their rows about even ones [distances]: 0.3 rows where these are rounded; a
#: random walk, 1.5 distances in 64, where changes come by chance.
_PIECE, _OFF = 64, 0.45
#: Steps of a coarse reading: changes below this part of a usual one are ignored; most steps in a change that is used;
#: scatter about whole steps [steps], and the part of the changes that is within it.
_FINE, _MANY, _SCATTER, _MOSTLY = 0.05, 12.0, 0.2, 0.95
_SOME_NEW: Final = 0.9  # part of the rows taken in which every held reading is new
#: Readings that follow from others, and these.
_DERIVED: Final = {
    "spin_rate": "spin_angle", "motor_current": "motor_voltage", "motor_voltage": "motor_current",
}  # fmt: skip
_VOLTAGES: Final = ("coil_voltage_x", "coil_voltage_y", "motor_voltage")
_TILTS: Final = ("tilt_x", "tilt_y")
_TORQUES: Final = {*_VOLTAGES, "motor_current"}  # one of them at least must be known
_SLOWEST: Final = (
    0.9 * math.pi
)  # rad between two rows, beyond which the angle does not show how far the shaft turned


def rows_a_value(values: Array, numbers: NDArray[np.int64] | None = None) -> float:
    """Return over how many rows each value of a reading (n,) is repeated; 1 for one that is new in every row.

    `numbers` (n,) are those of the samples, where some are missing.
    """
    runs, changes, places, new = _runs(values, np.arange(len(values)) if numbers is None else numbers)
    digit = 32.0 * np.finfo(float).eps * float(np.nanmax(np.abs(values), initial=0.0))
    sizes = changes[changes > digit]
    if len(runs) < _FEWEST or len(sizes) < _FEWEST:
        return 1.0
    apart = np.count_nonzero(np.diff(places) > 1)
    if apart < _REPEATED * (len(runs) - apart):  # whatever its steps, too few are repeated
        return 1.0
    usual = float(np.median(sizes))
    step = _coarse_step(sizes, usual, new)
    if step > usual / _COARSE:
        return _even_rows(places, changes, step)
    moving = runs[runs <= max(_PAUSES * float(np.median(runs)), 2.0)]
    if float(np.mean(moving > 1)) < max(_REPEATED, _BY_CHANCE * step / usual):
        return 1.0
    # a new value that equals the last one by chance makes two stretches one
    whole = float(np.median(moving))
    if not (whole > 1.0 and np.mean(np.remainder(moving, whole) == 0.0) > _EVEN):
        whole = float(np.mean(moving))
    rows = _even_distance(places, whole)
    return rows if 1.0 + _REPEATED <= rows <= _MOST else 1.0


def _coarse_step(sizes: Array, usual: float, new: Array) -> float:
    """Return the step of a reading from the sizes of its changes and its new values; 0 where it is much finer.

    Its values may be written with few digits, which scatter about the steps.
    """
    some = sizes[sizes > _FINE * usual]
    step = float(np.median(some[some <= 1.5 * np.percentile(some, 2.0)]))
    steps = some[some < _MANY * step] / step
    if float(np.mean(np.abs(steps - np.round(steps)) < _SCATTER)) < _MOSTLY:
        return 0.0
    # changes of an angle at one speed are multiples of one, too, but it comes to other values in every turn
    levels = float(np.ptp(new)) / step + 1.0
    return 0.0 if len(np.unique(new)) > 4.0 * levels else step


def _even_distance(places: NDArray[np.int64], rows: float) -> float:
    """Return the distance of rows with new values; 1 where they do not come evenly.

    Where a coarse reading repeats by chance, the distances add up at random. `rows` is a first estimate.
    """
    steps = np.diff(places).astype(np.float64)
    count = min(_PIECE, len(steps))
    pieces = steps[: len(steps) // count * count].reshape(-1, count)
    pieces = pieces[np.all((pieces > 0.0) & (pieces <= _PAUSES * max(rows, 2.0)), axis=1)]
    if not len(pieces):
        return rows
    # a new value that equals the last one makes two stretches one
    numbers = np.ceil(pieces / 2.0) if rows < 2.0 else np.maximum(np.round(pieces / rows), 1.0)
    numbers = np.cumsum(numbers, axis=1)
    off = np.cumsum(pieces, axis=1)
    numbers -= numbers.mean(axis=1, keepdims=True)
    off -= off.mean(axis=1, keepdims=True)
    slopes = np.sum(numbers * off, axis=1) / np.sum(numbers**2, axis=1)
    if float(np.median(np.std(off - slopes[:, None] * numbers, axis=1))) > _OFF * rows:
        return 1.0
    return rows if rows == round(rows) else float(np.median(slopes))


def _runs(values: Array, numbers: NDArray[np.int64]) -> tuple[Array, Array, NDArray[np.int64], Array]:
    """Return the lengths of stretches of one value, and of the changes between sizes, rows and new values."""
    starts = np.unique(np.linspace(0, max(len(values) - _LENGTH, 0), _PIECES).astype(np.int64))
    ends = np.append(np.maximum(starts[1:], 0), len(values))
    low, high = float(np.nanmin(values, initial=math.inf)), float(np.nanmax(values, initial=-math.inf))
    runs, changes, places, new = [], [], [], []
    for start, end in zip(starts, ends, strict=True):
        piece = values[start : min(start + _LENGTH, int(end))]
        own = numbers[start : start + len(piece)]
        known = np.isfinite(piece)
        piece, own = piece[known], own[known]
        at = np.flatnonzero(np.diff(piece) != 0.0) + 1
        if len(at) < 2:
            continue
        inner = (piece[at[:-1]] != low) & (piece[at[:-1]] != high)  # at the end of its range a reading stays
        runs.append((own[at[1:]] - own[at[:-1]])[inner])
        changes.append(np.abs(piece[at] - piece[at - 1]))
        places.append(own[at])
        new.append(piece[at])
    if not runs:
        return np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0)
    lengths = np.concatenate(runs).astype(np.float64)
    return lengths, np.concatenate(changes), np.concatenate(places), np.concatenate(new)


def _even_rows(places: NDArray[np.int64], changes: Array, step: float) -> float:
    """Return the distance of rows that have all changes of a coarse reading; 1 where they may be in any row."""
    sizes = np.unique(np.round(changes / step))
    if len(places) < 4 * _FEWEST or len(sizes) < _SIZES or float(np.mean(changes > 1.5 * step)) < _JUMPS:
        return 1.0
    return next((float(k) for k in range(40, 1, -1) if _lattice(places, k)), 1.0)


def _lattice(places: NDArray[np.int64], distance: int) -> bool:
    counts = np.bincount(places % distance, minlength=distance)
    return bool(counts.max() > _EVEN * counts.sum())


def held_readings(
    readings: Readings, time: Array, numbers: NDArray[np.int64], bench: Bench, names: tuple[str, ...] = NAMES
) -> dict[str, float]:
    """Return over how many rows each of some readings is repeated, where that is more than one.

    Voltages that are new whenever the loop of the bench gives new ones are as they should be.
    """
    if len(time) < _FEWEST:
        return {}
    period = float(np.median(np.diff(time)))
    found = {name: rows_a_value(readings[name], numbers) for name in names}
    loop = bench.sample_period / period if period > 0.0 else 1.0
    return {
        name: rows
        for name, rows in found.items()
        if rows > 1.0 and not (name in _VOLTAGES and abs(rows / loop - 1.0) < _SAME_PERIOD)
    }


def held_setup(
    readings: Readings, time: Array, numbers: NDArray[np.int64], absent: frozenset[str], bench: Bench
) -> list[WrongSetup]:
    """Return the held readings as wrong setups, one for each number of rows, with the cure of all.

    A reading that follows from others is left out. Of the others the rows with new values are taken, where these are
    the same for all; else those are left out, too, that may be missing.
    """
    held = held_readings(readings, time, numbers, bench)
    if not held:
        return []
    cure = _cure(held, readings, time, numbers, absent)
    by_rows: dict[float, list[str]] = {}
    for name, rows in held.items():
        by_rows.setdefault(round(rows, 1), []).append(name)
    return [WrongSetup("held", tuple(names), cure, value=rows) for rows, names in sorted(by_rows.items())]


def _cure(
    held: dict[str, float],
    readings: Readings,
    time: Array,
    numbers: NDArray[np.int64],
    absent: frozenset[str],
) -> Fix:
    without = tuple(
        name for name in held if (other := _DERIVED.get(name)) and other not in held and other not in absent
    )
    without = () if set(held) >= {"motor_current", "motor_voltage"} else without
    rest = {name: rows for name, rows in held.items() if name not in without}
    if not rest:
        return Fix(without=without)
    every = max(rest.values())
    every = round(every) if abs(every - round(every)) < _WHOLE else round(every, 2)
    fastest = float(np.nanmax(np.abs(readings.spin_rate), initial=0.0))
    # with fewer rows the angle is ambiguous, and what turns with the rotor may be taken for what stands still
    if every * float(np.median(np.diff(time))) * fastest < _SLOWEST:
        taken = new_rows({name: readings[name] for name in rest}, numbers, every)
        if taken.any() and all(_new(readings[name], taken) for name in rest):
            return Fix(every=every, without=without)
    left = absent | held.keys()
    if left.isdisjoint(_TILTS) and not left >= {"spin_angle", "spin_rate"} and not left >= _TORQUES:
        return Fix(without=tuple(held))
    return Fix()


def _new(values: Array, taken: NDArray[np.bool_]) -> bool:
    """Whether a held reading is new in the rows that are taken, but for values that are equal by chance."""
    changed = np.r_[True, np.diff(values) != 0.0]
    return bool(
        np.mean(changed[taken]) > _SOME_NEW * min(1.0, np.count_nonzero(changed) / np.count_nonzero(taken))
    )
