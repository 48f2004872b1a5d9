"""Where the letters of a picture are: none leaves it, and no two lie on each other."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

_TOUCH = 2.0  # dots that two boxes share before their letters do


def _hidden(figure: Figure) -> set[int]:
    """Return the labels of ticks that lie outside of their axes."""
    found = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            shown = set(map(id, axis._update_ticks()))  # type: ignore[union-attr]
            for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]:
                if id(tick) not in shown:
                    found |= {id(tick.label1), id(tick.label2)}
    return found


def _texts(artist: Any) -> Iterator[Text]:
    if not artist.get_visible() or hasattr(artist, "zaxis"):  # what is in space has no place in the plane
        return
    if isinstance(artist, Text) and artist.get_text().strip():
        yield artist
    for child in artist.get_children():
        yield from _texts(child)


def check_letters(figure: Figure) -> None:
    """Check that all letters of a picture lie within it, and those that run across do not lie on each other."""
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    hidden = _hidden(figure)
    shown = [(text, text.get_window_extent(renderer)) for text in _texts(figure) if id(text) not in hidden]
    assert shown
    outside = [
        text.get_text()
        for text, box in shown
        if min(box.x0, box.y0) < 0.0 or box.x1 > figure.bbox.x1 or box.y1 > figure.bbox.y1
    ]
    assert not outside
    level = [(text.get_text(), box) for text, box in shown if text.get_rotation() % 90.0 == 0.0]
    overlapping = [
        (one, two)
        for (one, a), (two, b) in itertools.combinations(level, 2)
        if min(a.x1, b.x1) - max(a.x0, b.x0) > _TOUCH and min(a.y1, b.y1) - max(a.y0, b.y0) > 2.0 * _TOUCH
    ]
    assert not overlapping
