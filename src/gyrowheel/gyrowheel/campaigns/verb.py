"""The verb `campaign`."""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gyrowheel.cli.console import INTERRUPTED, notes, put, put_json
from gyrowheel.cli.options import (
    BenchName,
    Json,
    Resume,
    going_on,
    going_on_command,
    merged,
    option,
    place_of,
)
from gyrowheel.cli.outputs import Output, json_content

if TYPE_CHECKING:
    from gyrowheel.campaigns.judge import Judged


def _is_case_list(path: Path) -> bool:
    content = json_content(path)
    return isinstance(content, list) and all(
        isinstance(item, dict) and {"case", "truth", "verdict", "outcome"} <= item.keys() for item in content
    )


_CASE_LIST = Output("an earlier list of cases", _is_case_list)


def campaign(
    context: typer.Context,
    plan: Annotated[
        str, option("--plan P", "Plan that is diagnosed: shipped name, or a plan file.")
    ] = "survey",
    validation_plan: Annotated[
        str, option("--validation-plan P", "Plan of the recording that is only predicted.")
    ] = "check",
    cases: Annotated[int, option("--cases N", "Number of cases.")] = 100,
    seed: Annotated[int, option("--seed N", "Seed of everything that is drawn.")] = 0,
    kinds: Annotated[
        str | None,
        option(
            "--kinds K,K..",
            "What may be hidden: none, single, pair, outside, alike (one effect, and a look-alike below its limit), "
            "memory (an effect with a memory); with --reality also event.",
            "none,single,pair,outside; with --reality none,single,event",
        ),
    ] = None,
    reality: Annotated[
        bool,
        option("--reality", "Imperfect instruments as well, several at once, and events in the recordings."),
    ] = False,
    noise: Annotated[float, option("--noise X", "White noise, as a multiple of the stated one.")] = 1.0,
    drift: Annotated[float, option("--drift X", "Slow drifts, as a multiple of the stated ones.")] = 1.0,
    gains: Annotated[
        float, option("--gains X", "Spin gains, as a multiple of those of the default controller.")
    ] = 1.0,
    lost: Annotated[float, option("--lost PART", "Fraction of the samples that is lost: 0.01 is 1 %.")] = 0.0,
    jobs: Annotated[
        int | None, option("--jobs N", "Cases at a time on this machine.", "one per core")
    ] = None,
    dask: Annotated[
        str | None, option("--dask ADDRESS", "Address of a Dask scheduler whose workers run the cases.")
    ] = None,
    only: Annotated[
        list[int] | None, option("--only I", "Run this case only, by number. Repeatable.")
    ] = None,
    keep: Annotated[
        Path | None,
        option("--keep DIR", "Keep recordings, keys and diagnoses here (tens of megabytes per case)."),
    ] = None,
    output: Annotated[
        Path | None,
        option(
            "-o --output DIR", "New folder that keeps each finished case, to go on from.", "out/campaign-N"
        ),
    ] = None,
    resume: Resume = None,
    list_file: Annotated[
        Path | None, option("--list FILE", "Write every case as JSON here."), _CASE_LIST
    ] = None,
    bench: BenchName = "gyrowheel",
    json: Json = None,
) -> None:
    """Test the diagnosis on many blind cases, each judged by its key.

    Each case is another machine: parameters are drawn within their
    uncertainties, noise, drift and controller vary, and it hides no effect, one,
    two, or one outside the library, 1 to 10 times as large as the detection limit
    of the plan. With --reality instruments differ from the bench file, and events
    happen. Ctrl-C ends the campaign and reports the finished cases; --resume
    continues with the others, also after a kill.
    """
    from gyrowheel.batches.workers import one_at_a_time
    from gyrowheel.campaigns.api import campaign as run
    from gyrowheel.campaigns.api import settings_of
    from gyrowheel.campaigns.page import campaign_report, case_line
    from gyrowheel.show.files import write_text

    folder = place_of(output, resume, "campaign")
    settings: dict[str, Any] = {
        "plan": plan,
        "validation_plan": validation_plan,
        "cases": cases,
        "seed": seed,
        "kinds": [] if kinds is None else [kind.strip() for kind in kinds.split(",")],
        "reality": reality,
        "noise": noise,
        "drift": drift,
        "gains": gains,
        "lost": lost,
        "bench": bench,
        "only": only or (),
    }
    if resume is not None:
        settings = merged(context, settings, settings_of(resume))
    others = {"jobs": jobs, "dask": dask, "keep": keep, "list": list_file, "json": json}
    if jobs is None and dask is None and (why := one_at_a_time()):
        notes().print(why, soft_wrap=True)
    again = going_on_command("campaign", folder, others)
    with going_on(again) as begun, _counting() as (count, say):

        def progress(done: Sequence[Judged], total: int) -> None:
            if begun():
                if done:
                    say(f"{total} cases, {len(done)} of them finished before")
            elif not done[-1].right:
                say(f"not right: {case_line(done[-1])}")
            count(len(done), sum(not case.right for case in done), total)

        result = run(
            **settings,
            jobs=jobs,
            dask=dask,
            keep=keep,
            folder=folder,
            resume=resume is not None,
            progress=progress,
        )
    report = folder / "report.html"
    write_text(report, campaign_report(result, _command(settings)))
    if list_file is not None:
        put_json(str(list_file), [case.to_json() for case in result.cases])
    put(result, json)
    notes().print(f"report: {report}", soft_wrap=True)
    if result.interrupted:
        notes().print(f"to go on: {again}", soft_wrap=True)
        raise typer.Exit(INTERRUPTED)


def _command(settings: Mapping[str, Any]) -> str:
    """Return the command that repeats the campaign."""
    words = ["gyrowheel", "campaign"]
    for name, value in settings.items():
        option = f"--{name.replace('_', '-')}"
        if name == "kinds":
            words += [option, ",".join(value)] if value else []
        elif isinstance(value, bool):
            words += [option] if value else []
        else:
            words += [
                w
                for own in (value if isinstance(value, list | tuple) else [value])
                for w in (option, str(own))
            ]
    return shlex.join(words)


@contextlib.contextmanager
def _counting() -> Iterator[tuple[Callable[[int, int, int], None], Callable[[str], None]]]:
    """Show on stderr the numbers of finished and wrong cases; a line every tenth without a terminal."""
    console = notes()

    def say(text: str) -> None:
        console.print(text, soft_wrap=True)

    if not console.is_terminal:
        shown = 0

        def tell(done: int, wrong: int, total: int) -> None:
            nonlocal shown
            if not done:
                say(f"{total} cases")
            tenth = 10 * done // total
            if tenth > shown:
                shown = tenth
                say(f"{done} of {total} cases, {wrong} not right")

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
        task = progress.add_task("none not right", total=None)

        def advance(done: int, wrong: int, total: int) -> None:
            progress.update(task, total=total, completed=done, description=f"{wrong or 'none'} not right")

        yield advance, say
