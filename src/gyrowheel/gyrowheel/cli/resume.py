"""Resuming long verbs: their folder, the option `--resume`, and the command that resumes."""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

from gyrowheel.cli.console import notes
from gyrowheel.show.files import new_folder
from gyrowheel_core.errors import InputError

Resume: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--resume",
        metavar="DIR",
        help="Resume the interrupted or killed work in this folder; its settings need not be repeated.",
        show_default=False,
    ),
]


def place_of(output: Path | None, resume: Path | None, kind: str) -> Path:
    """Return the folder of the work: the resumed one, the named one, or a new one in ``out``.

    Raises
    ------
    InputError
        If both are given.
    """
    if resume is not None:
        if output is not None:
            raise InputError(f"-o: with --resume the folder is {resume}; leave it out")
        return resume
    return new_folder(Path("out"), kind, 1) if output is None else output


def merged(context: typer.Context, given: Mapping[str, Any], stored: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a verb: those that the user typed, the others from the resumed folder."""

    def is_typed(name: str) -> bool:
        source = context.get_parameter_source(name)
        return source is not None and source.name not in ("DEFAULT", "DEFAULT_MAP")

    return {
        name: value if name not in stored or is_typed(name) else stored[name] for name, value in given.items()
    }


def going_on_command(verb: str, folder: Path, options: Mapping[str, object]) -> str:
    """Return the command that resumes the work in a folder, with the options that no result depends on."""
    words = ["gyrowheel", *verb.split(), "--resume", str(folder)]
    for name, value in options.items():
        words += [] if value is None else [f"--{name}", str(value)]
    return shlex.join(words)


@contextlib.contextmanager
def going_on(command: str) -> Iterator[Callable[[], bool]]:
    """Yield a function that prints the resuming command at its first call; it is printed again at an interruption.

    The function returns whether this was its first call.
    """
    said = False

    def begun() -> bool:
        nonlocal said
        is_first, said = not said, True
        if is_first:
            notes().print(f"if this is interrupted: {command}", soft_wrap=True)
        return is_first

    try:
        yield begun
    except (KeyboardInterrupt, InputError, MemoryError, OSError):
        if said:
            notes().print(f"to go on: {command}", soft_wrap=True)
        raise
