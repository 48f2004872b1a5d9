"""The verb `paper`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrowheel.cli.console import advancing, notes, put
from gyrowheel.cli.options import Json, Seed, example


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command(epilog=example("gyrowheel paper -o paper"))(paper)


def paper(
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="DIR",
            help="Write a page (index.html), its pictures and paper.json here, after every statement.",
            show_default=False,
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only", metavar="NAME", help="Judge this statement only. Repeatable.", show_default="all"
        ),
    ] = None,
    seed: Seed = 0,
    json: Json = None,
) -> None:
    """Judge every figure, table and result of the published ground test.

    Huo et al. 2016, statement by statement: its content, the number computed
    here, whether they agree, and why. Half a minute; the finished statements of an
    interrupted run stay in DIR.
    """
    import gyrowheel as gw

    try:
        with advancing("judging the paper") as advance:
            result = gw.paper(output, only=only, seed=seed, progress=advance)
    except KeyboardInterrupt:
        if output is not None and (output / "index.html").is_file():
            notes().print(f"what is finished: {output / 'index.html'}", soft_wrap=True)
        raise
    put(result, json)
    if output is not None and json != "-":
        notes().print(f"page: {output / 'index.html'}", soft_wrap=True)
