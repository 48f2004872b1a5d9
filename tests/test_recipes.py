"""The recipes of CONTRIBUTING.md, followed as they stand there in a copy of the packages."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
#: Changes in their order: path, place, and the text of the block.
CHANGES: list[tuple[str, str, str]] = re.findall(
    r"^<!-- recipe: (\S+), (.*?) -->\n```\w+\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE
)
Run = Callable[[str], str]


def follow(path: Path, place: str, block: str) -> None:
    """Change one file as a recipe states it."""
    if place == "as a diff":
        old, new = (
            "".join(f"{line[1:]}\n" for line in block.splitlines() if line[0] in (" ", sign)) for sign in "-+"
        )
        text = path.read_text(encoding="utf-8")
        assert text.count(old) == 1, f"{path}: the lines of the recipe do not stand there once"
        path.write_text(text.replace(old, new), encoding="utf-8")
        return
    if place == "as a file":
        assert not path.exists()
        path.write_text(block, encoding="utf-8")
        return
    text = path.read_text(encoding="utf-8")
    if place == "at the end":
        text += f"\n\n{block}"
    else:
        begin = text.index(f"\n{place.removeprefix('in ')} = (\n")
        end = text.index("\n)  # fmt: skip\n", begin) + 1
        text = text[:end] + textwrap.indent(f"{block.rstrip()},\n", "    ") + text[end:]
    path.write_text(text, encoding="utf-8")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a function that runs code with a copy of the packages in which every recipe was followed."""
    folder = tmp_path_factory.mktemp("house")
    for package in {path.partition("/")[0] for path, _, _ in CHANGES}:
        shutil.copytree(
            ROOT / "src" / package / package,
            folder / package,
            ignore=shutil.ignore_patterns("__pycache__"),
        )
    for path, place, block in CHANGES:
        follow(folder / path, place, block)

    def call(code: str) -> str:
        done = subprocess.run(
            [sys.executable, "-c", code],
            cwd=folder,
            env=os.environ | {"PYTHONPATH": str(folder), "COLUMNS": "120"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return call


WALKS = (
    "A word in the torque table",
    "A column in the error table",
    "A reader of a table format",
    "A statistic of a diagnosis",
)


def test_each_recipe_changes_one_file_and_each_walk_three_at_most() -> None:
    sections = dict(re.findall(r"^### (.+?)\n(.*?)(?=^##)", TEXT, re.DOTALL | re.MULTILINE))
    changed = {
        title: set(re.findall(r"^<!-- recipe: (\S+),|`(docs/\S+)` completes", text, re.MULTILINE))
        for title, text in sections.items()
    }
    for title in ("An effect", "A law target", "A channel", "A plan"):
        assert len(changed[title]) == 1, title
    for title in WALKS:
        assert 1 <= len(changed[title]) <= 3, title
    assert "A verb" in sections


def test_a_table_format_is_read(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "lab.jsonl"
    file.write_text("".join(f'{{"time": {time}, "tilt": 1.5}}\n' for time in (0.0, 0.1, 0.2)))
    said = run(
        "from pathlib import Path; from gyrowheel_recording.tables import read_grid\n"
        f"grid = read_grid(Path({str(file)!r})); print(*grid.columns, grid.columns['time'].values.tolist())"
    )
    assert said.strip() == "time tilt [0.0, 0.1, 0.2]"


@pytest.mark.slow
def test_effect_channel_column_statistic_and_word_are_simulated_shown_and_found(run: Run) -> None:
    """In one process: the effect makes new code, which takes long to compile."""
    said = run(
        "import gyrowheel as gw\n"
        "quick = gw.simulate('quick', effects={'nonlinear_damping': {}}, machine=3)\n"
        "found = gw.diagnose(quick, gw.Model())\n"
        "print(*(effect.name for effect in found.effects))\n"
        "print(found.to_dict()['largest_pull'] == found.largest_pull > 0.0)\n"
        "print('over noise' in str(found), 'Largest pull of a bench parameter' in str(found))\n"
        "print(*gw.compare(quick, gw.Model()).to_dict()['error']['before']['channels'])\n"
        "import sys; sys.argv = ['gyrowheel', 'effects', 'nonlinear_damping']\n"
        "print(gw.torques(tilt=0.05))\n"
        "from gyrowheel.cli.app import main; main()\n"
    )
    assert "damping of the flexures" in said
    assert "flexure loss" not in said
    named, stated, shown, channels, *page = said.splitlines()
    assert (stated, shown) == ("True", "True True")
    assert named == "nonlinear_damping"
    assert "tilt_3n" in channels.split()
    assert "damping per squared angle" in "\n".join(page)


@pytest.mark.study  # the recipe above goes the same way, with more in it
def test_a_law_acts_on_the_target_and_is_fitted(run: Run) -> None:
    said = run(
        "import gyrowheel as gw\n"
        "own = gw.own_effect('flexure_stiffness = s; s = 0.08 [1]', name='stiffer')\n"
        "quick = gw.simulate('quick', effects=[own])\n"
        "model = gw.Model().add(own, fit=quick)\n"
        "print(model.effects['stiffer']['s'], model.effect_errors['stiffer']['s'])\n"
    )
    value, error = (float(word) for word in said.split())
    assert abs(value - 0.08) < 3.0 * error
    assert value > 5.0 * error


def test_a_plan_is_listed_and_can_be_run(run: Run) -> None:
    said = run(
        "from gyrowheel_control.plans.plan import Plan\n"
        "from gyrowheel_sim.bench import Bench\n"
        "plan = Plan.load('slow'); plan.check(Bench.load()); print(plan.name in Plan.shipped(), len(plan.segments))\n"
    )
    assert said.split() == ["True", "5"]
