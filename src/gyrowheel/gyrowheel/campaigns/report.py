"""The report of a campaign: how often the finder was right, where it was not, and whether its numbers hold."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from gyrowheel.campaigns.judge import DETECTABLE, OUTCOMES
from gyrowheel.campaigns.page import KINDS, answered, hidden, rate_words
from gyrowheel.campaigns.summary import LEVELS, Rate
from gyrowheel.show.cells import Cells
from gyrowheel.show.files import REPORT_MARKS
from gyrowheel.show.html import embedded, environment, style_sheet
from gyrowheel_core.files import write_text
from gyrowheel_core.units import Unit

if TYPE_CHECKING:
    from gyrowheel.campaigns.result import CampaignResult

_COUNT, _PERCENT = Unit("", 1.0), Unit("%", 1e-2)


def campaign_content(result: CampaignResult) -> dict[str, Any]:
    """Return all numbers of the page: the statistics as ``gyrowheel campaign --json`` has them, and every case."""
    return {
        "schema": 1,
        "title": result.title,
        "campaign": result.to_dict(),
        "cases": [case.to_json() for case in result.cases],
    }


def campaign_page(result: CampaignResult, command: str) -> str:
    """Return a campaign as one page of HTML that needs no network and runs no script.

    Parameters
    ----------
    result : CampaignResult
        The campaign.
    command : str
        What to type for the same.
    """
    content = campaign_content(result)
    cells = Cells(content)
    summary = result.details
    wrong = [(k, case) for k, case in enumerate(result.cases) if not case.right]
    return (
        environment("gyrowheel.campaigns")
        .get_template("campaign.html")
        .render(
            style=style_sheet(),
            mark=Markup(REPORT_MARKS[0]),
            title=cells.words("title"),
            done=_count(cells, "campaign.cases"),
            asked=_count(cells, "campaign.asked"),
            right=len(result.cases) - len(wrong),
            mood="good" if not wrong else "found",
            detectable=f"{DETECTABLE:g}",
            kinds=list(_kinds(result, cells)),
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


def save_campaign(result: CampaignResult, file: Path, command: str) -> None:
    """Write the page; a failure leaves the old file."""
    write_text(file, campaign_page(result, command))


def _kinds(result: CampaignResult, cells: Cells) -> Any:
    """Yield the rows of what was hidden: counts, and the rate of right answers with its interval."""
    summary = result.details
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
    # a level has a point in its name, which a place cannot have
    value = cells.at(place)[level]
    return Markup('<span data-how="{}">{}</span>').format(f"{place}[{level}]", f"{100.0 * value:.1f} %")
