"""The Python of the pages prints what they show; a table is written and read by the commands of its page."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import gyrowheel as gw
from tools.page_outputs import differences, steps

from .conftest import Wheel
from .helpers import Shell

DOCS = Path(__file__).resolve().parents[2] / "docs"
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
pytestmark = pytest.mark.slow


@pytest.mark.study  # other tests cover the commands of README and the Python API
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
        assert differences(shown, capsys.readouterr().out) == []


def test_the_commands_of_the_page_of_tables_work(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wheel: Wheel
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "monday").symlink_to(wheel.recording)
    page = (DOCS / "exchange.md").read_text(encoding="utf-8")
    commands = [shlex.split(step.text)[1:] for step in steps(page)]
    assert [arguments[0] for arguments in commands] == ["export", "import"]
    for arguments in commands:
        gyrowheel.good(*arguments)
    before, after = (gw.Recording.open(f"runs/{name}").measurement for name in ("monday", "again"))
    assert np.array_equal(before["tilt_x"], after["tilt_x"])
