"""The verb `trend`: the results of a batch over time and machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from gyrowheel.cli.console import put
from gyrowheel.cli.options import Json, argument, option
from gyrowheel.cli.outputs import PICTURE


def trend(
    results: Annotated[Path, argument("RESULTS", "Table of the verb batch, .parquet or .csv.")],
    picture: Annotated[
        Path | None,
        option("--picture F.png|svg|pdf", "Draw the quantities over time with their control limits."),
        PICTURE,
    ] = None,
    json: Json = None,
) -> None:
    """Follow coefficients and bench parameters over time and machine.

    Control limits come from the differences of neighbours in time. What left
    them is named with the first machine or day: one value, a step, or a drift.
    Whatever the time: the mean of all machines, and the spread between them.
    """
    import gyrowheel as gw

    put(gw.trend(results), json, picture)
