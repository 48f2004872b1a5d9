"""The verb `diagnose`."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrowheel.cli.console import BAD_INPUT, ending, finding, notes, put, warn_of_changes, working
from gyrowheel.cli.options import (
    Averages,
    ErrorPicture,
    Json,
    Mixed,
    ModelFile,
    Recordings,
    Until,
    Validation,
    option,
    settled_only,
)
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from gyrowheel import Diagnosis, Model, Recording


def diagnose(
    directories: Recordings,
    model: ModelFile,
    validate: Validation = None,
    averages: Averages = False,
    fail_on_finding: Annotated[
        bool, option("--fail-on-finding", "Exit with 1 unless nothing is missing.")
    ] = False,
    mixed: Mixed = False,
    quick: Annotated[
        bool,
        option("--quick", "Leave out the next test, and detection limits where something was found."),
    ] = False,
    follow: Annotated[
        bool, option("--follow", "Diagnose one recording while it is written, again after every hold.")
    ] = False,
    until: Until = None,
    picture: ErrorPicture = None,
    json: Json = None,
) -> None:
    """Find which effect a model lacks, with the evidence, the alternatives and the detection limits.

    Ctrl-C ends a long search with what it has found.
    """
    import gyrowheel as gw
    from gyrowheel.diagnosis.page import following
    from gyrowheel.recordings.api import noted_machine
    from gyrowheel.recordings.inputs import opened_apart
    from gyrowheel.show.layout import commands

    loaded, interrupted = gw.Model.load(model), False
    early = settled_only(until, follow, "--follow")
    if follow:
        if len(directories) > 1 or mixed or quick:
            raise InputError(
                "--follow: allowed: one recording, which is being written, without --mixed and --quick"
            )
        recording, result, interrupted = _followed(
            directories[0], loaded, validate or (), averages=averages, early=early
        )
        recordings = [recording]
    else:
        recordings, unused = opened_apart(directories, validate or ())
        with working("diagnosing") as say, ending(gw.SearchEnded):
            result = gw.diagnose(
                recordings,
                loaded,
                validate=unused,
                averages=averages,
                mixed=mixed,
                quick=quick,
                progress=say,
            )
        warn_of_changes([*recordings, *unused])
        interrupted = result.ended
    if result.setup or result.misstated:
        put(result, json)
        raise typer.Exit(BAD_INPUT)
    parts = [shlex.join(["gyrowheel", "diagnose", part, "--model", str(model)]) for part in result.parts]
    machine = noted_machine(recordings)
    command = following(
        result, directories, validate or (), model, loaded.bench_source, averages=averages, machine=machine
    )
    put(
        result,
        json,
        picture,
        after=[
            *commands("The parts before and after, each alone", *parts),
            *commands("Next", *filter(None, [command])),
        ],
    )
    if interrupted:
        raise KeyboardInterrupt
    finding(fail_on_finding and result.verdict != "nothing_missing")


def _followed(
    directory: Path, model: Model, validate: Sequence[Path], *, averages: bool, early: bool
) -> tuple[Recording, Diagnosis, bool]:
    """Show every look at a recording on stderr; return the last one, and whether Ctrl-C ended it."""
    from gyrowheel.diagnosis.looks import follow
    from gyrowheel.diagnosis.page import look_line

    last, interrupted = None, False
    try:
        for last in follow(directory, model, validate=validate, averages=averages):
            line = look_line(last.diagnosis, last.recording.duration, last.state)
            notes().print(line, soft_wrap=True, highlight=False)
            if early and last.settled:
                break
    except KeyboardInterrupt:
        if last is None:
            raise
        interrupted = True
    assert last is not None  # a recording that has ended is looked at
    return last.recording, last.diagnosis, interrupted
