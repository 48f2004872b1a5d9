"""Layout of the pages on the terminal: headings, tables, lists and commands."""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterable, Iterator

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.padding import Padding
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from gyrowheel_core.errors import visible

_MARGIN = (0, 0, 0, 2)
_NARROWEST, _WIDEST = 40, 110  # lines [characters]: long ones are hard to read, and tables need some width
_GAPS = (2, 1)  # spaces right of a column, the fewest where a table needs the room
_FIGURES_GAP = 0  # the fewest in a table of numbers, whose titles tell its columns apart
_INDENT = 4  # of cells below their row
_KEY = 10  # a first column no wider leaves room for prose in the next column


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
    """Return an empty table of words, without titles without head; columns in `whole` stay in the line of their row."""
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


def indented(part: RenderableType) -> Padding:
    """Return a part of a page with its margin."""
    return Padding(part, _MARGIN)


def sentences(texts: Iterable[str]) -> list[Padding]:
    """Return sentences as a bulleted list with hanging indents."""
    rows = []
    for text in texts:
        row = Table.grid(padding=(0, 1, 0, 0))
        row.add_row("•", Text(text))
        rows.append(indented(row))
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


class TextConsole(Console):
    """A console on which a text is text: no character of it acts on the terminal or hides."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render, with hidden characters as escapes."""
        for own in super().render(renderable, options):
            yield own if own.control else Segment(visible(own.text), own.style)


def show(console: Console, parts: Iterable[RenderableType]) -> None:
    """Print parts one after the other."""
    for part in parts:
        console.print(part, soft_wrap=isinstance(part, Unbroken))


def plain_text(parts: Iterable[RenderableType], width: int = 80) -> str:
    """Return parts as lines of text without colours."""
    stream = io.StringIO()
    # in a notebook, or where colours are asked for, rich would take the stream for more than a text
    plain = TextConsole(
        file=stream, width=width, markup=False, force_jupyter=False, force_terminal=False, color_system=None
    )
    show(plain, parts)
    return "\n".join(line.rstrip() for line in stream.getvalue().strip("\n").splitlines()).rstrip()


def terminal_width() -> int:
    """Return the width of a page on this terminal [characters]; 80 without a terminal."""
    return readable(shutil.get_terminal_size((80, 24)).columns)


def readable(width: int) -> int:
    """Return the width of a page on a terminal of some width [characters]."""
    return min(max(width, _NARROWEST), _WIDEST)


class UncutTable(Table):
    """Table that cuts no word or number and breaks no cell over several lines, however narrow the terminal.

    Where the rows are too long, cells of words (columns without `no_wrap`) move to separate lines below their row,
    those of the first column above it. A column most of whose cells do not fit moves as a whole. Where the numbers
    alone do not fit, the remaining columns follow in a second table, with the first column repeated; where not even
    two columns fit side by side, every cell has its own line. Only a text that is longer than a line is wrapped.
    """

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the table as it fits the terminal."""
        room = options.max_width
        widths = self._natural_widths()
        every = list(widths)
        for gap in (*_GAPS, *([_FIGURES_GAP] if self._is_of_figures() else [])):
            if self._total(widths, gap) <= room:
                yield self._part(widths, gap, range(len(self.rows)))
                return
        gap = self._least_gap()
        widths = self._narrowed(widths, room)
        blocks = list(self._blocks(widths, room))
        if any(self._total(block, gap) > room for block in blocks):
            yield from self._one_by_one()
            return
        below = [i for i in every if i not in widths]
        for number, block in enumerate(blocks):
            if number:
                yield Text()
            yield from self._rows(block, gap, [] if number else below)

    def _is_of_figures(self) -> bool:
        """Whether all but the first column are numbers below titles."""
        return self.box is not None and all(column.no_wrap for column in self.columns[1:])

    def _least_gap(self) -> int:
        """Return the spaces right of a column where the table needs the room."""
        return _GAPS[0] if self.box is None else _GAPS[-1]

    def _cells(self, column: int) -> list[Text]:
        """Return the cells of a column."""
        return [_text(cell) for cell in self.columns[column].cells]

    def _title(self, column: int) -> str:
        """Return the title of a column in one line."""
        return " ".join(_text(self.columns[column].header).plain.split()) if self.show_header else ""

    def _natural_widths(self) -> dict[int, int]:
        """Return how wide each column would be in a terminal without an edge."""
        found = {}
        for i, column in enumerate(self.columns):
            titles = [_text(column.header)] if self.show_header else []
            found[i] = max((_width(text) for text in [*titles, *self._cells(i)]), default=1) or 1
        return found

    def _total(self, widths: dict[int, int], gap: int) -> int:
        """Return the width of some columns with the spaces between them."""
        return sum(widths.values()) + (gap + (self.box is not None)) * (len(widths) - 1)

    def _narrowed(self, widths: dict[int, int], room: int) -> dict[int, int]:
        """Return the columns that stay in the line of their row, with the widths that they get there."""
        gap = self._least_gap()
        words = [i for i, column in enumerate(self.columns) if not column.no_wrap]
        for i in sorted(words, key=lambda i: (i == 0, -widths[i])):
            if self._total(widths, gap) <= room:
                break
            left = room - self._total({**widths, i: 0}, gap)
            title = _width(_text(self.columns[i].header)) if self.show_header else 1
            sizes = [_width(cell) for cell in self._cells(i) if cell.plain]
            if left >= max(title, 1) and (
                2 * sum(size <= left for size in sizes) >= len(sizes) or self._is_prose(i)
            ):
                widths = {**widths, i: left}
            elif i:
                widths = {k: width for k, width in widths.items() if k != i}
        return widths

    def _is_prose(self, column: int) -> bool:
        """Whether a column is text that follows a short key."""
        return len(self.columns) == 2 and column == 1 and self._natural_widths()[0] <= _KEY

    def _blocks(self, widths: dict[int, int], room: int) -> Iterator[dict[int, int]]:
        """Yield the columns of successive tables, each with the first column."""
        first, *rest = widths
        block = {first: widths[first]}
        for i in rest:
            if len(block) > 1 and self._total({**block, i: widths[i]}, self._least_gap()) > room:
                yield block
                block = {first: widths[first]}
            block[i] = widths[i]
        yield block

    def _rows(self, widths: dict[int, int], gap: int, dropped: list[int]) -> Iterator[RenderableType]:
        """Yield the rows of some columns; too wide cells, and all of `dropped`, are in separate lines below."""
        columns = {i: self._cells(i) for i in [*widths, *dropped]}
        waiting: list[int] = []
        begun = False
        titles = [title for title in map(self._title, dropped) if title]
        if titles:
            yield self._part(widths, gap + 1, [], boxed=False)
            yield from (Padding(Text(title, style="dim"), (0, 0, 0, _INDENT)) for title in titles)
            yield Text("─" * self._total(widths, gap))
            begun = True
        for number, row in enumerate(self.rows):
            out = [
                i
                for i, width in widths.items()
                if _width(columns[i][number]) > width
                and not (self._is_prose(i) and _longest_word(columns[i][number]) <= width)
            ]
            below = [i for i in sorted([*out, *dropped]) if i and columns[i][number].plain]
            waiting.append(number)
            if not below and not out:
                continue
            if 0 in out:  # above its row
                waiting.pop()
                if waiting or not begun:
                    yield self._part(widths, gap, waiting, head=not begun)
                yield columns[0][number]
                waiting, begun = [number], True
            yield self._part(widths, gap, waiting, head=not begun, blank=(number, out))
            waiting, begun = [], True
            yield from self._lines(number, below)
            if row.end_section and number + 1 < len(self.rows):
                yield Text("─" * self._total(widths, gap))
        if waiting or not begun:
            yield self._part(widths, gap, waiting, head=not begun)

    def _lines(self, number: int, columns: list[int]) -> Iterator[RenderableType]:
        """Yield cells of a row in separate lines; several have their titles."""
        for i in columns:
            alone = len(columns) == 1 and i == len(self.columns) - 1
            label = f"{self._title(i)}: " if self._title(i) and not alone else ""
            yield Padding(Text.assemble((label, "dim"), self._cells(i)[number]), (0, 0, 0, _INDENT))

    def _one_by_one(self) -> Iterator[RenderableType]:
        """Yield every cell in a separate line."""
        for number in range(len(self.rows)):
            yield self._cells(0)[number]
            yield from self._lines(number, [i for i in range(1, len(self.columns)) if self._cells(i)[number]])

    def _part(
        self,
        widths: dict[int, int],
        gap: int,
        rows: Iterable[int],
        *,
        head: bool = True,
        boxed: bool = True,
        blank: tuple[int, list[int]] = (-1, []),
    ) -> Table:
        """Return some rows of some columns as a table, with the cells of one row left out."""
        part = Table(
            box=self.box if boxed else None,
            pad_edge=False,
            show_edge=False,
            show_header=self.show_header and head,
            header_style=self.header_style,
            padding=(0, gap, 0, 0),
        )
        columns = {i: self._cells(i) for i in widths}
        for i, width in widths.items():
            own = self.columns[i]
            part.add_column(own.header, justify=own.justify, width=width, overflow="fold")
        for number in rows:
            shown = [Text() if number == blank[0] and i in blank[1] else columns[i][number] for i in widths]
            part.add_row(*shown, end_section=self.rows[number].end_section)
        return part


def _text(cell: RenderableType) -> Text:
    """Return a cell, or a title, as text."""
    return cell if isinstance(cell, Text) else Text(str(cell))


def _longest_word(text: Text) -> int:
    """Return the width of the longest word."""
    return max((_width(Text(word)) for word in text.plain.split()), default=0)


def _width(text: Text) -> int:
    """Return the length of the longest line of a cell."""
    return max((line.cell_len for line in text.split("\n", allow_blank=True)), default=0)
