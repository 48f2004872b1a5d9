"""The taper of spectra."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Amplitudes of its cosines; Harris, F. J. (1978), Proceedings of the IEEE 66 (1), 51-83.
_BLACKMAN_HARRIS = (0.35875, 0.48829, 0.14128, 0.01168)


def taper(samples: int) -> NDArray[np.float64]:
    """Return the Blackman-Harris window, periodic, for so many samples.

    It is not taken from SciPy, whose module for it takes longer to load than a recording takes to be reduced.
    """
    angle = np.linspace(-np.pi, np.pi, samples + 1)
    window = sum((part * np.cos(k * angle) for k, part in enumerate(_BLACKMAN_HARRIS)), np.zeros(samples + 1))
    return window[:-1]
