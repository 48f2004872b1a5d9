"""Verbs that exchange recordings with other programs as tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrowheel.cli.options import Json, example
from gyrowheel.cli.outputs import COLUMN_MAP, TABLE, NewRecording
from gyrowheel.cli.shell import advancing, out, put_json, working


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command("import", epilog=example("gyrowheel import test.csv --map test.map.yaml -o runs/test"))(
        import_
    )
    app.command(epilog=example("gyrowheel export runs/monday -o monday.parquet"))(export)


def import_(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Table, .csv or .parquet.", show_default=False)
    ],
    column_map: Annotated[
        Path,
        typer.Option(
            "--map", metavar="MAP.yaml", help="Meaning and units of the columns.", show_default=False
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="DIR", help="New directory for the recording.", show_default=False
        ),
        NewRecording(),
    ],
    json: Json = None,
) -> None:
    """Convert a table, one row per sample, into a recording.

    The map says which column holds which reading, in which unit. Missing values
    (unless the map keeps them), repeated or irregular times and units of another
    kind are refused, each with its place in the table.
    docs/exchange.md shows a map.
    """
    from gyrowheel.tables import import_table

    with working(f"reading {file}"):
        made = import_table(file, column_map, output)
    if json is not None:
        put_json(
            json,
            {
                "schema": 1,
                "table": str(file),
                "recording": str(output),
                "bench": made.bench,
                "samples": made.samples,
                "seconds": made.seconds,
            },
        )
    if json != "-":
        out().print(f"{made.samples} samples, {made.seconds:.2f} s")
        out().print(f"recording: {output}", soft_wrap=True)


def export(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Recording.", show_default=False)],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="FILE", help="Table to write, .csv or .parquet.", show_default=False
        ),
        TABLE,
    ],
    column_map: Annotated[
        Path | None,
        typer.Option(
            "--map",
            metavar="MAP.yaml",
            help="Also write the map with which import reads the table.",
            show_default=False,
        ),
        COLUMN_MAP,
    ] = None,
    json: Json = None,
) -> None:
    """Convert a recording into a table, one row per sample, in SI units.

    Beside the readings stand the command that answers the sample and the
    setpoint in force. A Parquet file carries the units of its columns and what
    is known of bench and rig; a CSV file has the names alone.
    """
    from gyrowheel import Recording
    from gyrowheel.tables import check_suffix, write_table

    check_suffix(output)
    with working(f"reading {directory}"):
        recording = Recording.open(directory)
    with advancing(f"writing {output}") as advance:
        columns = write_table(recording, output, column_map=column_map, progress=advance)
    if json is not None:
        put_json(
            json,
            {
                "schema": 1,
                "recording": str(directory),
                "table": str(output),
                "map": None if column_map is None else str(column_map),
                "rows": len(recording),
                "columns": columns,
            },
        )
    if json != "-":
        out().print(f"{len(recording)} rows, {len(columns)} columns")
        out().print(f"table: {output}", soft_wrap=True)
        if column_map is not None:
            out().print(f"map: {column_map}", soft_wrap=True)
