"""The verb `simulate`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

from gyrowheel.cli.console import advancing, notes, put_content
from gyrowheel.cli.options import (
    Belief,
    BenchOfRun,
    Blind,
    Effects,
    Json,
    Machine,
    PlanName,
    RecordingMade,
    Seed,
    Truth,
)

if TYPE_CHECKING:
    from gyrowheel import Model
    from gyrowheel.catalogue.api import Plan


def simulate(
    plan: PlanName,
    output: RecordingMade,
    effect: Effects = None,
    truth: Truth = None,
    model: Belief = None,
    blind: Blind = None,
    machine: Machine = None,
    seed: Seed = 0,
    bench: BenchOfRun = None,
    json: Json = None,
) -> None:
    """Simulate a test plan without ROS, into the same recording that `up` would make."""
    from gyrowheel.recordings.api import machine_options, note_machine
    from gyrowheel.show.layout import Unbroken
    from gyrowheel.simulation.api import simulate as run

    machine_model, belief = model_of(truth), model_of(model)
    note_belief(belief, alone=not (effect or truth or blind or machine is not None))
    chosen = plan_on_bench(plan, bench, machine_model, belief)
    begin = time.monotonic()
    with advancing(f"simulating plan {chosen.name}") as advance:
        made = run(
            chosen,
            effects=effect or (),
            truth=machine_model,
            model=belief,
            bench=bench,
            machine=machine,
            seed=seed,
            blind=blind,
            folder=output,
            progress=advance,
        )
    wall = time.monotonic() - begin
    note_machine(
        made,
        machine_options(effect=effect, truth=truth, blind=blind, machine=machine, seed=seed, bench=bench),
    )
    pace = f"{chosen.duration:.1f} s simulated in {wall:.1f} s, {chosen.duration / wall:.0f} times real time"
    content = run_json(chosen.name, str(output), chosen.duration, wall)
    put_content(json, content, [pace, Unbroken(f"recording: {output}")])


def plan_on_bench(plan: str, bench: str | None, truth: Model | None, belief: Model | None) -> Plan:
    """Return a plan as the bench of a run executes it, and note on stderr where that differs from its file."""
    from gyrowheel.catalogue.api import plan_on
    from gyrowheel.simulation.scenario import simulated_bench

    details = [None if model is None else model.details for model in (truth, belief)]
    _, loaded = simulated_bench(bench, *details)
    chosen = plan_on(loaded, plan)
    if chosen.fitting:
        notes().print(f"{chosen.origin}: {'; '.join(chosen.fitting)}", soft_wrap=True)
    elif chosen.written_for and chosen.called != plan:
        notes().print(f"plan {plan}: the bench {loaded.name} has its own, {chosen.called}", soft_wrap=True)
    return chosen


def note_belief(belief: Model | None, *, alone: bool) -> None:
    """Explain on stderr what ``--model`` means if the user may have meant ``--truth``."""
    if alone and belief is not None and (belief.effects or belief.parameters):
        notes().print(
            "--model is what the analyst believes; the machine is as the bench states it (give --truth to simulate the "
            "machine of a model)",
            soft_wrap=True,
        )


def model_of(file: Path | None) -> Model | None:
    """Return the model of a file; None without a file."""
    if file is None:
        return None
    from gyrowheel import Model

    return Model.load(file)


def run_json(plan: str, recording: str | None, simulated: float, wall: float) -> dict[str, object]:
    """Return the common fields of the JSON of `simulate` and `up`; times in seconds."""
    return {
        "schema": 1,
        "plan": plan,
        "recording": recording,
        "simulated_seconds": simulated,
        "wall_seconds": wall,
        "ratio": simulated / max(wall, 1e-9),
    }
