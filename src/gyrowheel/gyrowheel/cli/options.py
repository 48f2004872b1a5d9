"""Options and arguments that several verbs have, and what resumes a long verb."""

from __future__ import annotations

import contextlib
import math
import shlex
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

from gyrowheel.cli.console import notes
from gyrowheel.cli.outputs import JSON_RESULT, PICTURE, NewRecording
from gyrowheel.show.files import new_folder
from gyrowheel_core.errors import InputError

_STEPS = 6  # of a range of numbers without a step
_MOST = 1000  # steps of a range of numbers


def option(names: str, text: str, default: str | bool = True, **more: Any) -> Any:
    """Return an option, with its names and its value as the help shows them: ``-o --output DIR``.

    `default` describes a default that is no value, such as ``all``.
    """
    *first, last = names.split()
    if last.startswith("-"):
        return typer.Option(*first, last, help=text, show_default=default, **more)
    return typer.Option(*first, metavar=last, help=text, show_default=default, **more)


def argument(name: str | None, text: str, default: str | bool = True) -> Any:
    """Return an argument, as `option` does; None: with the name of its parameter."""
    return typer.Argument(metavar=name, help=text, show_default=default)


Json: TypeAlias = Annotated[
    str | None, option("--json FILE", "Write the result as JSON ('-': to stdout)."), JSON_RESULT
]
Picture: TypeAlias = Annotated[
    Path | None, option("--picture F.png|svg|pdf", "Draw where the model fails."), PICTURE
]
ErrorPicture: TypeAlias = Annotated[
    Path | None, option("--picture F.png|svg|pdf", "Draw the error before and after."), PICTURE
]
TorquePicture: TypeAlias = Annotated[
    Path | None, option("--picture F.png|svg|pdf", "Draw the parts of the torques."), PICTURE
]
Recordings: TypeAlias = Annotated[list[Path], argument("DIR...", "Recordings.")]
ModelFile: TypeAlias = Annotated[Path, option("--model M.yaml", "Model file.")]
PlanName: TypeAlias = Annotated[str, option("--plan P", "Test plan: shipped name, or a plan file.")]
Effects: TypeAlias = Annotated[
    list[str] | None,
    option(
        "--effect NAME[:C=V,..]",
        "Effect of the simulated machine; coefficients not given take their usual size. aero:MODEL stands for all "
        "effects of an air model: correlation, vorticity or surrogate (gyrowheel air). Repeatable.",
    ),
]
Blind: TypeAlias = Annotated[
    Path | None,
    option(
        "--blind KEY.json",
        "Hidden machine of this key file; drawn at random if the file is new. Without a file: key.json.",
    ),
]
Seed: TypeAlias = Annotated[int, option("--seed N", "Seed of the noise, and of a new key file.")]
Machine: TypeAlias = Annotated[
    int | None,
    option(
        "--machine N",
        "Draw the true bench parameters within their uncertainties with this seed.",
        "as stated in the bench file",
    ),
]
Namespace: TypeAlias = Annotated[
    str,
    option(
        "--namespace NS",
        "ROS namespace of the nodes and their topics, such as /bench2: several benches share a domain.",
        "none",
    ),
]
Truth: TypeAlias = Annotated[
    Path | None,
    option(
        "--truth M.yaml",
        "Model file whose effects and estimated parameters the simulated machine has, besides those of --effect.",
    ),
]
Belief: TypeAlias = Annotated[
    Path | None,
    option(
        "--model M.yaml",
        "Model file that the analyst believes: drag estimates are made with it, never with the truth.",
        "the bench without effects",
    ),
]
BenchOfRun: TypeAlias = Annotated[
    str | None,
    option(
        "--bench B",
        "Bench: shipped name (gyrowheel, dtg), or a bench file.",
        "gyrowheel, or that of --truth or --model",
    ),
]
BenchName: TypeAlias = Annotated[
    str, option("--bench B", "Bench: shipped name (gyrowheel, dtg), or a bench file.")
]
Validation: TypeAlias = Annotated[
    list[Path] | None, option("--validate DIR", "Recording to validate on, not used to fit. Repeatable.")
]


Averages: TypeAlias = Annotated[
    bool,
    option(
        "--averages", "Use averages over revolutions only, for example where filters suppress faster signals."
    ),
]
RecordingMade: TypeAlias = Annotated[Path, option("-o --output DIR", "Recording to create."), NewRecording()]
Mixed: TypeAlias = Annotated[bool, option("--mixed", "Join recordings that state different machines.")]


Until: TypeAlias = Annotated[
    str | None, option("--until settled", "End once an effect is settled.", "the recording ends")
]


def settled_only(until: str | None, followed: bool, option_name: str) -> bool:
    """Return whether to end once an effect is settled; InputError for another word, or without a diagnosis."""
    if until is None:
        return False
    if until != "settled":
        raise InputError(f"--until: '{until}' is not allowed; allowed: settled")
    if not followed:
        raise InputError(f"--until: needs {option_name}")
    return True


def example(text: str) -> str:
    """Return the epilog of a help text: one example."""
    return f"Example: [cyan]{text}[/cyan]"


def numbers(text: str, name: str) -> list[float]:
    """Return the numbers of ``3``, ``1,2,3``, ``0..5`` or ``0..5:0.5``; errors begin with the name of the option."""
    wanted = f"{name}: '{text}' is no list of numbers; allowed: 3, or 1,2,3, or 0..5, or 0..5:0.5"
    try:
        ends, _, step = text.partition(":")
        first, dots, last = ends.partition("..")
        if not dots:
            values = [float(part) for part in text.split(",")]
        else:
            low, high = float(first), float(last)
            by = float(step) if step else (high - low) / _STEPS
            if not by * (high - low) > 0.0 or (high - low) / by > _MOST:
                raise InputError(wanted)
            values = [low + k * by for k in range(math.floor((high - low) / by + 1e-9) + 1)]
    except ValueError:
        raise InputError(wanted) from None
    if not all(math.isfinite(value) for value in values):
        raise InputError(wanted)
    return values


Resume: TypeAlias = Annotated[
    Path | None,
    option(
        "--resume DIR",
        "Resume the interrupted or killed work in this folder; its settings need not be repeated.",
    ),
]


def place_of(output: Path | None, resume: Path | None, kind: str) -> Path:
    """Return the folder of the work: the resumed one, the named one, or a new one in ``out``."""
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
