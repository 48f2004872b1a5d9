"""The verb `diagnose`."""

from __future__ import annotations

import shlex
from typing import Annotated

import typer

from gyrowheel.cli.console import BAD_INPUT, finding, put, warn_of_changes, working
from gyrowheel.cli.options import (
    Averages,
    ErrorPicture,
    Json,
    Mixed,
    ModelFile,
    Recordings,
    Validation,
    option,
)


def diagnose(
    directories: Recordings,
    model: ModelFile,
    validate: Validation = None,
    averages: Averages = False,
    fail_on_finding: Annotated[
        bool, option("--fail-on-finding", "Exit with 1 unless nothing is missing.")
    ] = False,
    mixed: Mixed = False,
    picture: ErrorPicture = None,
    json: Json = None,
) -> None:
    """Find which effect a model lacks, with the evidence, the alternatives and the detection limits."""
    import gyrowheel as gw
    from gyrowheel.diagnosis.page import following
    from gyrowheel.recordings.api import noted_machine
    from gyrowheel.recordings.inputs import opened_apart
    from gyrowheel.show.layout import commands

    loaded = gw.Model.load(model)
    recordings, unused = opened_apart(directories, validate or ())
    with working("diagnosing") as say:
        result = gw.diagnose(
            recordings, loaded, validate=unused, averages=averages, mixed=mixed, progress=say
        )
    warn_of_changes([*recordings, *unused])
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
    finding(fail_on_finding and result.verdict != "nothing_missing")
