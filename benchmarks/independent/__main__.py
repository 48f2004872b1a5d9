"""The command: ``python -m benchmarks.independent --cases 40 --seed S`` tests the diagnosis and prints a table."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path

from rich.padding import Padding
from rich.text import Text
from scipy.stats import binomtest

from benchmarks.independent.cases import DETECTABLE, SEQUENCES, Case, solve
from gyrowheel.cli.console import BAD_INPUT, FINDING, INTERRUPTED, OK, advancing, put_text
from gyrowheel.show.layout import figures_table, heading, sentences
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import disk_errors, write_text

#: Required fraction of right answers, and allowed fraction of wrong ones.
BARS = {"none": (1.0 - 0.01), "single": 0.97, "pair": 0.88}
_CONFIDENCE = 0.95


def main(arguments: Sequence[str] | None = None) -> int:
    """Test the diagnosis and return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.independent", description=__doc__.split(": ", 1)[1]
    )
    parser.add_argument("--cases", type=int, default=40, help="how many (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="what is drawn (%(default)s)")
    parser.add_argument("--only", type=int, nargs="+", metavar="N", help="these cases alone")
    parser.add_argument(
        "--sequence", choices=[*SEQUENCES], default="long", help="test sequence (%(default)s)"
    )
    parser.add_argument("--without-setpoints", action="store_true", help="leave out what was asked for")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes (%(default)s)")
    parser.add_argument("--json", metavar="FILE", help="file of the cases")
    parser.add_argument("--fail", action="store_true", help="end with 1 if a bar does not hold")
    asked = parser.parse_args(arguments)
    if asked.cases < 1 or asked.jobs < 1 or asked.seed < 0:
        parser.error("cases, jobs: at least 1; seed: at least 0")
    numbers = [n for n in range(asked.cases) if not asked.only or n in asked.only]
    cases: list[Case] = []
    try:
        if asked.json:
            with disk_errors(Path(asked.json)), Path(asked.json).open("a"):
                pass
        with advancing(f"{len(numbers)} cases") as advance, ProcessPoolExecutor(asked.jobs) as pool:
            waiting = [
                pool.submit(solve, asked.seed, n, asked.sequence, setpoints=not asked.without_setpoints)
                for n in numbers
            ]
            try:
                for done in as_completed(waiting):
                    cases.append(done.result())
                    advance(len(cases) / len(numbers))
                    if asked.json:
                        kept = [asdict(case) for case in sorted(cases, key=lambda case: case.number)]
                        write_text(Path(asked.json), json.dumps(kept, indent=1) + "\n")
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    except InputError as error:
        sys.stderr.write(f"error: {error}\n")
        return BAD_INPUT
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        return INTERRUPTED
    return OK if shown(sorted(cases, key=lambda case: case.number)) or not asked.fail else FINDING


def shown(cases: Sequence[Case]) -> bool:
    """Print the tables; return whether every bar is reached, or within the binomial interval of its figure."""
    table = figures_table("", "hidden", "size", "answer", "")
    for column in (1, 2, 3, 4):
        table.columns[column].justify = "left"
        table.columns[column].no_wrap = False
    for case in cases:
        answer = "; ".join(
            name + (f" (or {', '.join(ties)})" if ties else "") for name, ties in case.named.items()
        )
        size = ", ".join(f"{size:.1f}" for size in case.sizes.values())
        below = not case.detectable
        word = case.outcome + (", small" if below else "")
        style = (
            "green" if case.good else "" if below and case.outcome in ("missed", "partial") else "bold red"
        )
        table.add_row(
            str(case.number),
            " + ".join(case.effects) or "nothing",
            size,
            answer or case.verdict.replace("_", " "),
            Text(word, style=style),
        )
    put_text([heading("Finder on recordings of another make"), Padding(table, (0, 0, 0, 2))])
    counts = figures_table("", "cases", "right", "tied", "missed", "wrong", "good, %", "bar")
    held = True
    for kind, bar in BARS.items():
        some = [case for case in cases if case.kind == kind and case.detectable]
        if not some:
            continue
        good = sum(case.good for case in some)
        interval = binomtest(good, len(some)).proportion_ci(_CONFIDENCE, "wilson")
        held &= bool(good / len(some) >= bar or interval.high >= bar)
        outcomes = [case.outcome for case in some]
        counts.add_row(
            {"none": "nothing", "single": "one effect", "pair": "two effects"}[kind],
            str(len(some)),
            *(str(outcomes.count(word)) for word in ("right", "tied")),
            str(sum(outcomes.count(word) for word in ("missed", "partial", "unknown"))),
            str(outcomes.count("wrong")),
            f"{100 * good / len(some):.0f} ({100 * interval.low:.0f} .. {100 * interval.high:.0f})",
            f">= {100 * bar:.0f}",
        )
    small = [case for case in cases if not case.detectable]
    wrong = sum(case.outcome in ("wrong", "unknown") for case in small)
    put_text(
        [
            Padding(counts, (1, 0, 0, 2)),
            Text(""),
            *sentences(
                [
                    f"Counted are cases in which all that is hidden is above {DETECTABLE:g} detection limits. Good:"
                    " right, or tied with the truth and a test that separates; in brackets the 95 % interval. Missed:"
                    " nothing named, one of two, or called unknown.",
                    f"Of {len(small)} cases with something smaller, {wrong} got a wrong answer.",
                ]
            ),
        ]
    )
    return held


if __name__ == "__main__":
    sys.exit(main())
