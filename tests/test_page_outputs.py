"""What the pages show of outputs is what the commands print, number by number."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tools.page_outputs import PAGES, ROOT, agree, disagreements, renewed, steps


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.study) for name in PAGES if "start" not in name]
    + ["docs/start.md"],
)
def test_the_page_shows_what_its_commands_print(name: str, tmp_path: Path) -> None:
    assert disagreements(ROOT / name, tmp_path) == []


def test_the_readme_shows_the_lines_of_the_page_that_is_run() -> None:
    pages = ((ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/start.md"))
    own, run = ({step.text: step.shown for step in steps(text) if step.shown.strip()} for text in pages)
    assert own.keys() <= run.keys()
    for text, shown in own.items():
        lines = run[text].splitlines()
        for line in shown.splitlines():
            assert line in lines or line.startswith("(") or not line, line


@pytest.mark.parametrize("name", PAGES)
def test_a_changed_digit_on_a_page_is_noticed(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    shown = [line for step in steps(text) for line in step.shown.splitlines() if re.search(r"\d\.\d\d", line)]
    assert len(shown) > 2
    for line in shown:
        other = re.sub(r"(\d\.)(\d)(?=\d)", lambda m: f"{m[1]}{(int(m[2]) + 4) % 10}", line, count=1)
        assert agree(line, line)
        assert not agree(line, other), line


def test_remarks_stay_and_lines_that_are_not_printed_are_reported() -> None:
    shown = "a 1.0\n(seven more,\nof no interest)\nb 2.0\nnever printed at all\n"
    assert renewed(shown, "x\na 1.5\nc\nb 2.5\n") == (
        "a 1.5\n(seven more,\nof no interest)\nb 2.5\nnever printed at all\n",
        ["never printed at all"],
    )


@pytest.mark.parametrize(
    ("shown", "now", "same"),
    [
        ("χ²/N 1.03", "χ²/N 1.04", True),
        ("χ²/N 1.03", "χ²/N 1.05", False),
        ("−0.5 mN·m", "0.5 mN·m", False),
        ("5.379 ± 0.079", "5.379 ± 0.080", True),
        ("a 1.0", "b 1.0", False),
    ],
)
def test_numbers_may_differ_by_one_in_the_last_digit(shown: str, now: str, same: bool) -> None:
    assert agree(shown, now) == same


def test_a_sentence_that_goes_on_with_a_bracket_is_no_remark() -> None:
    shown = "(where it fails)\nerror from 0.2 to 0.1\n(noise 0.05).\n"
    assert renewed(shown, "Where it fails\nerror from 0.3 to 0.1\n(noise 0.06).\n") == (
        "(where it fails)\nerror from 0.3 to 0.1\n(noise 0.06).\n",
        [],
    )
