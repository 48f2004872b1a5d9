"""The one style of all pictures: fonts, line widths and colours.

Colours are of the palette of Okabe and Ito, which people with any colour vision distinguish. Pictures have a white
ground, so that they look the same on light and on dark pages.
"""

from __future__ import annotations

import os
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from gyrowheel_core import cache

BLUE, VERMILION, GREEN = "#0072B2", "#D55E00", "#009E73"
ORANGE, SKY, PINK = "#E69F00", "#56B4E9", "#CC79A7"
#: From dark to light: text, marks, ticks, remarks, frames, noise, lines of zero, grid, shaded stretches.
INK, DARK, TICK, SOFT, FRAME, NOISE, ZERO, FAINT, SHADE = (
    "#222222", "#444444", "#555555", "#777777", "#888888", "#9A9A9A", "#BBBBBB", "#E4E4E4", "#F4F4F4",
)  # fmt: skip
GROUND = "#FFFFFF"
#: The model before and after a change.
BEFORE, AFTER = VERMILION, BLUE


_VARIABLE = "MPLCONFIGDIR"


def _keep_settings() -> None:
    """Have matplotlib use our cache where it may not write to the user's settings: else it warns and is slow."""
    usual = cache.user_folder("config") / "matplotlib"
    there = next((folder for folder in (usual, *usual.parents) if folder.exists()), Path("/"))
    place = cache.folder()
    if _VARIABLE not in os.environ and place is not None and not os.access(there, os.W_OK):
        os.environ[_VARIABLE] = str(place / "matplotlib")


_keep_settings()


def style(
    size: float = 11.0, *, title: float | None = None, framed: bool = False
) -> AbstractContextManager[None]:
    """Return a context in which matplotlib draws in the style of the project; outside nothing is changed.

    Parameters
    ----------
    size : float
        Size of the letters [points].
    title : float, optional
        Size of the letters of the titles of panels; one more than `size` if not given.
    framed : bool
        Whether panels have a frame all round, not at the left and below alone.
    """
    import matplotlib as mpl

    settings: Any = {  # typed by matplotlib key by key
        "font.family": "sans-serif",
        "font.size": size,
        "axes.edgecolor": FRAME,
        "axes.labelcolor": INK,
        "axes.linewidth": 0.8,
        "axes.spines.top": framed,
        "axes.spines.right": framed,
        "text.color": INK,
        "xtick.color": TICK,
        "ytick.color": TICK,
        "axes.titlesize": size + 1.0 if title is None else title,
        "axes.titleweight": "bold",
        "axes.titlelocation": "left",
        "legend.frameon": False,
        "svg.fonttype": "none",  # text stays text: smaller files, the same on every machine
        "svg.hashsalt": "gyrowheel",
    }
    return mpl.rc_context(settings)
