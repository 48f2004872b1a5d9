"""What the pages show of outputs is what the commands print, number by number."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tools.page_outputs import (
    NOTEBOOKS,
    PAGES,
    ROOT,
    agree,
    differences,
    disagreements,
    numbers,
    renewed,
    steps,
    unheld,
)

#: The page that everybody reads first. `test_examples.py` runs the notebooks.
ALWAYS = ("README.md",)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in ALWAYS else pytest.mark.study) for name in PAGES]
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


def test_every_page_that_shows_the_number_of_an_output_is_run() -> None:
    """A page with a command or script and its output, apart from tables that the generator of pages holds."""
    left_out = []
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]:
        text = re.sub(r"<!-- table: .*?<!-- end -->", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        shown = "".join(step.shown for step in steps(text))
        name = str(page.relative_to(ROOT))
        if re.search(r"\d", shown) and name not in (*PAGES, *NOTEBOOKS):
            left_out.append(name)
    # the address of a server, which runs until Ctrl-C; `tests/bringup` and `tests/gyrowheel` start both
    assert left_out == ["docs/with_pip.md", "docs/workbench.md"]


@pytest.mark.parametrize("name", [*PAGES, *NOTEBOOKS])
def test_a_changed_digit_on_a_page_is_noticed(name: str) -> None:
    """Every number of every line that is shown, one of each line at a time."""
    text = (ROOT / name).read_text(encoding="utf-8")
    for shown in (step.shown for step in steps(text) if step.shown.strip()):
        assert differences(shown, shown) == []
        lines = shown.splitlines()
        found = [numbers(line) for line in lines]
        for k in range(max(map(len, found))):
            changed = list(lines)
            for n, places in enumerate(found):
                if k < len(places):
                    at = next(p for p in range(*places[k]) if lines[n][p].isdigit())
                    changed[n] = f"{lines[n][:at]}{(int(lines[n][at]) + 4) % 10}{lines[n][at + 1 :]}"
            said = "\n".join(differences("\n".join(changed), shown))
            for old, new in zip(lines, changed, strict=True):
                assert old == new or repr(new) in said, new


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))], ids=lambda p: p.stem
)
def test_numbers_that_the_text_repeats_stand_in_an_output(page: Path) -> None:
    assert unheld(page.read_text(encoding="utf-8")) == []


def test_a_repeated_number_that_no_output_has_is_noticed() -> None:
    page = (ROOT / "docs" / "start.md").read_text(encoding="utf-8")
    found = re.search(r"^  c +(\S+) ± (\S+) mN·m/rad$", page, flags=re.MULTILINE)
    assert found is not None
    value, error = found.groups()
    other = f"{value[:-1]}{(int(value[-1]) + 4) % 10}"
    text = f"<!-- quotes: start.md -->\nThe coefficient c is {value} ± {error} mN·m/rad.\n\nNo output has 123.4.\n"
    assert unheld(text) == []
    assert unheld(text.replace(value, other)) == [f"{other}, of start.md"]


def test_remarks_stay_and_lines_that_are_not_printed_are_reported() -> None:
    shown = "a 1.0\n(seven more,\nof no interest)\nb 2.0\nnever printed at all\n"
    assert renewed(shown, "x\na 1.5\nc\nb 2.5\n") == (
        "a 1.5\n(seven more,\nof no interest)\nb 2.5\nnever printed at all\n",
        ["never printed at all"],
    )
    assert differences("a 1.0\n(2 more)\n", "a 1.0\nb 2.0\n") == ["not printed: (2 more)"]


def test_a_sentence_that_is_broken_elsewhere_is_renewed_as_a_whole() -> None:
    shown = "first\n  • the torque falls from 9.5 to\n    1.0 mN·m\nlast 1\n"
    now = "first\n  • the torque falls from 10.5\n    to 1.0 mN·m\nmore\nlast 2\n"
    assert renewed(shown, now) == (now.replace("more\n", ""), [])
    assert differences(shown, now) != []


def test_steps_of_a_page_are_shown_or_in_comments() -> None:
    page = (
        "<!-- run: gyrowheel a -->\n\n| head |\n|---|\n| 1 |\n\n<!-- file: b.yaml -->\n```yaml\nb: 1\n```\n\n"
        "```python\nprint(2)\n```\n\n```\n2\n```\n\n```\n$ gyrowheel c \\\n  d\n3\n$ gyrowheel e\n```\n"
        "\n```\nno output\n```\n"
    )
    assert [(step.language, step.text, step.shown) for step in steps(page)] == [
        ("command", "gyrowheel a", "| head |\n|---|\n| 1 |\n"),
        ("file", "b.yaml\nb: 1\n", ""),
        ("python", "print(2)\n", "2\n"),
        ("command", "gyrowheel c \\\n  d", "3\n"),
        ("command", "gyrowheel e", ""),
    ]


@pytest.mark.parametrize(
    ("shown", "now", "same"),
    [
        ("χ²/N 1.03", "χ²/N 1.04", True),
        ("χ²/N 1.03", "χ²/N 1.05", False),
        ("−0.5 mN·m", "0.5 mN·m", False),
        ("5.379 ± 0.079", "5.379 ± 0.080", True),
        ("a 1.0", "b 1.0", False),
        (
            "48.4 s simulated in 1.9 s, 26 times real time",
            "48.4 s simulated in 0.4 s, 99 times real time",
            True,
        ),
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
