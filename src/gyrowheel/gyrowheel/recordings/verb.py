"""Verbs that show and repair recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrowheel.cli.console import advancing, put_json, put_text
from gyrowheel.cli.options import Json, RecordingMade, example


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command(epilog=example("gyrowheel info runs/monday"))(info)
    app.command(epilog=example("gyrowheel salvage runs/monday -o runs/monday_saved"))(salvage)


def info(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Recording.", show_default=False)],
    json: Json = None,
) -> None:
    """Show what a recording contains, and whether samples are missing."""
    from gyrowheel import Recording
    from gyrowheel.recordings.page import info_page

    recording = Recording.open(directory)
    if json is not None:
        put_json(json, recording.to_dict())
    if json != "-":
        put_text(info_page(recording.info))


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
        bool,
        typer.Option("--every-file", help="Take files too that metadata.yaml does not name."),
    ] = False,
    json: Json = None,
) -> None:
    """Make a complete recording from the readable part of a damaged one (MCAP), and report what is missing."""
    from dataclasses import asdict

    from gyrowheel import salvage as save
    from gyrowheel.recordings.page import salvage_page

    with advancing("salvaging") as advance:
        found = save(source, target, every_file=every_file, progress=advance)
    if json is not None:
        put_json(json, {"schema": 1, **asdict(found)})
    if json != "-":
        put_text(salvage_page(found))
