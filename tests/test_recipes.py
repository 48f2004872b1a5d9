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
RECIPES = {
    path: (place, block)
    for path, place, block in re.findall(
        r"^<!-- recipe: (\S+), (.*?) -->\n```\w+\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE
    )
}
Run = Callable[[str], str]


def follow(path: Path, place: str, block: str) -> None:
    """Change one file as a recipe says."""
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
    for package in {path.partition("/")[0] for path in RECIPES}:
        shutil.copytree(
            ROOT / "src" / package / package,
            folder / package,
            ignore=shutil.ignore_patterns("__pycache__"),
        )
    for path, (place, block) in RECIPES.items():
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


def test_there_is_a_recipe_for_each() -> None:
    assert len(RECIPES) == 4
    for title in ("An effect", "A law target", "A channel", "A plan", "A verb"):
        assert f"### {title}\n" in TEXT


@pytest.mark.slow
def test_an_effect_and_a_channel_are_simulated_shown_and_found(run: Run) -> None:
    said = run(
        "import gyrowheel as gw\n"
        "quick = gw.simulate('quick', effects={'nonlinear_damping': {}}, machine=3)\n"
        "found = gw.diagnose(quick, gw.Model())\n"
        "print(*(effect.name for effect in found.effects))\n"
        "print(*gw.compare(quick, gw.Model()).to_dict()['error']['before']['channels'])\n"
        "import sys; sys.argv = ['gyrowheel', 'effects', 'nonlinear_damping']\n"
        "from gyrowheel.cli.app import main; main()\n"
    )
    named, channels, *page = said.splitlines()
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
