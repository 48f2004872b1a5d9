"""How everything on the terminal looks: headings, tables, lists and the next command."""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterable, Iterator

from rich import box
from rich.console import Console, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from gyrowheel.show.table import UncutTable

_MARGIN = (0, 0, 0, 2)
_NARROWEST, _WIDEST = 40, 110  # lines [characters]: long ones are hard to read, and tables need some width


def heading(text: str) -> Text:
    """Return the heading of a section, with an empty line above."""
    return Text(f"\n{text}", style="bold")


def figures_table(first: str, *columns: str) -> Table:
    """Return an empty table: one column of words, then columns of numbers."""
    table = UncutTable(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, header_style="dim")
    table.add_column(first)
    for title in columns:
        table.add_column(title, justify="right", no_wrap=True)
    return table


def words_table(*columns: str, whole: Iterable[int] = ()) -> Table:
    """Return an empty table of words; without titles it has no head.

    Parameters
    ----------
    *columns : str
        Titles.
    whole : iterable of int
        Columns that stay in the line of their row: numbers with their units.
    """
    table = UncutTable(
        box=box.SIMPLE_HEAD if any(columns) else None,
        pad_edge=False,
        show_edge=False,
        show_header=any(columns),
        header_style="dim",
    )
    for title in columns:
        table.add_column(title)
    for column in whole:
        table.columns[column].no_wrap = True
    return table


def sentences(texts: Iterable[str]) -> list[Padding]:
    """Return sentences as a list with dots; a long one goes on under its own beginning."""
    rows = []
    for text in texts:
        row = Table.grid(padding=(0, 1, 0, 0))
        row.add_row("•", Text(text))
        rows.append(Padding(row, _MARGIN))
    return rows


class Unbroken(Text):
    """Text whose lines are never broken, so that it can be copied whole: commands and paths."""


def command(text: str) -> Unbroken:
    """Return a command to type."""
    return Unbroken(f"  {text}", style="cyan")


def commands(title: str, *texts: str) -> Iterator[Text]:
    """Yield commands to type, below a heading; nothing without commands."""
    if texts:
        yield heading(title)
        yield from map(command, texts)


def show(console: Console, parts: Iterable[RenderableType]) -> None:
    """Print parts one after the other."""
    for part in parts:
        console.print(part, soft_wrap=isinstance(part, Unbroken))


def plain_text(parts: Iterable[RenderableType], width: int = 80) -> str:
    """Return parts as lines of text without colours."""
    stream = io.StringIO()
    # in a notebook, or where colours are asked for, rich would take the stream for more than a text
    plain = Console(
        file=stream,
        width=width,
        markup=False,
        force_jupyter=False,
        force_terminal=False,
        color_system=None,
    )
    show(plain, parts)
    return "\n".join(line.rstrip() for line in stream.getvalue().strip("\n").splitlines()).rstrip()


def terminal_width() -> int:
    """Return the width of a page on this terminal [characters]; 80 where there is none."""
    return readable(shutil.get_terminal_size((80, 24)).columns)


def readable(width: int) -> int:
    """Return the width of a page on a terminal of some width [characters]."""
    return min(max(width, _NARROWEST), _WIDEST)
