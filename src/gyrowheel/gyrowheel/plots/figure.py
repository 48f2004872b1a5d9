"""The figure that every picture is drawn on."""

from __future__ import annotations

import io

from matplotlib.figure import Figure


class Picture(Figure):
    """A matplotlib figure that a notebook shows as it is, without pyplot and without any setting of matplotlib."""

    def _repr_png_(self) -> bytes:
        stream = io.BytesIO()
        self.savefig(stream, format="png", dpi=self.dpi)
        return stream.getvalue()


def finished(figure: Figure) -> Figure:
    """Return a figure with everything made that matplotlib makes at the first drawing, in the style in force now."""
    figure.draw_without_rendering()
    return figure
