"""Drag estimates of holds of any length."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import gyrowheel_analysis.drag
from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.drag import DragEstimator, Estimate
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction import Samples, reduce
from gyrowheel_control.loops.closed_loop import Run, simulate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.readings import Readings
from gyrowheel_sim.plant.scenario import Scenario

from .machines import BENCH

SETPOINT = ("tilt_x", "tilt_y", "tilt_rate_x", "tilt_rate_y", "spin_rate", "spin_acceleration")
LONG, SHORT = 25.0, 1.2


PLAN = f"""\
schema: 1
name: long
segments:
  - {{spin_rpm: 3000, tilt_deg: [[0, 0], [1, 0]], hold_s: {SHORT}}}
  - {{spin_rpm: 3000, tilt_deg: [[3, 0]], hold_s: {LONG}}}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a run with two short holds and a long one."""
    file = tmp_path_factory.mktemp("plan") / "plan.yaml"
    file.write_text(PLAN)
    return simulate(BENCH, Scenario.nominal(noise_seed=3), Plan.load(file))


def estimates(run: Run) -> Iterator[Estimate]:
    estimator = DragEstimator(Model.new())
    for row in run.setpoints:
        values = [float(row[name]) for name in SETPOINT]
        estimator.setpoint(int(row["stamp_ns"]), int(row["segment"]), int(row["phase"]), values)
    stamps = np.arange(len(run.measurement), dtype=np.int64) * 500_000
    for start in range(0, len(stamps), 100):
        yield from estimator.add_block(
            stamps[start : start + 100], Readings(run.measurement[start : start + 100])
        )
    yield from estimator.finish()


def test_a_long_hold_is_estimated_as_a_whole(run: Run) -> None:
    last = list(estimates(run))[-1]
    assert last.settled
    assert last.duration == pytest.approx(LONG, abs=1.0)
    time = np.arange(len(run.measurement), dtype=np.float64) * BENCH.sample_period
    stop = last.stamp_ns * 1e-9
    inside = (time >= stop - last.duration) & (time <= stop)
    assert last.spin_rate == pytest.approx(Readings(run.measurement).spin_rate[inside].mean(), rel=1e-7)
    np.testing.assert_allclose(last.dc_voltage, run.measurement[inside, 4:7].mean(axis=0), atol=3e-4)
    # all its windows, reduced in one go
    setpoint = run.setpoints
    samples = Samples(time, Readings(run.measurement), setpoint["stamp_ns"] * 1e-9, setpoint)
    windows = reduce(samples, BENCH)
    within = windows.segment == last.segment
    coil, motor = Balance(windows, BENCH, clean=False).required(BENCH.values(), [])
    weight = windows.duration * within / np.sum(windows.duration[within])
    expected = [coil.real @ weight, coil.imag @ weight, motor @ weight]
    np.testing.assert_allclose(last.simulated_torque, expected, atol=2e-6)


@pytest.mark.slow
def test_the_work_for_a_hold_grows_with_its_length_only(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    lengths = []

    def counting(data: Samples, *rest: Any) -> Any:
        lengths.append(len(data.time))
        return reduce(data, *rest)

    monkeypatch.setattr(gyrowheel_analysis.drag, "reduce", counting)
    found = list(estimates(run))
    assert sum(lengths) < 4 * len(run.measurement)
    assert max(lengths) * BENCH.sample_period < 3.0
    # often at first, and never silent for long
    times = (
        np.array([estimate.stamp_ns for estimate in found if estimate.segment == found[-1].segment]) * 1e-9
    )
    assert np.diff(times)[0] == pytest.approx(0.5, abs=0.1)
    assert np.diff(times).max() < 5.1
