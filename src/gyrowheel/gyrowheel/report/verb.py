"""The verb `report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrowheel.cli.console import BAD_INPUT, put_content, working
from gyrowheel.cli.options import Averages, Json, Mixed, ModelFile, Recordings, Validation, option
from gyrowheel.cli.outputs import Output, head
from gyrowheel_core.errors import InputError


def _is_report(path: Path) -> bool:
    from gyrowheel.show.html import REPORT_MARKS, REPORT_TITLE

    begin = head(path, 1024).decode("utf-8", errors="replace")
    return any(mark in begin for mark in REPORT_MARKS) or (
        begin.startswith("%PDF") and f"({REPORT_TITLE})" in begin
    )


_REPORT = Output("an earlier report of gyrowheel", _is_report, (".html", ".md", ".pdf"))


def report(
    directories: Recordings,
    model: ModelFile,
    output: Annotated[
        Path,
        option(
            "-o --output FILE",
            "The report: .html, one page with pictures; .md, words; .pdf, where Chromium is installed.",
        ),
        _REPORT,
    ] = Path("report.html"),
    validate: Validation = None,
    averages: Averages = False,
    mixed: Mixed = False,
    paper: Annotated[str, option("--paper SIZE", "Paper of a PDF: a4 or letter.")] = "a4",
    json: Json = None,
) -> None:
    """Diagnose recordings and write a report: result, pictures, tables, model, hashes, commands.

    One file that needs no network. Its numbers are those of
    `gyrowheel diagnose --json`.
    """
    import gyrowheel as gw
    from gyrowheel.recordings.inputs import opened_apart
    from gyrowheel.report.api import PAPERS
    from gyrowheel.show.layout import Unbroken

    if paper not in PAPERS:
        raise InputError(f"--paper: {paper!r} is not allowed; allowed: {', '.join(PAPERS)}")
    loaded = gw.Model.load(model)
    recordings, unused = opened_apart(directories, validate or ())
    with working("diagnosing") as say:
        made = gw.Report.of(recordings, loaded, validate=unused, averages=averages, mixed=mixed, progress=say)
        say("drawing")
        made.save(output, paper="a4" if paper == "a4" else "letter")
    put_content(json, made.to_dict(), [made.title, Unbroken(f"report: {output}")])
    if made.diagnosis.setup:
        raise typer.Exit(BAD_INPUT)
