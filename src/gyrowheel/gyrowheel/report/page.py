"""The page of a report: the template filled with sections and pictures, or Markdown."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from markupsafe import Markup

from gyrowheel.recordings.picture import envelope
from gyrowheel.report import sections
from gyrowheel.report.decision import decision, proved
from gyrowheel.show.figure import PANELS, png_bytes, svg_bytes
from gyrowheel.show.html import REPORT_MARKS, Cells, embedded, environment, style_sheet, template_text
from gyrowheel.show.layout import plain_text
from gyrowheel_core.errors import visible

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from gyrowheel.report.content import ReportContent
    from gyrowheel_recording.bags import Recording

#: Script of the charts. The page allows this script only, by its hash.
SCRIPT: Final = template_text("gyrowheel.report", "chart.js") or ""
#: Policy of a report: its own content and that script only; no requests.
POLICY: Final = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
    f"script-src 'sha256-{base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()}'"
)
_LARGEST = 600_000  # largest vector picture [bytes]; a larger one is stored as PNG
_OWN = "gyrowheel.report"
_WIDTH = 100  # characters of a line in Markdown


@dataclass(frozen=True)
class Picture:
    """A picture in a page."""

    source: str  # data URL
    title: str  # alternative text


def picture(draw: Callable[[], Figure], title: str) -> Picture:
    """Return the drawing of a function as a picture of a page."""
    figure = draw()
    kind, content = "svg+xml", svg_bytes(figure)
    if len(content) > _LARGEST:
        kind, content = "png", png_bytes(figure)
    return Picture(f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}", title)


def chart(recording: Recording) -> dict[str, Any]:
    """Return the signals of a recording for the script: every sample, or minimum and maximum of each interval.

    ``time`` [s] and the lines of the panels, in their units, are float32 in base64; ``pairs`` tells whether two
    successive points are the extremes of one interval.
    """
    panels: list[dict[str, Any]] = []
    times: NDArray[Any] = recording.time
    for title, unit, fields in PANELS:
        lines = []
        for name, label in fields.items():
            times, values = envelope(recording.time, recording.measurement[name] / unit)
            if np.isfinite(values).any():
                lines.append({"label": label if len(fields) > 1 else "", "values": _base64(values)})
        panels.append({"title": title, "lines": lines})
    return {"time": _base64(times), "pairs": len(times) < len(recording.time), "panels": panels}


def _base64(values: NDArray[Any]) -> str:
    return base64.b64encode(np.asarray(values, "<f4").tobytes()).decode("ascii")


def html_page(report: ReportContent) -> str:
    """Return a report as a page of HTML."""
    return environment(_OWN).get_template("report.html").render(_parts(report))


def _parts(report: ReportContent) -> dict[str, Any]:
    found, cells = report.diagnosis, Cells(report.to_dict())
    return sections.of_diagnosis(found, cells) | {
        "style": style_sheet(),
        "policy": POLICY,
        "script": Markup(SCRIPT),
        "charts": embedded(
            {f"recordings.{k}": chart(recording.data) for k, recording in enumerate(report.recordings)}
        ),
        "mark": Markup(REPORT_MARKS[0]),
        "title": report.title,
        "verdict": sections.verdict(found),
        "decision": decision(report, cells),
        "symbols": sections.symbols(report.latest, found),
        "made_by": report.made_by,
        "model_sha256": report.model_hash,
        "proof": _proof(report, cells),
        "names": [recording.name for recording in report.fitted],
        "unused": [recording.name for recording in report.unused],
        "made": report.made,
        "next_command": report.next_command,
        "error": sections.error_rows(
            cells, "diagnosis.error" if report.addition is None else "addition.error"
        ),
        "error_picture": _error_picture(report),
        "where_picture": _where_picture(report),
        "map_picture": _map_picture(report),
        "moved": sections.moved(found, cells),
        "model": report.latest,
        "model_effects": sections.model_effects(report.latest, cells),
        "model_parameters": sections.model_parameters(report.latest, cells),
        "references": report.latest.stated_bench.references,
        "history": sections.history(report.latest, cells),
        "recordings": [
            own | {"picture": picture(recording.plot, f"What was measured in {recording.name} over time")}
            for recording, own in zip(
                report.recordings, sections.recordings(report.recordings, cells), strict=True
            )
        ],
        "steps": [] if report.investigation is None else sections.steps(report.investigation, cells),
        "ended": ""
        if report.investigation is None
        else cells.shown("investigation", report.ending, "sentence"),
        "commands": report.commands,
        "versions": cells.at("versions"),
        "json": embedded(report.to_dict()),
    }


def _proof(report: ReportContent, cells: Cells) -> dict[str, Any] | None:
    known = proved(report)
    if known is None:
        return None
    proof, meaning = known
    added = report.addition is not None and report.addition.proof is not None
    return {
        "mood": "open" if proof.proven is None else "good" if proof.proven else "bad",
        "meaning": meaning,
        "words": cells.words(f"{'addition' if added else 'diagnosis'}.proof.reason"),
    }


def _error_picture(report: ReportContent) -> Picture | None:
    if report.diagnosis.error is None:
        return None
    return picture(
        report.figure,
        "The residual of every window before and after, and its size in noise floors by channel",
    )


def _where_picture(report: ReportContent) -> Picture | None:
    if report.comparison is None:
        return None
    return picture(
        report.comparison.plot,
        "The residual torque of the coils in the plane of the tilt, and χ²/N of every channel over each variable",
    )


def _map_picture(report: ReportContent) -> Picture | None:
    if report.diagnosis.map is None:
        return None
    return picture(report.diagnosis.plot_map, "The missing torque in the plane of the tilt at four speeds")


def markdown_page(report: ReportContent) -> str:
    """Return a report as Markdown: the words and tables of the terminal, recordings with hashes, commands."""
    from gyrowheel.catalogue.page import bench_page

    def block(text: str) -> str:
        # longer than any fence within the text
        fence = "`" * max(3, *(len(run) + 1 for run in re.findall("`+", text)), 3)
        return f"{fence}\n{visible(text)}\n{fence}\n"

    content = report.to_dict()
    by = f" by {_words(report.made_by)}" if report.made_by else ""
    lines = [
        REPORT_MARKS[1],
        f"# {_words(report.title)}\n",
        f"Made {report.made}{by} from {', '.join(_words(r.name) for r in report.fitted)}.\n",
    ]
    cells = Cells(content)
    proof = _proof(report, cells)
    for part in decision(report, cells):
        said = [proof["meaning"], proof["words"]] if proof and part["asked"] == "How sure" else []
        lines += [
            f"**{part['asked']}**\n",
            *(f"- {_words(_plain(line))}" for line in [*said, *part["lines"]]),
            "",
        ]
    lines += ["## Result\n", block(plain_text(report.diagnosis.page(), _WIDTH).strip("\n"))]
    if report.addition is not None:
        lines += ["## Added\n", block(plain_text(report.addition.page(), _WIDTH).strip("\n"))]
    lines += ["## Model\n", block(plain_text(report.latest.page(), _WIDTH))]
    lines += [block(plain_text(bench_page(report.latest.stated_bench), _WIDTH))]
    lines += ["## Recordings\n", "| recording | use | file | bytes | sha256 |", "|---|---|---|---|---|"]
    for recording, own in zip(report.recordings, content["recordings"], strict=True):
        name, role = _words(recording.name), own["role"]
        lines += [
            f"| {name} | {role} | {_words(file['name'])} | {file['size']} | `{file['sha256']}` |"
            for file in own["files"]
        ]
    lines += ["\n## Commands\n", block("\n".join(report.commands))]
    if report.next_command:
        lines += ["Next:\n", block(report.next_command)]
    versions = ", ".join(f"{name} {number}" for name, number in content["versions"].items())
    return "\n".join([*lines, f"Versions: {versions}.\n"])


def _plain(line: str) -> str:
    """Return a line of page one without its marks."""
    return str(line.striptags()) if isinstance(line, Markup) else line


def _words(text: str) -> str:
    """Return text as one line of Markdown, its markup escaped."""
    line = re.sub(r"([\\`*_\[\]|#~])", r"\\\1", visible(" ".join(text.split())))
    return line.replace("&", "&amp;").replace("<", "&lt;")
