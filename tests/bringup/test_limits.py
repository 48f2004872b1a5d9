"""Tilt limits: what a plan needs, what a bench allows, what setpoints are brought back to."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrowheel_control.loops.supervision import (
    SetpointGuard,
    largest_tilt_limit,
    plan_tilt_limit,
    tilt_limit,
    usual_tilt_limit,
)
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG
from gyrowheel_sim.bench import Bench

BENCH = Bench.load()
PLAN = """\
schema: 1
name: lean
segments:
  - {label: lean, spin_rpm: 2000, tilt_deg: [TILT, 0]}
"""


def test_default_bench_has_three_degrees_and_a_hard_stop_at_five():
    assert usual_tilt_limit(BENCH) == pytest.approx(3.0 * DEG)
    assert BENCH.value("tilt_limit") == pytest.approx(5.0 * DEG)
    assert tilt_limit(BENCH, 0.0, "x") == usual_tilt_limit(BENCH)
    with pytest.raises(
        InputError, match=r"^x: a tilt limit of 4\.90 deg is too near to the hard stop at 5\.00"
    ):
        tilt_limit(BENCH, 4.9 * DEG, "x")


@pytest.mark.parametrize("name", Plan.shipped())
def test_every_shipped_plan_runs_under_the_limit_that_it_states(name):
    bench = Bench.load("dtg" if name.startswith("dtg_") else "gyrowheel")
    plan = Plan.load(name)
    limit = plan_tilt_limit(plan, bench, usual_tilt_limit(bench))
    assert max(abs(segment.tilt) for segment in plan.segments) <= limit * (1 + 1e-9)
    assert limit <= largest_tilt_limit(bench)
    if plan.tilt_limit is not None:  # none states more than it needs
        assert limit < max(abs(segment.tilt) for segment in plan.segments) + 0.15 * DEG


def test_a_plan_beyond_the_usual_limit_must_say_so():
    text = PLAN.replace("TILT", "3.5")
    with pytest.raises(
        InputError, match=r"segment 0 \(lean\): tilt 3\.50 deg is beyond the tilt limit of 3\.00 deg"
    ):
        plan_tilt_limit(Plan.load(text), BENCH, 3.0 * DEG)
    assert plan_tilt_limit(Plan.load(text), BENCH, 4.0 * DEG) == 4.0 * DEG
    stated = text.replace("segments", "tilt_limit_deg: 3.6\nsegments")
    assert plan_tilt_limit(Plan.load(stated), BENCH, 3.0 * DEG) == pytest.approx(3.6 * DEG)
    with pytest.raises(InputError, match=r"tilt_limit_deg: a tilt limit of 4\.80 deg is too near"):
        plan_tilt_limit(Plan.load(stated.replace("3.6", "4.8")), BENCH, 3.0 * DEG)
    with pytest.raises(InputError, match=r"beyond the tilt limit of 3\.20 deg"):
        plan_tilt_limit(Plan.load(stated.replace("3.6", "3.2")), BENCH, 3.0 * DEG)


@given(
    st.lists(st.floats() | st.floats(-1.0, 1.0), min_size=4, max_size=4),
    st.floats() | st.floats(-100.0, 500.0),
)
def test_setpoints_stay_within_the_limit_or_are_refused(motion, spin):
    guard = SetpointGuard(BENCH, 3.0 * DEG)
    admitted = guard.admit((*motion, spin, 0.0))
    if admitted is None:
        assert guard.refused == 1
        assert not all(map(math.isfinite, (*motion, spin))) or not 0.0 <= spin <= 1.1 * BENCH.value(
            "spin_rate_maximum"
        )
        return
    x, y = admitted[:2]
    assert math.hypot(x, y) <= 3.0 * DEG * (1 + 1e-9)
    if guard.limited:  # in the same direction, at rest
        assert x * motion[1] == pytest.approx(y * motion[0])
        assert x * motion[0] >= 0.0
        assert admitted[2:] == (0.0, 0.0, spin, 0.0)
    else:
        assert admitted == (*motion, spin, 0.0)
