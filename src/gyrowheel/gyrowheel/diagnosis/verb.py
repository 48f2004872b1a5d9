"""The verb `diagnose`."""

from __future__ import annotations

import shlex
from typing import Annotated

import typer

from gyrowheel.cli.console import BAD_INPUT, finding, put_json, put_picture, put_text, working
from gyrowheel.cli.options import (
    Averages,
    ErrorPicture,
    Json,
    Mixed,
    ModelFile,
    Recordings,
    Validation,
    example,
)


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command(epilog=example("gyrowheel diagnose runs/monday --model wheel.yaml"))(diagnose)


def diagnose(
    directories: Recordings,
    model: ModelFile,
    validate: Validation = None,
    averages: Averages = False,
    fail_on_finding: Annotated[
        bool, typer.Option("--fail-on-finding", help="Exit with 1 unless nothing is missing.")
    ] = False,
    mixed: Mixed = False,
    picture: ErrorPicture = None,
    json: Json = None,
) -> None:
    """Find which effect a model lacks, with the evidence, the alternatives and the detection limits."""
    import gyrowheel as gw
    from gyrowheel.diagnosis.next_command import following
    from gyrowheel.recordings.inputs import opened_apart
    from gyrowheel.recordings.provenance import noted_machine

    loaded = gw.Model.load(model)
    recordings, unused = opened_apart(directories, validate or ())
    with working("diagnosing") as say:
        from gyrowheel.diagnosis.page import diagnosis

        result = gw.diagnose(
            recordings, loaded, validate=unused, averages=averages, mixed=mixed, progress=say
        )
    if json is not None:
        put_json(json, result.to_dict())
    if json != "-":
        command = following(
            result,
            directories,
            validate or (),
            model,
            loaded.bench_source,
            averages=averages,
            machine=noted_machine(recordings),
        )
        parts = [
            f"gyrowheel diagnose {shlex.quote(part)} --model {shlex.quote(str(model))}"
            for part in result.parts
        ]
        put_text(diagnosis(result.details, following=command, parts=parts))
    if result.setup:
        raise typer.Exit(BAD_INPUT)
    put_picture(picture, result.plot, quiet=json == "-")
    finding(fail_on_finding and result.verdict != "nothing_missing")
