"""What the controller does without setpoints, and when it says that the wheel does not follow."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrowheel_control.loops.supervision import HOLD_TIME, REST_SPIN_RATE, REST_TILT_RATE, Rest, Tracking
from gyrowheel_core.units import DEG, RPM

SECOND = 1_000_000_000
TILT = st.floats(-0.08, 0.08)


@given(TILT, TILT, st.floats(-500.0, 500.0), st.floats(-1.0, 1.0), st.floats(0.0, 60.0))
def test_the_last_setpoint_is_held_then_brought_to_rest(
    x: float, y: float, spin: float, rate: float, after: float
) -> None:
    rest = Rest((x, y, rate, -rate, spin, rate), 7 * SECOND)
    assert rest.at(7 * SECOND) == rest.at(round((7 + HOLD_TIME) * SECOND)) == (x, y, 0.0, 0.0, spin, 0.0)
    now = rest.at(round((7 + after) * SECOND))
    resting = max(after - HOLD_TIME, 0.0)
    assert math.hypot(*now[:2]) == pytest.approx(
        max(math.hypot(x, y) - REST_TILT_RATE * resting, 0.0), abs=1e-9
    )
    assert abs(now[4]) == pytest.approx(max(abs(spin) - REST_SPIN_RATE * resting, 0.0), abs=1e-6)
    assert now[0] * x >= 0.0
    assert now[4] * spin >= 0.0  # straight to rest, never beyond
    assert now[2:4] == (0.0, 0.0)


def tracking() -> Tracking:
    return Tracking(0.5 * DEG, 20.0, 3.0)


STILL = (3.0 * DEG, 0.0, 0.0, 0.0, 1000.0 * RPM, 0.0)


def first_loss(watch: Tracking, samples: Sequence[tuple[float, float, tuple[float, ...]]]) -> float | None:
    """Return when the wheel is lost [s]: one sample of tilt x, spin rate and setpoint every 10 ms."""
    for number, (tilt_x, spin, setpoint) in enumerate(samples):
        if watch.observe(number * SECOND // 100, tilt_x, 0.0, spin, setpoint):
            return number / 100
    return None


def test_lost_tracking_reports_setpoint_and_reading() -> None:
    watch = tracking()
    assert first_loss(watch, [(3.0 * DEG, 3500.0 * RPM, STILL)] * 500) == pytest.approx(3.01)
    assert watch.lost == (
        "the wheel does not follow: asked 3.00 deg and 1000 rpm, got 3.00 deg and 3500 rpm for 3 s"
    )
    assert not watch.observe(6 * SECOND, 3.0 * DEG, 0.0, 1000.0 * RPM, STILL)
    assert watch.lost == ""  # it follows again
    assert first_loss(tracking(), [(2.4 * DEG, 1000.0 * RPM, STILL)] * 500) == pytest.approx(3.01)


def test_a_moving_wheel_is_not_lost() -> None:
    # a small error, for ever
    assert first_loss(tracking(), [(2.6 * DEG, 1000.0 * RPM + 19.0, STILL)] * 2000) is None
    # a step that takes half a minute
    slow = [(3.0 * DEG, (1000.0 + 2500.0 * 0.998**n) * RPM, STILL) for n in range(3000)]
    assert first_loss(tracking(), slow) is None
    # a ramp, far behind
    ramp = (3.0 * DEG, 0.0, 0.0, 0.0, 1000.0 * RPM, 10.0)
    assert first_loss(tracking(), [(0.0, 0.0, ramp)] * 1000) is None
    # what is off now and then
    assert (
        first_loss(tracking(), ([(0.0, 0.0, STILL)] * 200 + [(3.0 * DEG, 1000.0 * RPM, STILL)]) * 10) is None
    )
