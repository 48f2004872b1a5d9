"""Verbs that compare recordings with a model: compare, diagnose, rate."""

from __future__ import annotations

import shlex
from typing import Annotated

import typer

from gyrowheel.cli.options import (
    Averages,
    ErrorPicture,
    Json,
    Mixed,
    ModelFile,
    Picture,
    Recordings,
    Validation,
    example,
)
from gyrowheel.cli.shell import BAD_INPUT, finding, put_json, put_picture, put_text, warn_of, working


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command(epilog=example("gyrowheel compare runs/monday --model wheel.yaml --map speed,azimuth"))(
        compare
    )
    app.command(epilog=example("gyrowheel diagnose runs/monday --model wheel.yaml"))(diagnose)
    app.command(epilog=example("gyrowheel rate runs/rate_table --model wheel.yaml"))(rate)


def compare(
    directories: Recordings,
    model: ModelFile,
    fail_above: Annotated[
        float | None,
        typer.Option(
            "--fail-above",
            metavar="X",
            min=0.0,
            help="Exit with 1 if χ²/N of a channel is above X (1: nothing but noise).",
            show_default=False,
        ),
    ] = None,
    map_over: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            metavar="VAR[,VAR]",
            help="Show a map of the residual over one or two of tilt, azimuth, speed, time, temperature. Repeatable.",
            show_default="speed,tilt where the model fails",
        ),
    ] = None,
    mixed: Mixed = False,
    picture: Picture = None,
    json: Json = None,
) -> None:
    """Compare a model with recordings: size of the error, where it is large, and what it depends on."""
    import gyrowheel as gw
    from gyrowheel.inputs import opened
    from gyrowheel.results.comparison import map_variables

    over = None if map_over is None else [map_variables(text) for text in map_over]
    loaded = gw.Model.load(model)
    recordings = opened(directories)
    with working("comparing") as say:
        from gyrowheel.text.comparison import comparison

        result = gw.compare(recordings, loaded, mixed=mixed, progress=say)
    warn_of(result.setup)
    if json is not None:
        put_json(json, result.to_dict())
    if json != "-":
        put_text(comparison(result.details, None if over is None else [result.map(*own) for own in over]))
    put_picture(picture, result.plot, quiet=json == "-")
    finding(fail_above is not None and result.worst > fail_above)


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
    from gyrowheel.commands import following
    from gyrowheel.inputs import opened_apart
    from gyrowheel.origins import noted_machine

    loaded = gw.Model.load(model)
    recordings, unused = opened_apart(directories, validate or ())
    with working("diagnosing") as say:
        from gyrowheel.text.diagnosis import diagnosis

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


def rate(directories: Recordings, model: ModelFile, mixed: Mixed = False, json: Json = None) -> None:
    """Use the wheel as a two-axis rate sensor: estimate the angular rate of the case.

    Where a rate table turned the rig (plan rate_table), scale and bias of both axes are calibrated against it.
    """
    import gyrowheel as gw
    from gyrowheel.inputs import opened

    loaded = gw.Model.load(model)
    recordings = opened(directories)
    with working("estimating rates") as say:
        from gyrowheel.text.rates import rates_page

        result = gw.rate(recordings, loaded, mixed=mixed, progress=say)
    if json is not None:
        put_json(json, result.to_dict())
    if json != "-":
        put_text(rates_page(result.details))
