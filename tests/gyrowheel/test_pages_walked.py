"""The pages to learn from can be followed: their commands in their order, with the verdicts that they show."""

from __future__ import annotations

import re
import shlex
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import gyrowheel as gw

from .conftest import Wheel
from .helpers import Shell

DOCS = Path(__file__).resolve().parents[2] / "docs"
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
pytestmark = pytest.mark.slow


def steps(page: Path) -> Iterator[tuple[str, str]]:
    """Yield scripts (their text, and nothing), and commands with what the page shows of their output."""
    for language, text in FENCE.findall(page.read_text(encoding="utf-8")):
        if language == "python":
            yield text, ""
        for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
            command, _, shown = part.replace("\\\n", " ").partition("\n")
            yield command, shown


def verdict(shown: str) -> str:
    """Return the words in the boxes of an output, without its numbers."""
    return words(" ".join(re.findall(r"^│ (.*?) *│$", shown, re.MULTILINE)))


def words(shown: str) -> str:
    """Return an output without its numbers: another machine rounds otherwise."""
    return re.sub(r"−?\d[\d.()]*", "#", shown)


@pytest.mark.study  # test_page_commands.py reads every command of every page
@pytest.mark.parametrize("name", ["tutorial", "start"])
def test_the_commands_of_the_page_work(
    name: str, gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    seen = 0
    for text, shown in steps(DOCS / f"{name}.md"):
        if text.startswith("sed "):
            subprocess.run(shlex.split(text), check=True)
            continue
        if not text.startswith("gyrowheel "):
            exec(compile(text, f"{name}.md", "exec"), {"__name__": "__main__"})  # the page's own code
            continue
        arguments = shlex.split(text)[1:]
        said = gyrowheel.good(*arguments)
        if "--suggest" in arguments:  # what is asked and told, no more
            assert said.out.count("•") == shown.count("•"), said.out
        if expected := verdict(shown):
            assert verdict(said.out) == expected, text
            seen += 1
    assert seen >= 1


@pytest.mark.parametrize("page", ["python.md", "fit.md"])
def test_the_python_of_the_page_runs_and_prints_what_it_shows(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    place: dict[str, object] = {"__name__": "__main__"}
    fences = FENCE.findall((DOCS / page).read_text(encoding="utf-8"))[:4]
    assert [language for language, _ in fences] == ["python", "", "python", ""]
    for (_, code), (_, shown) in zip(fences[::2], fences[1::2], strict=True):
        exec(compile(code, page, "exec"), place)  # the page's own code
        assert words(capsys.readouterr().out) == words(shown)


def test_the_commands_of_the_page_of_tables_work(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wheel: Wheel
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "monday").symlink_to(wheel.recording)
    commands = [shlex.split(text)[1:] for text, _ in steps(DOCS / "exchange.md")]
    assert [arguments[0] for arguments in commands] == ["export", "import"]
    for arguments in commands:
        gyrowheel.good(*arguments)
    before, after = (gw.Recording.open(f"runs/{name}").measurement for name in ("monday", "again"))
    assert np.array_equal(before["tilt_x"], after["tilt_x"])
