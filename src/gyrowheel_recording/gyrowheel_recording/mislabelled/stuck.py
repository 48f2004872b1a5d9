"""Columns that stay at one value while the physics says that they must move."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mislabelled.blocks import BLOCK, NAMES, block_at
from gyrowheel_recording.mislabelled.fixes import WrongSetup
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

_SHORTEST = 3.0  # s at one value
_SPEED = 0.02  # relative change of the speed that voltage, current and speed reading must follow


def stuck(recording: Recording, blocks: Array, bench: Bench) -> list[WrongSetup]:
    """Return the columns that stay at one value for seconds while what they must follow moves."""
    found = []
    for name in NAMES:
        first, last = _longest(recording.readings[name])
        if last == first:
            continue
        begin, end = (float(recording.time[k]) for k in (first, last))
        if end - begin < _SHORTEST:
            continue
        inside = slice(block_at(recording, begin), block_at(recording, end))
        if _must_move(name, inside, blocks, bench):
            found.append(WrongSetup("stuck", (name,), value=float(recording.readings[name][first])))
    return found


def _longest(values: Array) -> tuple[int, int]:
    """Return the first and the last sample of the longest run of one value."""
    edges = np.r_[0, np.flatnonzero(np.diff(values) != 0.0) + 1, len(values)]
    k = int(np.argmax(np.diff(edges)))
    return int(edges[k]), int(edges[k + 1]) - 1


def _must_move(name: str, inside: slice, blocks: Array, bench: Bench) -> bool:
    rows = blocks[inside]
    rows = rows[np.isfinite(rows).all(axis=1)]
    if len(rows) < 2:
        return False
    columns = dict(zip(NAMES, rows.T, strict=True))
    if name == "spin_angle":
        # at a voltage or a speed the angle turns, whatever the units
        return bool(np.abs(np.median(columns["spin_rate"])) > 0.0 or np.any(columns["motor_voltage"]))
    if name == "spin_rate":
        return _moves(columns["spin_angle"])
    if name in ("motor_voltage", "motor_current"):
        return _moves(columns["spin_angle"]) or _moves(columns["spin_rate"])
    # the torque that the precession of the other axis takes, against the torque of the flexures at full tilt
    most = bench.value("flexure_stiffness_x") * bench.value("tilt_limit")
    if name.startswith("tilt"):
        across = columns["coil_voltage_y" if name == "tilt_x" else "coil_voltage_x"]
        return bool(bench.value("coil_constant") * _range(across) > 2.0 * most)
    across = columns["tilt_y" if name == "coil_voltage_x" else "tilt_x"]
    slew = bench.precession_inertia * np.median(np.abs(columns["spin_rate"])) * np.gradient(across, BLOCK)
    return bool(_range(slew) > 2.0 * most)


def _moves(values: Array) -> bool:
    return bool(_range(values) > _SPEED * np.abs(np.median(values)))


def _range(values: Array) -> float:
    """Return the range of values averaged over a tenth of a second, so that neither ripple nor noise counts."""
    width = round(0.2 / BLOCK)
    if len(values) < 2 * width:
        return 0.0
    smooth = np.convolve(values, np.full(width, 1.0 / width), mode="valid")
    return float(np.ptp(smooth))
