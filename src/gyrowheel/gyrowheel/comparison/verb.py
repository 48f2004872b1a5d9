"""The verb `compare`."""

from __future__ import annotations

from typing import Annotated

from gyrowheel.cli.console import finding, put, warn_of, working
from gyrowheel.cli.options import Json, Mixed, ModelFile, Picture, Recordings, option


def compare(
    directories: Recordings,
    model: ModelFile,
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
    """Compare a model with recordings: size of the error, where it is large, and what it depends on."""
    import gyrowheel as gw
    from gyrowheel.comparison.api import map_variables
    from gyrowheel.comparison.page import comparison_page
    from gyrowheel.recordings.inputs import opened

    over = None if map_over is None else [map_variables(text) for text in map_over]
    loaded = gw.Model.load(model)
    recordings = opened(directories)
    with working("comparing") as say:
        result = gw.compare(recordings, loaded, mixed=mixed, progress=say)
    warn_of(result.setup)
    page = None if over is None else comparison_page(result, [result.map(*own) for own in over])
    put(result, json, picture, page=page)
    finding(fail_above is not None and result.worst > fail_above)
