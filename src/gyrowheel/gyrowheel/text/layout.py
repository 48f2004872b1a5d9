"""How everything on the terminal looks: headings, tables, lists and the next command."""

from __future__ import annotations

import copy
import io
from collections.abc import Iterable
from dataclasses import replace

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.measure import Measurement
from rich.padding import Padding
from rich.table import Column, Table
from rich.text import Text

_MARGIN = (0, 0, 0, 2)
_GAPS = (2, 1, 0)  # spaces right of a column, the fewest where a table needs the room
_FREE = 10_000  # characters, more than anything takes


def heading(text: str) -> Text:
    """Return the heading of a section, with an empty line above."""
    return Text(f"\n{text}", style="bold")


class UncutTable(Table):
    """Table that shows all of its words and numbers, however narrow the terminal.

    Cells go on in the next line between words, those of columns with `no_wrap` not at all. Where that does not fit, the
    columns move together; only where that does not fit either are words and numbers broken, and nothing is left out.
    """

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the table with columns that fit the terminal."""
        sizes = [self._size(column, console, options) for column in self.columns]
        twin = copy.copy(self)
        for gap in _GAPS if self.box is not None else _GAPS[:-1]:
            twin.padding = (0, gap, 0, 0)
            room = options.max_width - (gap + (self.box is not None)) * (len(sizes) - 1)
            least = [size.minimum for size in sizes]
            if sum(least) <= room:
                break
        else:
            least = [1] * len(sizes)
        twin.columns = [
            replace(column, width=width, no_wrap=False, overflow="fold")
            for column, width in zip(self.columns, _widths(sizes, least, room), strict=True)
        ]
        yield from super(UncutTable, twin).__rich_console__(console, options)

    def _size(self, column: Column, console: Console, options: ConsoleOptions) -> Measurement:
        """Return how wide a column must and may be."""
        cells = [*([column.header] if self.show_header else []), *column.cells]
        found = [Measurement.get(console, options.update(max_width=_FREE), cell) for cell in cells]
        most = max((size.maximum for size in found), default=1)
        return Measurement(most if column.no_wrap else max((s.minimum for s in found), default=1), most)


def _widths(sizes: list[Measurement], least: list[int], room: int) -> list[int]:
    """Return widths that fit into a room; the widest columns give way first."""
    widths = [size.maximum for size in sizes]
    for most in range(max(widths, default=1), 0, -1):
        widths = [max(min(size.maximum, most), low) for size, low in zip(sizes, least, strict=True)]
        if sum(widths) <= room:
            break
    return widths


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
        Columns whose cells stand in one line each: numbers with their units.
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


def show(console: Console, parts: Iterable[RenderableType]) -> None:
    """Print parts one after the other."""
    for part in parts:
        console.print(part, soft_wrap=isinstance(part, Unbroken))


def plain_text(parts: Iterable[RenderableType], width: int = 80) -> str:
    """Return parts as lines of text without colours."""
    stream = io.StringIO()
    show(Console(file=stream, width=width, markup=False), parts)
    return "\n".join(line.rstrip() for line in stream.getvalue().rstrip().splitlines())
