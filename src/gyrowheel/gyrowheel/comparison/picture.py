"""One picture of where a model fails: the residual in the plane of the tilt, and how bad it is over every variable."""

from __future__ import annotations

import math
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel.show.figure import DARK, FAINT, GROUND, SOFT, TICK, Picture, add_title, drawn
from gyrowheel.show.sentences.residuals import TITLES
from gyrowheel_analysis.channels import CHANNELS, COILS
from gyrowheel_analysis.compare import Comparison
from gyrowheel_analysis.reduction.windows import speed_groups
from gyrowheel_analysis.residuals.error_table import WindowResiduals
from gyrowheel_analysis.residuals.maps import VARIABLES, Cell, ResidualMap, Span, residual_map
from gyrowheel_core.quantities import decimal, number
from gyrowheel_core.units import DEG, RPM, unit_for

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_SPEEDS = 4
_LONG, _SHORT = 0.55, 0.12  # of the largest tilt: the longest arrow, and that of noise
_MOST_ARROWS = 0.9  # of the arrows: those that the scale leaves uncut
_WRONG = 9.0  # χ²/N from which on a window is not noise alone
_WORST = 1.0e3  # χ²/N at the end of the colours
_CELL = 12.0  # letters of the cells [points], which can be read on a page of paper, too
_UNITS = {"tilt": "°", "azimuth": "°", "speed": "rpm", "time": "s", "temperature": "°C"}


@drawn(framed=True)
def figure_of_failure(result: Comparison) -> Figure:
    """Draw where a model fails, 1600 by 1000 dots.

    Above, for every speed, the tilts that were held, with the residual torque of the coils as an arrow; below, χ²/N of
    every part of the residual over each variable.
    """
    from matplotlib.colors import LogNorm

    data = result.data
    title = f"Where the model fails: {', '.join(Path(name).name for name in result.recordings)}"
    figure = Picture(16.0, 10.0)
    add_title(figure, title)
    figure.text(
        0.045,
        0.915,
        "Arrows: residual torque of the coils, from the tilt at which it acts. Colours: χ²/N (1: noise)."
        + (" Crosses: windows far noisier than the others." if data.parts[COILS].noisy.any() else "")
        if COILS in data.parts
        else "Colours: χ²/N of all that was measured (1: noise). No arrows: they need both coil voltages.",
        fontsize=12.5,
        color=SOFT,
        va="center",
    )
    norm = LogNorm(vmin=1.0, vmax=_WORST)
    groups = _chosen(speed_groups(data.windows.mean_spin), data)
    above = figure.add_gridspec(1, len(groups), left=0.06, right=0.975, top=0.84, bottom=0.46, wspace=0.18)
    scale = arrow_scale(data) if COILS in data.parts else None
    for place, group in enumerate(groups):
        _plane(figure.add_subplot(above[0, place]), data, group, scale, norm, first=place == 0)
    maps = [residual_map(data, (name,)) for name in VARIABLES]
    widths = [max(len(m.cells), 3) for m in maps]
    below = figure.add_gridspec(
        1, len(maps), left=0.115, right=0.915, top=0.345, bottom=0.085, wspace=0.06, width_ratios=widths
    )
    strips = [
        _strip(figure.add_subplot(below[0, place]), shown, data, norm, first=place == 0)
        for place, shown in enumerate(maps)
    ]
    bar = figure.colorbar(strips[0], cax=figure.add_axes((0.928, 0.085, 0.012, 0.26)), extend="both")
    bar.set_label("χ²/N")
    bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    return figure


def _chosen(groups: list[NDArray[np.int64]], data: WindowResiduals) -> list[NDArray[np.int64]]:
    """Return the speeds that are drawn, slowest first: those with most tilted windows where there are many."""
    tilted = np.abs(data.windows.mean_tilt) > 0.3 * DEG
    ranked = sorted(groups, key=lambda g: -int(tilted[g].sum()))[:_MOST_SPEEDS]
    return sorted(ranked, key=lambda g: float(data.windows.mean_spin[g].mean()))


def arrow_scale(data: WindowResiduals) -> float:
    """Return degrees an N m: the arrow that is longer than nine in ten beyond the noise spans most of the largest tilt.

    Windows whose residual is noise, or whose noise is an outlier, do not count, and the few largest do not set the
    scale: `arrows` cuts them off. Where all is noise, its arrows are short.
    """
    part = data.parts[COILS]
    size, wrong = np.abs(part.values), (part.chi2 / len(part.kind.rows) > _WRONG) & ~part.noisy
    usual = float(np.quantile(size[wrong] if wrong.any() else size, _MOST_ARROWS))
    return (_LONG if wrong.any() else _SHORT) * _reach(data) / usual if usual > 0.0 else 1.0


def arrows(data: WindowResiduals) -> NDArray[Any]:
    """Return the residual of the coils in every window as an arrow [deg], cut off at twice the usual longest one.

    Windows whose noise is an outlier have none.
    """
    part = data.parts[COILS]
    own = part.values * arrow_scale(data)
    most = longest_arrow(data)
    return np.where(part.noisy, 0.0, own * np.minimum(1.0, most / np.maximum(np.abs(own), 1e-300)))


def longest_arrow(data: WindowResiduals) -> float:
    """Return the length at which arrows are cut off [deg]."""
    return 2.0 * _LONG * _reach(data)


def _reach(data: WindowResiduals) -> float:
    """Return the largest tilt, of one degree at least [deg]."""
    return max(float(np.abs(data.windows.mean_tilt).max()) / DEG, 1.0)


def _plane(
    axes: Axes,
    data: WindowResiduals,
    group: NDArray[np.int64],
    scale: float | None,
    norm: Any,
    *,
    first: bool,
) -> None:
    """Draw the tilts of one speed, with the residual of the coils as arrows where there is a scale for them."""
    w = data.windows
    z = np.asarray(w.mean_tilt)[group] / DEG
    shown = list(data.parts.values()) if scale is None else [data.parts[COILS]]
    chi2 = np.sum([own.chi2[group] for own in shown], axis=0) / sum(len(own.kind.rows) for own in shown)
    reach = 1.75 * _reach(data)
    for radius in range(2, math.ceil(reach), 2):
        axes.add_patch(_circle(radius))
    axes.axhline(0.0, color=FAINT, linewidth=0.8, zorder=0)
    axes.axvline(0.0, color=FAINT, linewidth=0.8, zorder=0)
    noisy = data.parts[COILS].noisy[group] if scale is not None else np.zeros(len(group), dtype=bool)
    for own, marker, edge in ((~noisy, "o", TICK), (noisy, "X", DARK)):
        axes.scatter(
            z.real[own], z.imag[own], c=np.maximum(chi2[own], 1.0), norm=norm, cmap=_colours(), s=55,
            edgecolors=edge, linewidths=0.6, zorder=4, marker=marker,
        )  # fmt: skip
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    axes.set_xticks([tick for tick in axes.get_yticks() if abs(tick) <= reach])
    axes.set_aspect("equal")
    axes.set_title(f"{round(float(w.mean_spin[group].mean()) / RPM, -1):.0f} rpm", fontsize=13, loc="center")
    axes.set_xlabel("tilt about x, °")
    if first:
        axes.set_ylabel("tilt about y, °")
    if scale is not None:
        _arrows(axes, z[~noisy], arrows(data)[group][~noisy], scale, reach)


def _arrows(axes: Axes, z: Any, drawn: Any, scale: float, reach: float) -> None:
    """Draw arrows [deg] from tilts [deg], and how long one of a round torque is."""
    axes.quiver(
        z.real, z.imag, drawn.real, drawn.imag, angles="xy", scale_units="xy", scale=1.0, width=0.007,
        color=DARK, alpha=0.8, zorder=3,
    )  # fmt: skip
    length = _round_down(0.4 * reach / scale)
    name, unit = unit_for(length, "N·m")
    axes.plot([-0.92 * reach, -0.92 * reach + length * scale], [-0.9 * reach] * 2, color=DARK, linewidth=2.0)
    axes.text(-0.92 * reach, -0.86 * reach, f"{number(length / unit, 1)} {name}", fontsize=10, color=DARK)


def _circle(radius: float) -> Any:
    from matplotlib.patches import Circle

    return Circle((0.0, 0.0), radius, fill=False, edgecolor=FAINT, linewidth=0.8, zorder=0)


def _strip(axes: Axes, shown: ResidualMap, data: WindowResiduals, norm: Any, *, first: bool) -> Any:
    """Draw χ²/N of every part over one variable."""
    (variable,) = shown.over
    names = list(data.parts)
    values = np.array([[cell.chi2_per_n[name] for cell in shown.cells] for name in names])
    image = axes.imshow(np.maximum(values, 1e-3), norm=norm, cmap=_colours(), aspect="auto")
    for i, j in np.ndindex(*values.shape):
        dark = values[i, j] > math.sqrt(_WORST)
        if values.shape[1] <= 9:
            text = _in_a_cell(float(values[i, j]))
            axes.text(j, i, text, ha="center", va="center", fontsize=_CELL, color=GROUND if dark else DARK)
    axes.set_xticks(
        range(len(shown.cells)), [cell_label(variable, cell) for cell in shown.cells], fontsize=_CELL
    )
    if len(shown.cells) > 2 and max(len(cell_label(variable, cell)) for cell in shown.cells) > 3:
        axes.tick_params(axis="x", rotation=45)
    axes.set_yticks(range(len(names)), [CHANNELS[name].title for name in names] if first else [])
    axes.tick_params(axis="y", labelsize=_CELL)
    # the unit stays with the last word
    title = axis_title(variable).replace(", ", ",\N{NO-BREAK SPACE}")
    axes.set_title(textwrap.fill(title, 16), fontsize=_CELL, loc="center")
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
    return image


def _in_a_cell(value: float) -> str:
    """Return χ²/N in at most three characters: 0.7, 12, 538, 19k."""
    if value < 9.95:
        return f"{value:.1f}"
    size, letter = next((own for own in ((1e6, "M"), (1e3, "k")) if value >= 0.9995 * own[0]), (1.0, ""))
    return f"{value / size:.0f}{letter}"


def axis_title(variable: str) -> str:
    """Return the title of a variable, with the unit of `cell_label`."""
    return f"{TITLES[variable]}, {_UNITS[variable]}"


def cell_label(variable: str, cell: Cell) -> str:
    """Return the label of a cell of a map over one variable."""
    span: Span = cell.spans[variable]
    if math.isnan(span.low):
        return "none"
    if variable == "azimuth":
        return decimal(math.degrees(span.middle), 0)
    if variable == "speed":
        return f"{round(span.middle / RPM, -1):.0f}"
    middle = {"tilt": span.middle / DEG, "time": span.middle, "temperature": span.middle - 273.15}[variable]
    return f"{middle:.1f}" if variable == "tilt" else f"{middle:.0f}"


def _colours() -> Any:
    """Return the colours, from white for noise on."""
    from matplotlib import colormaps

    return colormaps["OrRd"].with_extremes(under=GROUND)


def _round_down(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above a value."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value * (1.0 + 1e-9))
