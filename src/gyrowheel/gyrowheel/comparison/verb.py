"""The verb `compare`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from gyrowheel.cli.console import finding, put, warn_of, warn_of_changes, working
from gyrowheel.cli.options import Json, Mixed, Picture, argument, option
from gyrowheel_core.errors import InputError


def compare(
    directories: Annotated[
        list[Path] | None,
        argument("DIR...", "Recordings; with --on two model files, which are compared with each other."),
    ] = None,
    model: Annotated[
        Path | None, option("--model M.yaml", "Model file.", "none: two models are compared")
    ] = None,
    on: Annotated[
        list[Path] | None,
        option(
            "--on DIR", "Recording on which two models are compared, or the first of two sets. Repeatable."
        ),
    ] = None,
    against: Annotated[
        list[Path] | None,
        option("--against DIR", "Recording of the second of two sets: what changed from --on. Repeatable."),
    ] = None,
    fail_above: Annotated[
        float | None,
        option(
            "--fail-above X", "Exit with 1 if χ²/N of a channel is above X (1: nothing but noise).", min=0.0
        ),
    ] = None,
    map_over: Annotated[
        list[str] | None,
        option(
            "--map VAR[,VAR]",
            "Show a map of the residual over one or two of tilt, azimuth, speed, time, temperature. Repeatable.",
            "speed,tilt where the model fails",
        ),
    ] = None,
    mixed: Mixed = False,
    picture: Picture = None,
    json: Json = None,
) -> None:
    """Compare a model with recordings: size of the error, where it is large, and what it depends on.

    With --on, compare two models on the same recordings: which one they prefer, and the test that decides. With --on
    and --against, compare two sets of recordings under one model: what changed between two benches, days or versions.
    """
    import gyrowheel as gw
    from gyrowheel.comparison.api import map_variables
    from gyrowheel.comparison.page import comparison_page
    from gyrowheel.recordings.inputs import opened

    if against:
        _two_sets(
            directories or [], on or [], against, model, json=json, others=(fail_above, map_over, picture)
        )
        return
    if not directories:
        raise InputError("DIR: is missing; allowed: recordings, or --on DIR and --against DIR")
    if on or model is None:
        _two_models(
            directories, on or [], model, mixed=mixed, json=json, others=(fail_above, map_over, picture)
        )
        return
    over = None if map_over is None else [map_variables(text) for text in map_over]
    loaded = gw.Model.load(model)
    recordings = opened(directories)
    with working("comparing") as say:
        result = gw.compare(recordings, loaded, mixed=mixed, progress=say)
    warn_of(result.setup)
    warn_of_changes(recordings)
    page = None if over is None else comparison_page(result, [result.map(*own) for own in over])
    put(result, json, picture, page=page)
    finding(fail_above is not None and result.worst > fail_above)


def _two_models(
    files: Sequence[Path],
    on: Sequence[Path],
    model: Path | None,
    *,
    mixed: bool,
    json: str | None,
    others: Sequence[object],
) -> None:
    import gyrowheel as gw

    if not on:
        raise InputError("--model: is missing; allowed: --model M.yaml, or two model files and --on DIR")
    if model is not None or any(other is not None for other in others):
        raise InputError("--on: compares two models; allowed with it: --mixed, --json")
    if len(files) != 2:
        raise InputError(f"--on: compares two models; {len(files)} files are given")
    first, second = (gw.Model.load(file) for file in files)
    with working("comparing") as say:
        result = gw.compare_models(first, second, list(on), mixed=mixed, progress=say)
    put(result, json)


def _two_sets(
    directories: Sequence[Path],
    on: Sequence[Path],
    against: Sequence[Path],
    model: Path | None,
    *,
    json: str | None,
    others: Sequence[object],
) -> None:
    import gyrowheel as gw

    if model is None:
        raise InputError("--model: is missing; allowed: --model M.yaml, under which two sets are compared")
    if directories or not on:
        raise InputError(
            "--against: compares two sets of recordings; allowed: --on DIR for each of the first set"
        )
    if any(other is not None for other in others):
        raise InputError("--against: compares two sets of recordings; allowed with it: --on, --model, --json")
    loaded = gw.Model.load(model)
    with working("comparing") as say:
        result = gw.compare_sets(loaded, list(on), list(against), progress=say)
    put(result, json)
