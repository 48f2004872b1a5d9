"""Groups of windows: of the same speed, and of the same tilt direction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.units import DEG

#: Speeds within this fraction of the slowest of a group are the same.
SAME_SPEED = 0.04
#: A tilt below this has no direction [rad].
UPRIGHT = 0.3 * DEG


def speed_groups(spin_rate: Any) -> list[NDArray[np.int64]]:
    """Return the indices of the windows of each speed, slowest first; speeds within 4 % are the same.

    Parameters
    ----------
    spin_rate : ndarray (n,)
        Spin rates [rad/s], positive.
    """
    rates = np.asarray(spin_rate, dtype=float)
    groups: list[list[int]] = []
    for index in np.argsort(rates, kind="stable"):
        if groups and rates[index] <= (1.0 + SAME_SPEED) * rates[groups[-1][0]]:
            groups[-1].append(int(index))
        else:
            groups.append([int(index)])
    return [np.array(group) for group in groups]


def direction_groups(tilt: Any) -> list[NDArray[np.int64]]:
    """Return the indices of the windows of each octant of tilt direction; upright ones first.

    Parameters
    ----------
    tilt : complex ndarray (n,)
        Tilt angles phi_x + i phi_y [rad].
    """
    octant = octants(tilt)
    return [np.flatnonzero(octant == value) for value in np.unique(octant)]


def octants(tilt: Any) -> NDArray[np.int64]:
    """Return the octant of each tilt direction (n,), 0 about the x axis; -1 where the rotor is upright."""
    z = np.asarray(tilt, dtype=complex)
    eighth = np.round(np.angle(z) / (math.pi / 4.0)).astype(np.int64) % 8
    return np.where(np.abs(z) < UPRIGHT, -1, eighth)


def masks(groups: Sequence[NDArray[np.int64]], count: int) -> list[NDArray[np.bool_]]:
    """Return groups of indices as masks of length `count`."""
    result = []
    for group in groups:
        mask = np.zeros(count, dtype=bool)
        mask[group] = True
        result.append(mask)
    return result
