"""Outliers of readings: their share in a recording, and the noise that they add to a window."""

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
_FEWEST_CLEAN = 3  # blocks
_SECOND_OF_WHITE = 6.0  # mean square of second differences of white noise, over its own
_FEWEST_OF_WINDOW = 3  # outliers of a window: one reading makes three second differences
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

    The second differences of the samples of a steady motion, `spans` of time [s], show little but noise. Each block of
    them has its own scale, because the motion differs. `period` is the sample period [s].
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


def noise_excess(left: NDArray[Any], noise: float) -> NDArray[np.float64]:
    """Return the factors by which outliers raise the mean square of the noise at the samples of a window, (n,).

    `left` (n,) are the readings of the window without the motion; `noise` is that of the recording, the median over
    many blocks, which excludes bursts; zero where it is not known. Without outliers the factors are 1; else each is
    that of a block over the median of all blocks, or over blocks without outliers where a burst reaches most of them.
    """
    second = np.diff(left, 2)
    parts = np.stack((second.real, second.imag)) if np.iscomplexobj(second) else second[None]
    block = min(_LARGEST_BLOCK, parts.shape[1] // _BLOCKS_OF_WINDOW)
    usual = _SECOND_OF_WHITE * noise**2 or np.inf
    scale = min(float(np.median(np.abs(parts))) / _MEDIAN_OF_GAUSSIAN, np.sqrt(usual))
    far = np.abs(parts).max(axis=0) > OUTLIER * scale
    if block < _SMALLEST_BLOCK or np.sum(far) < _FEWEST_OF_WINDOW or scale == 0.0:
        return np.ones(len(left))
    whole = parts.shape[1] // block * block
    levels = np.mean(parts[:, :whole] ** 2, axis=0).reshape(-1, block).mean(axis=1)
    clean = levels[~far[:whole].reshape(-1, block).any(axis=1)]
    if len(clean) >= _FEWEST_CLEAN:
        usual = float(clean.mean())
    factor = np.repeat(levels / min(usual, float(np.median(levels))), block)
    factor = np.pad(factor, (1, len(left) - whole - 1), mode="edge")
    return np.asarray(factor / min(float(factor.mean()), 1.0))
