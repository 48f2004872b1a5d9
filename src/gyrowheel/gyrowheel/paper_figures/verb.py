"""The verb `paper`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from gyrowheel.cli.console import advancing, notes, put
from gyrowheel.cli.options import Json, Seed, option


def paper(
    output: Annotated[
        Path | None,
        option(
            "-o --output DIR",
            "Write a page (index.html), its pictures and paper.json here, after every statement.",
        ),
    ] = None,
    only: Annotated[
        list[str] | None, option("--only NAME", "Judge this statement only. Repeatable.", "all")
    ] = None,
    seed: Seed = 0,
    json: Json = None,
) -> None:
    """Judge every figure, table and result of the published ground test.

    Huo et al. 2016, statement by statement: its content, the number computed
    here, whether they agree, and why. Half a minute; the finished statements of an
    interrupted run stay in DIR.
    """
    import gyrowheel as gw

    try:
        with advancing("judging the paper") as advance:
            result = gw.paper(output, only=only, seed=seed, progress=advance)
    except KeyboardInterrupt:
        if output is not None and (output / "index.html").is_file():
            notes().print(f"finished statements: {output / 'index.html'}", soft_wrap=True)
        raise
    put(result, json)
    if output is not None and json != "-":
        notes().print(f"page: {output / 'index.html'}", soft_wrap=True)
