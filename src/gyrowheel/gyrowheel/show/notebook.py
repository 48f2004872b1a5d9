"""Pages of the terminal as HTML for a notebook: the same words and tables, readable on light and on dark ground."""

from __future__ import annotations

import html as escaping
import itertools
from collections.abc import Iterable

from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.panel import Panel
from rich.style import Style
from rich.table import Column, Table
from rich.text import Text

#: Shades that are legible on white and on black.
_COLOURS = {
    "red": "#d9483b",
    "green": "#2e9e4f",
    "yellow": "#b8860b",
    "blue": "#3b82d9",
    "magenta": "#b455b4",
    "cyan": "#1f93ad",
}
_LINE = "1px solid rgba(128,128,128,0.4)"
_PAGE = "font-family:system-ui,sans-serif;font-size:0.95em;line-height:1.45;max-width:70em"
_CELL = "padding:0.15em 0.7em;vertical-align:top;background:transparent"


def html(parts: Iterable[RenderableType]) -> str:
    """Return texts, tables, panels, groups and padded parts as one block of HTML; TypeError for any other part."""
    body = "".join(_block(part) for part in parts)
    return f'<div class="gyrowheel" style="{_PAGE}">{body}</div>'


def _block(part: RenderableType) -> str:
    if isinstance(part, Padding):
        return _block(part.renderable)
    if isinstance(part, Group):
        return "".join(_block(item) for item in part.renderables)
    if isinstance(part, Panel):
        edge = _css(part.border_style).removeprefix("color:") or "currentColor"
        inner = _block(part.renderable)
        style = f"border-left:0.25em solid {edge};padding:0.3em 0.8em;margin:0.5em 0;display:table"
        return f'<div style="{style}">{inner}</div>'
    if isinstance(part, Table):
        return _table(part)
    if isinstance(part, str | Text):
        return f"<div>{_line(part)}</div>" if str(part).strip() else ""
    raise TypeError(f"{type(part).__name__} cannot be shown in a notebook")


def _line(part: RenderableType) -> str:
    """Return a text with its styles; a part of another kind as a block."""
    if isinstance(part, str):
        return _escaped(part.strip("\n"))
    if not isinstance(part, Text):
        return _block(part)
    plain = part.plain
    first = len(plain) - len(plain.lstrip("\n"))
    last = len(plain.rstrip("\n"))
    edges = sorted({first, last, *(e for s in part.spans for e in (s.start, s.end) if first < e < last)})
    pieces = []
    for start, end in itertools.pairwise(edges):
        styles = [part.style, *(s.style for s in part.spans if s.start <= start and end <= s.end)]
        css = ";".join(filter(None, (_css(style) for style in styles)))
        text = _escaped(plain[start:end])
        pieces.append(f'<span style="{css}">{text}</span>' if css else text)
    return "".join(pieces)


def _css(style: str | Style) -> str:
    given = Style.parse(style) if isinstance(style, str) else style
    rules = []
    if given.color is not None and given.color.name in _COLOURS:
        rules.append(f"color:{_COLOURS[given.color.name]}")
    if given.bold:
        rules.append("font-weight:600")
    if given.dim:
        rules.append("opacity:0.7")
    return ";".join(rules)


def _table(table: Table) -> str:
    rows = list(zip(*(list(column.cells) for column in table.columns), strict=True))
    head = ""
    if table.show_header:
        cells = "".join(_cell("th", column, column.header) for column in table.columns)
        head = f'<thead><tr style="border-bottom:{_LINE};opacity:0.7">{cells}</tr></thead>'
    body = "".join(
        '<tr style="background:transparent">'
        + "".join(_cell("td", column, cell) for column, cell in zip(table.columns, row, strict=True))
        + "</tr>"
        for row in rows
    )
    style = "border-collapse:collapse;border:none;margin:0.3em 0"
    return f'<table style="{style}">{head}<tbody>{body}</tbody></table>'


def _cell(tag: str, column: Column, content: RenderableType) -> str:
    align = "right" if column.justify == "right" else "left"
    wrap = ";white-space:nowrap" if column.no_wrap else ""
    return f'<{tag} style="{_CELL};text-align:{align}{wrap}">{_line(content)}</{tag}>'


def _escaped(text: str) -> str:
    return escaping.escape(text).replace("\n", "<br>")
