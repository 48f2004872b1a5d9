"""The paper judged statement by statement: for the terminal, and as a page of HTML that needs no other file."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from html import escape
from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from gyrowheel.text.layout import heading, words_table

if TYPE_CHECKING:
    from gyrowheel.results.paper import Paper, Row, Verdict

CITATION = (
    "Huo, X.; Feng, S.; Liu, K.; Wang, L.; Chen, W. Aerodynamic Drag Analysis of 3-DOF Flex-Gimbal GyroWheel System in "
    "the Sense of Ground Test. Sensors 2016, 16, 2081, doi:10.3390/s16122081"
)
_COLOURS: Mapping[Verdict, str] = {"agree": "green", "disagree": "red", "cannot be decided": "yellow"}
_SHADES: Mapping[Verdict, str] = {"agree": "#1b7f4b", "disagree": "#b3402a", "cannot be decided": "#8a6d00"}
_INDENT = (0, 0, 0, 2)
_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#222;background:#fff;max-width:62rem;margin:2rem auto;padding:0 1.2rem}
h1{font-size:1.6rem;line-height:1.25}h2{font-size:1.1rem;margin:2.6rem 0 .3rem}
table{border-collapse:collapse;width:100%;font-size:.92rem}td,th{text-align:left;vertical-align:top;
padding:.35rem .8rem .35rem 0;border-bottom:1px solid #e4e4e4}th{color:#555;font-weight:600}
img{max-width:100%;height:auto;margin:.6rem 0}.verdict{font-weight:600;white-space:nowrap}.where{white-space:nowrap}
.why{color:#555}p{margin:.35rem 0}a{color:inherit}
"""


def paper_page(result: Paper) -> Iterator[RenderableType]:
    """Yield the table of verdicts, and number and reason for those statements that are not agreed with."""
    yield heading("Statements of Huo et al. 2016 (Sensors 16, 2081)")
    table = words_table("where", "name", "verdict")
    for row in result.rows:
        verdict = row.finding.verdict
        table.add_row(row.where, row.name, Text(verdict, style=_COLOURS[verdict]))
    yield Padding(table, _INDENT)
    open_ones = [row for row in result.rows if row.finding.verdict != "agree"]
    if open_ones:
        yield heading("Not agreed with")
    for row in open_ones:
        verdict = row.finding.verdict
        yield Text.assemble(f"{row.where}: ", (verdict, _COLOURS[verdict]), f" ({row.name})")
        yield Padding(Text(row.statement, style="italic"), _INDENT)
        yield Padding(Text(f"{row.finding.ours} {row.finding.why}"), _INDENT)
        yield Text()
    yield Text(_summary(result))


def _summary(result: Paper) -> str:
    counted = ", ".join(f"{number} {verdict}" for verdict, number in result.counts().items())
    rest = result.total - len(result.rows)
    return f"{len(result.rows)} statements: {counted}." + (f" {rest} not judged." if rest else "")


def html_page(result: Paper, pictures: Mapping[str, bytes]) -> str:
    """Return the page: a table of all statements, then each with number, reason and picture.

    Parameters
    ----------
    result : Paper
        The statements.
    pictures : mapping of str to bytes
        PNG files by the name of the row.
    """
    rows = "\n".join(
        f'<tr><td class="where"><a href="#{row.name}">{escape(row.where)}</a></td>'
        f"<td>{escape(row.statement)}</td><td>{_verdict(row.finding.verdict)}</td></tr>"
        for row in result.rows
    )
    sections = "\n".join(_section(row, pictures.get(row.name)) for row in result.rows)
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>The published ground test, statement by statement</title><style>{_STYLE}</style></head><body>
<h1>The published ground test, statement by statement</h1>
<p>{escape(CITATION)}.</p>
<p>Statements are given in other words. Numbers were computed when this page was made; recordings are simulated with the
computed air in the machine, noise seed {result.seed}. {escape(_summary(result))}</p>
<table><tr><th>where</th><th>what is stated</th><th>verdict</th></tr>
{rows}
</table>
{sections}
</body></html>
"""


def _verdict(verdict: Verdict) -> str:
    return f'<span class="verdict" style="color:{_SHADES[verdict]}">{verdict}</span>'


def _section(row: Row, picture: bytes | None) -> str:
    found = row.finding
    image = ""
    if picture is not None:
        data = base64.b64encode(picture).decode()
        image = f'<p><img alt="{escape(row.where)}: {escape(row.statement)}" src="data:image/png;base64,{data}"></p>'
    return (
        f'<h2 id="{row.name}">{escape(row.where)}: {_verdict(found.verdict)}</h2>'
        f"<p><b>{escape(row.statement)}</b></p><p>{escape(found.ours)}</p>"
        f'<p class="why">{escape(found.why)}</p>{image}'
    )
