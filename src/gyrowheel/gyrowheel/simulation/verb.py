"""Verbs that run the bench: as a graph of nodes, or simulated at once."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrowheel.cli.console import advancing, notes, out, put_json, put_text, working
from gyrowheel.cli.options import (
    Belief,
    BenchOfRun,
    Blind,
    Effects,
    Json,
    Machine,
    Namespace,
    PlanName,
    RecordingMade,
    Seed,
    Truth,
    example,
)
from gyrowheel.cli.outputs import NewRecording

if TYPE_CHECKING:
    from gyrowheel import Model
    from gyrowheel.catalogue.api import Plan
    from gyrowheel.graph.api import Graph, GraphResult


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command(epilog=example("gyrowheel up --plan quick --record runs/monday --effect windage"))(up)
    app.command(epilog=example("gyrowheel simulate --plan quick -o runs/monday --effect windage:w=0.001"))(
        simulate
    )


def up(
    plan: Annotated[
        str | None,
        typer.Option(
            "--plan", metavar="P", help="Test plan to run; without one the bench runs until Ctrl-C."
        ),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option("--record", metavar="DIR", help="Record into this new directory.", show_default=False),
        NewRecording(),
    ] = None,
    realtime: Annotated[
        bool,
        typer.Option(
            "--realtime", help="Pace the bench by wall-clock time instead of running as fast as possible."
        ),
    ] = False,
    effect: Effects = None,
    truth: Truth = None,
    model: Belief = None,
    blind: Blind = None,
    machine: Machine = None,
    seed: Seed = 0,
    bench: BenchOfRun = None,
    without: Annotated[
        list[str] | None,
        typer.Option(
            "--without",
            metavar="NODE",
            help="Do not start this node, because your own takes its place; may be given again.",
            show_default=False,
        ),
    ] = None,
    domain: Annotated[
        int | None,
        typer.Option(
            "--domain", metavar="N", help="ROS domain, 0 .. 101.", show_default="ROS_DOMAIN_ID, or 0"
        ),
    ] = None,
    namespace: Namespace = "",
    logs: Annotated[bool, typer.Option("--logs", help="Show what the nodes log.")] = False,
    json: Json = None,
) -> None:
    """Run the bench as ROS nodes: plant, controller, conductor, drag estimator and recorder, a process each.

    A plan that tilts further than usual says so in its file; the guards of the bench then allow it.
    """
    from gyrowheel import Recording
    from gyrowheel.graph import api as graphs
    from gyrowheel.recordings.provenance import machine_options, note_machine

    believed, machine_model = _model(model), _model(truth)
    chosen = None if plan is None else _for_bench(plan, bench, machine_model, believed)
    _note_belief(believed, alone=not (effect or truth or blind or machine is not None))
    graph = graphs.up(
        chosen,
        effects=effect or (),
        truth=machine_model,
        model=believed,
        bench=bench,
        machine=machine,
        seed=seed,
        blind=blind,
        record=record,
        realtime=realtime,
        without_nodes=without or (),
        domain=domain,
        namespace=namespace,
        logs=logs,
        on_trouble=lambda node, text: notes().print(f"{node}: {text}", soft_wrap=True, highlight=False),
    )
    with contextlib.ExitStack() as stack:
        with working("starting the nodes"):
            stack.enter_context(graph)
        notes().print("  ".join(f"{name} {pid}" for name, pid in graph.pids.items()), soft_wrap=True)
        if chosen is None:
            notes().print("the bench runs; Ctrl-C ends it")
            graph.wait()
            return
        result = walk(graph, chosen)
    if record is not None:
        note_machine(
            Recording(record),
            machine_options(effect=effect, truth=truth, blind=blind, machine=machine, seed=seed, bench=bench),
        )
    _report(result, json)


def walk(graph: Graph, plan: Plan) -> GraphResult:
    """Run the plan in a started graph, and show the progress."""
    with advancing(f"plan {plan.name}") as advance:
        result = graph.run(progress=lambda p: advance(min(p.elapsed / p.duration, 1.0)))
        advance(1.0)
    return result


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
    from gyrowheel.recordings.provenance import machine_options, note_machine
    from gyrowheel.simulation.api import simulate as run

    machine_model, belief = _model(truth), _model(model)
    _note_belief(belief, alone=not (effect or truth or blind or machine is not None))
    chosen = _for_bench(plan, bench, machine_model, belief)
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
    if json is not None:
        put_json(json, _run_json(chosen.name, str(output), chosen.duration, wall))
    if json != "-":
        out().print(
            f"{chosen.duration:.1f} s simulated in {wall:.1f} s, {chosen.duration / wall:.0f} times real time"
        )
        out().print(f"recording: {output}", soft_wrap=True)


def _for_bench(plan: str, bench: str | None, truth: Model | None, belief: Model | None) -> Plan:
    """Return a plan as the bench of a run walks it; say so where that is not as it is written."""
    from gyrowheel.catalogue.api import plan_on
    from gyrowheel.simulation.scenario import simulated_bench

    _, loaded = simulated_bench(bench, truth, belief)
    chosen = plan_on(loaded, plan)
    if chosen.fitting:
        notes().print(f"{chosen.origin}: {'; '.join(chosen.fitting)}", soft_wrap=True)
    elif chosen.written_for and chosen.called != plan:
        notes().print(
            f"plan {plan}: the bench {loaded.name} has one of its own, {chosen.called}", soft_wrap=True
        )
    return chosen


def _note_belief(belief: Model | None, *, alone: bool) -> None:
    """Say what a model is for where it may be meant as the machine."""
    if alone and belief is not None and (belief.effects or belief.parameters):
        notes().print(
            "--model is what the analyst believes; the machine is as the bench states it (give --truth to simulate the "
            "machine of a model)",
            soft_wrap=True,
        )


def _model(file: Path | None) -> Model | None:
    """Return the model of a file, if there is one."""
    if file is None:
        return None
    from gyrowheel import Model

    return Model.load(file)


def _report(result: GraphResult, json: str | None) -> None:
    if json is not None:
        content = _run_json(
            result.plan,
            None if result.recording is None else str(result.recording),
            result.simulated_seconds,
            result.wall_seconds,
        )
        content |= {"drag_estimates": [estimate.to_dict() for estimate in result.estimates]}
        content |= {"samples": result.samples, "processes": dict(result.pids)}
        put_json(json, content | ({"pace": dict(result.pace)} if result.pace else {}))
    if json != "-":
        out().print(
            f"{result.simulated_seconds:.1f} s simulated in {result.wall_seconds:.1f} s, "
            f"{result.ratio:.2f} times real time"
        )
        if pace := result.pace:
            share = pace["late_commands"] / max(result.samples, 1)
            still = f"; the bench stood still for {pace['behind_s']:.3f} s" if pace["behind_s"] > 0.0 else ""
            out().print(
                f"{pace['late_commands']:.0f} commands late ({share:.2%}), {pace['missing_commands']:.0f} missing; the "
                f"last one was held for {pace['held_samples']:.0f} samples{still}",
                soft_wrap=True,
            )
        if result.recording is not None:
            out().print(f"{result.samples} samples recorded, none missing")
            out().print(f"recording: {result.recording}", soft_wrap=True)
        from gyrowheel.drag_comparison.page import drag_page

        put_text(drag_page(result.estimates))


def _run_json(plan: str, recording: str | None, simulated: float, wall: float) -> dict[str, object]:
    return {
        "schema": 1,
        "plan": plan,
        "recording": recording,
        "simulated_seconds": simulated,
        "wall_seconds": wall,
        "ratio": simulated / max(wall, 1e-9),
    }
