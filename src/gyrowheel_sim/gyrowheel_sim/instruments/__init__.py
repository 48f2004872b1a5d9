"""The instruments of the bench: their frequency response; one sample of all of them is a row.

`readings` has the layout of the arrays, `kernel` computes the readings as part of the compiled plant.

Tilts and angles change smoothly, so their readings have the response of the analogue chain. Voltages are held between
latches. Their converters give the mean over one sampling period, which without delay is the held voltage itself; over
time, that mean is the straight line from each held voltage to the next, and what is delayed and filtered is that line.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_ALIASES = np.arange(-16, 17)


def smooth_response(omega: Any, delay: Any, time: Any = 0.0, order: Any = 1) -> NDArray[np.complex128]:
    """Return the response of a reading of a smooth quantity: tilt, angle.

    Parameters
    ----------
    omega : array
        Angular frequency [rad/s].
    delay, time : float
        Delay, and time constant of each pole of the filter [s].
    order : int
        Number of poles.
    """
    omega = np.asarray(omega, dtype=np.float64)
    response: NDArray[np.complex128] = np.exp(-1j * omega * delay) / (1.0 + 1j * omega * time) ** order
    return response


def held_response(
    omega: Any, delay: float, time: float = 0.0, order: int = 1, *, period: float
) -> NDArray[np.complex128]:
    """Return the response of a reading of a quantity that is held for each sampling period: voltages, motor current.

    Parameters are those of `smooth_response`; `period` is the sampling period [s]. It is 1 without delay and filter,
    and differs from `smooth_response` by a part of (omega period)^2 / 8 at most.
    """
    omega = np.asarray(omega, dtype=np.float64)
    if time == 0.0:
        samples, part = divmod(delay / period, 1.0)
        mixed = (1.0 - part) + part * np.exp(-1j * omega * period)
        response: NDArray[np.complex128] = np.exp(-1j * omega * samples * period) * mixed
        return response
    # the spectrum of the straight lines between samples, folded back by the sampling
    at = omega[..., None] + 2.0 * np.pi / period * _ALIASES
    lines = np.sinc(0.5 * at * period / np.pi) ** 2
    return np.asarray((lines * smooth_response(at, delay, time, order)).sum(axis=-1), dtype=np.complex128)
