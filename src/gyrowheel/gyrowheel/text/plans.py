"""Test plans: as a list, and one segment by segment."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType
from rich.text import Text

from gyrowheel.text.layout import command, figures_table, words_table
from gyrowheel.text.quantities import minus, seconds, short
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from gyrowheel_control.plans.plan import Plan, Segment
    from gyrowheel_sim.environment import Environment


def plan_list(plans: Iterable[Plan]) -> Iterator[RenderableType]:
    """Yield all plans, a line each."""
    table = words_table("plan", "takes", "what it is", whole=(0, 1))
    for plan in plans:
        table.add_row(Text(plan.name, style="cyan"), seconds(plan.duration), plan.title)
    yield table
    yield Text("\nMore about one:", style="dim")
    yield command("gyrowheel plans quick")


def plan_page(plan: Plan) -> Iterator[RenderableType]:
    """Yield a plan segment by segment."""
    count = len(plan.segments)
    yield Text.assemble((plan.name, "bold cyan"), f"  {plan.title}")
    yield Text(f"\n{minus(plan.description)}\n")
    yield Text(
        f"{count} segments, {seconds(plan.duration)} of bench time, from {_rpm(plan.initial_spin_rate)} rpm\n"
    )
    table = figures_table("", "start\ns", "ramp\ns", "steady\ns", "spin\nrpm", "tilt x, y\ndeg")
    table.add_column("", overflow="fold")
    for index, s in enumerate(plan.segments):
        table.add_row(
            str(index),
            f"{s.start:.1f}",
            f"{s.ramp:.2f}",
            f"{s.hold:.2f}",
            _rpm(s.spin) if s.spin_end == s.spin else f"{_rpm(s.spin)}→{_rpm(s.spin_end)}",
            f"{short(s.tilt.real / DEG)}, {short(s.tilt.imag / DEG)}",
            minus(", ".join(filter(None, (s.label, _turning(s), _surroundings(s.environment))))),
        )
    yield table


def plan_json(plan: Plan) -> dict[str, Any]:
    """Return a plan as a JSON object, SI units."""
    return {
        "name": plan.name,
        "title": plan.title,
        "description": plan.description,
        "duration": plan.duration,
        "initial_spin_rate": plan.initial_spin_rate,
        "segments": [
            {
                "label": s.label,
                "start": s.start,
                "ramp": s.ramp,
                "hold": s.hold,
                "tilt_x": s.tilt.real,
                "tilt_y": s.tilt.imag,
                "spin_rate": s.spin,
                "spin_rate_end": s.spin_end,
                "cone_rate": s.cone_rate,
                "rig": s.environment.rig,
                "yaw": s.environment.yaw,
                "air_density_ratio": s.environment.air_density_ratio,
                "preheat": s.environment.preheat,
                "table_rate": s.environment.table_rate,
            }
            for s in plan.segments
        ],
    }


def _turning(s: Segment) -> str:
    if s.cone_rate == 0.0:
        return ""
    return f"period {short(2.0 * math.pi / abs(s.cone_rate))} s"


def _surroundings(e: Environment) -> str:
    parts = [
        "" if e.rig == "upright" else e.rig,
        f"yaw {short(e.yaw / DEG)} deg" if e.yaw else "",
        f"rate table {short(e.table_rate / DEG)} deg/s" if e.table_rate else "",
        f"air ×{short(e.air_density_ratio)}" if e.air_density_ratio != 1.0 else "",
        f"coils +{short(e.preheat)} K" if e.preheat else "",
    ]
    return ", ".join(filter(None, parts))


def _rpm(rate: float) -> str:
    return f"{rate / RPM:.0f}"
