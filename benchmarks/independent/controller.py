"""Tilt and spin loops of the published structure with other filters, gains and arithmetic."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BANDWIDTH = 10.0  # of the tilt loop [1/s]
_INTEGRAL = 22.0  # [1/s^2]
_TILT_FILTER = 30.0  # Butterworth of second order [Hz]
_RATE_FILTER = 350.0  # of the derivative, first order by the trapezoidal rule [Hz]
_DAMPING = 0.16  # of the nutation, over the momentum of the spin
_SPIN_GAIN = 5.2  # over the inertia [1/s]
_SPIN_INTEGRAL = 7.0  # [1/s^2]
_SPIN_FILTER = 5.0  # Butterworth of second order [Hz]


class Controller:
    """The controller: computes the voltages that answer a sample.

    Parameters
    ----------
    stated : mapping
        The numbers of the bench file [SI], its only input.
    gain : float
        Factor of all gains.
    """

    def __init__(self, stated: Mapping[str, float], gain: float = 1.0) -> None:
        h = stated["sample_period"]
        momentum = stated["rotor_inertia_z"] + stated["gimbal_inertia_x"]
        inertia = stated["rotor_inertia_z"] + stated["gimbal_inertia_z"] + stated["shaft_inertia"]
        transverse = stated["rotor_inertia_x"] + 0.5 * stated["gimbal_inertia_x"]
        # one sample of delay, half of one for the hold, half for the difference, and the filter
        late = 2.0 * h + 1.0 / (2.0 * math.pi * _RATE_FILTER)
        self._p = np.array(
            [
                h,
                gain * _BANDWIDTH,
                gain * gain * _INTEGRAL,
                gain * _DAMPING,
                momentum,
                momentum / transverse * late,
                stated["flexure_stiffness_x"],
                0.5 * (stated["gimbal_inertia_x"] + stated["gimbal_inertia_y"] - stated["gimbal_inertia_z"]),
                stated["coil_constant"],
                stated["coil_voltage_limit"],
                gain * _SPIN_GAIN * inertia,
                gain * gain * _SPIN_INTEGRAL * inertia,
                inertia,
                stated["motor_constant"],
                stated["motor_resistance"],
                stated["supply_voltage"],
                2.0 / h * math.tan(math.pi * _RATE_FILTER * h),
            ]
        )
        self._tilt_filter = _butterworth(_TILT_FILTER, h)
        self._spin_filter = _butterworth(_SPIN_FILTER, h)
        self._state = np.zeros(18)
        self._out = np.zeros(3)

    def start(self, tilt_x: float, tilt_y: float, spin: float) -> None:
        """Initialise the filters to the steady state of these readings."""
        self._state[:] = 0.0
        for place, value in ((0, tilt_x), (2, tilt_y), (4, spin)):
            f = self._spin_filter if place == 4 else self._tilt_filter
            self._state[place] = value * (1.0 - f[0])
            self._state[place + 1] = value * (f[2] - f[4])
        self._state[6], self._state[7] = tilt_x, tilt_y

    def answer(
        self, tilt_x: float, tilt_y: float, spin: float,
        tilt: complex, tilt_rate: complex, speed: float, speed_rate: float,
    ) -> tuple[float, float, float]:  # fmt: skip
        """Return the voltages of two coils and the motor for a sample and its setpoint."""
        _answer(
            self._p, self._tilt_filter, self._spin_filter, self._state, tilt_x, tilt_y, spin,
            tilt.real, tilt.imag, tilt_rate.real, tilt_rate.imag, speed, speed_rate, self._out,
        )  # fmt: skip
        return float(self._out[0]), float(self._out[1]), float(self._out[2])


def _butterworth(corner: float, h: float) -> Array:
    """Return (b0, b1, b2, a1, a2) of a second-order low-pass, by the bilinear transform."""
    w = math.tan(math.pi * corner * h)
    n = 1.0 / (1.0 + math.sqrt(2.0) * w + w * w)
    return np.array(
        [
            w * w * n,
            2.0 * w * w * n,
            w * w * n,
            2.0 * (w * w - 1.0) * n,
            (1.0 - math.sqrt(2.0) * w + w * w) * n,
        ]
    )


@njit(cache=True)
def _filtered(f: Any, s: Any, at: int, x: float) -> float:
    """Advance a second-order filter (transposed form) whose two states are at `at`."""
    y = f[0] * x + s[at]
    s[at] = f[1] * x - f[3] * y + s[at + 1]
    s[at + 1] = f[2] * x - f[4] * y
    return float(y)


@njit(cache=True)
def _answer(
    p: Any, tilt_filter: Any, spin_filter: Any, s: Any, x: float, y: float, spin: float,
    rx: float, ry: float, rx_rate: float, ry_rate: float, speed: float, speed_rate: float, out: Any,
) -> None:  # fmt: skip
    h, bandwidth, integral, damping, momentum, lead, stiffness, tuning, k, limit = p[:10]
    spin_gain, spin_integral, inertia, km, resistance, supply, corner = p[10:]
    low_x, low_y = _filtered(tilt_filter, s, 0, x), _filtered(tilt_filter, s, 2, y)
    w = _filtered(spin_filter, s, 4, spin)
    # rate of the tilt: corner s / (s + corner) by the trapezoidal rule
    q = 2.0 / (2.0 + corner * h)
    s[8] = (2.0 - corner * h) / (2.0 + corner * h) * s[8] + corner * q * (x - s[6])
    s[9] = (2.0 - corner * h) / (2.0 + corner * h) * s[9] + corner * q * (y - s[7])
    s[6], s[7] = x, y
    ex, ey = rx - low_x, ry - low_y
    vx = bandwidth * ex + integral * s[10] + rx_rate
    vy = bandwidth * ey + integral * s[11] + ry_rate
    spring = stiffness - tuning * w * w
    turn, gain = lead * w, damping * momentum * w
    c, d = math.cos(turn), math.sin(turn)
    ux, uy = s[8] - rx_rate, s[9] - ry_rate
    tx = momentum * w * vy + spring * rx - gain * (c * ux - d * uy)
    ty = -momentum * w * vx + spring * ry - gain * (d * ux + c * uy)
    out[0], out[1] = min(max(tx / k, -limit), limit), min(max(ty / k, -limit), limit)
    if out[0] == tx / k and out[1] == ty / k:
        s[10] += h * ex
        s[11] += h * ey
    error = speed - w
    volts = km * speed + resistance / km * (spin_gain * error + spin_integral * s[12] + inertia * speed_rate)
    out[2] = min(max(volts, -supply), supply)
    if out[2] == volts:
        s[12] += h * error
