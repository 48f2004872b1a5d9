"""The verb `drag`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from gyrowheel.cli.console import out, put, put_picture, working
from gyrowheel.cli.options import Json, Mixed, Recordings, option
from gyrowheel.cli.outputs import PICTURE, TABLE


def drag(
    directories: Recordings,
    model: Annotated[
        Path | None, option("--model M.yaml", "Model file.", "bench gyrowheel without effects")
    ] = None,
    columns: Annotated[
        Path | None,
        option("--columns FILE", "Write the notch-filtered signals over time, .csv or .parquet."),
        TABLE,
    ] = None,
    picture: Annotated[
        Path | None,
        option(
            "--picture F.png|svg|pdf",
            "Draw the filtered voltages over time, and their increments over tilt and speed.",
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
