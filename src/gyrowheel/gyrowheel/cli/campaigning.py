"""The verb `campaign`."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from gyrowheel.cli.options import BenchName, Json, example
from gyrowheel.cli.outputs import CASE_LIST
from gyrowheel.cli.shell import INTERRUPTED, notes, put_json, put_text

if TYPE_CHECKING:
    from gyrowheel.campaign.cases import Case
    from gyrowheel.campaign.judge import Judged
    from gyrowheel_sim.blind.draw import Kind


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command(epilog=example("gyrowheel campaign --cases 40 --seed 3 --plan quick"))(campaign)


def campaign(
    plan: Annotated[
        str, typer.Option("--plan", metavar="P", help="Plan that is diagnosed: shipped name, or a plan file.")
    ] = "survey",
    validation_plan: Annotated[
        str,
        typer.Option("--validation-plan", metavar="P", help="Plan of the recording that is only predicted."),
    ] = "check",
    cases: Annotated[int, typer.Option("--cases", metavar="N", help="How many cases.")] = 100,
    seed: Annotated[int, typer.Option("--seed", metavar="N", help="Seed of everything that is drawn.")] = 0,
    kinds: Annotated[
        str, typer.Option("--kinds", metavar="K,K..", help="What may be hidden: none, single, pair, outside.")
    ] = "none,single,pair,outside",
    noise: Annotated[
        float, typer.Option("--noise", metavar="X", help="White noise, times the stated one.")
    ] = 1.0,
    drift: Annotated[
        float, typer.Option("--drift", metavar="X", help="Slow drifts, times the stated ones.")
    ] = 1.0,
    gains: Annotated[
        float, typer.Option("--gains", metavar="X", help="Spin gains, times those of the default controller.")
    ] = 1.0,
    lost: Annotated[
        float, typer.Option("--lost", metavar="PART", help="Part of the samples that is lost: 0.01 is 1 %.")
    ] = 0.0,
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs", metavar="N", help="Cases at a time on this machine.", show_default="one a core"
        ),
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(
            "--dask",
            metavar="ADDRESS",
            help="Scheduler of a Dask cluster that does the cases.",
            show_default=False,
        ),
    ] = None,
    only: Annotated[
        list[int] | None,
        typer.Option(
            "--only", metavar="I", help="Case of this number alone. Repeatable.", show_default=False
        ),
    ] = None,
    keep: Annotated[
        Path | None,
        typer.Option(
            "--keep",
            metavar="DIR",
            help="Keep recordings, keys and diagnoses here (some ten megabytes a case).",
            show_default=False,
        ),
    ] = None,
    list_file: Annotated[
        Path | None,
        typer.Option("--list", metavar="FILE", help="Write every case as JSON here.", show_default=False),
        CASE_LIST,
    ] = None,
    bench: BenchName = "gyrowheel",
    json: Json = None,
) -> None:
    """Put the discovery to the test by many blind cases, each judged by its key.

    Each case is a machine of its own: parameters within their uncertainties,
    noise, drift and controller varied, and hidden in it nothing, one effect,
    two, or one that no library has, 1 to 10 times as large as the detection
    limit of the plan. Ctrl-C ends it and reports the cases that were finished.
    """
    from gyrowheel.campaign.cases import Campaign
    from gyrowheel.campaign.cases import cases as all_cases
    from gyrowheel.campaign.summary import Summary
    from gyrowheel.campaign.workers import cores
    from gyrowheel.text.campaign import campaign_page
    from gyrowheel_control.plans.plan import Plan
    from gyrowheel_core.files import disk_errors
    from gyrowheel_sim.bench import Bench

    plans = [Plan.load(name) for name in (plan, validation_plan)]
    settings = Campaign(
        plan=plans[0].to_yaml(),
        validation_plan=plans[1].to_yaml(),
        bench=Bench.load(bench),
        seed=seed,
        kinds=tuple(cast("Kind", kind.strip()) for kind in kinds.split(",")),  # checked there
        noise=noise,
        drift=drift,
        gains=gains,
        lost=lost,
    )
    wanted = all_cases(settings, cases, only or ())
    if keep is not None:
        with disk_errors(keep):
            keep.mkdir(parents=True, exist_ok=True)
    done: list[Judged] = []
    interrupted = False
    try:
        _work(wanted, done, cores() if jobs is None else jobs, dask, keep)
    except KeyboardInterrupt:
        if not done:
            raise  # there is nothing to report
        interrupted = True
    summary = Summary.of(seed, len(wanted), done)
    if json is not None:
        put_json(json, summary.to_json())
    if list_file is not None:
        put_json(str(list_file), [case.to_json() for case in summary.cases])
    if json != "-":
        varied = {"noise": noise, "drift": drift, "spin gains": gains}
        changes = [f"{name} × {value:g}" for name, value in varied.items() if value != 1.0]
        changes += [f"{100.0 * lost:g} % of the samples lost"] if lost else []
        title = ", ".join([f"{len(wanted)} blind cases of plan {plans[0].name}", f"seed {seed}", *changes])
        put_text(campaign_page(summary, title))
    if interrupted:
        raise typer.Exit(INTERRUPTED)


def _work(wanted: Sequence[Case], done: list[Judged], jobs: int, dask: str | None, keep: Path | None) -> None:
    """Do the cases; those finished are in `done` whatever happens."""
    from gyrowheel.campaign.workers import judged_cases
    from gyrowheel.text.campaign import case_line

    kept = None if keep is None else str(keep.absolute())
    with (
        _counting(len(wanted)) as (count, say),
        judged_cases(wanted, jobs=jobs, dask=dask, keep=kept) as results,
    ):
        for case in results:
            done.append(case)
            if not case.right:
                say(f"not right: {case_line(case)}")
            count(len(done), sum(not c.right for c in done))


@contextlib.contextmanager
def _counting(total: int) -> Iterator[tuple[Callable[[int, int], None], Callable[[str], None]]]:
    """Show on stderr how many cases are done and how many of them not right; a line every tenth off a terminal."""
    console = notes()

    def say(text: str) -> None:
        console.print(text, soft_wrap=True)

    if not console.is_terminal:
        shown = 0

        def tell(done: int, wrong: int) -> None:
            nonlocal shown
            tenth = 10 * done // total
            if tenth > shown:
                shown = tenth
                say(f"{done} of {total} cases, {wrong} not right")

        say(f"{total} cases")
        yield tell, say
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("cases"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.description}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("none not right", total=total)

        def advance(done: int, wrong: int) -> None:
            progress.update(task, completed=done, description=f"{wrong or 'none'} not right")

        yield advance, say
