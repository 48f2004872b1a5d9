"""Held readings: those of a slower instrument, repeated row by row until there is a new one."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.readings import Readings
from gyrowheel_recording.mislabelled import Fix, WrongSetup
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
#: Readings that follow from others, and these.
_DERIVED: Final = {
    "spin_rate": "spin_angle", "motor_current": "motor_voltage", "motor_voltage": "motor_current",
}  # fmt: skip
_VOLTAGES: Final = ("coil_voltage_x", "coil_voltage_y", "motor_voltage")
_SLOWEST: Final = (
    0.9 * math.pi
)  # rad between two rows, beyond which the angle does not show how far the shaft turned


def rows_a_value(values: Array, numbers: NDArray[np.int64] | None = None) -> float:
    """Return over how many rows each value of a reading (n,) is repeated; 1 for one that is new in every row.

    `numbers` (n,) are those of the samples, where some are missing.
    """
    runs, changes, places = _runs(values, np.arange(len(values)) if numbers is None else numbers)
    digit = 32.0 * np.finfo(float).eps * float(np.nanmax(np.abs(values), initial=0.0))
    sizes = changes[changes > digit]
    if len(runs) < _FEWEST or len(sizes) < _FEWEST:
        return 1.0
    # an angle changes by nearly the same from row to row: its steps show in how much that differs
    gaps = np.diff(np.unique(sizes))
    usual, step = (
        float(np.median(sizes)),
        float(min(sizes.min(), np.min(gaps[gaps > digit], initial=math.inf))),
    )
    ratio = usual / step
    if ratio < _COARSE:
        return _even_rows(places, changes, step)
    moving = runs[runs <= max(_PAUSES * float(np.median(runs)), 2.0)]
    if float(np.mean(moving > 1)) < max(_REPEATED, _BY_CHANCE / ratio):
        return 1.0
    mean = float(np.mean(moving))
    # a new value that equals the last one by chance makes two stretches one
    whole = float(np.median(moving))
    rows = whole if whole > 1.0 and np.mean(np.remainder(moving, whole) == 0.0) > _EVEN else mean
    return rows if rows <= _MOST else 1.0


def _runs(values: Array, numbers: NDArray[np.int64]) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return the lengths of stretches of one value, the sizes of the changes between, and the rows of these."""
    starts = np.unique(np.linspace(0, max(len(values) - _LENGTH, 0), _PIECES).astype(np.int64))
    ends = np.append(np.maximum(starts[1:], 0), len(values))
    low, high = float(np.nanmin(values, initial=math.inf)), float(np.nanmax(values, initial=-math.inf))
    runs, changes, places = [], [], []
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
    if not runs:
        return np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int64)
    return np.concatenate(runs).astype(np.float64), np.concatenate(changes), np.concatenate(places)


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
    the same for all.
    """
    held = held_readings(readings, time, numbers, bench)
    if not held:
        return []
    without = tuple(
        name for name in held if (other := _DERIVED.get(name)) and other not in held and other not in absent
    )
    without = () if set(held) >= {"motor_current", "motor_voltage"} else without
    rest = {name: rows for name, rows in held.items() if name not in without}
    every = round(max(rest.values(), default=1.0))
    whole = all(abs(rows - round(rows)) < _WHOLE and every % round(rows) == 0 for rows in rest.values())
    fastest = float(np.nanmax(np.abs(readings.spin_rate), initial=0.0))
    shown = every * float(np.median(np.diff(time))) * fastest < _SLOWEST
    cure = Fix(every=every, without=without) if whole and shown else Fix()
    by_rows: dict[float, list[str]] = {}
    for name, rows in held.items():
        by_rows.setdefault(round(rows, 1), []).append(name)
    return [WrongSetup("held", tuple(names), cure, value=rows) for rows, names in sorted(by_rows.items())]
