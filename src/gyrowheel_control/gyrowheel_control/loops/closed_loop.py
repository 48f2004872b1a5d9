"""The closed loop in one compiled run: the same as the graph of nodes, without ROS."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_control.loops.controller import Gains, controller_parameters, loop_code
from gyrowheel_control.loops.kernel import CommandColumn, ControllerState, SetpointColumn
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import Environment
from gyrowheel_sim.instruments import Reading
from gyrowheel_sim.plant.machine import Machine
from gyrowheel_sim.plant.protection import STOP_SAMPLES
from gyrowheel_sim.plant.scenario import Scenario

_RUNAWAY = 2.0  # tilt limits beyond which a machine has left its loop; an overshoot stays within
_CHUNK = 20000  # samples computed between two reports of progress


@dataclass(frozen=True)
class Run:
    """Result of a closed-loop run."""

    #: Readings, columns `gyrowheel_sim.instruments.Reading` [SI]; sample k is at k times the sample
    #: period.
    measurement: NDArray[np.float64]
    #: Commands, columns `gyrowheel_control.loops.kernel.CommandColumn`; row k answers sample k [V].
    command: NDArray[np.float64]
    setpoints: NDArray[Any]  # setpoints, dtype `gyrowheel_control.plans.plan.SETPOINT_DTYPE`
    environment: Sequence[Environment]  # changes by the operator
    bench: Bench  # the bench as its file describes it
    stamps: NDArray[np.int64]  # stamp that the clock of the instruments gave each sample [ns]

    @property
    def duration(self) -> float:
        """Simulated time [s]."""
        return len(self.measurement) * self.bench.sample_period


def simulate(
    bench: Bench,
    scenario: Scenario,
    plan: Plan,
    *,
    gains: Gains | None = None,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Run a plan on a simulated machine.

    Parameters
    ----------
    bench : Bench
        The bench as its file describes it; all that the controller knows.
    scenario : Scenario
        The true machine.
    plan : Plan
        The test plan.
    gains : Gains, optional
        Gains of the controller; those of the bench file if not given.
    progress : callable, optional
        Called now and then with the fraction done.

    Raises
    ------
    InputError
        If the plan is beyond the limits of the bench, or the machine runs away on it.
    """
    plan.check(bench)
    setpoints = plan.setpoints()
    stamps = np.ascontiguousarray(setpoints["stamp_ns"])
    values = np.column_stack([setpoints[column.name] for column in SetpointColumn])
    period_ns = round(bench.sample_period * 1e9)
    n = round(plan.duration / bench.sample_period)
    machine = Machine(bench, scenario, initial_spin_rate=plan.initial_spin_rate)
    code = loop_code(machine.compiled)
    constants = code.ControllerParameters(*controller_parameters(bench, gains or bench.gains))
    controller = np.zeros(len(ControllerState))
    measurement, command = np.empty((n, len(Reading))), np.empty((n, len(CommandColumn)))
    # an environment acts from the first sample on that is not before it, and shows in the sample after
    due = [(round(e.time / bench.sample_period), e) for e in plan.environment()]
    changes = [(k + 1 if k else 0, e) for k, e in due]
    edges = sorted({0, n, *(k for k, _ in changes if k < n), *range(0, n, _CHUNK)})
    for start, stop in itertools.pairwise(edges):
        for k, event in changes:
            if k == start:
                machine.set_environment(event)
        first = max(np.searchsorted(stamps, start * period_ns, side="right") - 1, 0)
        code.closed_loop(
            machine.parameters, *machine.laws, machine.environment,
            machine.state,
            machine.held, constants, controller, values[first:], stamps[first:], start, machine.noise(stop - start),
            measurement[start:stop], command[start:stop],
        )  # fmt: skip
        _require_held(measurement[start:stop], start, bench, plan)
        if progress is not None:
            progress(stop / n)
    return Run(measurement, command, setpoints, plan.environment(), bench, machine.clock.stamps(n))


def _require_held(samples: NDArray[np.float64], first: int, bench: Bench, plan: Plan) -> None:
    """Refuse a machine that diverges, or that goes where no wheel can be."""
    finite = np.asarray(np.isfinite(samples).all(axis=1))
    stop = _RUNAWAY * bench.value("tilt_limit")
    tilt = np.hypot(samples[:, Reading.tilt_x], samples[:, Reading.tilt_y])
    beyond = np.convolve(~(tilt <= stop), np.ones(STOP_SAMPLES), "valid") > STOP_SAMPLES - 0.5
    where = min(_first(~finite), _first(beyond))
    if where == math.inf:
        return
    at = int(where)
    what = (
        f"its tilt is {math.degrees(tilt[at]):.3g} deg"
        if finite[at]
        else f"{list(Reading)[int(np.argmin(np.isfinite(samples[at])))].name} is no number"
    )
    raise InputError(
        f"plan {plan.name}: the simulated machine runs away: {what} at {(first + at) * bench.sample_period:.4f} s; "
        "allowed: parameters and effects with which the controller holds it"
    )


def _first(found: NDArray[np.bool_]) -> float:
    """Return the number of the first row of which something is true; infinite where it is of none."""
    return float(np.argmax(found)) if found.any() else math.inf
