"""Hostile names through all media: terminal, pictures, JSON, HTML, Markdown, SVG."""

from __future__ import annotations

import csv
import html
import io
import json
import os
import random
import re
import sys
import unicodedata
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import typer
import yaml
from rich.table import Table
from rich.text import Text

from gyrowheel.batches.api import COLUMNS, write_rows
from gyrowheel.cli import console as shell
from gyrowheel.cli.app import app
from gyrowheel.report.page import _words
from gyrowheel.show import html as pages
from gyrowheel.show.figure import Curve, Panel, curves_figure, png_bytes, svg_bytes
from gyrowheel.show.layout import TextConsole, plain_text
from gyrowheel_core.errors import visible
from gyrowheel_core.files import json_text

from .conftest import Wheel
from .helpers import DRAG_PLAN, SHORT_PLAN, Shell
from .test_nothing_but_named import _CALLS, commands

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


#: Verbs that take seconds: each of them is called with thirty of the names, the others with every one.
_LONG = (
    "compare", "diagnose", "model add", "model fit", "report", "momentum", "drag", "calibrate", "batch", "campaign",
)  # fmt: skip


_ENDINGS = (".yaml", ".csv", ".png", ".json", ".html", ".py")
_FOLDERS = ("made", "imported", "saved", "right", "campaign", "hidden", "wheel")


def _plan(text: str, name: str) -> str:
    """Return a plan whose texts are a name."""
    content = yaml.safe_load(text) | {"title": visible(name), "description": name.replace("\udcff", "")}
    return yaml.safe_dump(content, allow_unicode=True)


def _prepared(folder: Path, name: str, mapped: Path) -> None:
    """Write the files that the calls read, with a name wherever a file may have one."""
    (folder / f"short{folder.name}.yaml").write_text(_plan(SHORT_PLAN, name), encoding="utf-8")
    (folder / f"drag{folder.name}.yaml").write_text(_plan(DRAG_PLAN, name), encoding="utf-8")
    text = name.encode("utf-8", "replace").decode()
    with (folder / f"table{folder.name}.txt").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([["t", text, f"{text} [V]"], *([0.01 * k, k, k * k] for k in range(9))])
    columns = {text: np.arange(9.0), f"{text} 2": [text] * 9}
    with (folder / f"table{folder.name}.parquet").open("wb") as opened:
        pq.write_table(pa.table(columns), opened)
    row = dict.fromkeys(COLUMNS) | {"verdict": text, "summary": text, "machine": text, "error": ""}
    row |= {"windage.w": 1e-3, "windage.w.error": 1e-5}
    rows = [row | {"recording": text, "key": str(k), "start": 1e5 * k} for k in range(12)]
    write_rows(folder / f"many{folder.name}.csv", rows)
    declared: dict[str, object] = {"title": text, "sentence": text, "rotor_torque": "-k*z"}
    declared |= {"coefficients": {"k": {"unit": "N*m/rad", "usual": [0.01, 0.05], "description": text}}}
    model = {"schema": 1, "bench": "gyrowheel", "effects": {"own": {"declaration": declared, "k": 1e-6}}}
    (folder / f"model{folder.name}.yaml").write_text(
        yaml.safe_dump(model | {"history": []}), encoding="utf-8"
    )
    machine = "".join(filter(str.isprintable, text))[:64]  # others are refused
    content = yaml.safe_load(mapped.read_text(encoding="utf-8")) | {"environment": [{"machine": machine}]}
    (folder / f"table.map{folder.name}.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")


def _renamed(call: str, folder: Path) -> list[str]:
    """Return the words of a call with a name in the place of those of its files; the effect is that of the model."""
    words: list[str] = []
    call = call.replace("batch wheel ", "batch wheel/drag ").replace("remove windage", "remove own")
    call = call.replace("new.yaml --free windage.w", "wheel/model.yaml --free own.k")
    if call.startswith(("model remove", "model undo")):
        call = call.replace("new.yaml", "model.yaml")
    for word in call.split():
        place = Path(word)
        is_file = "/" in word or place.suffix in _ENDINGS or (bool(words) and word in _FOLDERS)
        words.append(str(folder / f"{place.stem}{folder.name}{place.suffix}") if is_file else word)
    return words


@pytest.mark.study
@pytest.mark.parametrize("first", range(0, _COUNT, 10))
def test_every_verb_takes_every_name(
    first: int, gyrowheel: Shell, wheel: Wheel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As names of files and folders, of columns, plans, machines and effects, and as arguments that mean nothing."""
    for stream in (sys.stdout, sys.stderr):  # as the program does where it is started
        assert isinstance(stream, io.TextIOWrapper)
        stream.reconfigure(errors="replace")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.yaml").write_text(SHORT_PLAN)
    gyrowheel.good("simulate", "--plan", "short.yaml", "-o", "short")
    for source, made in ((wheel.recording, "long"), ("short", "short")):
        gyrowheel.good("export", source, "-o", f"{made}.csv", "--map", f"{made}.map.yaml")
    calls = [call for call in _CALLS if "tdms" not in call and "suggest" not in call and call != "run"]
    long = [call for call in calls if call.startswith(_LONG)]
    short = [call for call in calls if call not in long]
    verbs = sorted(commands(typer.main.get_command(app)))

    def call(words: list[str], allowed: tuple[int, ...]) -> None:
        result = gyrowheel(*words)
        assert result.code in allowed, (words, result.err)
        assert _acts(result.out + result.err) == [], words

    for number, name in enumerate(NAMES[first : first + 10]):
        safe = name.replace("/", "\u2215").replace("\0", "")
        folder = tmp_path / f"{number}" / safe
        folder.mkdir(parents=True)
        _prepared(folder, name, tmp_path / "short.map.yaml")
        own = f"{folder / 'drag'}{safe}"
        call(["import", "long.csv", "--map", f"{folder / 'table.map'}{safe}.yaml", "-o", own], (0,))
        for kind in ("txt", "parquet"):
            call(["import", "--suggest", str(folder / f"table{safe}.{kind}")], (0, 2))
        for words in (_renamed(own, folder) for own in (*short, long[number % len(long)])):
            call(words, (0, 1) if words[0] not in ("rate", "torques", "drag") else (0, 1, 2))
        for verb in verbs:
            call([*verb.split(), "--", name.replace("\0", ""), "--no-such"], (2,))
        for file in folder.rglob("*"):
            if file.suffix in (".json", ".html", ".svg", ".md") and file.is_file():
                assert _acts(file.read_text(encoding="utf-8")) == [], file
        for file in sorted(folder.rglob("*"), reverse=True):
            os.unlink(file) if file.is_file() else os.rmdir(file)
