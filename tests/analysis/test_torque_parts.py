"""The torques that coils and motor hold, part by part, against the simulation and against each part's own law."""

from __future__ import annotations

import numpy as np
import pytest

from gyrowheel_analysis.balance.balance import ActiveEffect, Balance
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.segmentation import reduce
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_analysis.torques import BENCH_PARTS, torque_parts
from gyrowheel_control.loops.closed_loop import simulate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.readings import Readings
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import EffectValues, registry
from gyrowheel_sim.plant.scenario import Scenario

BENCH = Bench.load()
QUIET = {name: 0.0 for name in BENCH.values() if name.endswith(("_noise", "_drift"))}
#: One of every kind: air, flexure, the Earth, a sensor, an actuator, an imbalance with a torque and a reading.
NAMES = (
    "aero_restoring", "aero_cross", "windage", "flexure_hysteresis", "earth_rate", "gravity_offset", "runout",
    "tilt_rotation", "coil_heating", "static_imbalance",
)  # fmt: skip
SPEEDS = (1000, 2000, 3000, 4000)


def hold(rpm: float, tilt_deg: float, effects: EffectValues, density: float = 1.0) -> Windows:
    """Return the windows of a hold, simulated without noise."""
    plan = Plan.load(
        f"schema: 1\nname: hold\nhold_s: 6\nsegments:\n"
        f"  - {{spin_rpm: {rpm}, tilt_deg: [[{tilt_deg}, 0]], air_density_ratio: {density}}}\n"
    )
    run = simulate(BENCH, Scenario(values=QUIET, effects=effects), plan)
    time = np.arange(len(run.measurement), dtype=np.float64) * BENCH.sample_period
    stamps = run.setpoints["stamp_ns"] * 1e-9
    windows = reduce(Samples(time, Readings(run.measurement), stamps, run.setpoints, run.environment), BENCH)
    return windows.select([-1])  # what the start has left has died away


def defaults(*names: str) -> tuple[EffectValues, list[ActiveEffect]]:
    values = {name: registry()[name].defaults() for name in names}
    return values, [ActiveEffect(registry()[name], own) for name, own in values.items()]


@pytest.mark.parametrize("rpm", SPEEDS)
def test_torque_parts_sum_to_the_simulated_torque(rpm: float) -> None:
    torques = tuple(name for name in NAMES if name not in {"coil_heating"})
    values, effects = defaults(*torques)
    windows = hold(rpm, 3.0, values)
    balance = Balance(windows, BENCH, clean=False)
    parts = torque_parts(balance, BENCH.values(), effects)
    coil, motor = sum(p.coil for p in parts), sum(p.motor for p in parts)
    volts = BENCH.value("coil_constant") * windows.coil_voltage
    assert np.abs(coil - volts).max() < 1e-6
    assert np.abs(motor - BENCH.value("motor_constant") * windows.motor_current).max() < 1e-6
    whole = balance.required(BENCH.values(), effects)
    assert coil == pytest.approx(whole[0], abs=1e-9)
    assert motor == pytest.approx(whole[1], abs=1e-9)
    assert [p.name for p in parts] == [*BENCH_PARTS, *torques]


@pytest.mark.parametrize("rpm", SPEEDS)
def test_each_part_follows_its_own_law(rpm: float) -> None:
    names = (
        "aero_restoring",
        "aero_cross",
        "windage",
        "flexure_hysteresis",
        "gravity_offset",
        "tilt_rotation",
    )
    values, effects = defaults(*names)
    windows = hold(rpm, 3.0, values)
    parts = {p.name: p for p in torque_parts(Balance(windows, BENCH, clean=False), BENCH.values(), effects)}
    spin = rpm * RPM
    # the reading is turned, the true tilt is not what was asked for
    z = np.tan(3.0 * DEG) * np.exp(-1j * values["tilt_rotation"]["a"])
    v = BENCH.value
    # slow model of the averaged balance; what it leaves out is of the third order in the tilt
    third = np.abs(z) ** 2

    def close(name: str, wanted: complex, left_out: float = 0.02) -> None:
        assert np.abs(parts[name].coil - wanted).max() < left_out * abs(wanted) + 2e-6, name

    stiffness = 0.5 * (v("flexure_stiffness_x") + v("flexure_stiffness_y"))
    tuning = v("gimbal_inertia_x") + v("gimbal_inertia_y") - v("gimbal_inertia_z")
    close("flexure_stiffness", stiffness * z * (1.0 - third / 4.0))
    close("gimbal_inertia", -0.5 * tuning * spin**2 * z)
    close("flexure_damping", -0.5j * (v("flexure_damping_x") + v("flexure_damping_y")) * spin * z)
    ratio = spin / v("spin_rate_reference")
    restoring, cross, drag = (values[name] for name in names[:3])
    close("aero_restoring", restoring["k"] * ratio ** restoring["n"] * z)
    close("aero_cross", -1j * cross["c"] * ratio ** cross["n"] * z)
    torque = drag["w"] * ratio ** drag["n"]
    close("windage", -0.5j * torque * z)
    assert parts["windage"].motor == pytest.approx(torque, rel=5e-3)
    friction = v("bearing_coulomb") + v("bearing_viscous") * spin
    assert parts["bearing"].motor == pytest.approx(friction, rel=1e-6)
    assert np.abs(parts["bearing"].coil).max() < 1e-12
    assert np.abs(parts["tilt_rotation"].coil).max() == 0.0


def test_torque_of_the_air_vanishes_in_a_vacuum() -> None:
    values, effects = defaults("aero_restoring", "aero_cross", "windage")
    windows = hold(3000, 3.0, values, density=0.0)
    parts = torque_parts(Balance(windows, BENCH, clean=False), BENCH.values(), effects)
    for part in parts:
        if part.effect:
            assert (
                np.abs(part.coil).max() < 1e-6
            )  # the drag falls with the square root of what the pump leaves
            assert np.abs(part.motor).max() < 1e-6
