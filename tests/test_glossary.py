"""The glossary has the heads of all printed tables."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from gyrowheel.comparison import page as comparison
from gyrowheel.show import error_table as errors
from gyrowheel.show.sentences.residuals import TITLES
from gyrowheel_analysis.channels import CHANNELS

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
UNITS = {"deg", "rpm", "V", "mV", "mN·m", "SE", "%", "s", "deg/s", "deg/h", "°", "N·m·s", "Hz", "rpm/s"}
MAKERS = {"figures_table", "words_table", "add_column"}


def heads_in(page: str) -> set[str]:
    rows = re.findall(r"^\| (.+?) \| .+ \| .+ \|$", page.partition("## Heads of the tables")[2], re.MULTILINE)
    return {head for row in rows for head in (row, *row.split(", "))}


def texts(node: ast.AST) -> Iterator[str]:
    """Yield the texts within an expression, without the arguments of calls and format specifications."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    for name, child in ast.iter_fields(node):
        for part in child if isinstance(child, list) else [child]:
            if (
                isinstance(part, ast.AST)
                and not isinstance(part, ast.Call | ast.Subscript)
                and name != "format_spec"
            ):
                yield from texts(part)


def heads_in_code() -> Iterator[tuple[Path, str]]:
    for path in sorted((ROOT / "src" / "gyrowheel" / "gyrowheel").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        # layout and uncut_table get the heads as arguments
        if path.name in ("layout.py", "uncut_table.py") or not any(name in text for name in MAKERS):
            continue
        for node in ast.walk(ast.parse(text)):
            name = (
                getattr(node.func, "id", getattr(node.func, "attr", "")) if isinstance(node, ast.Call) else ""
            )
            if isinstance(node, ast.Call) and name in MAKERS:
                for argument in node.args:
                    yield from ((path, text) for text in texts(argument))


def words(head: str) -> list[str]:
    """Return the lines of a head without units; each line of two quantities is a separate head."""
    lines = []
    for line in head.split("\n"):
        line = line.strip(" ,").removeprefix("up to ")
        before, _, unit = line.rpartition(", ")
        line = before if unit in UNITS else line
        if line and line not in UNITS:
            lines.append(line)
    return lines


def explained(head: str, known: set[str]) -> bool:
    lines = words(head)
    return " ".join(lines) in known or all(line in known for line in lines)


def test_every_head_is_in_the_glossary() -> None:
    known = heads_in(PAGE)
    found = list(heads_in_code())
    assert len(found) > 100
    missing = {f"{path.name}: {head!r}" for path, head in found if not explained(head, known)}
    assert missing == set()
    # heads that are composed at run time
    made = [*(column.head for column in errors._COLUMNS), *comparison._SHORT.values()]
    made += [comparison._axis_title(name) for name in ("tilt", "azimuth", "speed", "time", "temperature")]
    assert [head for head in made if not explained(head, known)] == []
    assert not explained("entropy\nJ/K", known)


def test_channels_variables_and_basic_terms_are_in_the_glossary() -> None:
    text = " ".join(PAGE.split())
    for channel in CHANNELS.values():
        assert channel.title in text, channel.title
    for title in TITLES.values():
        assert title.split()[-1] in text, title
    for word in (
        "Theil",
        "noise floor",
        "window",
        "coverage",
        "hold",
        "effect",
        "instrument",
        "look-alike",
        "tie",
    ):
        assert re.search(rf"^### {word}$", PAGE, re.MULTILINE), word


def test_terms_are_in_alphabetical_order() -> None:
    named = re.findall(r"^### (.+)$", PAGE, re.MULTILINE)
    assert len(named) == len(set(named)) > 40
    plain = [name.lower().replace("χ²/n", "chi") for name in named]
    assert plain == sorted(plain)
