"""The figure that every picture is drawn on, and how it becomes a file."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from gyrowheel.show.style import GROUND, TICK  # first: it sets where matplotlib keeps its settings

# isort: split
from matplotlib.figure import Figure

from gyrowheel_core.files import new_file


class Picture(Figure):
    """A matplotlib figure on a white ground that a notebook shows as it is; made without pyplot.

    Parameters
    ----------
    width, height : float
        Size [inches].
    dots : int
        Dots an inch.
    **settings
        Further arguments of `matplotlib.figure.Figure`.
    """

    def __init__(self, width: float, height: float, *, dots: int = 100, **settings: Any) -> None:
        super().__init__(figsize=(width, height), dpi=dots, facecolor=GROUND, **settings)

    def _repr_png_(self) -> bytes:
        return png_bytes(self)


def finished(figure: Figure) -> Figure:
    """Return a figure with everything made that matplotlib makes at the first drawing, in the style in force now."""
    figure.draw_without_rendering()
    return figure


def png_bytes(figure: Figure, description: str = "") -> bytes:
    """Return a figure as PNG; a description goes into its metadata."""
    stream = io.BytesIO()
    metadata = {"Description": description} if description else None
    figure.savefig(stream, format="png", dpi=figure.dpi, metadata=metadata)
    return stream.getvalue()


def write_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, folders and all; the file is whole or as it was before.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    content = png_bytes(figure)
    with new_file(Path(path)) as place:
        place.write_bytes(content)


def headline(figure: Figure, title: str, text: str) -> None:
    """Write title and remark over a figure."""
    height = figure.get_figheight()
    figure.text(0.012, 1.0 - 0.32 / height, title, fontsize=15, fontweight="bold", va="center")
    figure.text(0.012, 1.0 - 0.64 / height, text, fontsize=10, color=TICK, va="center")
