"""Files that a command writes: checked before the work begins.

An existing file is replaced only if it is an earlier output of the same kind, so that a command can be repeated.
An input of the command, a file of another kind and anything within a recording are never overwritten.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import itertools
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import typer

from gyrowheel.show.files import bag_head, is_exported_map, is_exported_table, require_writable
from gyrowheel_core.errors import InputError

_BAGS = ("*.mcap", "*.db3")
_LONGEST = 50_000_000  # characters of a JSON file that this program may have written
_TORQUE_TABLE = {"schema", "rows"}  # the fields of its file


@dataclass(frozen=True)
class Output:
    """Marks a parameter of a verb as a file that it writes."""

    what: str  # kind of the file, for errors
    earlier: Callable[[Path], bool]  # tells whether an existing file is an earlier output of this kind
    suffixes: tuple[str, ...] = ()  # allowed endings of its name; any if empty


@dataclass(frozen=True)
class NewRecording:
    """Marks a parameter of a verb as the directory of a new recording."""


def guarded(verb: Callable[..., Any]) -> Callable[..., Any]:
    """Return a verb that checks its outputs before it begins."""

    @functools.wraps(verb)
    def checked(*args: Any, **given: Any) -> Any:
        check_outputs(verb, given)
        return verb(*args, **given)

    return checked


def guard(app: typer.Typer) -> None:
    """Have all verbs of a command line check their outputs before they begin."""
    for command in app.registered_commands:
        if command.callback is not None:
            command.callback = guarded(command.callback)
    for group in app.registered_groups:
        if group.typer_instance is not None:
            guard(group.typer_instance)


def check_outputs(verb: Callable[..., Any], given: Mapping[str, Any]) -> None:
    """Refuse outputs that would replace a file of another kind, or cannot be written.

    `Output` and `NewRecording` in the annotations of a verb mark its files; `given` are the values of its parameters.
    The InputError names option, file and reason.
    """
    outputs: dict[str, tuple[str, Path, Output]] = {}
    made: list[Path] = []
    others: list[Path] = []
    for name, parameter in inspect.signature(verb, eval_str=True).parameters.items():
        value = given.get(name)
        marks = get_args(parameter.annotation) if get_origin(parameter.annotation) is Annotated else ()
        output = next((mark for mark in marks if isinstance(mark, Output)), None)
        if output is None:
            paths = list(_paths(value))
            (made if any(isinstance(mark, NewRecording) for mark in marks) else others).extend(paths)
        elif value is not None and str(value) != "-":
            outputs[name] = (_option(marks, name), Path(value), output)
    for option, path, output in outputs.values():
        for other in others:
            if _same(path, other):
                raise InputError(f"{option}: {path} is an input of this command; name another file")
            if path.resolve().is_relative_to(other.resolve()) and _holds_a_bag(other):
                raise InputError(f"{option}: {path} lies in the recording {other}; name a file elsewhere")
        for folder in made:
            if path.resolve().is_relative_to(folder.resolve()):
                raise InputError(f"{option}: {path} lies in the recording {folder}; name a file elsewhere")
        _check(option, path, output)
    for (option, path, _), (second, again, _) in itertools.combinations(outputs.values(), 2):
        if _same(path, again):
            raise InputError(f"{second}: {again} is the file of {option}, too; name another one")


def _check(option: str, path: Path, output: Output) -> None:
    if output.suffixes and path.suffix not in output.suffixes:
        allowed = ", ".join(output.suffixes)
        raise InputError(f"{option}: {path}: the ending '{path.suffix}' is not known; allowed: {allowed}")
    for folder in path.resolve().parents:
        if bag_head(folder) is not None:
            raise InputError(f"{option}: {path} lies in the recording {folder}; name a file elsewhere")
    if path.exists() and not (path.is_file() and (_is_empty(path) or _is_earlier(path, output))):
        raise InputError(f"{option}: {path} exists and is not {output.what}; name a new file")
    require_writable(path)


def _paths(value: Any) -> Iterator[Path]:
    """Yield the paths in the value of a parameter."""
    if isinstance(value, Path | str):
        if value and "\0" not in str(value):
            yield Path(value)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _paths(item)


def _same(one: Path, other: Path) -> bool:
    with contextlib.suppress(OSError):
        return one.samefile(other)
    with contextlib.suppress(OSError):
        return one.resolve() == other.resolve()
    return False


def _option(marks: tuple[Any, ...], name: str) -> str:
    """Return the name of a parameter on the command line."""
    for mark in marks:
        for text in (getattr(mark, "default", ...), *(getattr(mark, "param_decls", None) or ())):
            if isinstance(text, str) and text.startswith("--"):
                return text
    return f"--{name}"


def _holds_a_bag(folder: Path) -> bool:
    return folder.is_dir() and (bag_head(folder) is not None or any(any(folder.glob(name)) for name in _BAGS))


def _is_empty(path: Path) -> bool:
    with contextlib.suppress(OSError):
        return path.stat().st_size == 0
    return False


def _is_earlier(path: Path, output: Output) -> bool:
    try:
        return output.earlier(path)
    except (OSError, ValueError, RecursionError):
        return False


def head(path: Path, size: int) -> bytes:
    """Return the first bytes of a file; OSError if it cannot be read."""
    with path.open("rb") as stream:
        return stream.read(size)


def json_content(path: Path) -> Any:
    """Return the content of a JSON file, None for any other file; OSError or ValueError if it cannot be read."""
    if head(path, 1) not in (b"{", b"["):
        return None
    with path.open(encoding="utf-8") as stream:
        text = stream.read(_LONGEST + 1)
    return json.loads(text) if len(text) <= _LONGEST else None


def _is_result(path: Path) -> bool:
    content = json_content(path)
    # a torque table is an input of other commands
    return isinstance(content, dict) and "schema" in content and content.keys() != _TORQUE_TABLE


def _is_torque_table(path: Path) -> bool:
    content = json_content(path)
    return isinstance(content, dict) and content.keys() == _TORQUE_TABLE


def _is_picture(path: Path) -> bool:
    begin = head(path, 4096)
    if begin.startswith(b"%PDF"):  # which names its maker at the end
        return path.stat().st_size < _LONGEST and b"Matplotlib" in path.read_bytes()
    return begin.startswith((b"\x89PNG\r\n\x1a\n", b"<?xml")) and b"matplotlib" in begin.lower()


JSON_RESULT = Output("a JSON result of an earlier command", _is_result)
PICTURE = Output("an earlier picture of gyrowheel", _is_picture, (".png", ".svg", ".pdf"))
TORQUE_TABLE = Output("an earlier torque table", _is_torque_table)
TABLE = Output("an earlier table of gyrowheel export", is_exported_table)
COLUMN_MAP = Output("an earlier map of gyrowheel export", is_exported_map)
