"""Outputs of commands and scripts on the pages: what a page shows of them, renewed and checked line by line.

``python -m tools.page_outputs`` renews every page that shows an output with a number, a page at a time;
``python -m tools.page_outputs PAGE...`` renews some. It reports shown lines that are not printed any more. Outputs
are kept in ``build/page_outputs`` until the code or the commands of the page change, so that it goes on where it was
interrupted.

A page is run from an empty folder on: lines ``$ command``, ``python`` fences, and what a reader does not need to see,
in comments: ``<!-- run: command -->``, ``<!-- python: code -->``, ``<!-- file: name -->`` with the content below the
name or in the fence that follows. The output of a command stands below it; that of a script or a comment is the
unlabelled fence, or the table, that follows it at once. A page may leave lines out, and may say so in a line in
brackets; every other line must be one of the output, number by number. After ``<!-- quotes: PAGE -->`` the numbers of a
paragraph, list or table must stand in the outputs or commands of that page.
"""

from __future__ import annotations

import contextlib
import difflib
import hashlib
import io
import json
import math
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from gyrowheel.simulation.code_identity import code_identity
from tools import notebooks

ROOT: Final = Path(__file__).resolve().parent.parent
#: Pages that are run, each on its own.
PAGES: Final = (
    "README.md",
    *(
        f"docs/{name}.md"
        for name in (
            "start",
            "tutorial",
            "air",
            "benches",
            "campaign",
            "diagnosis",
            "fit",
            "import",
            "instruments",
            "investigate",
            "machines",
            "memory",
            "paper",
            "python",
            "recordings",
            "report",
            "torques",
            "where",
            "your_daq",
        )
    ),
)
#: Pages of scripts, which `tools.notebooks` writes.
NOTEBOOKS: Final = tuple(f"docs/notebooks/{name}.md" for name in notebooks.GALLERY)
#: What differs from run to run and from computer to computer.
_VOLATILE: Final = re.compile(
    r"in \d[\d.]* s, \d[\d.]* times real time|\d{4}-\d\d-\d\d[T ][\d:.]+|/tmp/\S+|\d[\d.]* MB"
    r"|takes \d[\d.]* s \(median\)|\d[\d.]*e-1[4-9]"  # the last: rounding
)
_ENVIRONMENT: Final = {"COLUMNS": "80", "NO_COLOR": "1"}
_KEPT: Final = ROOT / "build" / "page_outputs"
_PART: Final = re.compile(
    r"^```(\w*)\n(.*?)^```$|^<!-- (run|python|file):\s+(.*?)\s*-->$", re.MULTILINE | re.DOTALL
)
_TABLE: Final = re.compile(r"\s*((?:^\|.*\n)+)", re.MULTILINE)
_QUOTES: Final = re.compile(r"^<!-- quotes: (\S+) -->\n+(.*?)(?:^\n|\Z)", re.MULTILINE | re.DOTALL)
_NUMBER: Final = re.compile(r"(?<![\w.])[−+-]?\d[\d.]*")
_ALIKE: Final = 0.85  # of two lines, one of which is the other with other numbers and other words


class Step(NamedTuple):
    """A command or script of a page, what the page shows of its output, and where."""

    text: str
    language: str
    shown: str
    begin: int
    end: int


def steps(text: str) -> Iterator[Step]:
    """Yield the commands and scripts of a page in their order, seen and hidden ones."""
    parts = list(_PART.finditer(text))
    for part, following in zip(parts, [*parts[1:], None], strict=False):
        if part[3] == "file":
            name, _, content = part[4].partition("\n")
            if not content and following is not None:
                content = following[2]
            yield Step(f"{name}\n{content}", "file", "", part.end(), part.end())
            continue
        if part[3] or part[1] == "python":
            begin, end = _below(text, part.end(), following)
            words = part[4] if part[3] else part[2]
            yield Step(words, "python" if part[3] != "run" else "command", text[begin:end], begin, end)
            continue
        for own in re.finditer(r"^\$ (.*?)(?=^\$ |\Z)", part[2] or "", re.MULTILINE | re.DOTALL):
            command = re.match(r"(?:.*\\\n)*.*\n?", own[1])
            assert command is not None
            begin = part.start(2) + own.start(1) + command.end()
            end = part.start(2) + own.end(1)
            yield Step(command[0].strip(), "command", text[begin:end], begin, end)


def _below(text: str, place: int, following: re.Match[str] | None) -> tuple[int, int]:
    """Return where the output of a script stands that ends at a place: in the fence or table that follows at once."""
    table = _TABLE.match(text, place)
    if table is not None:
        return table.span(1)
    if following is None or following[1] != "" or text[place : following.start()].strip():
        return place, place
    return (place, place) if following[2].startswith("$ ") else following.span(2)


class _Run:
    """The steps of a page in one folder; scripts share their names."""

    def __init__(self, page: Path, folder: Path) -> None:
        self.page, self.folder = page, folder
        self.names: dict[str, Any] = {"__name__": "__main__"}

    def output(self, step: Step) -> str:
        """Return what a step prints."""
        if step.language == "file":
            name, _, content = step.text.partition("\n")
            (self.folder / name).write_text(f"{content.rstrip()}\n", encoding="utf-8")
            return ""
        return self._script(step.text) if step.language == "python" else self._command(step)

    def _script(self, code: str) -> str:
        said = io.StringIO()
        before = dict(os.environ)
        os.environ.update(_ENVIRONMENT)
        try:
            with contextlib.chdir(self.folder), contextlib.redirect_stdout(said):
                exec(compile(code, str(self.page), "exec"), self.names)  # the page's own code
        finally:
            os.environ.clear()
            os.environ.update(before)
        return said.getvalue()

    def _command(self, step: Step) -> str:
        words = shlex.split(step.text.replace("\\\n", " "))
        if words[0] == "gyrowheel":
            words[0] = str(Path(sys.executable).with_name("gyrowheel"))
        done = subprocess.run(
            words,
            cwd=self.folder,
            env=os.environ | _ENVIRONMENT,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        # what is refused is an output too, where the page shows it
        if done.returncode not in ((0, 1, 2) if step.shown.strip() else (0, 1)):
            raise RuntimeError(
                f"{self.page.name}: {step.text}: exit code {done.returncode}: {done.stderr.strip()}"
            )
        return done.stdout + done.stderr


def outputs(page: Path, folder: Path) -> Iterator[tuple[Step, str]]:
    """Run the steps of a page in a folder; yield each with what it printed."""
    run = _Run(page, folder)
    for step in steps(page.read_text(encoding="utf-8")):
        yield step, run.output(step)


def renewed(shown: str, output: str) -> tuple[str, list[str]]:
    """Return what a page shows of an output with its lines as they are now, and the lines that are not in it."""
    actual = [line.rstrip() for line in output.splitlines()]
    words = [_skeleton(line) for line in actual]
    lines, stale, at = shown.splitlines(), [], 0
    result: list[str] = []
    k = 0
    while k < len(lines):
        line = lines[k]
        found = _place(line, actual, words, at)
        if found is None and (remark := _remark(lines[k:])):
            result += remark
            stale += [own for own in remark if re.search(r"\d", own)]  # nothing would hold its number
            k += len(remark) - 1
        elif line.startswith("╭"):
            end = next(n for n in range(k, len(lines)) if lines[n].startswith("╰"))
            box = _box(actual, at)
            result += box or lines[k : end + 1]
            stale += [] if box else lines[k : end + 1]
            k = end
        elif not line.strip():
            result.append(line)
        elif found is not None:
            result.append(actual[found])
            at = found + 1
        else:  # other words: all such lines up to the next that is known, which may be broken elsewhere now
            end = k + 1
            while end < len(lines) and _is_gone(lines[end:], actual, words, at):
                end += 1
            now, gone = _reworded(lines[k:end], actual)
            result += now
            stale += gone
            k = end - 1
        k += 1
    return "".join(f"{line}\n" for line in result), stale


def _remark(lines: Sequence[str]) -> list[str]:
    """Return the lines in brackets with which lines begin, if they do."""
    if lines[0].lstrip().startswith("("):
        for n, line in enumerate(lines):
            if not line.strip():
                break
            if line.rstrip().endswith(")"):
                return list(lines[: n + 1])
    return []


def _box(actual: Sequence[str], at: int) -> list[str]:
    for begin in [*range(at, len(actual)), *range(at)]:
        if actual[begin].startswith("╭"):
            end = next(n for n in range(begin, len(actual)) if actual[n].startswith("╰"))
            return list(actual[begin : end + 1])
    return []


def _skeleton(line: str) -> str:
    return " ".join(_NUMBER.sub("#", _VOLATILE.sub("…", line)).split())


def _place(line: str, actual: Sequence[str], words: Sequence[str], at: int) -> int | None:
    """Return the line of an output that a page shows: the same, else the next one of the same words."""
    order = [*range(at, len(actual)), *range(at)]
    same = next((n for n in order if actual[n] == line.rstrip()), None)
    own = _skeleton(line)
    return same if same is not None else next((n for n in order if own and words[n] == own), None)


def _is_gone(lines: Sequence[str], actual: Sequence[str], words: Sequence[str], at: int) -> bool:
    known = not lines[0].strip() or lines[0].startswith("╭") or _remark(lines)
    return not known and _place(lines[0], actual, words, at) is None


def _reworded(lines: Sequence[str], actual: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the lines of an output that are most like others in their words, and those that have none like them."""
    own, closing = _skeleton(" ".join(lines)), lines[-1].rstrip()[-1]
    best: tuple[float, list[str]] = (0.0, [])
    for begin in range(len(actual)):
        for size in range(max(len(lines) - 1, 1), len(lines) + 3):
            some = [line for line in actual[begin : begin + size] if line]
            if not some or (closing in ".:" and not some[-1].endswith(closing)):  # a part of the sentence
                continue
            matcher = difflib.SequenceMatcher(None, own, _skeleton(" ".join(some)), autojunk=False)
            if matcher.real_quick_ratio() > best[0] and matcher.quick_ratio() > max(best[0], _ALIKE):
                best = max(best, (matcher.ratio(), some))
    if best[0] >= _ALIKE:
        return best[1], []
    if len(lines) == 1:
        return list(lines), list(lines)
    parts = [_reworded([line], actual) for line in lines]
    return [line for now, _ in parts for line in now], [line for _, gone in parts for line in gone]


def numbers(line: str) -> list[tuple[int, int]]:
    """Return where in a line the numbers stand that are compared."""
    hidden = [found.span() for found in _VOLATILE.finditer(line)]
    return [
        found.span()
        for found in _NUMBER.finditer(line)
        if not any(begin <= found.start() < end for begin, end in hidden)
    ]


def agree(shown: str, now: str) -> bool:
    """Whether two lines agree: the same words, and numbers that differ by one in the last digit at most."""
    if _skeleton(shown) != _skeleton(now):
        return False
    one, other = ([line[slice(*place)] for place in numbers(line)] for line in (shown, now))
    return all(_close(own.rstrip("."), its.rstrip(".")) for own, its in zip(one, other, strict=True))


def _close(own: str, its: str) -> bool:
    try:
        first, second = (float(text.replace("−", "-")) for text in (own, its))
    except ValueError:  # a version, a time
        return own == its
    digits = min(len(text.partition(".")[2]) for text in (own, its))
    return math.isclose(first, second, rel_tol=0.0, abs_tol=1.01 * 10.0**-digits)


def differences(shown: str, output: str) -> list[str]:
    """Return the lines that a page shows of an output and that are not printed so, each with the printed one."""
    now, stale = renewed(shown, output)
    pairs = zip(shown.splitlines(), now.splitlines(), strict=False)
    return [f"not printed: {line}" for line in stale] + [
        f"shows {a!r}, prints {b!r}" for a, b in pairs if a != b and not agree(a, b)
    ]


def disagreements(page: Path, folder: Path) -> list[str]:
    """Return the lines of a page that are not what its commands print, each with the printed one."""
    return [
        f"{step.text}: {wrong}"
        for step, output in outputs(page, folder)
        for wrong in differences(step.shown, output)
    ]


def unheld(text: str) -> list[str]:
    """Return the numbers that a page quotes from the outputs of pages and that do not stand there."""
    wrong = []
    for name, paragraph in _QUOTES.findall(text):
        page = (ROOT / "docs" / name).read_text(encoding="utf-8")
        held = {number for step in steps(page) for part in (step.text, step.shown) for number in _plain(part)}
        wrong += [f"{number}, of {name}" for number in _plain(paragraph) if number not in held]
    return wrong


def _plain(text: str) -> list[str]:
    """Return the numbers in a text, without signs."""
    return [number.rstrip(".") for number in re.findall(r"\d[\d.]*", text)]


def _digest(*texts: str) -> str:
    """Return a digest of texts and of the code that prints."""
    return hashlib.sha256("\0".join([*texts, *code_identity().values()]).encode()).hexdigest()


def _kept_outputs(name: str) -> list[str]:
    """Return the outputs of a page, those of an earlier call where code and commands are the same."""
    page, kept = ROOT / name, _KEPT / f"{name.replace('/', '-')}.json"
    own = [*steps(page.read_text(encoding="utf-8"))]
    digest = _digest(*(step.text for step in own))
    if kept.exists() and (found := json.loads(kept.read_text(encoding="utf-8")))["digest"] == digest:
        return list(found["outputs"])
    with tempfile.TemporaryDirectory() as folder:
        printed = [output for _, output in outputs(page, Path(folder))]
    kept.parent.mkdir(parents=True, exist_ok=True)
    kept.write_text(json.dumps({"digest": digest, "outputs": printed}), encoding="utf-8")
    return printed


def _renew(name: str) -> list[str]:
    """Write the outputs on a page as they are now; return the lines that are not printed any more."""
    printed = _kept_outputs(name)
    page = ROOT / name
    text = page.read_text(encoding="utf-8")
    gone: list[str] = []
    for step, output in reversed(list(zip(steps(text), printed, strict=True))):
        if step.shown.strip():
            now, stale = renewed(step.shown, output)
            text = text[: step.begin] + now + text[step.end :]
            gone[:0] = [f"{step.text.splitlines()[0]}: not printed any more: {line}" for line in stale]
    page.write_text(text, encoding="utf-8")
    return gone


def _renew_notebook(name: str) -> list[str]:
    """Make the page of a notebook, unless code and script are those of an earlier call."""
    script, kept = Path(name).stem, _KEPT / f"{name.replace('/', '-')}.json"
    digest = _digest((notebooks.SCRIPTS / f"{script}.py").read_text(encoding="utf-8"))
    if not kept.exists() or kept.read_text(encoding="utf-8") != digest:
        notebooks.main([script])
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(digest, encoding="utf-8")
    return []


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the outputs on pages as they are now; report lines that are not printed any more."""
    names = list(sys.argv[1:] if arguments is None else arguments) or [*PAGES, *NOTEBOOKS]
    status = 0
    for name in names:
        try:
            wrong = _renew_notebook(name) if name in NOTEBOOKS else _renew(name)
        except Exception as error:  # the other pages are renewed
            wrong = [f"not renewed: {error}"]
        if (ROOT / name).suffix == ".md":
            wrong += [f"quotes {number}" for number in unheld((ROOT / name).read_text(encoding="utf-8"))]
        status |= bool(wrong)
        sys.stdout.write(f"{name}: {'as printed' if not wrong else ''}\n")
        sys.stdout.writelines(f"  {line}\n" for line in wrong)
        sys.stdout.flush()
    return status


if __name__ == "__main__":
    raise SystemExit(main())
