"""The verb `demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from gyrowheel.cli.console import Tour, finding, put_json
from gyrowheel.cli.options import Json, option


def demo(
    seed: Annotated[
        int, option("--seed N", "Seed of the hidden machine, its effect and the noise.", min=0)
    ] = 1,
    output: Annotated[
        Path | None, option("-o --output DIR", "New directory for all results.", "out/demo-N")
    ] = None,
    json: Json = None,
) -> None:
    """Hide an effect in a simulated machine, find it from a recording, add it, validate it, and open the key.

    Exits with 1 if the verdict was wrong.
    """
    from gyrowheel.demonstration.api import demonstrate, folder_for
    from gyrowheel.show.files import require_new

    folder = folder_for(seed, Path("out")) if output is None else output
    require_new(folder)
    tour = Tour(json)
    outcome = demonstrate(seed, folder, tour)
    tour.show(outcome.page())
    if json is not None:
        put_json(json, outcome.to_json() | {"seed": seed})
    finding(not outcome.judgement.right)
