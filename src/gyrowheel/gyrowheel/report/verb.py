"""The verb `report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrowheel.cli.console import BAD_INPUT, out, put_json, working
from gyrowheel.cli.options import Averages, Json, Mixed, ModelFile, Recordings, Validation, example
from gyrowheel.cli.outputs import Output, head


def _is_report(path: Path) -> bool:
    from gyrowheel.show.html import REPORT_MARKS, REPORT_TITLE

    begin = head(path, 1024).decode("utf-8", errors="replace")
    return any(mark in begin for mark in REPORT_MARKS) or (
        begin.startswith("%PDF") and f"({REPORT_TITLE})" in begin
    )


_REPORT = Output("an earlier report of gyrowheel", _is_report, (".html", ".md", ".pdf"))


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command(epilog=example("gyrowheel report runs/monday --model wheel.yaml -o monday.html"))(report)


def report(
    directories: Recordings,
    model: ModelFile,
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="The report: .html, one page with pictures; .md, words; .pdf, where Chromium is installed.",
        ),
        _REPORT,
    ] = Path("report.html"),
    validate: Validation = None,
    averages: Averages = False,
    mixed: Mixed = False,
    json: Json = None,
) -> None:
    """Diagnose recordings and write a report: result, pictures, tables, model, hashes, commands.

    One file that needs no network. Its numbers are those of
    `gyrowheel diagnose --json`.
    """
    import gyrowheel as gw
    from gyrowheel.recordings.inputs import opened_apart

    loaded = gw.Model.load(model)
    recordings, unused = opened_apart(directories, validate or ())
    with working("diagnosing") as say:
        made = gw.Report.of(recordings, loaded, validate=unused, averages=averages, mixed=mixed, progress=say)
        say("drawing")
        made.save(output)
    if json is not None:
        put_json(json, made.to_dict())
    if json != "-":
        out().print(made.title)
        out().print(f"report: {output}", soft_wrap=True)
    if made.diagnosis.setup:
        raise typer.Exit(BAD_INPUT)
