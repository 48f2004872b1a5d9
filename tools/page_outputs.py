"""Outputs of commands on the pages: what a page shows of them, renewed and checked line by line.

``python -m tools.page_outputs PAGE...`` runs the commands of pages, each page in an empty folder, and writes the lines
that have changed. A page may leave lines out, and may say so in a line in brackets; every other line must be one of the
output, number by number.
"""

from __future__ import annotations

import difflib
import math
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
#: Pages whose commands follow from each other, from an empty folder on.
PAGES = ("README.md", "docs/start.md", "docs/tutorial.md")
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
_NUMBER = re.compile(r"(?<![\w.])[−+-]?\d[\d.]*")
_ALIKE = 0.85  # of two lines, one of which is the other with other numbers and other words


class Step(NamedTuple):
    """A command or script of a page, what the page shows of its output, and where."""

    text: str
    language: str
    shown: str
    begin: int
    end: int


def steps(text: str) -> Iterator[Step]:
    """Yield the commands and scripts of a page in their order."""
    for fence in _FENCE.finditer(text):
        if fence[1] == "python":
            yield Step(fence[2], "python", "", 0, 0)
        for part in re.finditer(r"^\$ (.*?)(?=^\$ |\Z)", fence[2], re.MULTILINE | re.DOTALL):
            command = re.match(r"(?:.*\\\n)*.*\n?", part[1])
            assert command is not None
            begin = fence.start(2) + part.start(1) + command.end()
            words = command[0].replace("\\\n", " ").strip()
            yield Step(words, "command", part[1][command.end() :], begin, fence.start(2) + part.end(1))


def outputs(page: Path, folder: Path) -> Iterator[tuple[Step, str]]:
    """Run the commands of a page in a folder; yield each with what it printed."""
    environment = os.environ | {"COLUMNS": "80", "NO_COLOR": "1"}
    for step in steps(page.read_text(encoding="utf-8")):
        if step.language == "python":
            words = [sys.executable, "-c", step.text]
        elif step.text.startswith("gyrowheel "):
            words = [str(Path(sys.executable).with_name("gyrowheel")), *shlex.split(step.text)[1:]]
        else:
            words = shlex.split(step.text)
        done = subprocess.run(
            words,
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode not in (0, 1):
            raise RuntimeError(
                f"{page.name}: {step.text}: exit code {done.returncode}: {done.stderr.strip()}"
            )
        yield step, done.stdout


def renewed(shown: str, output: str) -> tuple[str, list[str]]:
    """Return what a page shows of an output with its lines as they are now, and the lines that are not in it."""
    actual = [line.rstrip() for line in output.splitlines()]
    lines, result, stale, at = shown.splitlines(), [], [], 0
    k = 0
    while k < len(lines):
        line = lines[k]
        if line.lstrip().startswith("(") and not _printed(line, actual):  # a remark, up to its bracket
            while not lines[k].rstrip().endswith(")"):
                result.append(lines[k])
                k += 1
            result.append(lines[k])
        elif line.startswith("╭"):
            end = next(n for n in range(k, len(lines)) if lines[n].startswith("╰"))
            box = _box(actual, at)
            result += box or lines[k : end + 1]
            stale += [] if box else lines[k : end + 1]
            k = end
        elif line.strip():
            found = _place(line, actual, at)
            if found is None:
                stale.append(line)
                result.append(line)
            else:
                result.append(actual[found])
                at = found + 1
        else:
            result.append(line)
        k += 1
    return "".join(f"{line}\n" for line in result), stale


def _box(actual: Sequence[str], at: int) -> list[str]:
    for begin in [*range(at, len(actual)), *range(at)]:
        if actual[begin].startswith("╭"):
            end = next(n for n in range(begin, len(actual)) if actual[n].startswith("╰"))
            return list(actual[begin : end + 1])
    return []


def _skeleton(line: str) -> str:
    return " ".join(_NUMBER.sub("#", line).split())


def _printed(line: str, actual: Sequence[str]) -> bool:
    """Whether a line of an output has the words of a line."""
    return any(_skeleton(own) == _skeleton(line) for own in actual)


def _place(line: str, actual: Sequence[str], at: int) -> int | None:
    """Return the line of an output that a page shows: the same, else the same words, else the most similar one."""
    order = [*range(at, len(actual)), *range(at)]
    same = next((n for n in order if actual[n] == line.rstrip()), None)
    words = next((n for n in order if actual[n] and _skeleton(actual[n]) == _skeleton(line)), None)
    if same is not None or words is not None:
        return same if same is not None else words
    rated = [
        (difflib.SequenceMatcher(None, _skeleton(line), _skeleton(actual[n])).ratio(), -n) for n in order
    ]
    best = max(rated, default=(0.0, 0))
    return -best[1] if best[0] >= _ALIKE else None


def agree(shown: str, now: str) -> bool:
    """Whether two lines agree: the same words, and numbers that differ by one in the last digit at most."""
    if _skeleton(shown) != _skeleton(now):
        return False
    pairs = zip(_NUMBER.findall(shown), _NUMBER.findall(now), strict=True)
    return all(_close(own.rstrip("."), its.rstrip(".")) for own, its in pairs)


def _close(own: str, its: str) -> bool:
    try:
        first, second = (float(text.replace("−", "-")) for text in (own, its))
    except ValueError:  # a version, a time
        return own == its
    digits = min(len(text.partition(".")[2]) for text in (own, its))
    return math.isclose(first, second, rel_tol=0.0, abs_tol=1.01 * 10.0**-digits)


def disagreements(page: Path, folder: Path) -> list[str]:
    """Return the lines of a page that are not what its commands print, each with the printed one."""
    wrong = []
    for step, output in outputs(page, folder):
        now, stale = renewed(step.shown, output)
        wrong += [f"{step.text}: not printed: {line}" for line in stale]
        pairs = zip(step.shown.splitlines(), now.splitlines(), strict=False)
        wrong += [f"{step.text}: shows {a!r}, prints {b!r}" for a, b in pairs if a != b and not agree(a, b)]
    return wrong


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the outputs on pages as they are now; report lines that are not printed any more."""
    names = list(sys.argv[1:] if arguments is None else arguments) or list(PAGES)
    status = 0
    for name in names:
        page = ROOT / name
        text = page.read_text(encoding="utf-8")
        with tempfile.TemporaryDirectory() as folder:
            for step, output in reversed(list(outputs(page, Path(folder)))):
                if step.language == "command" and step.shown.strip():
                    now, stale = renewed(step.shown, output)
                    text = text[: step.begin] + now + text[step.end :]
                    for line in stale:
                        status = 1
                        sys.stdout.write(f"{name}: {step.text}: not printed any more: {line}\n")
        page.write_text(text, encoding="utf-8")
    return status


if __name__ == "__main__":
    raise SystemExit(main())
