"""The columns of a recording that the reduction needs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.readings import Readings
from gyrowheel_recording.derived import Origin
from gyrowheel_sim.environment import Environment

Array = NDArray[np.float64]

#: Part by which the clock of a recording of the bench's own rate may be off.
_SAME_RATE = 0.05


@dataclass(frozen=True)
class Commanded:
    """Coil voltages that were commanded for the interval that ends with each sample, looked up when they are asked for.

    Attributes
    ----------
    voltages : (ndarray, ndarray)
        Coil voltages of the commands, x and y [V].
    places : ndarray of int (n,)
        Which of the commands was for the interval of each sample.
    """

    voltages: tuple[Array, Array]
    places: NDArray[np.integer]

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.places)

    def __getitem__(self, rows: Any) -> Commanded:
        """Return those of some of the samples."""
        return Commanded(self.voltages, self.places[rows])

    def at(self, rows: Any, axis: int) -> Array:
        """Return what was commanded to coil x or y (`axis` 0 or 1) for some of the samples [V]."""
        found: Array = self.voltages[axis][self.places[rows]]
        return found


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
    commanded : Commanded, optional
        Coil voltages that were commanded; None where unknown.
    absent : frozenset of str
        Readings that were never taken; `derived` says what stands for them.
    origins : mapping of str to Origin
        Where readings come from that no instrument of their own took.
    """

    time: Array
    readings: Readings
    setpoint_time: Array
    setpoint: Any
    environment: Sequence[Environment] = ()
    part: tuple[float, float] = (-math.inf, math.inf)
    sequence: NDArray[np.integer] | None = None
    commanded: Commanded | None = None
    absent: frozenset[str] = frozenset()
    origins: Mapping[str, Origin] = field(default_factory=dict)

    @property
    def summed(self) -> bool:
        """Whether the angle is a sum of the speed, with or without pulses that say where it is once in a while."""
        origin = self.origins.get("spin_angle")
        return "spin_angle" in self.absent or (origin is not None and origin.pulses > 0)

    def period(self, stated: float) -> float:
        """Return the sampling period of the recording [s].

        A recording may be of another rate than the loop of its bench. Where its stamps agree with the `stated` period
        of the bench, that one holds: by how much the clock is off is for the diagnosis to find.
        """
        one = self._usual_step
        if math.isnan(one) or abs(one / stated - 1.0) < _SAME_RATE:
            return stated
        steps = self._steps()
        return float(np.mean(steps[np.abs(steps / one - 1.0) < 0.5]))

    @cached_property
    def _usual_step(self) -> float:
        """Median time from one sample to the next one [s], NaN where there is none; hours of them are sorted once."""
        steps = self._steps()
        return float(np.median(steps, overwrite_input=True)) if len(steps) else math.nan

    def _steps(self) -> Array:
        """Return the times from one sample to the next one [s], where they are positive."""
        steps = np.diff(self.time)
        if self.sequence is not None and len(self.sequence) == len(self.time):
            passed = np.diff(self.sequence.astype(np.int64))
            steps /= np.maximum(passed, 1, out=passed)
        return steps[steps > 0.0]
