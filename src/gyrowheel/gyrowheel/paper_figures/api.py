"""The published ground test judged statement by statement."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrowheel.paper_figures import equations, experiment, flow
from gyrowheel.paper_figures.evidence import Evidence, JudgedPaper, Row, Statement
from gyrowheel.recordings.inputs import Fraction
from gyrowheel.show.result import Result
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError, nearest
from gyrowheel_core.files import disk_errors, json_text, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

#: All statements, in the order of the paper.
STATEMENTS: tuple[Statement, ...] = (*equations.STATEMENTS, *flow.STATEMENTS, *experiment.STATEMENTS)


@dataclass(frozen=True, repr=False)
class Paper(Result, JudgedPaper):
    """Outcome of `gyrowheel.paper`: the fields of `gyrowheel.paper_figures.evidence.JudgedPaper`."""

    def __getitem__(self, name: str) -> Row:
        """Return the row of a name; InputError for an unknown name."""
        for row in self.rows:
            if row.name == name:
                return row
        raise InputError(f"paper: '{name}' is no row; known: {', '.join(row.name for row in self.rows)}")

    def headline(self) -> str:
        """Return the number of statements of each verdict."""
        counted = ", ".join(f"{verdict}: {number}" for verdict, number in self.counts().items())
        return f"{len(self.rows)} of {self.total} statements of Huo et al. 2016; {counted}"

    def page(self) -> Iterable[RenderableType]:
        """Return the table of verdicts, then numbers and reasons of the statements without agreement."""
        from gyrowheel.paper_figures.page import paper_page

        return paper_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel paper --json``; values in SI units."""
        from gyrowheel.paper_figures.page import CITATION

        return {
            "schema": 1,
            "paper": CITATION,
            "seed": self.seed,
            "statements": self.total,
            "verdicts": self.counts(),
            "rows": [row.to_dict() for row in self.rows],
        }

    def to_columns(self) -> Mapping[str, Any]:
        """Return name, where, statement, verdict, ours and why, a row for each statement."""
        names = ("name", "where", "statement", "verdict", "ours", "why")
        rows = [row.to_dict() for row in self.rows]
        return {name: [row[name] for row in rows] for name in names}

    def plot(self, name: str = "fig-16-cause") -> Figure:
        """Return the picture of a row.

        Parameters
        ----------
        name : str
            Name of the row.

        Raises
        ------
        InputError
            If there is no such row, or it has no picture.
        """
        draw = self[name].finding.draw
        if draw is None:
            raise InputError(f"paper: row '{name}' has no picture")
        return draw()

    def write(self, folder: str | Path) -> None:
        """Write the pictures, the page ``index.html``, which holds them too, and ``paper.json``.

        Raises
        ------
        InputError
            If a file cannot be written.
        """
        for row in self.rows:
            _write_picture(row, Path(folder))
        _write_page(self, Path(folder))


@one_thread()
def paper(
    folder: str | Path | None = None,
    *,
    only: Sequence[str] | None = None,
    seed: int = 0,
    progress: Fraction | None = None,
) -> Paper:
    """Judge every figure, table and stated result of Huo et al. 2016 by computed numbers.

    Momenta and equations are computed here; flow and air torques are those of the project; the voltages are recordings
    of the paper's plans, simulated with the computed air in the machine.

    Parameters
    ----------
    folder : str or Path, optional
        Folder for the pictures, the page ``index.html`` and ``paper.json``, which are written after every statement and
        stay if the run is interrupted. Nothing is written without it.
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
            _write_picture(row, place)
            _write_page(Paper(tuple(rows), len(STATEMENTS), seed), place)
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


def _write_picture(row: Row, folder: Path) -> None:
    """Write the picture of a row, if it has one, by its name."""
    from gyrowheel.show.figure import write_figure

    if row.finding.draw is not None:
        write_figure(row.finding.draw(), folder / f"{row.name}.png")


def _write_page(paper: Paper, folder: Path) -> None:
    """Write page and JSON; the pictures of the rows must be in the folder."""
    from gyrowheel.paper_figures.page import html_page

    with disk_errors(folder):
        pictures = {
            row.name: (folder / f"{row.name}.png").read_bytes()
            for row in paper.rows
            if row.finding.draw is not None
        }
    content = paper.to_dict()
    write_text(folder / "paper.json", json_text(content))
    write_text(folder / "index.html", html_page(paper, content, pictures))
