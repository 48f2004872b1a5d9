"""Variations of plans: the same plan at other speeds or tilts, or in another environment."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG
from gyrowheel_sim.bench import Bench

SHIPPED = [name for name in Plan.shipped() if not name.startswith("dtg_")]


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize(
    ("setting", "attribute", "value"),
    [
        ("rig=inverted", "rig", "inverted"),
        ("yaw_deg=-90", "yaw", -90.0 * DEG),
        ("air_density_ratio=0.3", "air_density_ratio", 0.3),
        ("preheat_k=20", "preheat", 20.0),
    ],
)
def test_the_environment_holds_for_the_whole_plan(
    name: str, setting: str, attribute: str, value: float | str
) -> None:
    plain, other = Plan.load(name), Plan.load(f"{name}@{setting}")
    assert {getattr(s.environment, attribute) for s in other.segments} == {value}
    for a, b in zip(plain.segments, other.segments, strict=True):
        assert (a.start, a.hold, a.tilt, a.spin, a.spin_end) == (b.start, b.hold, b.tilt, b.spin, b.spin_end)
    other.check(Bench.load())


@pytest.mark.parametrize("name", SHIPPED)
def test_speeds_and_tilts_are_multiplied(name: str) -> None:
    plain, other = Plan.load(name), Plan.load(f"{name}@spin_ratio=0.75,tilt_ratio=0.5")
    for a, b in zip(plain.segments, other.segments, strict=True):
        assert b.spin == pytest.approx(0.75 * a.spin)
        assert b.spin_end == pytest.approx(0.75 * a.spin_end)
        if not a.cone_rate and not plain.segments[max(plain.segments.index(a) - 1, 0)].cone_rate:
            assert abs(b.tilt) == pytest.approx(0.5 * abs(a.tilt), abs=1e-12)


def test_every_hold_takes_as_long_as_asked_for_and_a_sweep_as_long_as_before() -> None:
    plain, other = Plan.load("coast_down"), Plan.load("coast_down@hold_s=4")
    for a, b in zip(plain.segments, other.segments, strict=True):
        assert b.hold == (a.hold if a.spin_end != a.spin else 4.0)


def test_a_variation_is_a_plan_with_its_own_yaml(tmp_path: Path) -> None:
    plan = Plan.load("check@rig=inverted,spin_ratio=0.8")
    assert plan.name == "check_rig_inverted_spin_ratio_0_8"
    assert plan.called == "check@rig=inverted,spin_ratio=0.8"
    assert Plan.load("check").called == "check"
    file = tmp_path / "plan.yaml"
    file.write_text(plan.to_yaml(), encoding="utf-8")
    again = Plan.load(file)
    assert (again.name, again.segments) == (plan.name, plan.segments)
    twice = Plan.load(f"{file}@tilt_ratio=0.5")
    assert math.isclose(
        max(abs(s.tilt) for s in twice.segments), 0.5 * max(abs(s.tilt) for s in plan.segments)
    )


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("check@speed=2", "'speed' cannot be varied; allowed: rig, yaw_deg, air_density_ratio"),
        ("check@", "'' cannot be varied"),
        ("check@rig=sideways", "rig: 'sideways' is not known; allowed: upright, inverted, x_up, y_up"),
        ("check@hold_s=soon", "hold_s: 'soon' is not a number"),
        ("check@hold_s=nan", "hold_s: 'nan' is not a number"),
        ("check@tilt_ratio=100", "tilt_ratio: 100 is out of range; allowed: 0.01 .. 10"),
        ("check@rig=inverted,rig=upright", "rig is given twice"),
        ("check@air_density_ratio=7", "air_density_ratio: 7.0 is out of range; allowed: 0 .. 2"),
        ("chek@rig=inverted", "plan 'chek': no such shipped plan or file; did you mean"),
    ],
)
def test_invalid_variations_are_refused_in_one_line(name: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        Plan.load(name)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
