"""Ways in which a residual may depend on the motion."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.reduction import Windows
from gyrowheel_core.units import DEG


def pattern(name: str, w: Windows, load: NDArray[Any] | None = None) -> NDArray[Any]:
    """Return a way in which a residual may depend on the motion, for an amplitude of one; zero where it is not there.

    ``tilt``: the tilt [rad]; ``mirror``: its mirror image; ``square``: its square; ``cube``: its cube;
    ``rate``: its rate [rad/s];
    ``load``: what the model asks of the coils [N m]; ``still``: one; ``acceleration``: of the spin [rad/s^2];
    ``table``: rate of the table about the axes of the case [rad/s]; ``room``: a direction that stands in the room while
    the rig turns.
    """
    z = np.asarray(w.mean_tilt)
    if name == "tilt":
        return z
    if name == "mirror":
        return np.conj(z)
    if name == "cube":
        return z * np.abs(z) ** 2
    if name == "square":
        return np.abs(z) ** 2
    if name == "rate":
        return np.where(np.abs(w.mean_tilt_rate) > 0.5 * DEG, w.mean_tilt_rate, 0.0)
    if name == "load":
        return np.zeros(len(w)) if load is None else load
    if name == "acceleration":
        return np.where(np.abs(w.mean_spin_acceleration) > 1.0, w.mean_spin_acceleration, 0.0)
    if name == "table":
        return np.asarray(w.table_rate * w.up_across)
    if name == "room":
        # where the rig is not turned it is the same as a direction in the case
        return w.home_x if np.ptp(np.angle(w.home_x * np.exp(0.1j))) > 0.1 else np.zeros(len(w))
    return np.ones(len(w))
