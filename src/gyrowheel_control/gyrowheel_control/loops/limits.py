"""Limits of setpoints: those beyond the tilt limit, and invalid ones."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gyrowheel_control.plans.demands import USUAL_SHARE
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG
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
    """Return the tilt limit under which a plan runs [rad]: the usual one, or what the plan asks for.

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
    return limit


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

        Parameters
        ----------
        setpoint : sequence of 6 floats
            tilt_x, tilt_y [rad], their rates [rad/s], spin rate [rad/s] and acceleration [rad/s^2].
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
