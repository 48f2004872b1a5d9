"""The command line put together from its verbs."""

from __future__ import annotations

from typing import Annotated

import typer

from gyrowheel import __version__
from gyrowheel.cli import (
    air,
    calibrating,
    campaigning,
    catalogue,
    correcting,
    demonstration,
    editing,
    estimating,
    exchanging,
    finding,
    holding,
    investigating,
    judging,
    momentum,
    paper,
    recordings,
    replaying,
    reporting,
    ros,
    running,
    viewing,
    workbench,
)
from gyrowheel.cli.outputs import guard

app = typer.Typer(
    name="gyrowheel",
    help="Test bench of a gyroscopic wheel: run it, compare recordings with the model, find what the model lacks.",
    epilog=(
        "Exit codes: 0 success, 1 a finding that you asked to fail on, 2 bad input, 3 a node of the bench failed, "
        "70 a defect of the program, 130 interrupted."
    ),
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(asked: bool) -> None:
    if asked:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and end.")
    ] = False,
) -> None:
    pass


for module in (
    demonstration,
    running,
    recordings,
    replaying,
    viewing,
    exchanging,
    correcting,
    finding,
    reporting,
    workbench,
    holding,
    momentum,
    paper,
    estimating,
    investigating,
    judging,
    calibrating,
    editing,
    catalogue,
    air,
    campaigning,
    ros,
):
    module.register(app)
guard(app)
