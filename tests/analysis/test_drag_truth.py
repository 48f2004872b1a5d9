"""Drag estimates against the truth of simulated machines, and what each field says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrowheel_analysis.drag import Estimate
from gyrowheel_analysis.drag_stream import drag_estimates
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
QUIET = {name: 0.0 for name in BENCH.values() if name.endswith(("_noise", "_drift"))}
AIR: EffectValues = {
    "windage": registry()["windage"].defaults(),
    "aero_cross": registry()["aero_cross"].defaults(),
}


def run_of(machine: Scenario, plan: str = PLAN, bench: Bench = BENCH) -> Run:
    return simulate(bench, machine, Plan.load(plan))


def estimates(run: Run, model: Model) -> list[Estimate]:
    period = round(run.bench.sample_period * wire.SECOND)
    stamps = np.arange(len(run.measurement), dtype=np.int64) * period
    return list(drag_estimates(stamps, Readings(run.measurement), run.setpoints, model))


def holds(run: Run, model: Model) -> list[Estimate]:
    return [estimate for estimate in estimates(run, model) if estimate.settled]


@cache
def air_run() -> Run:
    return run_of(Scenario(effects=AIR, noise_seed=5))


def believing(effects: EffectValues | None = None, overrides: Mapping[str, Override] | None = None) -> Model:
    return replace(Model(BENCH), effects=effects or {}, overrides=overrides or {})


def held(machine: Scenario) -> list[NDArray[np.float64]]:
    """Return the true torques of coils and motor in every hold: of the machine without noise, by its own constants."""
    quiet = run_of(replace(machine, values={**machine.values, **QUIET}))
    own = BENCH.with_values(machine.values)
    constants = np.array([own.value("coil_constant")] * 2 + [own.value("motor_constant")])
    return [constants * [*e.dc_voltage[:2], e.motor_current] for e in holds(quiet, Model(BENCH))]


def test_the_torque_is_that_of_the_machine_within_three_standard_errors() -> None:
    scores = []
    for number in range(3):
        machine = hidden_machine(number, AIR if number else {})
        found = holds(run_of(machine), Model(BENCH))
        assert len(found) == 8
        for estimate, truth in zip(found, held(machine), strict=True):
            assert not estimate.calibrated
            scores.append((estimate.measured_torque - truth) / estimate.residual_std)
    assert np.mean(np.abs(scores) < 3.0) >= 0.95
    # and the standard errors are not so large that it could not fail
    assert np.std(scores) > 0.2


def test_every_field_is_finite_while_a_hold_is_under_way_and_after() -> None:
    for model in (Model(BENCH), believing(AIR)):
        found = estimates(air_run(), model)
        assert {estimate.settled for estimate in found} == {True, False}
        for estimate in found:
            for name in wire.DRAG_ESTIMATE.names:
                assert np.all(np.isfinite(getattr(estimate, name))), name


def test_without_air_in_the_model_the_difference_is_the_torque_of_the_air() -> None:
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


def test_increments_of_voltage_are_those_that_the_model_predicts() -> None:
    for e in holds(air_run(), believing(AIR)):
        # the model's own prediction has the noise of the measured motion in it, the motor's most of all
        error = np.hypot(e.voltage_increment_std, [1e-3, 1e-3, 5e-3])
        assert np.all(np.abs(e.voltage_increment - e.simulated_voltage_increment) < 4.0 * error)


def test_the_noise_is_that_of_the_data() -> None:
    loud = Scenario(values={"coil_voltage_noise": 0.2, "motor_current_noise": 0.5}, noise_seed=5)
    for e in holds(run_of(loud), Model(BENCH)):
        count = e.duration / BENCH.sample_period
        white = np.sqrt(e.dc_voltage_std[:2] ** 2 - BENCH.value("coil_voltage_drift") ** 2)
        assert white == pytest.approx(0.2 / np.sqrt(count), rel=0.9)
        assert e.motor_current_std > 0.3 * 0.5 / np.sqrt(count)
        assert e.measured_torque_std[2] == pytest.approx(0.03 * e.motor_current_std)


def test_constants_are_stated_until_calibrated() -> None:
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
        assert stated.constants_std == pytest.approx(np.abs(read) * [0.0004, 0.0004, 0.0003], rel=1e-9)
        assert learned.measured_torque == pytest.approx(read * [0.021, 0.021, 0.031], abs=1e-12)
        assert learned.constants_std == pytest.approx(np.abs(read) * [1e-5, 1e-5, 2e-5], rel=1e-9)


def test_an_estimate_is_the_message() -> None:
    names = [own.name for own in fields(Estimate)]
    assert names == ["stamp_ns", *wire.DRAG_ESTIMATE.names]
    for estimate in estimates(air_run(), believing(AIR)):
        again = Estimate.from_bytes(estimate.serialized())
        assert again.to_dict() == estimate.to_dict()
