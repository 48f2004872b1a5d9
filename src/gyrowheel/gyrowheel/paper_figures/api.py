"""The paper judged statement by statement; what is finished is kept."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from gyrowheel.paper_figures import equations, experiment, flow, momentum, remarks
from gyrowheel.paper_figures.evidence import Evidence, Statement
from gyrowheel.paper_figures.result import Paper, Row, write_page, write_picture
from gyrowheel.recordings.inputs import Fraction
from gyrowheel_analysis.fitting.preparation import one_thread
from gyrowheel_core.errors import InputError, nearest
from gyrowheel_core.files import disk_errors

#: All statements, in the order of the paper.
STATEMENTS: tuple[Statement, ...] = (
    *momentum.STATEMENTS,
    *equations.STATEMENTS,
    *flow.STATEMENTS,
    *remarks.SETUP,
    *experiment.STATEMENTS,
    *remarks.REMARKS,
)


@one_thread()
def paper(
    folder: str | Path | None = None,
    *,
    only: Sequence[str] | None = None,
    seed: int = 0,
    progress: Fraction | None = None,
) -> Paper:
    """Judge every figure, table and stated result of Huo et al. 2016, with numbers made on the spot.

    Momenta and equations are computed, the flow and its torques are those that come with the project, the voltages are
    recordings of the paper's own plans, simulated with the computed air in the machine.

    Parameters
    ----------
    folder : str or Path, optional
        Where pictures, the page ``index.html`` and ``paper.json`` are written after every statement; nothing is written
        without it. What an interrupted run has finished stays there.
    only : sequence of str, optional
        Names of the statements to judge; all if not given.
    seed : int
        Seed of the noise of the recordings; not negative.
    progress : callable, optional
        Called with the fraction done, 0 .. 1.

    Raises
    ------
    InputError
        If a name or the seed is not known, or the folder cannot be written.
    """
    chosen = _chosen(only)
    if seed < 0:
        raise InputError(f"seed: {seed} is out of range; allowed: >= 0")
    place = None if folder is None else _place(Path(folder))
    evidence = Evidence(seed)
    rows: list[Row] = []
    for number, own in enumerate(chosen):
        found = own.judge(evidence)
        found = replace(found, ours=_minus(found.ours), why=_minus(found.why))
        row = Row(own.name, own.where, own.statement, found)
        rows.append(row)
        if place is not None:
            write_picture(row, place)
            write_page(Paper(tuple(rows), len(STATEMENTS), seed), place)
        if progress is not None:
            progress((number + 1) / len(chosen))
    return Paper(tuple(rows), len(STATEMENTS), seed)


def _minus(text: str) -> str:
    """Return a text with the sign of negative numbers, but not of exponents, as a minus."""
    return re.sub(r"(?<![\w-])-(?=\d)", "−", text)


def _chosen(only: Sequence[str] | None) -> list[Statement]:
    if only is None:
        return list(STATEMENTS)
    known = {own.name: own for own in STATEMENTS}
    for name in only:
        if name not in known:
            raise InputError(f"only: '{name}' is no statement; {nearest(name, known, 'known')}")
    return [own for own in STATEMENTS if own.name in only]


def _place(folder: Path) -> Path:
    """Return a folder that is new, empty, or holds an earlier outcome."""
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()) and not (folder / "paper.json").is_file():
            raise InputError(f"{folder}: holds other files; name a new folder")
    return folder
