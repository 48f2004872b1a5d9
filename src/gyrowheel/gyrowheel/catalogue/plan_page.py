"""Test plans: as a list, and one segment by segment."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType
from rich.text import Text

from gyrowheel.show.layout import command, figures_table, sentences, words_table
from gyrowheel.show.quantities import minus, seconds, short
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from gyrowheel.catalogue.plan_check_result import Outlook, PlanCheck
    from gyrowheel_control.plans.demands import Segment
    from gyrowheel_control.plans.inspection import Wrong
    from gyrowheel_control.plans.plan import Plan
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


def check_page(result: PlanCheck) -> Iterator[RenderableType]:
    """Yield all that is wrong with a plan file, or what it will do."""
    title = "" if result.plan is None else result.plan.title
    yield Text.assemble((result.file, "bold cyan"), f"  {title}")
    if result.outlook is not None:
        yield Text(f"\nNothing is wrong: the bench {result.bench} can run it.")
        yield from sentences(outlook_lines(result.outlook))
        return
    count = len(result.wrong)
    many = "One thing is" if count == 1 else f"{count} things are"
    yield Text(f"\n{many} wrong for the bench {result.bench}:\n")
    table = words_table("line", "place", "what, and what is allowed", whole=(0,))
    for item in result.wrong:
        table.add_row("" if item.line is None else str(item.line), Text(item.place, style="cyan"), item.said)
    yield table


def wrong_line(item: Wrong) -> str:
    """Return what is wrong in one place as the rest of a line that begins with the file."""
    line = "" if item.line is None else f"{item.line}:"
    return f"{line} {item.place}: {item.said}" if item.place else f"{line} {item.said}"


def outlook_lines(found: Outlook) -> Iterator[str]:
    """Yield in sentences what a plan will do."""
    kinds = ((found.holds, "hold"), (found.cones, "cone"), (found.sweeps, "sweep"))
    parts = ", ".join(f"{count} {name}{'s' if count > 1 else ''}" for count, name in kinds if count)
    yield f"It takes {seconds(found.duration)}: {parts}."
    low, high = found.speeds[0], found.speeds[-1]
    speeds = (
        f"{_rpm(low)} rpm" if low == high else f"{len(found.speeds)} speeds, {_rpm(low)} .. {_rpm(high)} rpm"
    )
    yield f"{speeds[:1].upper()}{speeds[1:]}; the largest tilt is {short(found.largest_tilt / DEG)} deg."
    yield (
        f"It needs up to {100.0 * found.coil_share:.0f} % of the coils' voltage and {100.0 * found.motor_share:.0f} % "
        "of the supply."
    )
    share = 100.0 * found.covered / found.duration
    windows = f"{found.windows} window{'' if found.windows == 1 else 's'}"
    yield f"It gives {windows} of whole revolutions, {seconds(found.covered)} ({share:.0f} % of the time)."
    for text in found.empty:
        yield f"No window: {text}; half a second settles, a whole one after a change of speed."


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
