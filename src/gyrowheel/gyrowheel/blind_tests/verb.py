"""The verb `key`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from gyrowheel.cli.console import finding, put
from gyrowheel.cli.options import Json, argument, option


def key(
    file: Annotated[Path, argument("KEY", "Key file of --blind.")],
    against: Annotated[Path | None, option("--against M.yaml", "Model file to judge.")] = None,
    bench: Annotated[
        str | None,
        option(
            "--bench B",
            "Bench that the key was drawn for: shipped name, or a bench file.",
            "that of the model, or gyrowheel",
        ),
    ] = None,
    fail_on_finding: Annotated[
        bool, option("--fail-on-finding", "Exit with 1 unless the model is right.")
    ] = False,
    json: Json = None,
) -> None:
    """Open the key of a blind test: show the hidden machine, and judge a model against it.

    Open it only when the model is finished: a key that was read is no test any more.
    """
    import gyrowheel as gw
    from gyrowheel_core.errors import InputError

    if fail_on_finding and against is None:
        raise InputError("--fail-on-finding: needs --against")
    model = None if against is None else gw.Model.load(against)
    result = gw.open_key(file, model, bench=bench)
    put(result, json)
    finding(fail_on_finding and result.outcome != "right")
