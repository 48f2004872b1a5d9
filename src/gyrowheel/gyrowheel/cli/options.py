"""Options and arguments that several verbs have."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from gyrowheel.cli.outputs import JSON_RESULT, PICTURE, NewRecording
from gyrowheel_core.errors import InputError

_STEPS = 6  # of a range of numbers without a step
_MOST = 1000  # steps of a range of numbers

Json: TypeAlias = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE", help="Write the result as JSON ('-': to stdout)."),
    JSON_RESULT,
]
Picture: TypeAlias = Annotated[
    Path | None,
    typer.Option("--picture", metavar="FILE.png", help="Draw where the model fails.", show_default=False),
    PICTURE,
]
ErrorPicture: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--picture", metavar="FILE.png", help="Draw the error before and after.", show_default=False
    ),
    PICTURE,
]
TorquePicture: TypeAlias = Annotated[
    Path | None,
    typer.Option("--picture", metavar="FILE.png", help="Draw the parts of the torques.", show_default=False),
    PICTURE,
]
Recordings: TypeAlias = Annotated[
    list[Path], typer.Argument(metavar="DIR...", help="Recordings.", show_default=False)
]
ModelFile: TypeAlias = Annotated[
    Path, typer.Option("--model", metavar="M.yaml", help="Model file.", show_default=False)
]
PlanName: TypeAlias = Annotated[
    str,
    typer.Option("--plan", metavar="P", help="Test plan: shipped name, or a plan file.", show_default=False),
]
Effects: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--effect",
        metavar="NAME[:C=V,..]",
        help="Effect of the simulated machine; coefficients not given take their usual size. aero:MODEL stands for all "
        "effects of an air model: correlation, vorticity or surrogate (gyrowheel air). Repeatable.",
        show_default=False,
    ),
]
Blind: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--blind",
        metavar="KEY.json",
        help="Hidden machine of this key file; drawn at random if the file is new. Without a file: key.json.",
        show_default=False,
    ),
]
Seed: TypeAlias = Annotated[
    int, typer.Option("--seed", metavar="N", help="Seed of the noise, and of a new key file.")
]
Machine: TypeAlias = Annotated[
    int | None,
    typer.Option(
        "--machine",
        metavar="N",
        help="Draw the true bench parameters within their uncertainties with this seed.",
        show_default="as stated in the bench file",
    ),
]
Namespace: TypeAlias = Annotated[
    str,
    typer.Option(
        "--namespace",
        metavar="NS",
        help="ROS namespace of the nodes and their topics, such as /bench2: several benches share a domain.",
        show_default="none",
    ),
]
Truth: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--truth",
        metavar="M.yaml",
        help="Model file whose effects and estimated parameters the simulated machine has, besides those of --effect.",
        show_default=False,
    ),
]
Belief: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--model",
        metavar="M.yaml",
        help="Model file that the analyst believes: drag estimates are made with it, never with the truth.",
        show_default="the bench without effects",
    ),
]
BenchOfRun: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--bench",
        metavar="B",
        help="Bench: shipped name (gyrowheel, dtg), or a bench file.",
        show_default="gyrowheel, or that of --truth or --model",
    ),
]
BenchName: TypeAlias = Annotated[
    str, typer.Option("--bench", metavar="B", help="Bench: shipped name (gyrowheel, dtg), or a bench file.")
]
Validation: TypeAlias = Annotated[
    list[Path] | None,
    typer.Option(
        "--validate",
        metavar="DIR",
        help="Recording to validate on, not used to fit. Repeatable.",
        show_default=False,
    ),
]


Averages: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--averages",
        help="Use averages over revolutions alone, as where filters hide what happens within one.",
    ),
]
RecordingMade: TypeAlias = Annotated[
    Path,
    typer.Option("-o", "--output", metavar="DIR", help="Recording to create.", show_default=False),
    NewRecording(),
]
Mixed: TypeAlias = Annotated[
    bool, typer.Option("--mixed", help="Join recordings that state different machines.")
]


def example(text: str) -> str:
    """Return the epilog of a help text: one example."""
    return f"Example: [cyan]{text}[/cyan]"


def numbers(text: str, option: str) -> list[float]:
    """Return the numbers of ``3``, ``1,2,3``, ``0..5`` or ``0..5:0.5``.

    Parameters
    ----------
    text : str
        The text.
    option : str
        Its option, for errors.

    Raises
    ------
    InputError
        If it is no list of numbers.
    """
    wanted = f"{option}: '{text}' is no list of numbers; allowed: 3, or 1,2,3, or 0..5, or 0..5:0.5"
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
