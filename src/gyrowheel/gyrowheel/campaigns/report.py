"""The report of a campaign: one page of HTML."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from markupsafe import Markup

from gyrowheel.blind_tests.judge import OUTCOMES
from gyrowheel.campaigns.judge import DETECTABLE
from gyrowheel.campaigns.page import KINDS, answered, hidden, rate_words
from gyrowheel.campaigns.summary import LEVELS, Rate, Summary
from gyrowheel.show.cells import Cells
from gyrowheel.show.html import REPORT_MARKS, embedded, environment, style_sheet
from gyrowheel_core.files import write_text
from gyrowheel_core.units import Unit

_COUNT, _PERCENT = Unit("", 1.0), Unit("%", 1e-2)


def campaign_report(summary: Summary, command: str) -> str:
    """Return a campaign as one page of HTML that needs no network and runs no script.

    Parameters
    ----------
    summary : Summary
        The campaign.
    command : str
        Command that repeats the campaign.
    """
    content: dict[str, Any] = {
        "schema": 1,
        "title": summary.title,
        "campaign": summary.to_json(),
        "cases": [case.to_json() for case in summary.cases],
    }
    cells = Cells(content)
    wrong = [(k, case) for k, case in enumerate(summary.cases) if not case.right]
    return (
        environment("gyrowheel.campaigns")
        .get_template("campaign.html")
        .render(
            style=style_sheet(),
            mark=Markup(REPORT_MARKS[0]),
            title=cells.words("title"),
            done=_count(cells, "campaign.cases"),
            asked=_count(cells, "campaign.asked"),
            right=len(summary.cases) - len(wrong),
            mood="good" if not wrong else "found",
            detectable=f"{DETECTABLE:g}",
            kinds=list(_kinds(summary, cells)),
            wrong=[
                {
                    "index": _count(cells, f"cases.{k}.case"),
                    "hidden": hidden(case),
                    "answered": answered(case),
                    "meaning": OUTCOMES[case.outcome],
                }
                for k, case in wrong
            ],
            confusion=[
                {
                    "truth": truth,
                    "answers": [
                        (name, _count(cells, f"campaign.confusion.{truth}.{name}"))
                        for name in content["campaign"]["confusion"][truth]
                    ],
                }
                for truth in content["campaign"]["confusion"]
            ],
            levels=[f"{100 * level:g} %" for level in LEVELS],
            coverage=[
                {
                    "what": words,
                    "parts": [_part(cells, f"campaign.coverage.{name}", f"{level:g}") for level in LEVELS],
                    "of": _count(cells, f"campaign.coverage.{name}.n"),
                }
                for name, words in (("coefficients", "true coefficient"), ("bench", "true parameter"))
                if content["campaign"]["coverage"][name]["n"]
            ],
            seconds=""
            if math.isnan(summary.median_seconds)
            else cells.number("campaign.median_seconds", _COUNT, lambda v: f"{v:.2f}"),
            command=command,
            json=embedded(content),
        )
    )


def save_campaign(summary: Summary, file: Path, command: str) -> None:
    """Write the page; a failure leaves the old file."""
    write_text(file, campaign_report(summary, command))


def _kinds(summary: Summary, cells: Cells) -> Any:
    """Yield a row for each kind of case: counts, and the rate of right answers with its interval."""
    for kind, words in KINDS.items():
        cases = summary.of_kind(kind)
        if not cases:
            continue
        row: dict[str, Any] = {
            "kind": words,
            "n": len(cases),
            "seen": "–",
            "exact": "–",
            "tied": "–",
            "wrong": "–",
        }
        if kind in ("single", "pair"):
            place = f"campaign.{kind}"
            row["n"] = _count(cells, f"{place}.n")
            for name, field in (
                ("seen", "detectable"),
                ("exact", "exact"),
                ("tied", "tied"),
                ("wrong", "wrong"),
            ):
                row[name] = _count(cells, f"{place}.{field}")
            how = summary.outcomes(summary.detectable(kind))
            rate = Rate(how["exact"] + how["tied"], len(summary.detectable(kind)))
        else:
            if kind in ("none", "outside"):
                row["n"] = _count(cells, f"campaign.{kind}.n")
            rate = Rate(sum(case.right for case in cases), len(cases))
        yield row | {"rate": rate_words(rate)}


def _count(cells: Cells, place: str) -> Markup:
    return cells.number(place, _COUNT, lambda v: f"{v:.0f}")


def _part(cells: Cells, place: str, level: str) -> Markup:
    # the name of a level contains a point, which separates the parts of a place
    value = cells.at(place)[level]
    return Markup('<span data-how="{}">{}</span>').format(f"{place}[{level}]", f"{100.0 * value:.1f} %")
