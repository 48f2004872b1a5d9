"""The verb `drag`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrowheel.cli.console import out, put, put_picture, working
from gyrowheel.cli.options import Json, Mixed, Recordings, example
from gyrowheel.cli.outputs import PICTURE, TABLE


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command(epilog=example("gyrowheel drag runs/tilts --model wheel.yaml"))(drag)


def drag(
    directories: Recordings,
    model: Annotated[
        Path | None,
        typer.Option(
            "--model", metavar="M.yaml", help="Model file.", show_default="bench gyrowheel without effects"
        ),
    ] = None,
    columns: Annotated[
        Path | None,
        typer.Option(
            "--columns",
            metavar="FILE",
            help="Write the notch-filtered signals over time, .csv or .parquet.",
            show_default=False,
        ),
        TABLE,
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            "--picture",
            metavar="FILE.png",
            help="Draw the filtered voltages over time, and their increments over tilt and speed.",
            show_default=False,
        ),
        PICTURE,
    ] = None,
    mixed: Mixed = False,
    json: Json = None,
) -> None:
    """Show measured DC voltages next to simulated torques, hold by hold.

    The drag estimates of a running test, computed again from the measurements:
    mean voltages, their change from a reference hold, measured and simulated
    torque, and the share of the air.
    """
    import gyrowheel as gw
    from gyrowheel.tables.api import check_suffix

    if columns is not None:
        check_suffix(columns)
    with working("averaging the holds"):
        result = gw.drag(directories, gw.Model() if model is None else gw.Model.load(model), mixed=mixed)
    put(result, json)
    if columns is not None:
        result.write_signals(columns)
        if json != "-":
            out().print(f"\nsignals: {columns}", soft_wrap=True)
    put_picture(picture, result.plot, quiet=json == "-")
