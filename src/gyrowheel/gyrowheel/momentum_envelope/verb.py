"""The verb `momentum`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from gyrowheel.cli.console import put, put_picture
from gyrowheel.cli.options import BenchName, Json, numbers, option
from gyrowheel.cli.outputs import PICTURE


def momentum(
    bench: BenchName = "gyrowheel",
    speed: Annotated[
        str | None,
        option(
            "--speed RPM",
            "Spin rates: 3000, or 3000,4000, or 2000..4000, or 2000..4000:500, in rpm.",
            "highest, reference, and as far below it",
        ),
    ] = None,
    picture: Annotated[
        Path | None, option("--picture F.png|svg|pdf", "Draw the caps of up to three spin rates."), PICTURE
    ] = None,
    body: Annotated[
        Path | None, option("--body F.png|svg|pdf", "Draw the body between all spin rates."), PICTURE
    ] = None,
    json: Json = None,
) -> None:
    """Show which angular momentum a wheel can reach by speed and tilt.

    Eqs (1) and (2) of Huo et al. 2016 with the caps and the body of Figs 3 and 4,
    for any bench, next to the exact momentum of the rotor.
    """
    import gyrowheel as gw

    rates = None if speed is None else [value * math.pi / 30.0 for value in numbers(speed, "--speed")]
    result = gw.momentum(bench, spin_rate=rates)
    # refused before anything is written if there is a single spin rate
    solid = None if body is None else result.plot("body")
    put(result, json, picture)
    put_picture(body, lambda: solid, quiet=json == "-")
