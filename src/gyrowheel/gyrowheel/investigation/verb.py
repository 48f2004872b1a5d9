"""The verb `investigate`."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gyrowheel.cli.console import INTERRUPTED, Tour, advancing, put_json, put_picture, working
from gyrowheel.cli.options import (
    Averages,
    Blind,
    Effects,
    ErrorPicture,
    Json,
    Machine,
    Resume,
    Seed,
    argument,
    going_on,
    going_on_command,
    merged,
    option,
    place_of,
)
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from gyrowheel.investigation.api import Investigation
    from gyrowheel.investigation.procedure import Step


def investigate(
    context: typer.Context,
    model: Annotated[Path | None, option("--model M.yaml", "Model file; needed unless --resume.")] = None,
    directories: Annotated[list[Path] | None, argument("DIR", "Existing recordings to start from.")] = None,
    budget: Annotated[float, option("--budget MINUTES", "Bench time that may be spent.", min=0.0)] = 15.0,
    plan: Annotated[
        list[str] | None,
        option(
            "--plan P",
            "First plan: shipped name, or a plan file. Repeatable.",
            "quick, if there are no recordings",
        ),
    ] = None,
    thorough: Annotated[
        bool, option("--thorough", "Continue until every known effect would have shown at a usual size.")
    ] = False,
    averages: Averages = False,
    simulate: Annotated[
        bool, option("--simulate", "Simulate the plans at once, without the graph of nodes.")
    ] = False,
    effect: Effects = None,
    blind: Blind = None,
    machine: Machine = None,
    seed: Seed = 0,
    output: Annotated[
        Path | None, option("-o --output DIR", "New directory for all recordings.", "out/investigation-N")
    ] = None,
    resume: Resume = None,
    picture: ErrorPicture = None,
    json: Json = None,
) -> None:
    """Find what a model lacks: run a test, diagnose, run the next test, until the verdict is settled.

    Each diagnosis names the test to run next.
    The machine is the simulated bench with --effect, --blind and --machine.
    Recordings are kept, also after Ctrl-C; the model file is not changed.
    A report of all findings is written next to the recordings: report.html.
    --resume continues after Ctrl-C or a kill; no plan is run again.
    """
    from gyrowheel import Model, Recording
    from gyrowheel.investigation.api import investigate as run
    from gyrowheel.investigation.api import settings_of
    from gyrowheel.recordings.api import machine_options, note_machine

    folder = place_of(output, resume, "investigation")
    chosen: dict[str, Any] = {
        "model": model,
        "directories": list(directories or ()),
        "plan": plan,
        "budget": budget,
        "thorough": thorough,
        "averages": averages,
        "simulate": simulate,
        "effect": effect,
        "blind": blind,
        "machine": machine,
        "seed": seed,
    }
    if resume is not None:
        chosen = merged(context, chosen, _as_typed(settings_of(resume)))
    if chosen["model"] is None:
        raise InputError("--model: missing; name the model file")
    place = Path(chosen["model"])
    tour = Tour(json)
    machine_of = {name: chosen[name] for name in ("effect", "blind", "machine", "seed")}
    on = going_on_command("investigate", folder, {"picture": picture, "json": json})
    with going_on(on) as begun:
        done = run(
            Model.load(place),
            chosen["directories"],
            plans=chosen["plan"],
            budget=chosen["budget"],
            thorough=chosen["thorough"],
            averages=chosen["averages"],
            effects=machine_of["effect"] or (),
            machine=machine_of["machine"],
            seed=machine_of["seed"],
            blind=machine_of["blind"],
            nodes=not chosen["simulate"],
            folder=folder,
            resume=resume is not None,
            listener=_Teller(tour, begun),
        )
    for path in done.recordings[:1]:
        note_machine(Recording.open(path), machine_options(**machine_of))
    recordings = [*map(Path, chosen["directories"]), *done.recordings]
    switches = {name: chosen[name] for name in ("averages", "simulate", "thorough")}
    again = _again(recordings, place, machine_of | {"seed": machine_of["seed"] or None}, switches)
    _finish(
        done, recordings, place, tour, again=on if done.interrupted else again, thorough=chosen["thorough"]
    )
    if not done.interrupted:
        _report(done, recordings, place, tour)
    if json is not None:
        put_json(json, done.to_dict())
    if done.diagnosis is not None:
        put_picture(picture, done.diagnosis.plot, quiet=json == "-")
    if done.interrupted:
        raise typer.Exit(INTERRUPTED)


def _as_typed(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings of the API by the names of the parameters of the verb."""
    names = {"recordings": "directories", "plans": "plan", "effects": "effect"}
    result = {names.get(name, name): value for name, value in settings.items()}
    return result | {"simulate": not settings["nodes"]}


class _Teller:
    """Shows the course of an investigation; `begun` is called at the first step, when all settings are checked."""

    def __init__(self, tour: Tour, begun: Callable[[], object]) -> None:
        self._tour, self._begun = tour, begun

    def begin(self, number: int, plans: Sequence[str], why: str) -> None:
        self._begun()
        what = f"{'plans' if len(plans) > 1 else 'plan'} {' and '.join(plans)}: {why}" if plans else why
        self._tour.step(what[0].upper() + what[1:])

    def working(self, title: str) -> AbstractContextManager[Callable[[str], None]]:
        return working(title)

    def advancing(self, title: str) -> AbstractContextManager[Callable[[float], None]]:
        return advancing(title)

    def learned(self, step: Step) -> None:
        from gyrowheel.investigation.page import verdict_line

        for sentence in step.learned:
            self._tour.say(sentence)
        self._tour.say(verdict_line(step), style="dim")


def _again(
    recordings: Sequence[Path], model: Path, options: Mapping[str, object], switches: Mapping[str, bool]
) -> str:
    """Return the command that continues from recordings, on the same machine."""
    words = ["gyrowheel", "investigate", *map(str, recordings), "--model", str(model)]
    for name, value in options.items():
        for item in value if isinstance(value, list) else [value]:
            words += [] if item is None else [f"--{name}", str(item)]
    words += [f"--{name}" for name, on in switches.items() if on]
    return shlex.join(words)


def _report(done: Investigation, recordings: Sequence[Path], model: Path, tour: Tour) -> None:
    """Write the report of the last diagnosis next to the recordings."""
    import gyrowheel as gw
    from gyrowheel.diagnosis.page import diagnosing, following
    from gyrowheel.show.layout import Unbroken

    if done.diagnosis is None:
        return
    averages = done.averages
    with working("writing the report") as say:
        report = gw.Report.around(
            done.diagnosis,
            gw.Model.load(model),
            [gw.Recording.open(path) for path in recordings],
            commands=[diagnosing(recordings, model, (), averages=averages)],
            next_command=following(done.diagnosis, recordings, (), model, averages=averages),
            investigation=done,
            progress=say,
        )
        report.save(done.folder / "report.html")
    tour.show([Unbroken(f"report: {done.folder / 'report.html'}")])


def _finish(
    done: Investigation, recordings: Sequence[Path], model: Path, tour: Tour, *, again: str, thorough: bool
) -> None:
    """Show the last diagnosis, the next command, and how the investigation ended."""
    from rich.text import Text

    from gyrowheel.diagnosis.page import detection_limits, error_section, findings, following
    from gyrowheel.investigation.page import end_sentence, unseen_sentence
    from gyrowheel.show.layout import Unbroken, command, heading

    last = done.diagnosis
    if last is not None:
        tour.step("What is known now")
        tour.show([*findings(last), *detection_limits(last.limits)])
        tour.show(error_section(last))
        if done.settled and (next_command := following(last, recordings, (), model)):
            tour.show([heading("Next"), command(next_command)])
        unseen = unseen_sentence(last)
        if done.settled and not thorough and unseen:
            tour.show([heading("To be thorough"), Text(unseen), command(f"{again} --thorough")])
    if done.interrupted or (done.steps and not done.settled and recordings):
        tour.show([heading("To continue from here"), command(again)])
    colour = "green" if done.settled else "yellow"
    tour.show([Text(f"\n{end_sentence(done)}", style=f"bold {colour}")])
    if done.folder.is_dir() and any(part.is_dir() for part in done.folder.iterdir()):
        tour.show([Unbroken(f"recordings: {done.folder}")])
