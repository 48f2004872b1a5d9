"""Every command on a page is valid: verb, options, names of plans, effects and benches."""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer

import benchmarks
import gyrowheel
from gyrowheel.cli.app import app
from gyrowheel_control.plans.plan import Plan
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import registry

ROOT = Path(__file__).resolve().parents[1]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
#: Options whose value is a shipped name, a file, a variation, or a placeholder.
NAMES = {
    "--plan": Plan.shipped,
    "--validation-plan": Plan.shipped,
    "--bench": Bench.shipped,
    "--effect": lambda: list(registry()),
}


def blocks(page: Path, *languages: str) -> Iterator[str]:
    for language, text in FENCE.findall(page.read_text(encoding="utf-8")):
        if language in languages:
            yield text


def commands() -> Iterator[tuple[Path, str, bool]]:
    """Yield every command of the project on the pages, and whether it is complete."""
    for page in PAGES:
        for text in blocks(page, "", "console", "sh"):
            for line in re.sub(r"\\\n\s*", "", text).splitlines():
                found = re.match(r"\s*(?:\$ )?(gyrowheel [a-z].*)", line)
                if found and "metavar" not in line:
                    # text after several blanks or a hash describes the command
                    yield page, re.split(r"\s{3,}|\s+#\s", found[1])[0], line.startswith("$")
        prose = FENCE.sub("", page.read_text(encoding="utf-8"))
        for text in re.findall(r"`(gyrowheel [a-z][^`]*)`", prose):
            yield page, " ".join(text.split()), False


@cache
def root() -> Any:
    return typer.main.get_command(app)


def fault(command: str, *, whole: bool) -> str:
    """Return the fault of a command; empty if it is valid."""
    words = shlex.split(command)[1:]
    verb = root()
    while hasattr(verb, "commands"):
        if not words or words[0] not in verb.commands:
            return f"no verb {words[0]!r}" if words else "no verb" if whole else ""
        verb = verb.commands[words.pop(0)]
    if verb.name == "run":  # whose arguments are those of a node
        return ""
    options = {name: p for p in verb.params for name in (*p.opts, *p.secondary_opts) if name.startswith("-")}
    given, free = set(), 0
    while words:
        word = words.pop(0)
        name, _, value = word.partition("=") if word.startswith("--") else (word, "", "")
        if not name.startswith("-") or re.fullmatch(r"-[\d.]+", name) or name == "-":
            free += 1
            continue
        if name in ("--help", "-h"):
            return ""
        if name not in options:
            return f"no option {name}"
        given.add(options[name].name)
        if options[name].is_flag:
            continue
        if not value:
            if not words:
                return "" if not whole else f"{name} has no value"
            value = words.pop(0)
        if wrong := _unknown(name, value):
            return wrong
    if whole:
        missing = [
            p.name
            for p in verb.params
            if p.required and p.name not in given and not (p.param_type_name == "argument" and free)
        ]
        if missing:
            return f"without {', '.join(missing)}"
    return ""


def _unknown(option: str, value: str) -> str:
    if option not in NAMES:
        return ""
    name = re.split(r"[@:]", value)[0]
    if name in ("aero", "P", "NAME") or name.endswith(".yaml") or name in NAMES[option]():
        return ""
    return f"{option}: {name!r} is not known"


#: Names that the reader of a page adds: the recipes of CONTRIBUTING.md, the package of docs/formulas.md.
OF_PAGES = {"slow", "nonlinear_damping", "stator_pull"}


def test_every_command_on_the_pages_is_valid() -> None:
    found = list(commands())
    assert len(found) > 150
    wrong = [
        f"{page.relative_to(ROOT)}: {command}: {said}"
        for page, command, whole in found
        if (said := fault(command, whole=whole)) and not any(name in command for name in OF_PAGES)
    ]
    assert wrong == []


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("gyrowheel diagnose runs/monday", "without model"),
        ("gyrowheel diagnos runs/monday", "no verb 'diagnos'"),
        ("gyrowheel model adds x", "no verb 'adds'"),
        ("gyrowheel diagnose runs/monday --model wheel.yaml --avarages", "no option --avarages"),
        ("gyrowheel simulate --plan quik -o runs/a", "--plan: 'quik' is not known"),
        (
            "gyrowheel simulate --plan quick@rig=inverted -o runs/a --effect wind",
            "--effect: 'wind' is not known",
        ),
        ("gyrowheel simulate --plan quick -o runs/a --effect aero:surrogate", ""),
    ],
)
def test_invalid_commands_are_detected(command: str, said: str) -> None:
    assert fault(command, whole=True) == said


def test_make_targets_and_benchmark_subjects_on_the_pages_exist() -> None:
    targets = set(re.findall(r"^([a-z]+):.*##", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    named, subjects = set(), set()
    for page in PAGES:
        text = page.read_text("utf-8")
        named |= set(re.findall(r"(?:`|^\$? ?)make ([a-z]+)", text, re.MULTILINE))
        subjects |= set(re.findall(r"python -m benchmarks\.?(?: |\b)([a-z_]*)", text))
    assert len(named) > 5
    assert named <= targets
    modules = {path.stem for path in (ROOT / "benchmarks").glob("[a-z]*")}
    assert {name for name in subjects if name} <= {*benchmarks.SUBJECTS, *modules}


def test_python_on_the_pages_uses_public_names() -> None:
    seen = 0
    for page in PAGES:
        for text in blocks(page, "python"):
            tree = ast.parse(text)
            for node in ast.walk(tree):
                if (
                    isinstance(node, ast.Attribute)
                    and isinstance(node.value, ast.Name)
                    and node.value.id == "gw"
                ):
                    assert node.attr in gyrowheel.__all__, f"{page}: gw.{node.attr}"
                    seen += 1
    assert seen > 20
