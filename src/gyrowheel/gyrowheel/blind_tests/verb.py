"""The verb `key`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrowheel.cli.console import finding, put
from gyrowheel.cli.options import Json, example


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command(epilog=example("gyrowheel key key.json --against wheel.yaml"))(key)


def key(
    file: Annotated[Path, typer.Argument(metavar="KEY", help="Key file of --blind.", show_default=False)],
    against: Annotated[
        Path | None,
        typer.Option("--against", metavar="M.yaml", help="Model file to judge.", show_default=False),
    ] = None,
    bench: Annotated[
        str | None,
        typer.Option(
            "--bench",
            metavar="B",
            help="Bench that the key was drawn for: shipped name, or a bench file.",
            show_default="that of the model, or gyrowheel",
        ),
    ] = None,
    fail_on_finding: Annotated[
        bool, typer.Option("--fail-on-finding", help="Exit with 1 unless the model is right.")
    ] = False,
    json: Json = None,
) -> None:
    """Open the key of a blind test: show the hidden machine, and judge a model against it.

    Open it only when the model is finished: a key that was read is no test any more.
    """
    import gyrowheel as gw
    from gyrowheel_core.errors import InputError

    if fail_on_finding and against is None:
        raise InputError("--fail-on-finding: needs --against")
    model = None if against is None else gw.Model.load(against)
    result = gw.open_key(file, model, bench=bench)
    put(result, json)
    finding(fail_on_finding and result.outcome != "right")
