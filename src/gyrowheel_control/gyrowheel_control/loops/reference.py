"""Setpoints where none come any more, and whether the wheel follows those that do; no ROS, no clock."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gyrowheel_core.units import DEG, RPM

#: How long the last setpoint is held when no more come, before the wheel is brought to rest [s].
HOLD_TIME = 1.0
#: How fast it is then brought to rest: the tilt [rad/s], the spin rate [rad/s^2].
REST_TILT_RATE, REST_SPIN_RATE = 2.0 * DEG, 100.0
#: Below this the gyroscopic loop cannot hold the tilt: the coils are off on the way to rest [rad/s].
LOWEST_SPIN = 100.0
#: An error that has fallen to this share of what it was is still falling.
_NEARER = 0.9


class Rest:
    """The way from the last setpoint to rest: held for `HOLD_TIME`, then the tilt back to zero and the spin down.

    Parameters
    ----------
    setpoint : sequence of 6 floats
        The last setpoint (`gyrowheel_control.loops.state.SetpointColumn`).
    since_ns : int
        From when on none holds [ns].
    """

    def __init__(self, setpoint: Sequence[float], since_ns: int) -> None:
        self._tilt_x, self._tilt_y, _, _, self._spin, _ = setpoint
        self._since = since_ns

    def at(self, now_ns: int) -> tuple[float, ...]:
        """Return the setpoint of a time [ns]; its rates are zero, so that it stands still between two samples."""
        resting = max((now_ns - self._since) * 1e-9 - HOLD_TIME, 0.0)
        tilt = math.hypot(self._tilt_x, self._tilt_y)
        left = max(1.0 - REST_TILT_RATE * resting / tilt, 0.0) if tilt else 0.0
        spin = math.copysign(max(abs(self._spin) - REST_SPIN_RATE * resting, 0.0), self._spin)
        return (left * self._tilt_x, left * self._tilt_y, 0.0, 0.0, spin, 0.0)


class Tracking:
    """Whether the wheel follows its setpoints.

    A ramp may leave the wheel behind, and a step may take long: only an error counts that lasts while the setpoint
    stands still, and that does not fall.

    Parameters
    ----------
    tilt, spin : float
        Errors beyond which the wheel is off: of the tilt [rad], of the spin rate [rad/s].
    patience : float
        How long it may be [s].

    Attributes
    ----------
    lost : str
        What was asked and what there is, in one line, once the wheel has been off for too long; empty while it follows.
    """

    def __init__(self, tilt: float, spin: float, patience: float) -> None:
        self._tilt_squared, self._spin = tilt * tilt, spin
        self._patience = patience
        self._since: int | None = None  # when the error was last seen to fall, or the setpoint to move [ns]
        self._off = math.inf  # the error over its bound then
        self.lost = ""

    def observe(
        self, stamp: int, tilt_x: float, tilt_y: float, spin_rate: float, setpoint: Sequence[float]
    ) -> bool:
        """Look at a sample and the setpoint that it is to follow; return whether the wheel has just been lost.

        Parameters
        ----------
        stamp : int
            Stamp of the sample [ns].
        tilt_x, tilt_y : float
            Tilt [rad].
        spin_rate : float
            Spin rate [rad/s].
        setpoint : sequence of 6 floats
            The setpoint (`gyrowheel_control.loops.state.SetpointColumn`).
        """
        x, y, rate_x, rate_y, spin, acceleration = setpoint
        error_x, error_y, error = tilt_x - x, tilt_y - y, spin_rate - spin
        tilt_error = error_x * error_x + error_y * error_y
        if tilt_error < self._tilt_squared and -self._spin < error < self._spin:
            self._since, self.lost = None, ""
            return False
        if self.lost:
            return False
        off = max(math.sqrt(tilt_error / self._tilt_squared), abs(error) / self._spin)
        if rate_x or rate_y or acceleration or self._since is None or off < _NEARER * self._off:
            self._since, self._off = stamp, off
            return False
        if stamp - self._since <= self._patience * 1e9:
            return False
        self.lost = (
            f"the wheel does not follow: asked {math.hypot(x, y) / DEG:.2f} deg and {spin / RPM:.0f} rpm, "
            f"got {math.hypot(tilt_x, tilt_y) / DEG:.2f} deg and {spin_rate / RPM:.0f} rpm for {self._patience:g} s"
        )
        return True
