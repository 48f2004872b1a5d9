"""Campaign: rate of right answers, wrong answers, confusion, and coverage of the stated intervals; as HTML, too."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator
from typing import Any

from markupsafe import Markup
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from gyrowheel.blind_tests.judge import OUTCOMES
from gyrowheel.campaigns.judge import DATED, DETECTABLE, Judged
from gyrowheel.campaigns.picture import rates_figure
from gyrowheel.campaigns.summary import LEVELS, WITHIN_FLOOR, WITHIN_FORMULA, Rate, Summary, covered
from gyrowheel.show.figure import png_bytes
from gyrowheel.show.html import REPORT_MARKS, Cells, embedded, environment, style_sheet
from gyrowheel.show.layout import figures_table, heading, indented, sentences, words_table
from gyrowheel_core.quantities import fixed, seconds

#: Kinds of cases in words.
KINDS = {
    "none": "nothing",
    "single": "one effect",
    "pair": "two effects",
    "outside": "outside library",
    "alike": "one effect and a look-alike",
    "memory": "a law with a memory",
    "event": "an event",
}
_SIZED = ("single", "pair", "alike", "memory")
_WORDS = {
    "tied_without_test": "tied, no test named",
    "partial": "one of two found",
    "named_right": "named right",
    "misnamed": "misnamed",
}


def campaign_page(summary: Summary) -> Iterator[RenderableType]:
    """Yield the tables of a campaign, part by part."""
    done, asked = len(summary.cases), summary.asked
    yield Text(summary.title, style="bold")
    if done < asked:
        yield Text(
            f"interrupted: {done} of {asked} cases were finished; the figures are of these", style="yellow"
        )
    if not done:
        return
    yield Text(f"{tally(summary)}.")
    yield Text()
    yield _kinds(summary)
    yield from sentences(_remarks(summary))
    yield from sentences(_reality(summary))
    yield from _mistakes(summary)
    yield from _confusion(summary)
    yield heading("Coverage of the intervals")
    if summary.intervals or summary.parameters:
        yield indented(_coverage(summary))
    yield from sentences(_numbers(summary))


def tally(summary: Summary) -> str:
    """Return how many answers are right, miss what is too small to be found, and are wrong."""
    own = summary.tally
    small = (
        f", {own['too_small']} miss what is smaller than {DETECTABLE:g} detection limits"
        if own["too_small"]
        else ""
    )
    return f"{own['right']} of {len(summary.cases)} answers are right{small}, {own['wrong']} wrong"


def case_line(case: Judged) -> str:
    """Return one case in a line: hidden and answered."""
    return f"case {case.index}: hidden {hidden(case)}; answered {answered(case)}"


def _kinds(summary: Summary) -> Table:
    table = figures_table("hidden", "cases", "≥ 2×", "exact", "tied", "wrong", "right (95 % interval)")
    table.columns[0].no_wrap = True
    for kind, words in KINDS.items():
        cases = summary.of_kind(kind)
        if not cases:
            continue
        if kind in ("none", "outside"):
            right = sum(c.right for c in cases)
            counts = ["–", "–" if kind == "outside" else str(right), "–", str(len(cases) - right)]
            rate = Rate(right, len(cases))
        else:
            seen = summary.detectable(kind)
            how = summary.outcomes(seen)
            good = how["exact"] + how["tied"]
            counts = [str(len(seen)), str(how["exact"]), str(how["tied"]), str(len(seen) - good)]
            rate = Rate(good, len(seen))
        wrong = Text(counts[3], style="bold red" if counts[3] != "0" else "green")
        table.add_row(words, str(len(cases)), *counts[:3], wrong, rate_words(rate))
    return table


def _remarks(summary: Summary) -> Iterator[str]:
    """Yield remarks below the table."""
    if any(summary.of_kind(kind) for kind in _SIZED):
        yield f"≥ {DETECTABLE:g}×: at least {DETECTABLE:g} times the detection limit; exact, tied and wrong count these"
    if summary.of_kind("none"):
        alarms = summary.false_alarms
        yield f"false alarms: {alarms.count} of {alarms.n}: {rate_words(alarms)}"
    outside = summary.outcomes(summary.of_kind("outside"))
    if outside:
        named = {"unknown": "called unknown", "misnamed": "absorbed by library effects"}
        parts = [f"{named.get(k, _WORDS.get(k, k))} {v}" for k, v in outside.most_common()]
        yield f"outside the library: {', '.join(parts)}"
    below = [c for kind in _SIZED for c in summary.of_kind(kind) if not c.detectable]
    if below:
        parts = [f"{_WORDS.get(k, k)} {v}" for k, v in summary.outcomes(below).most_common()]
        yield f"smaller than that: {', '.join(parts)}"


def _reality(summary: Summary) -> Iterator[str]:
    """Yield the rates of found instruments and events."""
    wrong = sum(len(c.instruments_wrong) for c in summary.cases)
    if summary.instruments or wrong:
        seen = [i for i in summary.instruments if i.detectable]
        named, tied = (sum(i.found == how for i in seen) for how in ("named", "tied"))
        yield (
            f"instruments that are not as stated: {len(summary.instruments)}, {len(seen)} of them ≥ {DETECTABLE:g}×; "
            f"named {named}, tied {tied}: {rate_words(Rate(named + tied, len(seen)))}; "
            f"named without being wrong: {wrong}"
        )
    if summary.events:
        visible = [e for e in summary.events if e.detectable]
        dated = Rate(sum(e.dated for e in visible), len(visible))
        yield (
            f"events: {len(summary.events)}, {len(visible)} of them ≥ {DETECTABLE:g}×; "
            f"dated within {DATED:g} s: {dated.count}: {rate_words(dated)}"
        )


def _mistakes(summary: Summary) -> Iterator[RenderableType]:
    wrong = [c for c in summary.cases if not c.right]
    if not wrong:
        return
    yield heading("Wrong answers")
    table = words_table("case", "hidden (size / limit)", "answered", "meaning")
    table.columns[0].justify = "right"
    for case in wrong:
        table.add_row(str(case.index), hidden(case), answered(case), _WORDS.get(case.outcome, case.outcome))
    yield indented(table)
    kinds = {c.outcome: OUTCOMES[c.outcome] for c in wrong}
    for outcome, meaning in kinds.items():
        yield indented(Text(f"{_WORDS.get(outcome, outcome)}: {meaning}", style="dim"))


def _confusion(summary: Summary) -> Iterator[RenderableType]:
    """Yield the answers for each truth; pairs are too many for a table: see the JSON."""
    single = [c for c in summary.cases if c.kind != "pair"]
    rows: dict[str, list[Judged]] = {}
    for case in single:
        rows.setdefault(case.truth_label, []).append(case)
    if len(rows) < 2:
        return
    yield heading("Answers" + (" (without pairs)" if len(single) < len(summary.cases) else ""))
    table = words_table("hidden", "cases", "answered")
    table.columns[1].justify = "right"
    order = sorted(rows, key=lambda name: (list(KINDS).index(rows[name][0].kind), name))
    for name in order:
        answers: dict[str, list[Judged]] = {}
        for case in rows[name]:
            answers.setdefault(case.named_label, []).append(case)
        text = Text()
        for label, cases in sorted(answers.items(), key=lambda item: -len(item[1])):
            if text:
                text.append(", ")
            style = "green" if all(c.right for c in cases) else "bold red"
            seen = "" if any(c.detectable for c in cases) else " (below the limit)"
            text.append(f"{_plain(label)}{seen}", style="dim" if seen and style == "green" else style)
            text.append(f" {len(cases)}")
        table.add_row(name, str(len(rows[name])), text)
    yield indented(table)


def _coverage(summary: Summary) -> Table:
    table = figures_table("interval stated as", *(f"{100 * level:g} %" for level in LEVELS), "of")
    for words, given in (
        ("true coefficient inside", summary.intervals),
        ("true parameter inside", summary.parameters),
    ):
        if given:
            parts = [_percent(covered(given, level).part) for level in LEVELS]
            table.add_row(words, *parts, str(len(given)))
    return table


def _numbers(summary: Summary) -> Iterator[str]:
    good = summary.validated
    if good.n:
        yield (
            f"on the validation recording the error falls to {WITHIN_FLOOR:g} noise floors or below in "
            f"{good.count} of {good.n} cases named exactly: {rate_words(good)}"
        )
    formulas = summary.formulas_validated
    if formulas.n:
        yield (
            f"with the formula proposed for an unknown it falls to {WITHIN_FORMULA:g} or below in "
            f"{formulas.count} of {formulas.n}: {rate_words(formulas)}"
        )
    if not math.isnan(summary.median_seconds):
        yield f"a diagnosis takes {seconds(summary.median_seconds)} (median)"


def hidden(case: Judged) -> str:
    """Return the hidden effects of a case, each with its size in detection limits."""
    names = [*case.truth, *([case.event.name] if case.event else []), *(i.name for i in case.instruments)]
    if not names:
        return "nothing"
    sizes = (case.sizes.get(name, math.nan) for name in names)
    return " + ".join(
        name + (f" ({fixed(size, 2)})" if math.isfinite(size) else "")
        for name, size in zip(names, sizes, strict=True)
    )


def answered(case: Judged) -> str:
    """Return the answer of a case."""
    if case.outcome == "failed":
        return case.error
    text = " + ".join(case.named + case.instruments_named) or _plain(case.verdict)
    if case.beside_unknown:
        text = f"{text}, and something unknown"
    if case.ties:
        text += f" or {', '.join(dict.fromkeys(name for name, _ in case.ties))}"
    return text


def _plain(label: str) -> str:
    return {"nothing_missing": "nothing", "insufficient_data": "too little data"}.get(label, label)


def _percent(part: float) -> str:
    return "–" if math.isnan(part) else f"{_number(part)} %"


def rate_words(rate: Rate) -> str:
    """Return a rate and its 95 % interval."""
    if not rate.n:
        return "–"
    low, high = rate.interval
    return f"{_number(rate.part)} % ({_number(low)} .. {_number(high)})"


def _number(part: float) -> str:
    return f"{100.0 * part:.1f}".removesuffix(".0")


def campaign_report(summary: Summary, command: str) -> str:
    """Return a campaign as one page of HTML that needs no network and runs no script.

    `command` is the command that repeats the campaign.
    """
    content: dict[str, Any] = {
        "schema": 1,
        "title": summary.title,
        "campaign": summary.to_json(),
        "cases": [case.to_json() for case in summary.cases],
    }
    cells = Cells(content)
    wrong = [(k, case) for k, case in enumerate(summary.cases) if not case.right]
    kinds = list(_kind_rows(summary, cells))
    drawn = png_bytes(rates_figure({row["kind"]: row["counted"] for row in kinds}, summary))
    return (
        environment("gyrowheel.campaigns")
        .get_template("campaign.html")
        .render(
            style=style_sheet(),
            mark=Markup(REPORT_MARKS[0]),
            title=cells.words("title"),
            done=cells.digits("campaign.cases", 0),
            asked=cells.digits("campaign.asked", 0),
            tally=tally(summary),
            mood="good" if not wrong else "found",
            detectable=f"{DETECTABLE:g}",
            kinds=kinds,
            picture=base64.b64encode(drawn).decode(),
            wrong=[
                {
                    "index": cells.digits(f"cases.{k}.case", 0),
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
                        (name, cells.digits(f"campaign.confusion.{truth}.{name}", 0))
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
                    "of": cells.digits(f"campaign.coverage.{name}.n", 0),
                }
                for name, words in (("coefficients", "true coefficient"), ("bench", "true parameter"))
                if content["campaign"]["coverage"][name]["n"]
            ],
            seconds="" if math.isnan(summary.median_seconds) else cells.digits("campaign.median_seconds", 2),
            command=command,
            json=embedded(content),
        )
    )


def _kind_rows(summary: Summary, cells: Cells) -> Any:
    """Yield a row for each kind of case: counts, and the rate of right answers with its interval."""
    for kind, words in KINDS.items():
        cases = summary.of_kind(kind)
        if not cases:
            continue
        row: dict[str, Any] = dict.fromkeys(("seen", "exact", "tied", "wrong"), "–")
        row |= {"kind": words, "n": len(cases)}
        if kind in _SIZED:
            place = f"campaign.{kind}"
            row["n"] = cells.digits(f"{place}.n", 0)
            row |= {name: cells.digits(f"{place}.{name}", 0) for name in ("exact", "tied", "wrong")}
            row["seen"] = cells.digits(f"{place}.detectable", 0)
            how = summary.outcomes(summary.detectable(kind))
            rate = Rate(how["exact"] + how["tied"], len(summary.detectable(kind)))
        else:
            if kind in ("none", "outside"):
                row["n"] = cells.digits(f"campaign.{kind}.n", 0)
            rate = Rate(sum(case.right for case in cases), len(cases))
        yield row | {"rate": rate_words(rate), "counted": rate}


def _part(cells: Cells, place: str, level: str) -> Markup:
    # the name of a level contains a point, which separates the parts of a place
    value = cells.at(place)[level]
    return Markup('<span data-how="{}">{}</span>').format(f"{place}[{level}]", f"{100.0 * value:.1f} %")
