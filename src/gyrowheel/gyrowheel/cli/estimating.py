"""The verb `drag`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrowheel.cli.options import Json, Recordings, example
from gyrowheel.cli.shell import put_json, put_text, working


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
    json: Json = None,
) -> None:
    """Show measured DC voltages beside simulated torques, hold by hold.

    What the drag estimator says while a test runs, computed anew from the
    measurements: mean voltages, their change from a reference hold, measured
    and simulated torque, and the share of the air.
    """
    import gyrowheel as gw

    with working("averaging the holds"):
        result = gw.drag(directories, gw.Model() if model is None else gw.Model.load(model))
    if json is not None:
        put_json(json, result.to_dict())
    if json != "-":
        put_text(result._page())
