"""A recording made at once, as the graph of nodes would have recorded it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
import psutil

from gyrowheel_analysis.drag import DragEstimator, Estimate
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.recording import write_run
from gyrowheel_control.loops.closed_loop import Run, simulate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import new_directory
from gyrowheel_core.readings import Readings
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import to_json
from gyrowheel_sim.plant.scenario import Scenario

_PER_SAMPLE: Final = 700  # bytes of memory that a sample takes until it is written, as measured
_BLOCK = 100  # samples that the drag estimator takes at a time, as its node does
_SETPOINT = ("tilt_x", "tilt_y", "tilt_rate_x", "tilt_rate_y", "spin_rate", "spin_acceleration")


def record_simulation(
    directory: Path,
    bench: Bench,
    scenario: Scenario,
    plan: Plan,
    *,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Run a plan on a simulated machine and write the recording; it appears whole or not at all.

    Parameters
    ----------
    directory : Path
        To create; must not exist, or be empty.
    bench : Bench
        The bench as its file describes it.
    scenario : Scenario
        What the machine really is; nothing of it goes into the recording but its behaviour.
    plan : Plan
        The test plan.
    progress : callable, optional
        Called now and then with the fraction done.

    Raises
    ------
    InputError
        If the plan is beyond the limits of the bench or too long for the memory, or the directory cannot be written.
    """
    _require_memory(plan, bench)
    with new_directory(directory) as place:
        run = simulate(bench, scenario, plan, progress=progress)
        write_run(
            place,
            run.measurement,
            run.command,
            run.setpoints,
            to_json(run.environment),
            bench.describe(),
            sample_period=bench.sample_period,
            drag_estimates=[(estimate.stamp_ns, _message(estimate)) for estimate in _estimates(run, bench)],
        )


def _require_memory(plan: Plan, bench: Bench) -> None:
    """Refuse a run that would not fit: the system would end the process in the middle of it, without a word."""
    needed, free = _PER_SAMPLE * plan.duration / bench.sample_period, psutil.virtual_memory().available
    if needed > free:
        raise InputError(
            f"plan {plan.name}: {plan.duration:.0f} s take {1e-9 * needed:.3g} GB of memory to simulate at once; "
            f"allowed: {1e-9 * free:.3g} GB, what is free (split the plan, or record it with 'gyrowheel up')"
        )


def _estimates(run: Run, bench: Bench) -> Iterator[Estimate]:
    """Yield what the drag estimator says during a run."""
    estimator = DragEstimator(Model(bench))
    for row in run.setpoints:
        values = [float(row[name]) for name in _SETPOINT]
        estimator.setpoint(int(row["stamp_ns"]), int(row["segment"]), int(row["phase"]), values)
    stamps = np.arange(len(run.measurement), dtype=np.int64) * round(bench.sample_period * wire.SECOND)
    for start in range(0, len(stamps), _BLOCK):
        block = slice(start, start + _BLOCK)
        yield from estimator.add_block(stamps[block], Readings(run.measurement[block]))
    yield from estimator.finish()


def _message(estimate: Estimate) -> bytes:
    return wire.DRAG_ESTIMATE.pack(
        estimate.stamp_ns,
        estimate.segment,
        estimate.settled,
        estimate.duration,
        estimate.tilt_x,
        estimate.tilt_y,
        estimate.spin_rate,
        *estimate.dc_voltage,
        *estimate.dc_voltage_std,
        *estimate.voltage_increment,
        *estimate.measured_torque,
        *estimate.measured_torque_std,
        *estimate.simulated_torque,
        *estimate.residual,
    )
