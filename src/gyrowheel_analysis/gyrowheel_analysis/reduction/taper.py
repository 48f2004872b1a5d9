"""The taper of spectra."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def taper(samples: int) -> NDArray[np.float64]:
    """Return the Blackman-Harris window, periodic, for so many samples."""
    # the library takes long to load, and the node of the drag estimator has no use for it
    from scipy.signal.windows import blackmanharris

    return np.asarray(blackmanharris(samples, sym=False))
