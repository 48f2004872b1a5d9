"""Drag estimates against the truth of simulated machines, and what each field says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrowheel_analysis.drag.estimate import Estimate
from gyrowheel_analysis.drag.stream import drag_estimates
from gyrowheel_analysis.model import Model, Override
from gyrowheel_control.loops.closed_loop import Run, simulate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import wire
from gyrowheel_core.readings import Readings
from gyrowheel_core.units import RPM
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import EffectValues, registry
from gyrowheel_sim.plant.scenario import Scenario

from .machines import BENCH, hidden_machine

PLAN = """\
schema: 1
name: tilts
hold_s: 1.5
segments:
  - {spin_rpm: 3500, tilt_deg: [[0, 0], [2, 0], [0, -3], [0, 0], [-1, 1]]}
  - {spin_rpm: 2500, tilt_deg: [[1, 0], [0, 0], [3, 0]]}
"""
TURNED = """\
schema: 1
name: turned
hold_s: 1.5
segments:
  - {spin_rpm: 3500, tilt_deg: [[0, 0], [3, 0]], rig: inverted, yaw_deg: 90}
  - {spin_rpm: 3500, tilt_deg: [[3, 0]], rig: upright, air_density_ratio: 0.3}
  - {spin_rpm: 2000, tilt_deg: [[0, 0], [0, -2]], rig: inverted, yaw_deg: 0}
"""
QUIET = {name: 0.0 for name in BENCH.values() if name.endswith(("_noise", "_drift"))}
AIR: EffectValues = {
    "windage": registry()["windage"].defaults(),
    "aero_cross": registry()["aero_cross"].defaults(),
}
#: What a turned rig changes: the centre of gravity above the flexures, the Earth, and the air.
WEIGHT = 6.0e-3  # N m per rad, at the centre of gravity above the pivot
ROOM: EffectValues = {
    **AIR,
    "gravity_offset": {"G": WEIGHT},
    "earth_rate": registry()["earth_rate"].defaults(),
}


def run_of(machine: Scenario, plan: str = PLAN, bench: Bench = BENCH) -> Run:
    return simulate(bench, machine, Plan.load(plan))


def estimates(run: Run, model: Model) -> list[Estimate]:
    period = round(run.bench.sample_period * wire.SECOND)
    stamps = np.arange(len(run.measurement), dtype=np.int64) * period
    return list(drag_estimates(stamps, Readings(run.measurement), run.setpoints, model, run.environment))


def holds(run: Run, model: Model) -> list[Estimate]:
    return [estimate for estimate in estimates(run, model) if estimate.settled]


@cache
def air_run() -> Run:
    return run_of(Scenario(effects=AIR, noise_seed=5))


def believing(effects: EffectValues | None = None, overrides: Mapping[str, Override] | None = None) -> Model:
    return replace(Model(BENCH), effects=effects or {}, overrides=overrides or {})


def held(machine: Scenario, plan: str = PLAN) -> list[NDArray[np.float64]]:
    """Return the true torques of coils and motor in every hold: of the machine without noise, by its own constants."""
    quiet = run_of(replace(machine, values={**machine.values, **QUIET}), plan)
    own = BENCH.with_values(machine.values)
    constants = np.array([own.value("coil_constant")] * 2 + [own.value("motor_constant")])
    return [constants * [*e.dc_voltage[:2], e.motor_current] for e in holds(quiet, Model(BENCH))]


def stated_constants_std(estimate: Estimate) -> NDArray[np.float64]:
    """Return the standard error of the measured torque from the constants as the bench states them."""
    return np.abs(estimate.measured_torque) * [0.02, 0.02, 0.01]


#: How many machines; the larger number is a study.
MACHINES = pytest.mark.parametrize("machines", [3, pytest.param(10, marks=pytest.mark.study)])


@pytest.mark.slow
@MACHINES
def test_estimated_torque_equals_the_true_one_within_three_standard_errors(machines: int) -> None:
    scores, differences = [], []
    for number in range(machines):
        effects = AIR if number else {}
        machine = hidden_machine(number, effects)
        found = holds(run_of(machine), believing(effects))
        assert len(found) == 8
        for estimate, truth in zip(found, held(machine), strict=True):
            assert not estimate.calibrated
            own = np.hypot(estimate.measured_torque_std, stated_constants_std(estimate))
            scores.append((estimate.measured_torque - truth) / own)
            differences.append(estimate.residual / estimate.residual_std)
    for score in (scores, differences):
        assert np.mean(np.abs(score) < 3.0) >= 0.95
        # and the standard errors are not so large that it could not fail
        assert 0.3 < np.sqrt(np.mean(np.square(score))) < 1.6


@pytest.mark.slow
@MACHINES
def test_the_attitude_of_the_rig_enters_the_prediction(machines: int) -> None:
    scores, blind, sizes = [], [], []
    for number in range(machines):
        machine = hidden_machine(number, ROOM)
        run = run_of(machine, TURNED)
        for estimate in (known := holds(run, believing(ROOM))):
            scores.append(estimate.residual / estimate.residual_std)
        if number == 0:
            blind = holds(replace(run, environment=[]), believing(ROOM))
            sizes = known
    assert np.mean(np.abs(scores) < 3.0) >= 0.95
    assert np.sqrt(np.mean(np.square(scores))) < 1.6
    # taken for upright, the inverted rotor misses twice the weight of its offset, and that only
    for seen, taken in zip(sizes, blind, strict=True):
        change = taken.simulated_torque - seen.simulated_torque
        inverted = seen.segment != 2
        tilt = np.tan([seen.tilt_x, seen.tilt_y])
        weight = -2.0 * WEIGHT * tilt if inverted else np.zeros(2)
        assert np.abs(change[:2] - weight) == pytest.approx(0.0, abs=0.1e-3)
    assert max(abs(2.0 * WEIGHT * np.tan(e.tilt_x)) for e in sizes) > 0.5e-3


@cache
def tilted_run() -> Run:
    """Return a run with a single hold, 2 deg about x at 3500 rpm."""
    plan = PLAN.split("segments:")[0] + "segments: [{spin_rpm: 3500, tilt_deg: [2, 0]}]\n"
    return run_of(Scenario(effects=AIR, noise_seed=5), plan)


@pytest.mark.slow
def test_standard_errors_include_every_stated_uncertainty() -> None:
    (tilted,) = holds(tilted_run(), Model(BENCH))
    tilt, rate = np.tan(tilted.tilt_x), tilted.spin_rate

    def alone(*left: str) -> NDArray[np.float64]:
        """Return the standard errors where nothing is uncertain but some parameters."""
        parameters = {
            name: p if name in left else replace(p, uncertainty=0.0) for name, p in BENCH.parameters.items()
        }
        (found,) = holds(tilted_run(), Model(replace(BENCH, parameters=parameters)))
        return found.constants_std

    assert np.all(alone() == 0.0)
    # two flexures of 2 % each that share the tilt, by K = (Kx + Ky) / 2
    stiffness = alone("flexure_stiffness_x", "flexure_stiffness_y")
    assert stiffness[0] == pytest.approx(0.02 * 0.1343 / np.sqrt(2.0) * tilt, rel=0.02)
    # one factor for the inertias of the gimbal, by (Igx + Igy - Igz) / 2
    inertia = alone(*(f"gimbal_inertia_{axis}" for axis in "xyz"))
    assert inertia[0] == pytest.approx(0.1 * 0.5 * 2.0e-6 * rate**2 * tilt, rel=0.02)
    bearing = alone("bearing_coulomb", "bearing_viscous")
    assert bearing[2] == pytest.approx(np.hypot(0.2 * 5e-4, 0.2 * 1e-6 * rate), rel=0.02)
    fixed = alone("fixed_torque_x", "fixed_torque_y")
    assert fixed[:2] == pytest.approx([1e-4, 1e-4], rel=0.02)
    # shaft, damping, constants and tilt sensors have the rest
    parts = np.sqrt(np.sum(np.square([stiffness, inertia, bearing, fixed]), axis=0))
    assert np.all(tilted.constants_std > parts)
    assert tilted.constants_std[0] == pytest.approx(parts[0], rel=0.02)


@pytest.mark.slow
def test_standard_error_includes_the_uncertainty_of_the_air_pressure() -> None:
    model, dull = believing(AIR), replace(BENCH.parameters["pressure_bias"], uncertainty=2000.0)
    other = replace(
        model, stated_bench=replace(BENCH, parameters={**BENCH.parameters, "pressure_bias": dull})
    )
    (usual,), (worse,) = ([e for e in holds(air_run(), own) if e.segment == 1] for own in (model, other))
    added = np.sqrt(worse.constants_std[2] ** 2 - usual.constants_std[2] ** 2)
    exponent = AIR["windage"]["n"] - 1.0
    assert added == pytest.approx(2000.0 / 101325.0 * exponent * AIR["windage"]["w"], rel=0.05)


@pytest.mark.slow
def test_every_field_is_finite_while_a_hold_is_under_way_and_after() -> None:
    for model in (Model(BENCH), believing(AIR)):
        found = estimates(air_run(), model)
        assert {estimate.settled for estimate in found} == {True, False}
        for estimate in found:
            for name in wire.DRAG_ESTIMATE.names:
                assert np.all(np.isfinite(getattr(estimate, name))), name


@pytest.mark.slow
def test_residual_of_a_model_without_air_is_the_torque_of_the_air() -> None:
    without, with_air = holds(air_run(), Model(BENCH)), holds(air_run(), believing(AIR))
    cross, size = AIR["aero_cross"]["c"], []
    for plain, known in zip(without, with_air, strict=True):
        error = plain.residual_std
        assert np.all(plain.simulated_air_torque == 0.0)
        assert np.all(np.abs(known.residual) < 3.0 * error)
        assert np.all(np.abs(plain.residual - known.simulated_air_torque) < 3.0 * error)
        size.append(np.abs(known.simulated_air_torque / error).max())
        if plain.spin_rate > 3400 * RPM:  # the reference of the law
            tilt = np.tan(plain.tilt_x) + 1j * np.tan(plain.tilt_y)
            coil = known.simulated_air_torque[0] + 1j * known.simulated_air_torque[1]
            assert coil == pytest.approx(-1j * cross * tilt, abs=3e-5)
    assert min(size) > 3.0  # the error could not hide it


@pytest.mark.slow
def test_the_reference_is_the_last_hold_before_that_is_upright_at_the_same_speed() -> None:
    found = holds(air_run(), Model(BENCH))
    assert [e.reference_segment for e in found] == [0, 0, 0, 0, 3, 0, 6, 6]
    by_segment = {e.segment: e for e in found}
    for e in found:
        reference = by_segment[e.reference_segment]
        assert e.voltage_increment == pytest.approx(e.dc_voltage - reference.dc_voltage, abs=1e-12)
        own = e.segment == e.reference_segment
        assert np.all((e.voltage_increment_std == 0.0) == own)
        assert np.any(e.simulated_voltage_increment != 0.0) != own
    # the first hold is tilted: it is what there is
    tilted = PLAN.replace("[[0, 0], [2, 0], [0, -3], [0, 0], [-1, 1]]", "[[1, 0], [2, 0]]")
    few = holds(run_of(Scenario.nominal(noise_seed=1), tilted), Model(BENCH))
    assert [e.reference_segment for e in few] == [0, 0, 0, 3, 3]


def test_voltage_increments_equal_the_predicted_ones() -> None:
    for e in holds(air_run(), believing(AIR)):
        # the model's own prediction has the noise of the measured motion in it, the motor's most of all
        error = np.hypot(e.voltage_increment_std, [1e-3, 1e-3, 5e-3])
        assert np.all(np.abs(e.voltage_increment - e.simulated_voltage_increment) < 4.0 * error)


def test_standard_errors_follow_the_noise_of_the_data() -> None:
    loud = Scenario(values={"coil_voltage_noise": 0.2, "motor_current_noise": 0.5}, noise_seed=5)
    for e in holds(run_of(loud), Model(BENCH)):
        count = e.duration / BENCH.sample_period
        white = np.sqrt(e.dc_voltage_std[:2] ** 2 - BENCH.value("coil_voltage_drift") ** 2)
        assert white == pytest.approx(0.2 / np.sqrt(count), rel=0.9)
        assert e.motor_current_std > 0.3 * 0.5 / np.sqrt(count)
        assert e.measured_torque_std[2] == pytest.approx(0.03 * e.motor_current_std)


@pytest.mark.slow
def test_estimates_are_marked_calibrated_once_both_constants_are_learned() -> None:
    known = {"coil_constant": Override(0.021, 1e-5), "motor_constant": Override(0.031, 2e-5)}
    for stated, half, learned in zip(
        holds(air_run(), Model(BENCH)),
        holds(air_run(), believing(overrides={"coil_constant": known["coil_constant"]})),
        holds(air_run(), believing(overrides=known)),
        strict=True,
    ):
        assert [e.calibrated for e in (stated, half, learned)] == [False, False, True]
        read = np.array([*stated.dc_voltage[:2], stated.motor_current])
        assert stated.measured_torque == pytest.approx(read * [0.02, 0.02, 0.03], abs=1e-12)
        # a fixed torque and the bearing are uncertain beside the constants
        assert np.all(stated.constants_std > np.abs(read) * [0.0004, 0.0004, 0.0003])
        assert learned.measured_torque == pytest.approx(read * [0.021, 0.021, 0.031], abs=1e-12)
        # what the constants were uncertain by has gone, and nothing else
        stated_share, learned_share = (
            np.abs(own.simulated_torque) / np.array(values)
            for own, values in (
                (stated, [50.0, 50.0, 100.0]),
                (learned, [0.021 / 1e-5, 0.021 / 1e-5, 0.031 / 2e-5]),
            )
        )
        variance = stated.constants_std**2 - learned.constants_std**2
        gone = np.sign(variance) * np.sqrt(np.abs(variance))
        assert gone == pytest.approx(np.sqrt(stated_share**2 - learned_share**2), rel=0.1, abs=2e-6)


def test_estimate_and_message_convert_both_ways() -> None:
    names = [own.name for own in fields(Estimate)]
    # what holds share of their errors is not sent
    assert names == ["stamp_ns", *wire.DRAG_ESTIMATE.names, "changes"]
    for estimate in estimates(air_run(), believing(AIR)):
        again = Estimate.from_bytes(estimate.serialized())
        assert again.to_dict() == estimate.to_dict()
