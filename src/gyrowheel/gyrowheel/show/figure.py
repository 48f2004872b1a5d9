"""The figure that every picture is drawn on, the one style of all pictures, and how a figure becomes a file.

Colours are of the palette of Okabe and Ito, which people with any colour vision distinguish. Pictures have a white
ground, so that they look the same on light and on dark pages.
"""

from __future__ import annotations

import functools
import io
import os
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ParamSpec

from numpy.typing import ArrayLike

from gyrowheel_core import cache
from gyrowheel_core.errors import InputError, visible
from gyrowheel_core.files import new_file
from gyrowheel_core.surroundings import ignored_here
from gyrowheel_core.units import DEG, RPM

P = ParamSpec("P")

BLUE, VERMILION, GREEN = "#0072B2", "#D55E00", "#009E73"
ORANGE, SKY, PINK = "#E69F00", "#56B4E9", "#CC79A7"
#: From dark to light: text, marks, ticks, remarks, frames, noise, lines of zero, grid, shaded stretches.
INK, DARK, TICK, SOFT, FRAME, NOISE, ZERO, FAINT, SHADE = (
    "#222222", "#444444", "#555555", "#777777", "#888888", "#9A9A9A", "#BBBBBB", "#E4E4E4", "#F4F4F4",
)  # fmt: skip
GROUND = "#FFFFFF"
#: The model before and after a change.
BEFORE, AFTER = VERMILION, BLUE

#: Signals of a recording that are drawn: title of the panel with unit, size of the unit, columns with their labels.
PANELS: tuple[tuple[str, float, Mapping[str, str]], ...] = (
    ("tilt, °", DEG, {"tilt_x": "about x", "tilt_y": "about y"}),
    ("spin rate, rpm", RPM, {"spin_rate": "spin rate"}),
    ("coil voltage, V", 1.0, {"coil_voltage_x": "coil x", "coil_voltage_y": "coil y"}),
    ("motor voltage, V", 1.0, {"motor_voltage": "motor"}),
    ("motor current, A", 1.0, {"motor_current": "motor"}),
)


def columns() -> Iterator[tuple[str, float]]:
    """Yield the columns of `PANELS` with the sizes of their units."""
    for _, size, names in PANELS:
        for name in names:
            yield name, size


_VARIABLE = "MPLCONFIGDIR"


def _keep_settings() -> None:
    """Have matplotlib use our cache where it may not write to the user's settings: else it warns and is slow."""
    usual = cache.user_folder("config") / "matplotlib"
    there = next((folder for folder in (usual, *usual.parents) if folder.exists()), Path("/"))
    place = cache.folder()
    if _VARIABLE not in os.environ and place is not None and not os.access(there, os.W_OK):
        os.environ[_VARIABLE] = str(place / "matplotlib")


_keep_settings()

with ignored_here("matplotlibrc"):
    import matplotlib as mpl
from matplotlib.figure import Figure  # noqa: E402, its import looks for the settings
from matplotlib.text import Text  # noqa: E402

#: What matplotlib has where nobody has set anything else: pictures do not depend on settings of the user.
_PLAIN: Any = {
    name: value for name, value in mpl.rcParamsDefault.items() if not name.startswith(("backend", "inter"))
} | {"text.parse_math": False}  # names of users are no formulas


_EDGE = 0.1  # inches around what a layout arranges


class Picture(Figure):
    """A figure on a white ground, of a width and a height [inches], that a notebook shows; made without pyplot."""

    def __init__(self, width: float, height: float, *, dots: int = 100, **settings: Any) -> None:
        super().__init__(figsize=(width, height), dpi=dots, facecolor=GROUND, **settings)
        if (engine := self.get_layout_engine()) is not None:
            engine.set(w_pad=_EDGE, h_pad=_EDGE)  # type: ignore[call-arg]  # no letter touches an edge

    def _repr_png_(self) -> bytes:
        return png_bytes(self)


def style(
    size: float = 11.0, *, title: float | None = None, framed: bool = False
) -> AbstractContextManager[None]:
    """Return a context in which matplotlib draws in the style of the project; outside nothing is changed.

    `size` is that of the letters [points], `title` that of the titles of panels, one more if not given. With `framed`
    panels have a frame on all sides, not only left and below.
    """
    settings: Any = _PLAIN | {  # typed by matplotlib key by key
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


def finished(figure: Figure) -> Figure:
    """Return a figure with everything made that matplotlib makes at the first drawing, in the style in force now."""
    for text in figure.findobj(Text):
        if (shown := visible(text.get_text())) != text.get_text():  # no file has such characters
            text.set_text(shown)
    figure.draw_without_rendering()
    return figure


def drawn(
    size: float = 11.0, *, title: float | None = None, framed: bool = False
) -> Callable[[Callable[P, Figure]], Callable[P, Figure]]:
    """Return a decorator of functions that draw a figure: they draw and finish it in `style`."""

    def decorate(draw: Callable[P, Figure]) -> Callable[P, Figure]:
        @functools.wraps(draw)
        def in_style(*args: P.args, **named: P.kwargs) -> Figure:
            with style(size, title=title, framed=framed):
                return finished(draw(*args, **named))

        return in_style

    return decorate


def png_bytes(figure: Figure, description: str = "") -> bytes:
    """Return a figure as PNG; a description goes into its metadata."""
    stream = io.BytesIO()
    metadata = {"Description": description} if description else None
    with mpl.rc_context(_PLAIN):
        figure.savefig(stream, format="png", dpi=figure.dpi, metadata=metadata)
    return stream.getvalue()


def svg_bytes(figure: Figure) -> bytes:
    """Return a figure as SVG, in which letters are outlines: the same on every machine."""
    stream = io.BytesIO()
    with mpl.rc_context(_PLAIN | {"svg.fonttype": "path", "svg.hashsalt": "gyrowheel"}):
        figure.savefig(stream, format="svg", metadata={"Date": None})
    return stream.getvalue()


def pdf_bytes(figure: Figure) -> bytes:
    """Return a figure as PDF, with its letters as fonts, which can be searched."""
    stream = io.BytesIO()
    with mpl.rc_context(_PLAIN | {"pdf.fonttype": 42}):
        figure.savefig(stream, format="pdf", metadata={"CreationDate": None})
    return stream.getvalue()


_FORMATS: Mapping[str, Callable[[Figure], bytes]] = {".png": png_bytes, ".svg": svg_bytes, ".pdf": pdf_bytes}


def write_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure with its folders, atomically, in the format of the ending of its name.

    InputError if the file cannot be written, or its name has another ending.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _FORMATS:
        raise InputError(f"{path}: '{suffix}' is no format of pictures; allowed: {', '.join(_FORMATS)}")
    content = _FORMATS[suffix](figure)
    with new_file(Path(path)) as place:
        place.write_bytes(content)


def headline(figure: Figure, title: str, text: str) -> None:
    """Write title and remark over a figure."""
    height = figure.get_figheight()
    figure.text(0.012, 1.0 - 0.32 / height, title, fontsize=15, fontweight="bold", va="center")
    figure.text(0.012, 1.0 - 0.64 / height, text, fontsize=10, color=TICK, va="center")


def add_grid(axes: Any, axis: str = "both") -> None:
    """Draw a faint grid below the data, of both axes or of one."""
    axes.grid(axis=axis, color=FAINT, linewidth=0.8)
    axes.set_axisbelow(True)


_EM = 0.567  # mean width of a bold letter over its size
_TITLES = ((22.0, 1), (17.0, 2), (14.0, 2))  # sizes [points] and the most lines of each


def letters_in(width: float, size: float) -> int:
    """Return how many letters of a size [points] a line of a width [inches] holds."""
    return int(72.0 * width / (_EM * size))


def add_title(figure: Figure, title: str) -> None:
    """Write the title of a figure of 16 by 10 inches, the longer, the smaller; what two lines do not hold is cut."""

    def lines(size: float, most: int) -> list[str]:
        return textwrap.wrap(title, letters_in(14.56, size), max_lines=most, placeholder=" …")

    size, most = next((own for own in _TITLES if lines(*own) == lines(own[0], len(title))), _TITLES[-1])
    figure.text(0.045, 0.96, "\n".join(lines(size, most)), fontsize=size, fontweight="bold", va="center")


def keep_apart(texts: Sequence[Text]) -> None:
    """Hide each of some labels, from left to right, that would lie on the one before."""
    end = float("-inf")
    for text in texts:
        place = text.get_window_extent()
        text.set_visible(place.x0 > end + 0.4 * place.height)
        end = max(end, place.x1) if text.get_visible() else end


def shared_legend(figure: Figure, axes: Any, **settings: Any) -> None:
    """Add a legend with the entries of some panels, each label once."""
    found: dict[str, Any] = {}
    for panel in axes:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    figure.legend(found.values(), found.keys(), **settings)


@dataclass(frozen=True)
class Curve:
    """One curve."""

    label: str  # in the legend; empty for none
    x: ArrayLike  # points, in the units of the labels
    y: ArrayLike
    colour: str
    error: ArrayLike | None = None  # bars, to both sides
    line: str = "-"  # as matplotlib has it, like `marker`
    marker: str = ""


@dataclass(frozen=True)
class Panel:
    """One panel: its title, what its axes show with units, and its curves."""

    title: str
    x: str
    y: str
    curves: Sequence[Curve]


@drawn()
def curves_figure(title: str, remark: str, panels: Sequence[Panel]) -> Figure:
    """Draw one to three panels side by side, with a headline, a line below it, and the legend above the panels."""
    figure = Picture(12.0 if len(panels) > 1 else 9.0, 4.8, dots=110)
    left = 0.07 if len(panels) > 1 else 0.1
    grid = figure.add_gridspec(1, len(panels), left=left, right=0.98, top=0.70, bottom=0.13, wspace=0.26)
    for place, panel in enumerate(panels):
        axes = figure.add_subplot(grid[0, place])
        axes.axhline(0.0, color=ZERO, linewidth=0.8, zorder=1)
        for curve in panel.curves:
            axes.errorbar(
                curve.x,
                curve.y,
                curve.error,
                color=curve.colour,
                linestyle=curve.line or "none",
                marker=curve.marker or None,
                markersize=5.5,
                linewidth=1.7,
                capsize=3 if curve.error is not None else 0,
                label=curve.label or None,
            )
        axes.set_title(panel.title)
        axes.set_xlabel(panel.x)
        axes.set_ylabel(panel.y)
        add_grid(axes, "y")
    headline(figure, title, remark)
    shared_legend(
        figure,
        figure.axes,
        loc="upper left",
        ncols=5,
        fontsize=10,
        bbox_to_anchor=(0.005, 1.0 - 0.74 / figure.get_figheight()),
        columnspacing=1.4,
    )
    return figure
