"""Verbs that show, repair and correct recordings."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from gyrowheel.cli.console import advancing, out, put, put_content, put_json, working
from gyrowheel.cli.options import Json, RecordingMade, example
from gyrowheel_core.errors import InputError


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command(epilog=example("gyrowheel info runs/monday"))(info)
    app.command(epilog=example("gyrowheel salvage runs/monday -o runs/monday_saved"))(salvage)


def register_correct(app: typer.Typer) -> None:
    """Add the verb that corrects a recording."""
    app.command(epilog=example("gyrowheel correct runs/monday -o runs/right --exchange tilt_x:tilt_y"))(
        correct
    )


def info(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Recording.", show_default=False)],
    json: Json = None,
) -> None:
    """Show what a recording contains, and whether samples are missing."""
    from gyrowheel import Recording

    recording = Recording.open(directory)
    put(recording, json)


def salvage(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="PATH",
            help="Damaged recording, directory or .mcap file; it is not changed.",
            show_default=False,
        ),
    ],
    target: RecordingMade,
    every_file: Annotated[
        bool, typer.Option("--every-file", help="Take files too that metadata.yaml does not name.")
    ] = False,
    json: Json = None,
) -> None:
    """Make a complete recording from the readable part of a damaged one (MCAP), and report what is missing."""
    from dataclasses import asdict

    from gyrowheel import salvage as save
    from gyrowheel.recordings.page import salvage_page

    with advancing("salvaging") as advance:
        found = save(source, target, every_file=every_file, progress=advance)
    put_content(json, {"schema": 1, **asdict(found)}, salvage_page(found))


def correct(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="Recording; it is not changed.", show_default=False)
    ],
    output: RecordingMade,
    exchange: Annotated[
        list[str] | None,
        typer.Option(
            "--exchange", metavar="A:B", help="Exchange two readings. Repeatable.", show_default=False
        ),
    ] = None,
    scale: Annotated[
        list[str] | None,
        typer.Option(
            "--scale",
            metavar="NAME=FACTOR",
            help="Multiply a reading: -1 turns its sign. Repeatable.",
            show_default=False,
        ),
    ] = None,
    offset: Annotated[
        list[str] | None,
        typer.Option(
            "--offset", metavar="NAME=VALUE", help="Increase a reading [SI]. Repeatable.", show_default=False
        ),
    ] = None,
    shift: Annotated[
        list[str] | None,
        typer.Option(
            "--shift",
            metavar="NAME=SECONDS",
            help="Move a reading to later times. Repeatable.",
            show_default=False,
        ),
    ] = None,
    json: Json = None,
) -> None:
    """Write a copy of a recording with corrected readings: axes, signs, units, times.

    diagnose prints the command where it finds a setup that cannot be right.
    """
    import gyrowheel as gw

    with working(f"correcting {directory}"):
        made = gw.correct(
            directory,
            exchange=[_pair(text) for text in exchange or ()],
            scale=_values(scale, "--scale"),
            offset=_values(offset, "--offset"),
            shift=_values(shift, "--shift"),
            folder=output,
        )
    if json is not None:
        put_json(
            json, {"schema": 1, "source": str(directory), "recording": str(output), "samples": len(made)}
        )
    if json != "-":
        out().print(f"{len(made)} samples")
        out().print(f"recording: {output}", soft_wrap=True)


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
