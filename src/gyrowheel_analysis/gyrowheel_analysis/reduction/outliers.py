"""Noise of the readings that is not Gaussian: heavy tails and bursts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import FEWEST_OUTLIERS, OUTLIER, OUTLIER_BLOCKS, OUTLIER_SHARE
from gyrowheel_analysis.reduction.samples import Samples

_BLOCK = 500  # samples with a scale of their own
_BLOCKS_OF_WINDOW = 16
_SMALLEST_BLOCK, _LARGEST_BLOCK = 8, 256  # samples; the latter as in the noise of a recording
_FEWEST_OF_WINDOW = 3  # outliers of a window: a single reading changes three second differences
_SAME_RUN = 20  # samples; outliers that are closer belong together
_MEDIAN_OF_GAUSSIAN = 0.6745  # of the absolute value, in standard deviations
#: Readings that show the noise of a channel. Voltages are left out: they answer the noise of tilt and speed.
_SHOWING = {
    "tilt": ("tilt_x", "tilt_y"),
    "spin_angle": ("spin_angle",),
    "spin_rate": ("spin_rate",),
    "motor_current": ("motor_current",),
}


class Outliers(NamedTuple):
    """Samples of a reading far outside of its Gaussian noise: their share, and how many come together on average."""

    share: float
    together: float


def outliers(data: Samples, spans: Sequence[tuple[float, float]], period: float) -> dict[str, Outliers]:
    """Return the outliers of readings whose noise is not Gaussian, by channel.

    The second differences of the samples of a steady motion, `spans` of time [s], show little but noise; every block of
    them has a scale of its own, because the motion differs. `period` is that of the samples [s].
    """
    even = np.diff(data.time) < 1.5 * period
    blocks = [
        (start, min(start + _BLOCK, stop))
        for first, last in np.searchsorted(data.time, spans).tolist()
        for start, stop in ((k, last) for k in range(first, last - _BLOCK // 2, _BLOCK))
    ]
    found = {}
    for channel, names in _SHOWING.items():
        shown = far = runs = with_one = 0
        for name in set(names) - data.absent:
            for first, last in blocks:
                own, size = _far(
                    data.readings[name][first:last], even[first : last - 1], name == "spin_angle"
                )
                shown, far, with_one = shown + size, far + len(own), with_one + bool(len(own))
                runs += int(np.sum(np.diff(own, prepend=-_BLOCK) > _SAME_RUN))
        if far >= max(FEWEST_OUTLIERS, OUTLIER_SHARE * shown) and with_one >= OUTLIER_BLOCKS:
            found[channel] = Outliers(far / shown, far / runs)
    return found


def _far(values: NDArray[np.float64], even: NDArray[np.bool_], turning: bool) -> tuple[NDArray[np.intp], int]:
    """Return the places of the outliers among consecutive samples, and the number of differences."""
    second = np.diff(np.unwrap(values) if turning else values, 2)[even[1:] & even[:-1]]
    scale = float(np.median(np.abs(second))) / _MEDIAN_OF_GAUSSIAN if len(second) else 0.0
    far = np.flatnonzero(np.abs(second) > OUTLIER * scale) if scale > 0.0 else np.zeros(0, dtype=np.intp)
    return far, len(second)


def noise_excess(left: NDArray[Any]) -> float:
    """Return the factor by which outliers raise the mean square of the noise in a window; 1 without outliers.

    `left` (n,) are the readings of the window without the motion. The noise of a recording is the median over many
    blocks, which excludes bursts: the factor is the mean over the blocks of the window divided by their median.
    """
    second = np.diff(left, 2)
    parts = (second.real, second.imag) if np.iscomplexobj(second) else (second,)
    block = min(_LARGEST_BLOCK, len(second) // _BLOCKS_OF_WINDOW)
    size = np.max([np.abs(part) for part in parts], axis=0)
    scale = float(np.median(np.abs(parts))) / _MEDIAN_OF_GAUSSIAN
    if block < _SMALLEST_BLOCK or np.sum(size > OUTLIER * scale) < _FEWEST_OF_WINDOW:
        return 1.0
    squares = np.abs(second[: len(second) // block * block].reshape(-1, block)) ** 2
    levels = squares.mean(axis=1)
    return max(float(levels.mean() / np.median(levels)), 1.0) if levels.any() else 1.0
