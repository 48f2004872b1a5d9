"""Hostile names through all media: terminal, pictures, JSON, HTML, Markdown, SVG."""

from __future__ import annotations

import html
import io
import json
import random
import re
import unicodedata
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from typing import Literal

import pytest
from rich.table import Table
from rich.text import Text

from gyrowheel.cli import console as shell
from gyrowheel.report.page import _words
from gyrowheel.show import html as pages
from gyrowheel.show.figure import Curve, Panel, curves_figure, png_bytes, svg_bytes
from gyrowheel.show.layout import TextConsole, plain_text
from gyrowheel_core.errors import visible
from gyrowheel_core.files import json_text

#: What means something somewhere: to terminals, mathtext, markup of rich, HTML, Markdown, SVG, shells, formats.
_PIECES = (
    "\x1b]0;owned\x07", "\x1b[2J", "\x1b[8m", "\x9b31m", "\x08" * 5, "\r", "\x7f", "\u202e", "\u2066", "\u200b",
    "\ufeff", "\u2028", "$", "$x^$", "$\\frac{", "\\", "{", "}", "%s", "{0}", "[red]", "[/]", ":smile:",
    "<script>alert(1)</script>", "<!--", "-->", "]]>", "&amp;",
    "&#x1b;", "\udcff", "\"'>", "`", "```", "|", "*", "_", "#", "](javascript:x)", "![", "~",
    "$(id)", "; rm -rf", "../", "é", "Ω", "\u0130", "\u00a0", "\U0001f600", "name", " ", "-rf", "\n",
)  # fmt: skip
_COUNT = 300


def _names() -> Iterator[str]:
    yield from _PIECES
    draw = random.Random(41)
    for _ in range(_COUNT - len(_PIECES)):
        yield "".join(draw.choice(_PIECES) for _ in range(draw.randint(2, 5)))


NAMES = tuple(_names())


def _acts(text: str) -> list[str]:
    """Return the characters of a text that act on a terminal, or hide."""
    return [c for c in text if unicodedata.category(c) in ("Cc", "Cf", "Zl", "Zp") and c not in "\n\t"]


def test_hidden_characters_are_those_of_their_categories() -> None:
    """All characters below the supplementary planes; soft hyphens and marks of Arabic numbers act on nothing."""
    every = "".join(map(chr, range(0xD800))) + "".join(map(chr, range(0xE000, 0x10000)))
    left = {c for c in _acts(visible(every)) if not "\u0600" <= c <= "\u08e2"}
    assert left == set()
    kept = "a Ω\u00a0\u2009é\n\t漢"
    assert visible(kept) == kept


def test_the_terminal_gets_no_character_that_it_obeys() -> None:
    colours: Literal["truecolor"] | None
    for colours in (None, "truecolor"):
        stream = io.StringIO()
        console = TextConsole(
            file=stream, force_terminal=colours is not None, color_system=colours, markup=False, width=300
        )
        for name in NAMES:
            table = Table()
            table.add_column(name)
            table.add_row(Text(name, style="bold"))
            console.print(table)
            console.print(name, soft_wrap=True)
        own = re.sub(r"\x1b\[[0-9;]*m", "", stream.getvalue())  # styles are those of the console itself
        assert _acts(own) == []
    assert all(_acts(plain_text([Text(name)])) == [] for name in NAMES)
    assert isinstance(shell._console(stderr=False), TextConsole)


def test_messages_get_no_character_that_a_terminal_obeys(capsys: pytest.CaptureFixture[str]) -> None:
    for name in NAMES:
        shell.bad_input(f"{name}: no such option")
    assert _acts(capsys.readouterr().err) == []


def test_json_is_the_same_content_and_hides_nothing() -> None:
    text = json_text({name: [name] for name in NAMES})
    assert _acts(text) == []
    assert json.loads(text) == {name: [name] for name in NAMES}


def test_pages_show_names_as_text() -> None:
    template = pages.environment("gyrowheel.report").from_string('<p title="{{ name }}">{{ name }}</p>')
    for name in NAMES:
        page = template.render(name=name)
        found = re.fullmatch(r'<p title="([^"<>]*)">([^<>]*)</p>', page, re.DOTALL)
        assert found, page
        assert html.unescape(found[1]) == html.unescape(found[2]) == visible(name)
        assert _acts(page) == []


def test_markdown_shows_names_as_text() -> None:
    for name in NAMES:
        line = _words(name)
        assert "\n" not in line
        assert _acts(line) == []
        assert not re.search(r"(?<!\\)(\\\\)*[`*\[\]|_#~]", line), line
        assert "<" not in line


def test_pictures_draw_names_as_text() -> None:
    """As titles, labels and entries of the legend."""
    for some in (NAMES[: len(_PIECES)], NAMES[-20:]):
        curves = [Curve(name, [0.0, 1.0], [0.0, 1.0], "k") for name in some]
        figure = curves_figure(some[0], some[1], [Panel(some[2], some[3], some[4], curves)])
        assert png_bytes(figure)
        assert ET.fromstring(svg_bytes(figure)) is not None
