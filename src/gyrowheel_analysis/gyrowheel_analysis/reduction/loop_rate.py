"""Samples that are not those of the loop: how fast the loop is, and what an average of its voltages misses.

The loop answers the noise of its readings with voltages that are real torques and move the rotor. A recording at the
rate of the loop has them all. One at another rate misses some, or shows some more often than others, and its average
voltage is another one than that which acted: the difference is noise.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import ANSWERED, OTHER_RATE
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

_BLOCK, _MOST = 160, 100  # samples, blocks
_LAGS = 12  # samples before a voltage whose tilts it may answer
_STEADY = 75.0  # percent of blocks; so many may lie in moves
_HELD, _AGAIN = (
    6.0,
    0.2,
)  # noises between two samples of one held voltage; part of the steps from which on it is held
_HIGH = 1.5  # by how much the noise of a loop is stronger at half its rate than on average


def loop_period(data: Samples, period: float, bench: Bench) -> float:
    """Return the period of the loop whose voltages a recording shows [s].

    It is that which the bench states, unless the samples say otherwise: where each voltage answers the tilts recorded
    just before it, the loop runs with the samples; where voltages are repeated, it is slower by that.

    Parameters
    ----------
    data : Samples
        The recording, every reading a number.
    period : float
        Its sampling period [s].
    bench : Bench
        The bench as stated.
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
        # block by block: the loop answers otherwise at another speed, and in a move its setpoint as well
        explained = np.percentile([_explained(*block) for block in zip(volts, tilt, strict=True)], _STEADY)
        return period if explained > ANSWERED else stated
    near = _HELD * bench.value("coil_voltage_noise")
    steps = np.diff(volts, axis=1)
    again = float(np.mean((np.abs(steps.real) < near) & (np.abs(steps.imag) < near)))
    found = period / max(1.0 - again, 1e-3) if again > _AGAIN else period
    return stated if abs(found / stated - 1.0) <= OTHER_RATE else found


def _explained(volts: Any, tilt: Any) -> float:
    """Return what part of the fast changes of voltages (n,) the tilts just before them explain."""
    answer, cause = np.diff(volts, 2), np.diff(tilt, 2)
    n = len(answer)
    design = np.stack([cause[_LAGS - k : n - k] for k in range(1, _LAGS + 1)], axis=1)
    target = answer[_LAGS:]
    size = float(np.linalg.norm(target) ** 2)
    if not size > 0.0:
        return 0.0
    fit, *_ = np.linalg.lstsq(design, target, rcond=None)
    # terms explain a part of anything
    left = float(np.linalg.norm(target - design @ fit) ** 2) * len(target) / (len(target) - _LAGS)
    return 1.0 - left / size


def unseen_noise(left: Any, noise: float, samples: float) -> float:
    """Return the noise of a coil voltage as it counts in the average over a window [V].

    Parameters
    ----------
    left : complex ndarray (n,)
        What neither slow motion nor harmonics explain of the readings x + i y [V].
    noise : float
        Noise of a reading [V].
    samples : float
        Samples of the recording for every one of the loop.
    """
    if abs(samples - 1.0) <= OTHER_RATE:
        return noise
    shown = max(float(np.mean(part**2)) for part in (left.real, left.imag))
    if samples < 1.0:
        return max(noise, math.sqrt(shown))
    part = samples % 1.0
    return max(noise, math.sqrt(_HIGH * part * (1.0 - part) / samples * shown))
