"""The columns of a recording that the reduction needs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.readings import Readings
from gyrowheel_sim.environment import Environment

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Samples:
    """The columns of a recording that the reduction needs.

    Attributes
    ----------
    time : ndarray (n,)
        Sampling instants [s].
    readings : Readings
        Readings [SI] of n samples; a reading that was not taken is not finite.
    setpoint_time : ndarray (m,)
        Times of the setpoints [s]; empty if there are none.
    setpoint : structured ndarray (m,)
        Setpoints, with the fields of the Setpoint message.
    environment : sequence of Environment
        Known changes of the environment.
    part : (float, float)
        Between which times steady motion is looked for [s].
    sequence : ndarray (n,), optional
        Numbers of the samples, ascending.
    commanded : ndarray (n, 2), optional
        Coil voltages that were commanded for the interval that ends with each sample [V]; None where unknown.
    """

    time: Array
    readings: Readings
    setpoint_time: Array
    setpoint: Any
    environment: Sequence[Environment] = ()
    part: tuple[float, float] = (-math.inf, math.inf)
    sequence: NDArray[np.integer] | None = None
    commanded: Array | None = None
