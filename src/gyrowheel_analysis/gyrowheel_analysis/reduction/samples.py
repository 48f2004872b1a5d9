"""The columns of a recording that the reduction needs, and the rate of the loop that they show.

The loop answers the noise of its readings with voltages that are real torques and move the rotor. A recording at the
rate of the loop has all of them. At another rate it misses or repeats some, so that its average voltage differs from
the one that acted: the difference is noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import ANSWERED, OTHER_RATE
from gyrowheel_core.readings import Readings
from gyrowheel_recording.derived import Origin
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import Environment

Array = NDArray[np.float64]

#: Part by which the clock of a recording of the bench's own rate may be off.
_SAME_RATE = 0.05


@dataclass(frozen=True)
class Commanded:
    """Coil voltages that were commanded for the interval that ends with each sample, looked up on demand.

    `voltages` has those of all commands, x and y [V]; `places` (n,) the command for the interval of each sample.
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
        """Return the command of coil x or y (`axis` 0 or 1) for some of the samples [V]."""
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
        Times of the setpoints [s]; empty without setpoints.
    setpoint : structured ndarray (m,)
        Setpoints, with the fields of the Setpoint message.
    environment : sequence of Environment
        Known changes of the environment.
    part : (float, float)
        Range of times in which steady motion is looked for [s].
    sequence : ndarray (n,), optional
        Numbers of the samples, ascending.
    commanded : Commanded, optional
        Coil voltages that were commanded; None where unknown.
    absent : frozenset of str
        Readings that were never taken, with substitutes from `gyrowheel_recording.derived`.
    origins : mapping of str to Origin
        Origins of readings that were derived from others.
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
        """Whether the angle is an integral of the speed, with or without pulses as references."""
        origin = self.origins.get("spin_angle")
        return "spin_angle" in self.absent or (origin is not None and origin.pulses > 0)

    def period(self, stated: float) -> float:
        """Return the sampling period of the recording [s].

        The rate may differ from that of the loop of the bench. Stamps that agree with the `stated` period of the bench
        give that period: the error of the clock is a matter of the diagnosis.
        """
        one = self._usual_step
        if math.isnan(one) or abs(one / stated - 1.0) < _SAME_RATE:
            return stated
        return self._mean_step

    # cached: both are asked for once a window, and take all samples

    @cached_property
    def _mean_step(self) -> float:
        """Mean time from one sample to the next one [s], of the steps that are about the usual one."""
        steps = self._steps()
        return float(np.mean(steps[np.abs(steps / self._usual_step - 1.0) < 0.5]))

    @cached_property
    def _usual_step(self) -> float:
        """Median time from one sample to the next one [s], NaN for a single sample."""
        steps = self._steps()
        return float(np.median(steps, overwrite_input=True)) if len(steps) else math.nan

    def _steps(self) -> Array:
        """Return the times from one sample to the next one [s], where they are positive."""
        steps = np.diff(self.time)
        if self.sequence is not None and len(self.sequence) == len(self.time):
            passed = np.diff(self.sequence.astype(np.int64))
            steps /= np.maximum(passed, 1, out=passed)
        return steps[steps > 0.0]


_BLOCK, _MOST = 160, 100  # samples, blocks
_LAGS = 12  # samples before a voltage whose tilts it may answer
_STEADY = 75.0  # percent of blocks; the rest may lie in moves
#: Noises between two samples of a held voltage; part of the steps from which on it is held.
_HELD, _AGAIN = 6.0, 0.2
_HIGH = 1.5  # noise of a loop at half its rate over its average


def loop_period(data: Samples, period: float, bench: Bench) -> float:
    """Return the period of the loop whose voltages a recording shows [s].

    The bench's stated period holds unless the samples contradict it: where each voltage answers the tilts recorded just
    before it, the loop runs at the sampling `period` [s]; where voltages repeat, it is slower by that. Every reading of
    `data` is a number.
    """
    stated = bench.sample_period
    if abs(period / stated - 1.0) <= OTHER_RATE or len(data.time) < 4 * _BLOCK:
        return stated
    starts = np.linspace(0, len(data.time) - _BLOCK, _MOST).astype(np.int64)
    whole = data.time[starts + _BLOCK - 1] - data.time[starts] < (_BLOCK + 1) * period
    blocks = starts[whole][:, None] + np.arange(_BLOCK)
    if not len(blocks):
        return stated
    own = data.readings
    tilt, volts = (
        own[f"{name}_x"][blocks] + 1j * own[f"{name}_y"][blocks] for name in ("tilt", "coil_voltage")
    )
    if period > stated:
        # block by block: the loop differs at another speed, and in a move answers its setpoint as well
        explained = np.percentile([_explained(*block) for block in zip(volts, tilt, strict=True)], _STEADY)
        return period if explained > ANSWERED else stated
    near = _HELD * bench.value("coil_voltage_noise")
    steps = np.diff(volts, axis=1)
    again = float(np.mean((np.abs(steps.real) < near) & (np.abs(steps.imag) < near)))
    found = period / max(1.0 - again, 1e-3) if again > _AGAIN else period
    return stated if abs(found / stated - 1.0) <= OTHER_RATE else found


def _explained(volts: Any, tilt: Any) -> float:
    """Return the part of the fast changes of voltages (n,) that the preceding tilts explain."""
    answer, cause = np.diff(volts, 2), np.diff(tilt, 2)
    n = len(answer)
    design = np.stack([cause[_LAGS - k : n - k] for k in range(1, _LAGS + 1)], axis=1)
    target = answer[_LAGS:]
    size = float(np.linalg.norm(target) ** 2)
    if not size > 0.0:
        return 0.0
    fit, *_ = np.linalg.lstsq(design, target, rcond=None)
    # correction for the part that any terms explain
    left = float(np.linalg.norm(target - design @ fit) ** 2) * len(target) / (len(target) - _LAGS)
    return 1.0 - left / size


def unseen_noise(left: Any, noise: float, samples: float) -> float:
    """Return the effective noise of a coil voltage in the average over a window [V].

    `left` (n,) are the readings x + i y without slow motion and harmonics [V], `noise` is that of a reading [V], and
    `samples` the number of samples of the recording for each of the loop.
    """
    if abs(samples - 1.0) <= OTHER_RATE:
        return noise
    shown = max(float(np.mean(part**2)) for part in (left.real, left.imag))
    if samples < 1.0:
        return max(noise, math.sqrt(shown))
    part = samples % 1.0
    return max(noise, math.sqrt(_HIGH * part * (1.0 - part) / samples * shown))
