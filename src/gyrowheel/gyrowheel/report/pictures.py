"""Pictures of a report: vector graphics within the page, their letters drawn, so that they look the same everywhere."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gyrowheel.show.figure import png_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LARGEST = 600_000  # of a picture as vectors [bytes]; a larger one is stored dot by dot


@dataclass(frozen=True)
class Picture:
    """A picture in a page.

    Attributes
    ----------
    source : str
        Its bytes as an address.
    title : str
        What it shows, for people who do not see it.
    """

    source: str
    title: str


def picture(draw: Callable[[], Figure], title: str) -> Picture:
    """Return what a function draws, as a picture of a page."""
    import matplotlib as mpl

    figure = draw()
    stream = io.BytesIO()
    with mpl.rc_context({"svg.fonttype": "path", "svg.hashsalt": "gyrowheel"}):
        figure.savefig(stream, format="svg", metadata={"Date": None})
    kind, content = "svg+xml", stream.getvalue()
    if len(content) > _LARGEST:
        kind, content = "png", png_bytes(figure)
    return Picture(f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}", title)
