"""A newcomer's package with effects of its own: installed as docs/formulas.md says, shown, hidden, found."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "formulas.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"<!-- file: (\S+) -->\n```\w+\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE))
COMMANDS = re.findall(r"^\$ (pip .*|gyrowheel .*)$", PAGE, re.MULTILINE)
Run = Callable[[str], str]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Return a function that runs a command of the page with a site of its own, into which pip installs."""
    site = tmp_path / "site"
    for name, text in FILES.items():
        file = tmp_path / name
        file.parent.mkdir(exist_ok=True)
        file.write_text(text, encoding="utf-8")

    def call(command: str) -> str:
        program, *arguments = shlex.split(command)
        if program == "pip":  # nothing is fetched: what builds it is here
            module = ["-m", "pip", "--disable-pip-version-check", "--no-input"]
            arguments += ["--no-build-isolation", "--no-index", "--target", str(site)]
        else:
            module = ["-c", "from gyrowheel.cli.app import main; main()"]
        done = subprocess.run(
            [sys.executable, *module, *arguments],
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(site), "COLUMNS": "100"},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return call


@pytest.mark.slow
def test_an_effect_package_installed_as_documented_is_registered(run: Run) -> None:
    assert set(FILES) == {"my_effects/pyproject.toml", "my_effects/my_effects.py"}
    install, show, *_ = COMMANDS
    pytest.importorskip("hatchling")
    run(install)
    assert "pull of the stator" in run(show)


@pytest.mark.study
def test_an_effect_hidden_as_documented_is_found(run: Run) -> None:
    pytest.importorskip("hatchling")
    said = [run(command) for command in COMMANDS]
    assert "An effect is missing: pull of the stator (stator_pull)." in said[-1]
