"""The paper's figures, tables and stated results beside what this project computes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from gyrowheel.show.result import Result
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

Verdict = Literal["agree", "disagree", "cannot be decided"]
VERDICTS: tuple[Verdict, ...] = ("agree", "disagree", "cannot be decided")


@dataclass(frozen=True)
class Finding:
    """What this project finds about one statement.

    Attributes
    ----------
    verdict : str
        ``agree``, ``disagree`` or ``cannot be decided``.
    ours : str
        What was computed.
    why : str
        Why the verdict is what it is.
    values : mapping of str to float
        The numbers behind it [SI], by names that end in their unit.
    draw : callable, optional
        Makes the picture.
    """

    verdict: Verdict
    ours: str
    why: str
    values: Mapping[str, float] = field(default_factory=dict)
    draw: Callable[[], Figure] | None = None


@dataclass(frozen=True)
class Row:
    """A statement of the paper, and what was found about it.

    Attributes
    ----------
    name : str
        Short name, also of the picture.
    where : str
        Figure, table, equation or section.
    statement : str
        What is stated there, in other words.
    finding : Finding
        What was found.
    """

    name: str
    where: str
    statement: str
    finding: Finding

    def to_dict(self) -> dict[str, Any]:
        """Return the row as in the JSON file."""
        found = self.finding
        return {
            "name": self.name,
            "where": self.where,
            "statement": self.statement,
            "verdict": found.verdict,
            "ours": found.ours,
            "why": found.why,
            "values": dict(found.values),
            "picture": f"{self.name}.png" if found.draw is not None else None,
        }


@dataclass(frozen=True, repr=False)
class Paper(Result):
    """Outcome of `gyrowheel.paper`.

    Attributes
    ----------
    rows : tuple of Row
        The statements, in the order of the paper.
    total : int
        Statements that there are; more than rows if the run was interrupted or only some were asked for.
    seed : int
        Seed of the noise of the recordings.
    """

    rows: tuple[Row, ...]
    total: int
    seed: int

    def counts(self) -> dict[Verdict, int]:
        """Return the number of rows of each verdict."""
        return {verdict: sum(row.finding.verdict == verdict for row in self.rows) for verdict in VERDICTS}

    def __getitem__(self, name: str) -> Row:
        """Return the row of a name.

        Raises
        ------
        InputError
            If there is none.
        """
        for row in self.rows:
            if row.name == name:
                return row
        raise InputError(f"paper: '{name}' is no row; known: {', '.join(row.name for row in self.rows)}")

    def __str__(self) -> str:
        """Return how many statements hold."""
        counted = ", ".join(f"{verdict}: {number}" for verdict, number in self.counts().items())
        return f"{len(self.rows)} of {self.total} statements of Huo et al. 2016; {counted}"

    def page(self) -> Iterable[RenderableType]:
        """Return the page that `print` and a notebook show."""
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
            write_picture(row, Path(folder))
        write_page(self, Path(folder))


def write_picture(row: Row, folder: Path) -> None:
    """Write the picture of a row, if it has one, by its name."""
    from gyrowheel.show.figure import write_figure

    if row.finding.draw is not None:
        write_figure(row.finding.draw(), folder / f"{row.name}.png")


def write_page(paper: Paper, folder: Path) -> None:
    """Write page and JSON; the pictures of the rows must be in the folder."""
    from gyrowheel.paper_figures.page import html_page
    from gyrowheel_core.files import disk_errors, json_text, write_text

    with disk_errors(folder):
        pictures = {
            row.name: (folder / f"{row.name}.png").read_bytes()
            for row in paper.rows
            if row.finding.draw is not None
        }
    write_text(folder / "paper.json", json_text(paper.to_dict()))
    write_text(folder / "index.html", html_page(paper, pictures))
