"""The bench: every parameter with its uncertainty and where it comes from."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.text import Text

from gyrowheel.show.layout import figures_table, heading, sentences, words_table
from gyrowheel.show.quantities import quantity, short, with_error
from gyrowheel_control.plans.demands import COIL_SHARE, SUPPLY_SHARE
from gyrowheel_control.plans.format import PlanFile
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from gyrowheel_analysis.capability import Reach
    from gyrowheel_sim.bench import Bench


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
    """Yield what a bench can reach at its speeds, and what it cannot and why."""
    v = found.bench.value
    yield heading("What it can reach")
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
    yield heading("Why not more")
    yield from sentences(reach_sentences(found))


def reach_sentences(found: Reach) -> Iterator[str]:
    """Yield what limits a bench, and what of its own range it cannot reach."""
    v, top = found.bench.value, found.speeds[-1]
    yield (
        f"Tilt rate: turning the momentum of {short(top.momentum)} N·m·s at {_rpm(top.spin_rate)} takes a torque of "
        f"{quantity(top.momentum * DEG, 'N*m')} per deg/s; the coils give "
        f"{quantity(COIL_SHARE * v('coil_constant') * v('coil_voltage_limit'), 'N*m')}."
    )
    usual = PlanFile.model_fields["tilt_rate_deg_s"].default * DEG
    if slow := [own for own in found.speeds if own.slew < usual]:
        yield (
            f"From {_rpm(slow[0].spin_rate)} on that is less than the {short(usual / DEG)} deg/s of the shipped plans, "
            "which become slower for it. Coils with more torque, or a higher voltage, would follow."
        )
    worst = max(found.speeds, key=lambda own: own.coil_volts)
    limit = v("tilt_limit")
    if found.largest_tilt < limit:
        yield (
            f"Tilt: {short(limit / DEG)} deg cannot be held. At {_rpm(worst.spin_rate)} the flexures, stiffer or softer"
            f" than the gimbal tunes them, take {short(worst.coil_volts)} V of the coils; up to "
            f"{short(found.largest_tilt / DEG)} deg can be held at every speed."
        )
    else:
        share = 100.0 * abs(worst.coil_volts_air) / worst.coil_volts if worst.coil_volts else 0.0
        yield (
            f"Tilt: {short(limit / DEG)} deg, the hard stop, can be held at every speed; most of all at "
            f"{_rpm(worst.spin_rate)}, with {short(worst.coil_volts)} V, of which the air makes {share:.0f} %."
        )
    back = v("motor_constant") * top.spin_rate
    losses = top.motor_volts - back
    yield (
        f"Motor: {_rpm(top.spin_rate)} takes {short(back)} V against the back-EMF and {short(losses)} V for bearing"
        f" and air (the air {short(top.motor_volts_air)} V)."
    )
    if math.isfinite(found.top_speed):
        yield f"That is more than the supply gives: it holds up to {_rpm(found.top_speed)}, and plans end below that."
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
            f"Nutation: at {_rpm(top.spin_rate)} {short(top.nutation)} Hz, so a period has fewer than ten of the "
            f"{short(sampled)} samples a second, and its damper comes late: sample faster, or tilt with lower gains."
        )


def _rpm(rate: float) -> str:
    return f"{rate / RPM:.0f} rpm"
