"""A recording simulated at once, equal to what the graph of nodes would record."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import psutil

from gyrowheel.recordings.api import Recording
from gyrowheel.simulation.scenario import scenario, simulated_bench
from gyrowheel_analysis.drag.estimate import Estimate
from gyrowheel_analysis.drag.stream import drag_estimates
from gyrowheel_analysis.model import Model
from gyrowheel_control.loops.closed_loop import Run
from gyrowheel_control.loops.closed_loop import simulate as run_loop
from gyrowheel_control.plans.adaptation import plan_for
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import new_directory, require_new
from gyrowheel_core.readings import Readings
from gyrowheel_recording.bags import write_run
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import Effect
from gyrowheel_sim.environment import to_json
from gyrowheel_sim.plant.scenario import Scenario

if TYPE_CHECKING:
    from gyrowheel.models.api import Model as PublicModel

_PER_SAMPLE: Final = 180  # bytes of memory that a sample takes until it is written, as measured


def simulate(
    plan: str | Path | Plan,
    *,
    effects: Mapping[str, Mapping[str, float]] | Sequence[str | Effect] = (),
    truth: PublicModel | None = None,
    model: PublicModel | None = None,
    bench: str | Path | None = None,
    machine: int | None = None,
    seed: int = 0,
    blind: str | Path | None = None,
    folder: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> Recording:
    """Run a test plan on a simulated machine, at once and without ROS.

    Parameters
    ----------
    plan : str, Path or Plan
        Shipped name (`gyrowheel.plans`), plan file, text of one, or plan.
    effects : mapping or sequence, optional
        Effects that the machine has: ``{"windage": {"w": 0.0013}}``, coefficients in SI units, those not given of their
        usual size; or names, ``NAME:COEF=VALUE,...`` and user-defined effects (`gyrowheel.own_effect`).
    truth : Model, optional
        A model whose effects and estimated parameters the machine has, in addition to `effects`.
    model : Model, optional
        The model that the analyst believes: with it the recorded drag estimates are made, never with the truth; by
        default the bench without effects.
    bench : str or Path, optional
        Shipped name of the bench (`gyrowheel.benches`) or bench file; if not given, that of `truth` or `model`, else
        ``gyrowheel``.
    machine : int, optional
        Draw the true bench parameters within their uncertainties with this seed; as stated if not given.
    seed : int
        Seed of the noise, which differs between plans too; not negative.
    blind : str or Path, optional
        Key file of a hidden machine: used if it exists, else drawn at random and written.
    folder : str or Path, optional
        New directory to keep the recording in; a temporary one that is removed with the recording if not given.
    progress : callable, optional
        Called with the fraction done, 0 .. 1.

    Raises
    ------
    InputError
        If something is not known or out of range, the plan is beyond the limits of the bench, or the folder cannot be
        written.
    """
    real, belief = (None if given is None else given.details for given in (truth, model))
    _, loaded = simulated_bench(bench, real, belief)
    chosen = plan_for(plan, loaded)
    if folder is not None:
        require_new(Path(folder))
    hidden = scenario(
        loaded,
        chosen.name,
        effects=effects,
        truth=real,
        blind=None if blind is None else Path(blind),
        seed=seed,
        machine=machine,
    )
    return Recording.written(
        folder,
        chosen.name,
        lambda place: record_simulation(place, loaded, hidden, chosen, model=belief, progress=progress),
    )


def record_simulation(
    directory: Path,
    bench: Bench,
    scenario: Scenario,
    plan: Plan,
    *,
    model: Model | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Run a plan on a simulated machine and write the recording; it appears complete or not at all.

    Only the behaviour of the machine goes into the recording. Drag estimates are made with the believed `model`, by
    default the bench without effects. InputError if the plan exceeds the limits of the bench or the memory, or the
    directory is not new.
    """
    _require_memory(plan, bench)
    machine = scenario.identity(bench)
    with new_directory(directory) as place:
        run = run_loop(bench, scenario, plan, progress=progress)
        write_run(
            place,
            run.measurement,
            run.command,
            run.setpoints,
            to_json(replace(event, machine=machine) for event in run.environment),
            bench.describe(),
            sample_period=bench.sample_period,
            stamps=run.stamps,
            drag_estimates=[
                (estimate.stamp_ns, estimate.serialized())
                for estimate in _estimates(run, model or Model(bench))
            ],
        )


def _require_memory(plan: Plan, bench: Bench) -> None:
    """Refuse a run that would not fit: the operating system would kill the process without a message."""
    needed, free = _PER_SAMPLE * plan.duration / bench.sample_period, psutil.virtual_memory().available
    if needed > free:
        raise InputError(
            f"plan {plan.name}: {plan.duration:.0f} s take {1e-9 * needed:.3g} GB of memory to simulate at once; "
            f"allowed: {1e-9 * free:.3g} GB, the free memory (split the plan, or record it with 'gyrowheel up')"
        )


@one_thread()  # the last digit of a sum must not depend on the number of cores
def _estimates(run: Run, model: Model) -> list[Estimate]:
    """Return the drag estimates of a run."""
    return list(drag_estimates(run.stamps, Readings(run.measurement), run.setpoints, model, run.environment))
