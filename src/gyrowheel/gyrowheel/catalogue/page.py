"""Pages of effects, test plans and benches."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType
from rich.text import Text

from gyrowheel.show.formulas import pretty
from gyrowheel.show.layout import command, figures_table, heading, indented, sentences, words_table
from gyrowheel.show.sentences.diagnosis import ERROR_TITLES
from gyrowheel_analysis.criteria import ERROR_LIMIT
from gyrowheel_core.quantities import minus, quantity, seconds, short, span, with_error
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from gyrowheel.catalogue.parameter_error import ParameterError
    from gyrowheel.catalogue.plan_check import CheckedPlan, Outlook
    from gyrowheel_analysis.capability import Reach
    from gyrowheel_control.plans.demands import Segment
    from gyrowheel_control.plans.plan import Plan
    from gyrowheel_sim.bench import Bench
    from gyrowheel_sim.effects import Coefficient, Effect
    from gyrowheel_sim.environment import Environment


def effect_list(effects: Iterable[Effect]) -> Iterator[RenderableType]:
    """Yield all effects, a line each, grouped by category, and the errors of bench parameters."""
    table = words_table("effect", "what it is", whole=(0,))
    shown = list(effects)
    for category in dict.fromkeys(effect.category for effect in shown):
        table.add_row(Text(category, style="bold"), "")
        for effect in shown:
            if effect.category == category:
                table.add_row(Text(f"  {effect.name}", style="cyan"), effect.title)
    table.add_row(Text("errors of bench parameters", style="bold"), "")
    for name, title in ERROR_TITLES.items():
        table.add_row(Text(f"  {name}", style="cyan"), title)
    yield table
    yield Text("\nMore about one:", style="dim")
    yield command("gyrowheel effects windage")


def effect_page(effect: Effect) -> Iterator[RenderableType]:
    """Yield the description of an effect."""
    yield Text.assemble((effect.name, "bold cyan"), f"  {effect.title}")
    yield Text(f"\n{effect.sentence}\n")
    for part in pretty(effect.formula).split("; "):
        yield indented(Text(part, style="bold"))
    yield heading("Coefficients")
    table = words_table("", "usual size", "what it is")
    for c in effect.coefficients:
        sign = ", either sign" if c.signed else ""
        table.add_row(
            Text(c.name, style="bold"),
            f"{span(*c.usual, c.unit, pure=c.shape is not None)}{sign}",
            minus(f"{c.description} [{c.source}]"),
        )
    yield indented(table)
    facts = words_table("", "")
    for text in possible_sizes(effect):
        facts.add_row("possible", minus(text))
    facts.add_row("holds for", Text(effect.validity))
    facts.add_row("source", Text(effect.source))
    yield Text()
    yield facts
    if effect.look_alikes:
        yield heading("Confounders, and how to separate them")
        yield from sentences(f"{name}: {test}" for name, test in effect.look_alikes.items())


def parameter_error_page(error: ParameterError) -> Iterator[RenderableType]:
    """Yield the description of an error of bench parameters."""
    yield Text.assemble((error.name, "bold cyan"), f"  {ERROR_TITLES[error.name]}")
    many = len(error.parameters) > 1
    yield Text(
        f"\nThe bench file states {'these parameters' if many else 'this parameter'} with an uncertainty, and every "
        f"fit estimates {'them' if many else 'it'} within that. A diagnosis reports an error where the recordings "
        f"contradict the bench file by more than {ERROR_LIMIT:g} of these uncertainties. No law is missing then: "
        "correct the bench file, or let the model override the parameter.\n"
    )
    table = words_table("parameter", "value", "source")
    for p in error.parameters:
        table.add_row(Text(p.name, style="bold"), with_error(p.value, p.uncertainty, p.unit), minus(p.source))
    yield indented(table)
    if error.look_alikes:
        yield heading("Confounders, and how to separate them")
        yield from sentences(f"{name}: {test}" for name, test in error.look_alikes.items())


def parameter_error_json(error: ParameterError) -> dict[str, Any]:
    """Return the description of an error of bench parameters as a JSON object, SI units."""
    return {
        "name": error.name,
        "title": ERROR_TITLES[error.name],
        "parameters": {
            p.name: {"value": p.value, "uncertainty": p.uncertainty, "unit": p.unit, "source": p.source}
            for p in error.parameters
        },
        "look_alikes": dict(error.look_alikes),
    }


def possible_sizes(effect: Effect) -> list[str]:
    """Return the possible ranges of the coefficients, a text for each range."""
    names: dict[str, list[str]] = {}
    for c in effect.coefficients:
        low, high = c.physical
        if low > -math.inf or high < math.inf:
            shown = "0 or more" if (low, high) == (0.0, math.inf) else span(low, high, c.unit)
            names.setdefault(f"{shown}: {c.why_possible}", []).append(c.name)
    return [f"{', '.join(own)} {text}" for text, own in names.items()]


def effect_json(effect: Effect) -> dict[str, Any]:
    """Return the description of an effect as a JSON object, SI units."""
    return {
        "name": effect.name,
        "title": effect.title,
        "category": effect.category,
        "sentence": effect.sentence,
        "formula": effect.formula,
        "coefficients": {c.name: _coefficient_json(c) for c in effect.coefficients},
        "validity": effect.validity,
        "source": effect.source,
        "look_alikes": dict(effect.look_alikes),
    }


def _coefficient_json(c: Coefficient) -> dict[str, Any]:
    return {
        "unit": c.unit,
        "description": c.description,
        "usual": list(c.usual),
        "bounds": list(c.bounds),
        "possible": [value if math.isfinite(value) else None for value in c.physical],
        "signed": c.signed,
        "shape": c.shape is not None,
        "default": c.default,
        "source": c.source,
    }


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


def check_page(found: CheckedPlan) -> Iterator[RenderableType]:
    """Yield the errors of a plan file, or its outlook."""
    title = "" if found.plan is None else found.plan.title
    yield Text.assemble((found.file, "bold cyan"), f"  {title}")
    if found.outlook is not None:
        yield Text(f"\nNothing is wrong: the bench {found.bench} can run it.")
        yield from sentences(_outlook_lines(found.outlook))
        return
    count = len(found.wrong)
    many = "One thing is" if count == 1 else f"{count} things are"
    yield Text(f"\n{many} wrong for the bench {found.bench}:\n")
    table = words_table("line", "place", "what, and what is allowed", whole=(0,))
    for item in found.wrong:
        table.add_row("" if item.line is None else str(item.line), Text(item.place, style="cyan"), item.said)
    yield table


def _outlook_lines(found: Outlook) -> Iterator[str]:
    """Yield the outlook of a plan in sentences."""
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
    return f"period {short(2.0 * math.pi / abs(s.cone_rate))} s" if s.cone_rate else ""


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


def bench_page(bench: Bench) -> Iterator[RenderableType]:
    """Yield the bench as a table."""
    yield Text.assemble((bench.name, "bold cyan"), f"  {bench.title}\n")
    table = words_table("parameter", "value", "source", whole=(0, 1))
    for p in bench.parameters.values():
        pure = p.unit == "1"
        table.add_row(
            Text(p.name, style="cyan"), with_error(p.value, p.uncertainty, p.unit, pure=pure), p.source
        )
    yield table
    if bench.references:
        yield heading("Sources")
        yield from sentences(f"{key}: {text}" for key, text in bench.references.items())


def reach_page(found: Reach) -> Iterator[RenderableType]:
    """Yield the capability of a bench at its speeds, and what limits it."""
    from gyrowheel_control.plans.demands import COIL_SHARE, SUPPLY_SHARE

    v = found.bench.value
    yield heading("Capability")
    table = figures_table(
        "rpm", "momentum\nN·m·s", "tilt rate\nup to deg/s", f"hold {short(v('tilt_limit') / DEG)} deg\nV",
        "motor\nV", "acceleration\nup to rpm/s", "nutation\nHz",
    )  # fmt: skip
    for own in found.speeds:
        table.add_row(
            f"{own.spin_rate / RPM:.0f}",
            short(own.momentum),
            short(max(own.slew, 0.0) / DEG),
            short(own.coil_volts),
            short(own.motor_volts),
            short(max(own.acceleration, 0.0) / RPM, 2),
            short(own.nutation),
        )
    yield table
    yield Text(
        f"Plans may take {100 * COIL_SHARE:.0f} % of the {short(v('coil_voltage_limit'))} V of the coils and "
        f"{100 * SUPPLY_SHARE:.0f} % of the {short(v('supply_voltage'))} V of the supply. With the air of usual size.",
        style="dim",
    )
    yield heading("Limits")
    yield from sentences(reach_sentences(found))


def reach_sentences(found: Reach) -> Iterator[str]:
    """Yield sentences about the limits of a bench, and about the part of its range that it cannot reach."""
    from gyrowheel_control.plans.demands import COIL_SHARE
    from gyrowheel_control.plans.plan import PlanFile

    v, top = found.bench.value, found.speeds[-1]
    yield (
        f"Tilt rate: turning the momentum of {short(top.momentum)} N·m·s at {_rpm(top.spin_rate)} rpm takes "
        f"a torque of {quantity(top.momentum * DEG, 'N*m')} per deg/s; the coils give "
        f"{quantity(COIL_SHARE * v('coil_constant') * v('coil_voltage_limit'), 'N*m')}."
    )
    usual = PlanFile.model_fields["tilt_rate_deg_s"].default * DEG
    if slow := [own for own in found.speeds if own.slew < usual]:
        yield (
            f"From {_rpm(slow[0].spin_rate)} rpm on that is less than the {short(usual / DEG)} deg/s of the shipped "
            "plans, which become slower for it. Coils with more torque, or a higher voltage, would follow."
        )
    worst = max(found.speeds, key=lambda own: own.coil_volts)
    limit = v("tilt_limit")
    if found.largest_tilt < limit:
        yield (
            f"Tilt: {short(limit / DEG)} deg cannot be held. At {_rpm(worst.spin_rate)} rpm the flexures, stiffer or "
            f"softer than the gimbal tunes them, take {short(worst.coil_volts)} V of the coils; up to "
            f"{short(found.largest_tilt / DEG)} deg can be held at every speed."
        )
    else:
        share = 100.0 * abs(worst.coil_volts_air) / worst.coil_volts if worst.coil_volts else 0.0
        yield (
            f"Tilt: {short(limit / DEG)} deg, the hard stop, can be held at every speed; most of all at "
            f"{_rpm(worst.spin_rate)} rpm, with {short(worst.coil_volts)} V, of which the air makes {share:.0f} %."
        )
    back = v("motor_constant") * top.spin_rate
    losses = top.motor_volts - back
    yield (
        f"Motor: {_rpm(top.spin_rate)} rpm takes {short(back)} V against the back-EMF and {short(losses)} V for bearing"
        f" and air (the air {short(top.motor_volts_air)} V)."
    )
    if math.isfinite(found.top_speed):
        yield (
            f"That is more than the supply gives: it holds up to {_rpm(found.top_speed)} rpm, and plans end below that."
        )
    rise = PlanFile.model_fields["spin_acceleration_rpm_s"].default * RPM
    if 0.0 < top.acceleration < rise:
        inertia = quantity(found.bench.axial_inertia, "kg*m^2")
        yield (
            f"What is left accelerates {inertia} by {short(top.acceleration / RPM, 2)} rpm/s, less than the "
            f"{short(rise / RPM)} of the shipped plans, which take longer for it."
        )
    sampled = 1.0 / found.bench.sample_period
    if top.nutation > sampled / 10.0:
        yield (
            f"Nutation: at {_rpm(top.spin_rate)} rpm {short(top.nutation)} Hz, so a period has fewer than ten of the "
            f"{short(sampled)} samples a second, and its damper comes late: sample faster, or tilt with lower gains."
        )
