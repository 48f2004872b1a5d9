"""Pages of the judged paper: for the terminal, and as one HTML file."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from gyrowheel.paper_figures.evidence import JudgedPaper, Verdict
from gyrowheel.show.html import Cells, embedded, environment, style_sheet
from gyrowheel.show.layout import heading, indented, words_table

CITATION = (
    "Huo, X.; Feng, S.; Liu, K.; Wang, L.; Chen, W. Aerodynamic Drag Analysis of 3-DOF Flex-Gimbal GyroWheel System in "
    "the Sense of Ground Test. Sensors 2016, 16, 2081, doi:10.3390/s16122081"
)
_COLOURS: Mapping[Verdict, str] = {"agree": "green", "disagree": "red", "cannot be decided": "yellow"}
#: Colours of the verdicts on the page, by their names in the style sheet.
_MOODS: Mapping[Verdict, str] = {"agree": "good", "disagree": "bad", "cannot be decided": "open"}


def paper_page(result: JudgedPaper) -> Iterator[RenderableType]:
    """Yield the table of verdicts, then numbers and reasons of the statements without agreement."""
    yield heading("Statements of Huo et al. 2016 (Sensors 16, 2081)")
    table = words_table("where", "name", "verdict")
    for row in result.rows:
        verdict = row.finding.verdict
        table.add_row(row.where, row.name, Text(verdict, style=_COLOURS[verdict]))
    yield indented(table)
    others = [row for row in result.rows if row.finding.verdict != "agree"]
    if others:
        yield heading("Disagreements and open statements")
    for row in others:
        verdict = row.finding.verdict
        yield Text.assemble(f"{row.where}: ", (verdict, _COLOURS[verdict]), f" ({row.name})")
        yield indented(Text(row.statement, style="italic"))
        yield indented(Text(f"{row.finding.ours} {row.finding.why}"))
        yield Text()
    yield Text(_summary(result))


def _summary(result: JudgedPaper) -> str:
    counted = ", ".join(f"{number} {verdict}" for verdict, number in result.counts().items())
    rest = result.total - len(result.rows)
    return f"{len(result.rows)} statements: {counted}." + (f" {rest} not judged." if rest else "")


def html_page(result: JudgedPaper, content: Mapping[str, Any], pictures: Mapping[str, bytes]) -> str:
    """Return the page: a table of all statements, then each with number, reason and picture.

    `content` equals ``paper.json``; `pictures` are PNG files by the name of the row.
    """
    cells = Cells(content)
    rows = [
        {
            "name": row.name,
            "where": cells.words(f"rows.{k}.where"),
            "statement": cells.words(f"rows.{k}.statement"),
            "verdict": cells.words(f"rows.{k}.verdict"),
            "mood": _MOODS[row.finding.verdict],
            "ours": cells.words(f"rows.{k}.ours"),
            "why": cells.words(f"rows.{k}.why"),
            "title": f"{row.where}: {row.statement}",
            "picture": base64.b64encode(pictures[row.name]).decode() if row.name in pictures else "",
        }
        for k, row in enumerate(result.rows)
    ]
    page = environment("gyrowheel.paper_figures").get_template("paper.html")
    return page.render(
        style=style_sheet(),
        citation=cells.words("paper"),
        seed=result.seed,
        summary=_summary(result),
        rows=rows,
        json=embedded(content),
    )
