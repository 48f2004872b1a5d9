"""Verbs of the running bench: `up`, `replay`, `live` and `run`."""

from __future__ import annotations

import contextlib
import math
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrowheel.cli.console import advancing, notes, out, put_content, put_json, put_text, working
from gyrowheel.cli.options import (
    Belief,
    BenchOfRun,
    Blind,
    Effects,
    Json,
    Machine,
    Namespace,
    Seed,
    Truth,
    Until,
    argument,
    option,
    settled_only,
)
from gyrowheel.cli.outputs import NewRecording
from gyrowheel.simulation.verb import model_of, note_belief, plan_on_bench, run_json
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from gyrowheel.graph.api import GraphResult, Playing, Progress
    from gyrowheel.graph.follower import Follower


class _Settled(Exception):
    """An effect is settled before the plan has ended: the rest of the plan would not change that."""


def up(
    plan: Annotated[
        str | None, option("--plan P", "Test plan to run; without one the bench runs until Ctrl-C.")
    ] = None,
    record: Annotated[
        Path | None, option("--record DIR", "Record into this new directory."), NewRecording()
    ] = None,
    realtime: Annotated[
        bool,
        option("--realtime", "Pace the bench by wall-clock time instead of running as fast as possible."),
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
        option(
            "--without NODE", "Do not start this node, because your own takes its place; may be given again."
        ),
    ] = None,
    domain: Annotated[
        int | None, option("--domain N", "ROS domain, 0 .. 101.", "ROS_DOMAIN_ID, or 0")
    ] = None,
    namespace: Namespace = "",
    diagnose: Annotated[
        bool,
        option(
            "--diagnose",
            "Diagnose the recording while it is made, with the model of --model.",
        ),
    ] = False,
    until: Until = None,
    logs: Annotated[bool, option("--logs", "Show the logs of the nodes.")] = False,
    json: Json = None,
) -> None:
    """Run the bench as ROS nodes: plant, controller, conductor, drag estimator and recorder, a process each.

    A plan that tilts further than usual says so in its file; the guards of the bench then allow it.
    """
    from gyrowheel import Recording
    from gyrowheel.graph import api as graphs
    from gyrowheel.recordings.api import machine_options, note_machine

    early = settled_only(until, diagnose, "--diagnose")
    if diagnose and (record is None or model is None):
        raise InputError("--diagnose: needs --record and --model")
    if early and plan is None:
        raise InputError("--until: needs --plan, which it ends")
    believed, machine_model = model_of(model), model_of(truth)
    chosen = None if plan is None else plan_on_bench(plan, bench, machine_model, believed)
    note_belief(believed, alone=not (effect or truth or blind or machine is not None))
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
    with contextlib.ExitStack() as after:  # the diagnosis ends after the bench, with the whole recording
        looks: Follower | None = None
        result: GraphResult | None = None
        with contextlib.ExitStack() as stack:
            with working("starting the nodes"):
                stack.enter_context(graph)
            notes().print("  ".join(f"{name} {pid}" for name, pid in graph.pids.items()), soft_wrap=True)
            if diagnose and record is not None and model is not None:
                from gyrowheel.graph.follower import Follower

                looks = after.enter_context(Follower(record, model, early=early, quiet=json == "-"))
            if chosen is None:
                notes().print("the bench runs; Ctrl-C ends it")
                graph.wait()
                return
            ended, begin = 0.0, time.monotonic()
            with advancing(f"plan {chosen.name}") as advance:

                def progress(now: Progress) -> None:
                    nonlocal ended
                    ended = now.elapsed
                    advance(min(now.elapsed / now.duration, 1.0))
                    if early and looks is not None and looks.ended:
                        raise _Settled

                try:
                    result = graph.run(progress=progress)
                    advance(1.0)
                except _Settled:
                    notes().print(
                        f"plan {chosen.name}: ended at {ended:.0f} s of {chosen.duration:.0f} s: settled"
                    )
        if record is not None:
            note_machine(
                Recording(record),
                machine_options(
                    effect=effect, truth=truth, blind=blind, machine=machine, seed=seed, bench=bench
                ),
            )
        if result is not None:
            _report(result, json)
        elif json is not None:
            put_json(json, run_json(chosen.name, str(record), ended, time.monotonic() - begin))


def _report(result: GraphResult, json: str | None) -> None:
    if json is not None:
        content = run_json(
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
            share = f" ({pace['late_commands'] / result.samples:.2%})" if result.samples else ""
            still = f"; the bench stood still for {pace['behind_s']:.3f} s" if pace["behind_s"] > 0.0 else ""
            out().print(
                f"{pace['late_commands']:.0f} commands late{share}, {pace['missing_commands']:.0f} missing; the "
                f"last one was held for {pace['held_samples']:.0f} samples{still}",
                soft_wrap=True,
            )
        if result.recording is not None:
            out().print(f"{result.samples} samples recorded, none missing")
            out().print(f"recording: {result.recording}", soft_wrap=True)
        from gyrowheel.drag_comparison.page import drag_page

        put_text(drag_page(result.estimates))


def replay(
    directory: Annotated[Path, argument("DIR", "Recording.")],
    rate: Annotated[float, option("--rate R", "Speed, as a multiple of the recorded one.")] = 1.0,
    fast: Annotated[bool, option("--fast", "As fast as the readers can take it.")] = False,
    step: Annotated[bool, option("--step", "Start paused, and go on step by step.")] = False,
    step_length: Annotated[
        float, option("--step-length S", "Length of a step, in seconds; 0: to the next sample.")
    ] = 0.0,
    loop: Annotated[bool, option("--loop", "Start again at the end.")] = False,
    start: Annotated[float, option("--from S", "Start, in seconds since the first sample.")] = 0.0,
    end: Annotated[
        float | None, option("--to S", "End, in seconds since the first sample.", "the end")
    ] = None,
    topic: Annotated[
        list[str] | None, option("--topic T", "Publish this topic only. Repeatable.", "all")
    ] = None,
    without: Annotated[list[str] | None, option("--without T", "Leave out this topic. Repeatable.")] = None,
    clock: Annotated[bool, option("--clock/--no-clock", "Publish /clock.")] = True,
    wait: Annotated[
        float, option("--wait S", "Time to look for other nodes before it begins, in seconds.")
    ] = 3.5,
    readers: Annotated[int, option("--readers N", "Readers of the samples to wait for.")] = 0,
    estimate: Annotated[
        bool, option("--estimate", "Run the drag estimator on it and show its estimates.")
    ] = False,
    model: Annotated[
        Path | None,
        option("--model M.yaml", "Model that the estimator believes.", "a new one of the bench gyrowheel"),
    ] = None,
    namespace: Namespace = "",
    logs: Annotated[bool, option("--logs", "Show the logs of the nodes.")] = False,
    json: Json = None,
) -> None:
    """Publish a recorded run again over ROS, message by message.

    On a terminal the space bar pauses and resumes it, s makes one step,
    q ends it. The services /gyrowheel/replay/pause and step do the same from
    elsewhere.
    """
    for name, value, low, high in (
        ("--rate", rate, 1e-3, 1e6),
        ("--step-length", step_length, 0.0, 3600.0),
        ("--from", start, 0.0, 1e9),
        ("--to", end, 0.0, 1e9),
        ("--wait", wait, 0.0, 60.0),
        ("--readers", readers, 0, 100),
    ):
        if value is not None and not low <= value <= high:  # also refuses NaN
            raise InputError(f"{name}: {value:g} is out of range; allowed: {low:g} .. {high:g}")
    if model is not None and not estimate:
        raise InputError("--model: is for the estimator; add --estimate")
    if estimate and loop:
        raise InputError("--estimate: not together with --loop, which has no end")
    with contextlib.ExitStack() as stack:
        estimator: dict[str, object] | None = None
        if estimate:
            estimator = {}
            if model is not None:
                from gyrowheel import Model

                Model.load(model)
                estimator["model"] = str(model.absolute())
        with notes().status(f"opening {directory}") if notes().is_terminal else contextlib.nullcontext():
            from gyrowheel.graph.api import play
            from gyrowheel.graph.api import tape as open_tape

            tape = open_tape(
                directory,
                only=topic or (),
                without=without or (),
                start=start,
                end=math.inf if end is None else end,
                estimate=estimate,
            )
        stack.callback(tape.close)

        from gyrowheel.graph.page import replay_page

        with _showing(tape.duration, tape.start) as show:
            outcome = play(
                tape,
                {
                    "rate": 0.0 if fast else rate,
                    "loop": loop,
                    "paused": step,
                    "step": step_length,
                    "clock": clock,
                    "wait": 1.0 if estimate else wait,
                    "wait_for_subscribers": readers + int(estimate),
                },
                show=show,
                estimator=estimator,
                namespace=namespace,
                logs=logs,
            )
    if outcome.code:
        raise typer.Exit(outcome.code)
    if not outcome.complete and not outcome.stopped:
        raise KeyboardInterrupt
    put_content(
        json,
        {
            "schema": 1,
            "recording": str(directory),
            "from": start,
            "to": start + tape.duration,
            "complete": outcome.complete,
            "rounds": outcome.rounds,
            "messages": outcome.counts,
            "left_out": outcome.left_out,
            "wall_seconds": outcome.wall,
            "drag_estimates": [estimate.to_dict() for estimate in outcome.estimates],
        },
        replay_page(outcome, tape.duration),
    )


@contextlib.contextmanager
def _showing(duration: float, start: float) -> Iterator[Callable[[Playing], None]]:
    """Show on stderr where a replay is: one changing line on a terminal, a line every quarter elsewhere."""
    console = notes()
    if not console.is_terminal:
        told = -1

        def tell(node: Playing) -> None:
            nonlocal told
            quarter = 4 * node.rounds + int(4.0 * (node.position - start) / max(duration, 1e-9) + 1e-9)
            if node.started and quarter > told:
                told = quarter
                console.print(f"replay: at {node.position:.1f} s of {start + duration:.1f} s", soft_wrap=True)

        yield tell
        return
    with console.status("looking for other nodes") as status:

        def draw(node: Playing) -> None:
            if not node.started:
                return
            done = (node.position - start) / max(duration, 1e-9)
            bar = "━" * round(20 * min(done, 1.0))
            state = "paused" if node.paused else "replay"
            rounds = f", round {node.rounds + 1}" if node.rounds else ""
            status.update(
                f"{state} {bar:╌<20} {node.position:9.4f} of {start + duration:.4f} s{rounds}"
                "   space: pause  s: step  q: end"
            )

        yield draw


def live(
    port: Annotated[int, option("--port N", "Port on this computer; 0: any.", min=0, max=65535)] = 8765,
    origin: Annotated[
        list[str] | None,
        option(
            "--origin URL",
            "A web page that may read too, such as https://app.foxglove.dev; repeatable. Pages of other sites are "
            "refused.",
        ),
    ] = None,
    namespace: Namespace = "",
) -> None:
    """Show the running bench, or a replay, in the viewer Foxglove until Ctrl-C.

    Start it while `gyrowheel up` or `gyrowheel replay` runs, open the address
    that it prints in Foxglove (Open connection), and import the layout that it
    names.
    """
    from gyrowheel.graph.api import foxglove, foxglove_layout, share_file

    with contextlib.ExitStack() as stack:
        with working("starting the server"):
            address = stack.enter_context(foxglove(port, origin or (), namespace=namespace))
        layout = share_file("config/foxglove_layout.json")
        if namespace.strip("/"):  # its topics have other names
            layout = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="gyrowheel-"))) / layout.name
            layout.write_text(foxglove_layout(namespace), encoding="utf-8")
        out().print(f"address: {address}", soft_wrap=True)
        out().print(f"layout: {layout}", soft_wrap=True)
        notes().print("Ctrl-C ends it")
        while True:
            time.sleep(3600.0)


def run(
    context: typer.Context,
    package: Annotated[str | None, argument("PKG", "Package.", "lists all packages")] = None,
    executable: Annotated[
        str | None, argument("EXE", "Executable of it.", "lists those of the package")
    ] = None,
) -> None:
    """Start one node, as ros2 run does; further arguments go to the node.

    Without arguments it lists packages and executables.
    """
    # after a package and an executable, --help is for the node
    if {package, executable} & {"-h", "--help"}:
        typer.echo(context.get_help())
        return
    from gyrowheel.graph.api import executables, find_executable, run_executable

    if package is not None and executable is not None:
        run_executable(package, executable, context.args)
    known = executables()
    if package is not None and package not in known:
        find_executable(package, "")  # raises the error
    for name in known if package is None else [package]:
        typer.echo(name)
        for own in known[name]:
            typer.echo(f"  {own}")
