"""A plan file to begin with: it runs on the bench it is made for, and every line says what it does."""

from __future__ import annotations

import re
from typing import Any, Final

from gyrowheel_control.plans import demands
from gyrowheel_control.plans.fitting import plan_for
from gyrowheel_core.quantities import short
from gyrowheel_core.units import DEG, RPM
from gyrowheel_core.yaml_text import read_yaml
from gyrowheel_sim.bench import Bench

#: The plan whose speeds, tilts and rates it takes.
_PATTERN: Final = "quick"

_TEXT: Final = """\
# A test plan for the bench {bench}. docs/plans.md has every key; `gyrowheel plans --check` finds what is wrong.
# Angles in degrees, speeds in rpm, times in seconds, as the keys say.
schema: 1
name: {name}
title: What it shows, in one line
description: What it is for.
hold_s: {hold}  # how long every tilt is held; half a second of it settles, a whole one after a change of speed
tilt_rate_deg_s: {rate}  # from one tilt to the next; at {fast} rpm this bench follows up to {most_rate} deg/s
spin_acceleration_rpm_s: {rise}  # from one speed to the next; near {fast} rpm up to {most_rise} rpm/s
# A tilt beyond three fifths of the hard stop, {usual} of {stop} deg, must be asked for:
# tilt_limit_deg: {wide}
segments:
  # Holds: tilts [phi_x, phi_y], one after the other. Speeds of this bench: {low} .. {high} rpm.
  - {{label: holds, spin_rpm: {fast}, tilt_deg: [[0, 0], [{tilt}, 0], [0, {tilt}], [-{tilt}, 0], [0, -{tilt}]]}}
  # A cone: the tilt turns about the case axis. It shows what moves with the rate of the tilt, and calibrates the coils.
  - {{label: cone, cone_radius_deg: {tilt}, cone_period_s: {period}, cone_turns: 1}}
  # A grid: every tilt at every speed; what is not said stays as it was. Three speeds tell most effects apart.
  - {{label: grid, spin_rpm: [{slow}, {middle}], tilt_deg: [[0, 0], [{tilt}, 0], [0, -{tilt}]]}}
  # A sweep of the speed:
  # - {{label: sweep, tilt_deg: [0, 0], sweep_to_rpm: {slow}, hold_s: 20}}
  # Rig, yaw, air density, preheat and rate table stay as they are until another block changes them:
  # - {{label: low pressure, spin_rpm: {fast}, air_density_ratio: 0.3, tilt_deg: [[0, 0], [{tilt}, 0]]}}
  # - {{label: upside down, rig: inverted, air_density_ratio: 1, tilt_deg: [[0, 0], [{tilt}, 0]]}}
  # - {{label: warm coils, rig: upright, preheat_k: 20, tilt_deg: [[{tilt}, 0], [0, {tilt}]]}}
"""


def skeleton(bench: Bench, name: str) -> str:
    """Return the text of a plan file for a bench.

    Parameters
    ----------
    bench : Bench
        The bench: speeds, tilts and rates are its own.
    name : str
        What the plan is called, such as the stem of its file; what a name may not have becomes ``_``.

    Raises
    ------
    InputError
        If the bench can run no plan at all.
    """
    plan = plan_for(_PATTERN, bench)
    content: dict[str, Any] = read_yaml(plan.to_yaml(), plan.origin)
    usual = demands.USUAL_SHARE * bench.value("tilt_limit")
    tilt = 0.8 * min(usual, max(abs(s.tilt) for s in plan.segments))
    speeds = sorted({s.spin for s in plan.segments})
    fastest = max(plan.segments, key=lambda s: (s.spin, abs(s.tilt)))
    period = max(float(block["cone_period_s"]) for block in content["segments"] if "cone_period_s" in block)
    stem = re.sub(r"[^a-z0-9_]+", "_", name.lower()).strip("_")
    return _TEXT.format(
        bench=bench.name,
        name=stem if stem[:1].isalpha() else f"plan_{stem}".rstrip("_"),
        hold=short(float(content.get("hold_s", 1.5))),
        rate=short(float(content.get("tilt_rate_deg_s", 8.0))),
        rise=short(float(content.get("spin_acceleration_rpm_s", 1000.0)), 4),
        most_rate=short(demands.possible_slew(bench, fastest) / DEG),
        most_rise=short(demands.possible_acceleration(bench, fastest) / RPM),
        usual=short(usual / DEG),
        stop=short(bench.value("tilt_limit") / DEG),
        wide=short(0.9 * bench.value("tilt_limit") / DEG, 2),
        low=short(bench.value("spin_rate_minimum") / RPM),
        high=short(bench.value("spin_rate_maximum") / RPM),
        fast=short(speeds[-1] / RPM),
        middle=short(speeds[len(speeds) // 2] / RPM),
        slow=short(speeds[0] / RPM),
        tilt=short(tilt / DEG, 2),
        period=short(period),
    )
