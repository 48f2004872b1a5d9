"""Numbers of a plan that no bench can have are refused where they stand."""

import pytest

from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench

_PLAN = "schema: 1\nname: x\nhold_s: 1\nsegments:\n  - {{{block}}}\n"


@pytest.mark.parametrize(
    ("block", "said"),
    [
        ("spin_rpm: 3000, tilt_deg: [[-1e308, 0]]", "segments.0.tilt_deg.0.0: '-1e308' is out of range"),
        ("spin_rpm: 3000, tilt_deg: [[0, 0]], hold_s: 1e-320", "segments.0.hold_s: '1e-320' is out of range"),
        ("spin_rpm: 3000, tilt_deg: [[0, 0]], ramp_s: 1e-300", "segments.0.ramp_s: '1e-300' is out of range"),
        ("spin_rpm: 1e308, tilt_deg: [[0, 0]]", "segments.0.spin_rpm: '1e308' is out of range"),
        (
            "spin_rpm: 3000, tilt_deg: [[1, 0]], tilt_rate_deg_s: 1e-300",
            "tilt_rate_deg_s: '1e-300' is out of range",
        ),
        (
            "spin_rpm: 3000, cone_radius_deg: 1e300, cone_period_s: 4",
            "cone_radius_deg: '1e300' is out of range",
        ),
        ("spin_rpm: 3000, hold_s: 10, sweep_to_rpm: -1e308", "sweep_to_rpm: '-1e308' is out of range"),
    ],
)
def test_a_number_beyond_any_bench_is_refused(block: str, said: str) -> None:
    """One line that names the field, the value and what is allowed."""
    with pytest.raises(InputError) as refused:
        Plan.load(_PLAN.format(block=block)).check(Bench.load())
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)
    assert "allowed: " in str(refused.value)
