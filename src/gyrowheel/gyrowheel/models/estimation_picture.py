"""Pictures of a fit: correlation matrix, profile of a parameter, contours of two."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gyrowheel.models.page import estimate_of, unit_of
from gyrowheel.show.figure import AFTER, BEFORE, DARK, GROUND, SOFT, Picture, finished, style
from gyrowheel_core.quantities import decimal

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gyrowheel_analysis.estimation.result import Estimation, Parameter

_NAMED = 0.5  # correlation from which on it is written
_LEVELS = (0.683, 0.95)


def correlation_figure(fit: Estimation) -> Figure:
    """Return the correlation matrix of the free parameters."""
    names, values = fit.names, fit.correlation.values
    count = len(names)
    with style(9.0):
        side = 2.6 + 0.24 * count
        figure = Picture(side + 1.2, side, layout="compressed")
        axes = figure.subplots()
        image = axes.imshow(values, vmin=-1.0, vmax=1.0, cmap="RdBu_r")
        for i, k in np.argwhere(np.abs(values) >= _NAMED):
            if i != k:  # in grey both signs are dark
                number = decimal(float(values[i, k]), 2).replace("0.", ".")
                axes.text(k, i, number, fontsize=6.5, color=GROUND, ha="center", va="center")
        axes.set_xticks(range(count), names, rotation=90)
        axes.set_yticks(range(count), names)
        axes.set_title("Correlation of the estimates")
        figure.colorbar(image, ax=axes, shrink=0.8, label="correlation")
        return finished(figure)


def profile_figure(fit: Estimation, name: str) -> Figure:
    """Return the profile of a parameter with its 95 % interval and the parabola of its standard error."""
    values, rise = fit.profile(name)
    own = fit.parameters[name]
    unit = unit_of(own)
    low, high = fit.interval(name)
    with style(10.0):
        figure = Picture(6.4, 4.2, layout="constrained")
        axes = figure.subplots()
        axes.axvspan(low / unit.size, high / unit.size, color=AFTER, alpha=0.12, lw=0, label="95 % interval")
        axes.plot(
            values / unit.size,
            ((values - own.value) / own.standard_error) ** 2,
            "--",
            color=SOFT,
            label="by the standard error",
        )
        axes.plot(values / unit.size, rise, color=AFTER, lw=2.0, label="profile")
        if own.prior is not None:
            drawn = np.linspace(values[0], values[-1], 101)
            pull = ((drawn - own.prior.mean) / own.prior.deviation) ** 2
            axes.plot(drawn / unit.size, pull, ":", color=BEFORE, label="prior")
        axes.axhline(3.84, color=DARK, lw=0.8)
        axes.set_ylim(0.0, max(10.0, float(rise.max())))
        axes.set_xlabel(_label(own))
        axes.set_ylabel("rise of χ²")
        axes.set_title(f"{name} = {estimate_of(own)}")
        axes.legend(loc="upper center", fontsize=8)
        return finished(figure)


def contour_figure(fit: Estimation, first: str, second: str) -> Figure:
    """Return the regions of two parameters, by the profile and by the covariance."""
    one, two = fit.parameters[first], fit.parameters[second]
    across, up = unit_of(one).size, unit_of(two).size
    pair = [fit.names.index(first), fit.names.index(second)]
    root = np.linalg.cholesky(fit.covariance.values[np.ix_(pair, pair)])
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    with style(10.0):
        figure = Picture(6.0, 5.2, layout="constrained")
        axes = figure.subplots()
        for level, width in zip(_LEVELS, (2.0, 1.2), strict=True):
            x, y = fit.contour(first, second, level)
            x, y = x / across, y / up
            axes.plot([*x, x[0]], [*y, y[0]], color=AFTER, lw=width, label=f"{100.0 * level:.0f} %")
            size = np.sqrt(-2.0 * np.log(1.0 - level))
            ellipse = size * root @ [np.cos(turn), np.sin(turn)]
            axes.plot(
                (one.value + ellipse[0]) / across, (two.value + ellipse[1]) / up, "--", color=SOFT, lw=0.9
            )
        axes.plot(one.value / across, two.value / up, "+", color=DARK, ms=9)
        axes.set_xlabel(_label(one))
        axes.set_ylabel(_label(two))
        axes.set_title("Regions of confidence (dashed: by the covariance)")
        axes.legend(fontsize=8)
        return finished(figure)


def _label(own: Parameter) -> str:
    unit = unit_of(own).label
    return f"{own.name}, {unit}" if unit else own.name
