"""Long work that can be resumed: its settings and all finished parts are kept in its folder.

Each finished part is one file, written atomically, so that a kill at any instant costs no more than the unfinished
parts. Resuming with other settings or other code is refused: the parts would not belong together.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from gyrowheel_core.cache import digest
from gyrowheel_core.errors import InputError, with_article
from gyrowheel_core.files import disk_errors, json_text, read_json, require_new, write_text
from gyrowheel_core.locks import alone_in
from gyrowheel_core.schema import Section, check

SETTINGS, FINISHED = "settings.json", "finished"
_LONGEST = 60  # characters of a value that a message repeats


class Work(Section):
    """Settings of some work, on which its results depend: the content of the settings file.

    Attributes
    ----------
    kind : str
        Kind of work, in a word.
    settings : dict
        Values by the names of the options: content of a JSON file.
    contents : dict of str to str
        Digests of the files that `settings` names.
    versions : dict of str to str
        Versions of the code and of all that it uses.
    sum : str
        Digest of all of this, which shows later edits.
    """

    schema_: Literal[1] = Field(default=1, alias="schema")
    kind: str
    settings: dict[str, Any]
    contents: dict[str, str] = Field(default_factory=dict)
    versions: dict[str, str] = Field(default_factory=dict)
    sum: str = ""

    def text(self) -> str:
        """Return the text of the file."""
        content = self.model_dump(by_alias=True, exclude={"sum"})
        return json_text(content | {"sum": digest(json_text(content))})


@dataclass(frozen=True)
class Journal:
    """The finished parts of some work."""

    folder: Path  # where they are
    identity: str  # digest of settings and versions; a part of other work in the same folder does not count

    def finish(self, name: str, content: Any) -> None:
        """Write a finished part: content of a JSON file, in which numbers need not be finite.

        Raises
        ------
        InputError
            If the disk refuses it.
        """
        text = json_text({"of": self.identity, "content": _spelled(content)})
        write_text(self.folder / FINISHED / f"{name}.json", text)

    def finished(self) -> dict[str, Any]:
        """Return the finished parts by name, without damaged ones.

        Numbers that are not finite come back as the texts ``nan``, ``inf`` and ``-inf``.
        """
        found = {}
        for path in sorted((self.folder / FINISHED).glob("[!.]*.json")):
            with contextlib.suppress(InputError):
                part = read_json(path)
                if isinstance(part, dict) and part.get("of") == self.identity and "content" in part:
                    found[path.stem] = part["content"]
        return found


def begun(folder: Path, kind: str) -> Work:
    """Return the settings of the work in a folder.

    Raises
    ------
    InputError
        If there are none, the work is of another kind, or they were edited.
    """
    file = folder / SETTINGS
    if not file.is_file():
        raise InputError(f"{folder}: there is no {kind} to go on with: no {SETTINGS} in it")
    found = check(Work, read_json(file), str(file), kind=f"settings of {with_article(kind)}")
    if found.kind != kind:
        raise InputError(f"{folder}: holds {with_article(found.kind[:_LONGEST])}, not {with_article(kind)}")
    if json.loads(found.text())["sum"] != found.sum:
        raise InputError(
            f"{file}: was edited or damaged since the {kind} was begun; begin another one in a new folder"
        )
    return found.model_copy(update={"sum": ""})


def begin(folder: Path, work: Work) -> None:
    """Write the settings of new work into a folder.

    Raises
    ------
    InputError
        If the disk refuses it.
    """
    write_text(folder / SETTINGS, work.text())


def require_same(folder: Path, work: Work) -> None:
    """Refuse to resume other work than that of a folder.

    Raises
    ------
    InputError
        If there is no work, or a setting, a file or the code differs; the message names it.
    """
    stored = begun(folder, work.kind)
    given = Work.model_validate(json.loads(work.text()))
    there = f"the {work.kind} in {folder}"
    for name, before, now in _differences(stored.settings, given.settings):
        said = _said(now), _said(before)
        values = f"is another one than that of {there}"
        if said[0] is not None and said[1] is not None:
            values = f"{said[0]} is not that of {there}, {said[1]}"
        raise InputError(f"{name}: {values}; leave it out, or begin another {work.kind} in a new folder")
    for name, _, _ in _differences(stored.contents, given.contents):
        raise InputError(f"{name}: has changed since {there} was begun; begin another one in a new folder")
    for name, before, now in _differences(stored.versions, given.versions):
        raise InputError(
            f"{name}: {there} was begun with {_said(before)}, and this is {_said(now)}; results of the two do not "
            "belong together: begin another one in a new folder"
        )


@contextlib.contextmanager
def journal(folder: Path, work: Work, *, resume: bool = False) -> Iterator[Journal]:
    """Lock a folder for some work, and yield its journal.

    A folder in which nothing was finished before an InputError is left unchanged.

    Parameters
    ----------
    folder : Path
        New or empty; with `resume` that of the work to resume.
    work : Work
        Its settings.
    resume : bool
        Whether to resume the work in the folder.

    Raises
    ------
    InputError
        If the folder is not new, or has no work to resume or other work (see `require_same`); if another process
        works in it, or the disk refuses it.
    """
    if resume:
        require_same(folder, work)
    elif not _is_left_over(folder):
        require_new(folder, what=work.kind)
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    try:
        with alone_in(folder, work.kind):
            if not resume:
                begin(folder, work)
            try:
                yield Journal(folder, digest(work.text()))
            except InputError:
                if not resume and not (folder / FINISHED).exists():
                    (folder / SETTINGS).unlink(missing_ok=True)
                raise
    finally:
        with contextlib.suppress(OSError):
            for place in missing:
                place.rmdir()  # as a rule there is something in it


def _is_left_over(folder: Path) -> bool:
    """Whether a folder has nothing but the files of work that was killed before it began."""
    try:
        return all(path.name.startswith((".lock", f".{SETTINGS}")) for path in folder.iterdir())
    except OSError:
        return False


def _differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    """Yield the names of differing values and both values; None for a missing one."""
    for name in {**before, **now}:
        if before.get(name) != now.get(name):
            yield name, before.get(name), now.get(name)


def _said(value: Any) -> str | None:
    """Return a value for a message; None if it is too long."""
    text = "none" if value is None else value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= _LONGEST and text.isprintable() else None


def _spelled(content: Any) -> Any:
    """Return content with numbers that are not finite as texts: JSON has no such numbers."""
    if isinstance(content, Mapping):
        return {str(key): _spelled(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_spelled(value) for value in content]
    if isinstance(content, float) and not math.isfinite(content):
        return repr(float(content))
    return content
