"""The verb `replay`."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrowheel.cli.console import notes, put_json, put_text
from gyrowheel.cli.options import Json, Namespace, example
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from gyrowheel.graph.api import Playing


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command(epilog=example("gyrowheel replay runs/monday --from 10 --to 20 --rate 0.5"))(replay)


def replay(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Recording.", show_default=False)],
    rate: Annotated[
        float, typer.Option("--rate", metavar="R", help="Speed, as a multiple of the recorded one.")
    ] = 1.0,
    fast: Annotated[bool, typer.Option("--fast", help="As fast as the readers can take it.")] = False,
    step: Annotated[bool, typer.Option("--step", help="Start paused, and go on step by step.")] = False,
    step_length: Annotated[
        float,
        typer.Option(
            "--step-length", metavar="S", help="Length of a step, in seconds; 0: to the next sample."
        ),
    ] = 0.0,
    loop: Annotated[bool, typer.Option("--loop", help="Start again at the end.")] = False,
    start: Annotated[
        float, typer.Option("--from", metavar="S", help="Start, in seconds since the first sample.")
    ] = 0.0,
    end: Annotated[
        float | None,
        typer.Option(
            "--to", metavar="S", help="End, in seconds since the first sample.", show_default="the end"
        ),
    ] = None,
    topic: Annotated[
        list[str] | None,
        typer.Option("--topic", metavar="T", help="Publish this topic only. Repeatable.", show_default="all"),
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option("--without", metavar="T", help="Leave out this topic. Repeatable.", show_default=False),
    ] = None,
    clock: Annotated[bool, typer.Option("--clock/--no-clock", help="Publish /clock.")] = True,
    wait: Annotated[
        float,
        typer.Option(
            "--wait", metavar="S", help="Time to look for other nodes before it begins, in seconds."
        ),
    ] = 3.5,
    readers: Annotated[
        int, typer.Option("--readers", metavar="N", help="Readers of the samples to wait for.")
    ] = 0,
    estimate: Annotated[
        bool, typer.Option("--estimate", help="Run the drag estimator on it and show its estimates.")
    ] = False,
    model: Annotated[
        Path | None,
        typer.Option(
            "--model",
            metavar="M.yaml",
            help="Model that the estimator believes.",
            show_default="a new one of the bench gyrowheel",
        ),
    ] = None,
    namespace: Namespace = "",
    logs: Annotated[bool, typer.Option("--logs", help="Show what the nodes log.")] = False,
    json: Json = None,
) -> None:
    """Publish a recorded run again over ROS, message by message.

    On a terminal the space bar stops it and lets it go on, s makes one step,
    q ends it. The services /gyrowheel/replay/pause and step do the same from
    elsewhere.
    """
    import math

    for name, value, low, high in (
        ("--rate", rate, 1e-3, 1e6),
        ("--step-length", step_length, 0.0, 3600.0),
        ("--from", start, 0.0, 1e9),
        ("--to", end, 0.0, 1e9),
        ("--wait", wait, 0.0, 60.0),
        ("--readers", readers, 0, 100),
    ):
        if value is not None and not low <= value <= high:  # refuses what is no number, too
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

        from gyrowheel.graph.replay_page import replay_page

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
    if json is not None:
        put_json(
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
        )
    if json != "-":
        put_text(replay_page(outcome, tape.duration))


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
