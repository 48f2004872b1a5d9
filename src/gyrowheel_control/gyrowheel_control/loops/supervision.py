"""Supervision of the loops: tilt limits, setpoint limiter, ramp to rest without setpoints, tracking monitor."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gyrowheel_control.plans.demands import USUAL_SHARE
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench

#: Largest tilt of a test, as a share of the hard stop: overshoot and noise need room.
LARGEST_SHARE = 0.95
#: A setpoint of the spin rate beyond this multiple of the largest one of the bench is refused.
_SPIN_MARGIN = 1.1


def usual_tilt_limit(bench: Bench) -> float:
    """Return the tilt limit of tests that do not ask for more [rad]."""
    return USUAL_SHARE * bench.value("tilt_limit")


def largest_tilt_limit(bench: Bench) -> float:
    """Return the largest tilt limit that a test can ask for [rad]: a little less than the hard stop."""
    return LARGEST_SHARE * bench.value("tilt_limit")


def tilt_limit(bench: Bench, wanted: float, where: str) -> float:
    """Return the requested tilt limit [rad], or the usual one for 0.

    Raises
    ------
    InputError
        If it is beyond `largest_tilt_limit`; `where` begins the message.
    """
    largest = largest_tilt_limit(bench)
    if wanted > largest * (1.0 + 1e-9):
        raise InputError(
            f"{where}: a tilt limit of {wanted / DEG:.2f} deg is too near to the hard stop at "
            f"{bench.value('tilt_limit') / DEG:.2f} deg; allowed: up to {largest / DEG:.2f} deg"
        )
    return wanted or usual_tilt_limit(bench)


def plan_tilt_limit(plan: Plan, bench: Bench, usual: float) -> float:
    """Return the tilt limit under which a plan runs [rad]: the usual one, what the plan asks for, or where it begins.

    Parameters
    ----------
    plan : Plan
        The plan.
    bench : Bench
        The bench.
    usual : float
        Limit for plans that say nothing [rad].

    Raises
    ------
    InputError
        If the plan goes beyond the limit, or its own limit is too near to the hard stop.
    """
    limit = usual
    if plan.tilt_limit is not None:
        limit = max(usual, tilt_limit(bench, plan.tilt_limit, f"{plan.origin}: tilt_limit_deg"))
    for index, segment in enumerate(plan.segments):
        tilt = abs(segment.tilt)
        if tilt > limit * (1.0 + 1e-9):
            where = f"{plan.origin}: segment {index}" + (f" ({segment.label})" if segment.label else "")
            largest = largest_tilt_limit(bench)
            raise InputError(
                f"{where}: tilt {tilt / DEG:.2f} deg is beyond the tilt limit of {limit / DEG:.2f} deg; "
                f"a plan that needs more says so by tilt_limit_deg, up to {largest / DEG:.2f}"
            )
    # a plan before may have ended beyond it, and is held there
    return max(limit, min(abs(plan.segments[0].tilt_from), largest_tilt_limit(bench)))


class SetpointGuard:
    """Keeps setpoints within the tilt limit and refuses invalid ones.

    Parameters
    ----------
    bench : Bench
        The bench.
    limit : float
        Tilt limit [rad].

    Attributes
    ----------
    limit : float
        As given; may be changed at any time.
    limited, refused : int
        Setpoints beyond the limit, which were reduced to it in the same direction and at rest; setpoints refused.
    """

    def __init__(self, bench: Bench, limit: float) -> None:
        self._spin_limit = _SPIN_MARGIN * bench.value("spin_rate_maximum")
        self.limit = limit
        self.limited = self.refused = 0

    def admit(self, setpoint: Sequence[float]) -> tuple[float, ...] | None:
        """Return the setpoint that the loops may follow, or None for an invalid one.

        `setpoint`: tilt_x, tilt_y [rad], their rates [rad/s], spin rate [rad/s] and acceleration [rad/s^2].
        """
        x, y, _, _, spin, _ = setpoint
        if not all(map(math.isfinite, setpoint)) or not 0.0 <= spin <= self._spin_limit:
            self.refused += 1
            return None
        tilt = math.hypot(x, y)
        if tilt <= self.limit * (1.0 + 1e-9):
            return tuple(setpoint)
        self.limited += 1
        share = self.limit / tilt
        return (x * share, y * share, 0.0, 0.0, *setpoint[4:])


#: Time for which the last setpoint is held after their loss, before the wheel is brought to rest [s].
HOLD_TIME = 1.0
#: How fast it is then brought to rest: the tilt [rad/s], the spin rate [rad/s^2].
REST_TILT_RATE, REST_SPIN_RATE = 2.0 * DEG, 100.0
#: Below this the gyroscopic loop cannot hold the tilt: the coils are off on the way to rest [rad/s].
LOWEST_SPIN = 100.0
#: An error that has fallen to this share of what it was is still falling.
_NEARER = 0.9


class Rest:
    """Ramp from the last setpoint to rest: held for `HOLD_TIME`, then tilt and spin go to zero.

    `setpoint`: the last setpoint (`gyrowheel_control.loops.kernel.SetpointColumn`); `since_ns`: from when on
    none holds [ns].
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
    """Monitor of tracking: whether the wheel follows its setpoints.

    The wheel may lag on a ramp, and a step may take long: only an error counts that persists at a constant setpoint
    and does not decrease.

    `tilt`, `spin`: errors beyond which the wheel is off: of the tilt [rad], of the spin rate [rad/s];
    `patience`: how long it may be [s].
    """

    def __init__(self, tilt: float, spin: float, patience: float) -> None:
        self._tilt_squared, self._spin = tilt * tilt, spin
        self._patience = patience
        self._since: int | None = None  # when the error was last seen to fall, or the setpoint to move [ns]
        self._off = math.inf  # the error over its bound then
        #: Setpoint and reading, in one line, once the wheel has not followed for too long; empty while it
        #: follows.
        self.lost = ""

    def observe(
        self, stamp: int, tilt_x: float, tilt_y: float, spin_rate: float, setpoint: Sequence[float]
    ) -> bool:
        """Compare a sample with the setpoint in force; return whether the wheel has just been lost.

        `stamp`: stamp of the sample [ns]; `tilt_x`, `tilt_y`: tilt [rad]; `spin_rate`: spin rate [rad/s];
        `setpoint`: the setpoint (`gyrowheel_control.loops.kernel.SetpointColumn`).
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
