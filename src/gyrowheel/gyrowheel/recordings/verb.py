"""Verbs that show, repair and correct recordings."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from gyrowheel.cli.console import advancing, put, put_content, working
from gyrowheel.cli.options import Json, RecordingMade, argument, option
from gyrowheel_core.errors import InputError


def info(directory: Annotated[Path, argument("DIR", "Recording.")], json: Json = None) -> None:
    """Show what a recording contains, and whether samples are missing."""
    from gyrowheel import Recording

    recording = Recording.open(directory)
    put(recording, json)


def salvage(
    source: Annotated[
        Path, argument("PATH", "Damaged recording, directory or .mcap file; it is not changed.")
    ],
    target: RecordingMade,
    every_file: Annotated[
        bool, option("--every-file", "Take files too that metadata.yaml does not name.")
    ] = False,
    json: Json = None,
) -> None:
    """Make a complete recording from the readable part of a damaged one (MCAP), and report the missing part."""
    from dataclasses import asdict

    from gyrowheel import salvage as save
    from gyrowheel.recordings.page import salvage_page

    with advancing("salvaging") as advance:
        found = save(source, target, every_file=every_file, progress=advance)
    put_content(json, {"schema": 1, **asdict(found)}, salvage_page(found))


def correct(
    directory: Annotated[Path, argument("DIR", "Recording; it is not changed.")],
    output: RecordingMade,
    exchange: Annotated[
        list[str] | None, option("--exchange A:B", "Exchange two readings. Repeatable.")
    ] = None,
    scale: Annotated[
        list[str] | None, option("--scale NAME=FACTOR", "Multiply a reading: -1 turns its sign. Repeatable.")
    ] = None,
    offset: Annotated[
        list[str] | None, option("--offset NAME=VALUE", "Increase a reading [SI]. Repeatable.")
    ] = None,
    shift: Annotated[
        list[str] | None, option("--shift NAME=SECONDS", "Move a reading to later times. Repeatable.")
    ] = None,
    without: Annotated[
        list[str] | None, option("--without NAME", "Leave a reading out, as not measured. Repeatable.")
    ] = None,
    every: Annotated[
        float,
        option("--every N", "Of N samples keep the one in which a reading that is held so long is new."),
    ] = 1,
    json: Json = None,
) -> None:
    """Write a copy of a recording with corrected readings: axes, signs, units, times.

    diagnose prints the command where it finds a setup that cannot be right.
    """
    import gyrowheel as gw
    from gyrowheel.show.layout import Unbroken

    with working(f"correcting {directory}"):
        made = gw.correct(
            directory,
            exchange=[_pair(text) for text in exchange or ()],
            scale=_values(scale, "--scale"),
            offset=_values(offset, "--offset"),
            shift=_values(shift, "--shift"),
            without=without or (),
            every=every,
            folder=output,
        )
    put_content(
        json,
        {"schema": 1, "source": str(directory), "recording": str(output), "samples": len(made)},
        [f"{len(made)} samples", Unbroken(f"recording: {output}")],
    )


def _pair(text: str) -> tuple[str, str]:
    one, _, other = text.partition(":")
    if not one or not other:
        raise InputError(f"--exchange: '{text}' is no pair of readings; allowed: such as tilt_x:tilt_y")
    return one, other


def _values(given: list[str] | None, option: str) -> dict[str, float]:
    result: dict[str, float] = {}
    for text in given or ():
        name, _, number = text.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not name or not math.isfinite(value):
            raise InputError(f"{option}: '{text}' is no reading with a number; allowed: such as tilt_x=-1")
        if name in result:
            raise InputError(f"{option}: {name} is given twice")
        result[name] = value
    return result
