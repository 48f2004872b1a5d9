"""Verbs that exchange recordings with other programs as tables."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from gyrowheel.cli.console import advancing, out, put, put_content, put_picture, put_text, working
from gyrowheel.cli.options import Json, argument, option
from gyrowheel.cli.outputs import COLUMN_MAP, PICTURE, TABLE, NewRecording
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from rich.console import RenderableType


def import_(
    files: Annotated[
        list[Path],
        argument(
            "FILE...",
            "Text (CSV), Parquet, Feather, MATLAB, HDF5, NumPy, TDMS, MDF, or a bag; of several loggers one each.",
        ),
    ],
    column_map: Annotated[Path | None, option("--map MAP.yaml", "Meaning and units of the columns.")] = None,
    output: Annotated[
        Path | None,
        option(
            "-o --output DIR|MAP.yaml", "New directory for the recording; with --suggest, the map to write."
        ),
        NewRecording(),
    ] = None,
    suggest: Annotated[bool, option("--suggest", "Propose a map for the table, with reasons.")] = False,
    picture: Annotated[
        Path | None, option("--picture F.png|svg|pdf", "Draw the signals as the map reads them."), PICTURE
    ] = None,
    bench: Annotated[
        str, option("--bench NAME|FILE", "With --suggest: bench that the table was measured on.")
    ] = "gyrowheel",
    json: Json = None,
) -> None:
    """Convert a table, one row per sample, into a recording.

    A map gives the reading and the unit of every column. --suggest proposes one
    from names, units and ranges, checks it by the laws of the wheel, and lists all
    that is doubtful or missing, each with its fix.
    Files of several loggers become one recording: their clocks are aligned.
    docs/exchange.md shows maps, and a lab's recording in ten minutes.
    """
    if suggest:
        _suggest(files, column_map, output, picture, bench, json)
        return
    if column_map is None:
        raise InputError(
            "--map: missing; allowed: a map file; `gyrowheel import --suggest FILE -o MAP.yaml` proposes one"
        )
    if output is None:
        raise InputError("-o: missing; allowed: a new directory for the recording")
    from gyrowheel import Recording
    from gyrowheel.show.layout import Unbroken, heading, sentences
    from gyrowheel.tables.api import import_table

    table = files if len(files) > 1 else files[0]
    names = " and ".join(map(str, files))
    with working(f"reading {names}"):
        made = import_table(table, column_map, output, question=True)
    content = {"schema": 1, "table": names, "recording": str(output), **asdict(made)}
    asked = [heading("Questions to answer before a diagnosis"), *sentences(made.questions)]
    page: list[RenderableType] = [
        f"{made.samples} samples, {made.seconds:.2f} s",
        *(f"  {remark}" for remark in made.remarks),
        *(asked if made.questions else ()),
        Unbroken(f"recording: {output}"),
    ]
    put_content(json, content, page)
    put_picture(picture, lambda: Recording.open(output).plot(), quiet=json == "-")


def _is_suggested_map(file: Path) -> bool:
    """Return whether a file is a map of `gyrowheel.TableMap`; OSError if it cannot be read."""
    with file.open(encoding="utf-8", errors="replace") as stream:
        return stream.readline(1000).startswith("# Suggested for ")


def _suggest(
    files: list[Path],
    column_map: Path | None,
    output: Path | None,
    picture: Path | None,
    bench: str,
    json: str | None,
) -> None:
    """Propose a map."""
    from gyrowheel import suggest_map
    from gyrowheel.show.layout import command

    if column_map is not None:
        raise InputError("--map: cannot be combined with --suggest, which proposes one")
    if output is not None and output.exists() and not _is_suggested_map(output):
        raise InputError(f"-o: {output} exists and is not an earlier suggested map; name a new file")
    with working(f"looking at {' and '.join(map(str, files))}"):
        found = suggest_map(files if len(files) > 1 else files[0], bench=bench)
    if output is not None:
        found.save(output)
    put(found, json)
    if output is not None and json != "-":
        names, folder = " ".join(map(str, files)), files[0].name.partition(".")[0]
        out().print(f"map: {output}", soft_wrap=True)
        put_text([command(f"gyrowheel import {names} --map {output} -o runs/{folder}")])
    put_picture(picture, found.plot, quiet=json == "-")


def export(
    directory: Annotated[Path, argument("DIR", "Recording.")],
    output: Annotated[Path, option("-o --output FILE", "Table to write, .csv or .parquet."), TABLE],
    column_map: Annotated[
        Path | None,
        option("--map MAP.yaml", "Also write the map with which import reads the table."),
        COLUMN_MAP,
    ] = None,
    json: Json = None,
) -> None:
    """Convert a recording into a table, one row per sample, in SI units.

    The readings are followed by the command that answers the sample and by the
    setpoint in force. A Parquet file has the units of its columns and the
    description of bench and rig; a CSV file has the names alone.
    """
    from gyrowheel import Recording
    from gyrowheel.show.layout import Unbroken
    from gyrowheel.tables.api import check_suffix, write_table

    check_suffix(output)
    with working(f"reading {directory}"):
        recording = Recording.open(directory)
    with advancing(f"writing {output}") as advance:
        columns = write_table(recording, output, column_map=column_map, progress=advance)
    content = {
        "schema": 1,
        "recording": str(directory),
        "table": str(output),
        "map": None if column_map is None else str(column_map),
        "rows": len(recording),
        "columns": columns,
    }
    files = [Unbroken(f"table: {output}")] + ([] if column_map is None else [Unbroken(f"map: {column_map}")])
    put_content(json, content, [f"{len(recording)} rows, {len(columns)} columns", *files])
