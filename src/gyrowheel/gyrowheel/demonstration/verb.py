"""The verb `demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrowheel.cli.console import Tour, finding, put_json
from gyrowheel.cli.options import Json, example


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command(epilog=example("gyrowheel demo --seed 3"))(demo)


def demo(
    seed: Annotated[
        int,
        typer.Option(
            "--seed", metavar="N", min=0, help="Seed of the hidden machine, its effect and the noise."
        ),
    ] = 1,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="DIR", help="New directory for all results.", show_default="out/demo-N"
        ),
    ] = None,
    json: Json = None,
) -> None:
    """Hide an effect in a simulated machine, find it from a recording, add it, validate it, and open the key.

    Exits with 1 if the verdict was wrong.
    """
    from gyrowheel.demonstration.api import demonstrate, folder_for
    from gyrowheel.show.files import require_new
    from gyrowheel.show.layout import words_table
    from gyrowheel.show.quantities import seconds

    folder = folder_for(seed, Path("out")) if output is None else output
    require_new(folder)
    tour = Tour(json)
    outcome = demonstrate(seed, folder, tour)
    table = words_table("", "")
    for name, path in outcome.files.all().items():
        table.add_row(name.replace("_", " "), str(path))
    tour.show(["", table, f"\n{seconds(outcome.seconds)} in all"])
    if json is not None:
        put_json(json, outcome.to_json() | {"seed": seed})
    finding(not outcome.judgement.right)
