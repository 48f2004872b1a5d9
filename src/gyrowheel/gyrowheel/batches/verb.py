"""The verb `batch`: many recordings, a row of a table for each."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrowheel.cli.console import INTERRUPTED, notes, put
from gyrowheel.cli.options import Json, ModelFile, argument, option
from gyrowheel.show.files import require_writable


def batch(
    folders: Annotated[
        list[Path], argument("DIR...", "Folders that are searched for recordings, or recordings.")
    ],
    model: ModelFile,
    output: Annotated[
        Path,
        option(
            "-o --output FILE",
            "Table, .parquet or .csv; recordings that it has already are not diagnosed again.",
        ),
    ],
    jobs: Annotated[int | None, option("--jobs N", "Recordings at a time.", "one per core")] = None,
    dask: Annotated[
        str | None,
        option("--dask ADDRESS", "Dask scheduler whose workers see the recordings under the same paths."),
    ] = None,
    json: Json = None,
) -> None:
    """Diagnose every recording below some folders, each alone, into a table.

    A recording that cannot be diagnosed is a row with the reason. Ctrl-C keeps the
    finished rows; the same command goes on.
    """
    from gyrowheel import Model
    from gyrowheel.batches.api import batch as run

    require_writable(output)
    say = notes()

    def progress(done: int, total: int, recording: str) -> None:
        say.print(f"{done} of {total}: {recording}", soft_wrap=True)

    result = run(folders, Model.load(model), output, jobs=jobs, dask=dask, progress=progress)
    if result.kept:
        say.print(f"{result.kept} of {len(result.rows)} were in {output} already", soft_wrap=True)
    if result.outdated:
        say.print(f"{result.outdated} of {output} were of another version: diagnosed again", soft_wrap=True)
    put(result, json)
    say.print(f"table: {output}", soft_wrap=True)
    if result.interrupted:
        raise typer.Exit(INTERRUPTED)
