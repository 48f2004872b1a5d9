"""Maps of the residual over tilt, azimuth, speed, time and temperature: what is left in every cell, and how sure."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.channels import COILS
from gyrowheel_analysis.reduction.windows import UPRIGHT, Windows, octants, speed_groups
from gyrowheel_analysis.residuals.windows import WindowResiduals
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG

Array = NDArray[np.float64]

#: Over what a map can be made.
VARIABLES = ("tilt", "azimuth", "speed", "time", "temperature")
#: Map that a comparison contains and shows by default.
DEFAULT = ("speed", "tilt")
_MOST = 8  # cells along a variable


@dataclass(frozen=True)
class Span:
    """Where a cell lies along a variable.

    Attributes
    ----------
    low, high : float
        Values in it [rad, rad/s, s or K]. An azimuth is that of the middle, -pi .. pi, and low and high are the edges
        of the eighth of the circle; nan for upright windows, which have none.
    """

    low: float
    high: float

    @property
    def middle(self) -> float:
        """The middle."""
        return 0.5 * (self.low + self.high)


@dataclass(frozen=True)
class Cell:
    """The residual in one cell of a map.

    Attributes
    ----------
    spans : dict of str to Span
        Where it lies, by variable.
    count : int
        Windows in it.
    mean : dict of str to float or complex
        Mean residual by part (`channels.CHANNELS`), weighted with the noise [unit of the part]: of the averages of the
        tilt x + i y in case axes.
    turned : complex or None
        Mean of the tilt's residual in axes that turn with the tilt: along it + i across it [N m]; None where nothing
        is tilted.
    chi2_per_n : dict of str to float
        Mean square of the residual in units of its noise, by part.
    share_of_chi2 : float
        Its share of the whole misfit.
    """

    spans: dict[str, Span]
    count: int
    mean: dict[str, complex]
    turned: complex | None
    chi2_per_n: dict[str, float]
    share_of_chi2: float

    def to_json(self) -> dict[str, Any]:
        """Return the cell as a JSON object; a number that there is not becomes null."""
        return {
            **{name: _span_json(span) for name, span in self.spans.items()},
            "count": self.count,
            "residual": {
                **{
                    name: [value.real, value.imag] if isinstance(value, complex) else value
                    for name, value in self.mean.items()
                },
                "along_tilt": None if self.turned is None else self.turned.real,
                "across_tilt": None if self.turned is None else self.turned.imag,
            },
            "chi2_per_n": self.chi2_per_n,
            "share_of_chi2": self.share_of_chi2,
        }


def _span_json(span: Span) -> list[float] | None:
    return None if math.isnan(span.low) else [span.low, span.high]


@dataclass(frozen=True)
class ResidualMap:
    """The residual over one variable or several.

    Attributes
    ----------
    over : tuple of str
        The variables.
    cells : list of Cell
        Those that have windows, in the order of the variables.
    """

    over: tuple[str, ...]
    cells: list[Cell]

    def along(self, variable: str) -> list[Span]:
        """Return the spans of one variable that occur, in order."""
        spans = {(s.low, s.high): s for s in (cell.spans[variable] for cell in self.cells) if s.low == s.low}
        upright = [c.spans[variable] for c in self.cells if math.isnan(c.spans[variable].low)]
        return upright[:1] + [spans[key] for key in sorted(spans)]


def variables_of(text: str) -> tuple[str, ...]:
    """Return the variables of a map as a user types them: ``speed,tilt``.

    Raises
    ------
    InputError
        If one is not known or given twice, or there are more than two.
    """
    names = tuple(part.strip() for part in text.split(","))
    for name in names:
        if name not in VARIABLES:
            raise InputError(f"map: '{name[:40]}' is not known; allowed: {', '.join(VARIABLES)}")
    if len(set(names)) < len(names) or len(names) > 2:
        raise InputError(f"map: '{text[:60]}'; one variable or two different ones are allowed")
    return names


def residual_map(data: WindowResiduals, over: Sequence[str] = DEFAULT) -> ResidualMap:
    """Return a map of the residual.

    Parameters
    ----------
    data : WindowResiduals
        The residuals.
    over : sequence of str
        Variables of `VARIABLES`.
    """
    w = data.windows
    bins = [_bins(name, w) for name in over]
    total = data.chi2
    cells = []
    for chosen in itertools.product(*(range(len(b)) for b in bins)):
        mask = np.ones(len(w), dtype=bool)
        for own, k in zip(bins, chosen, strict=True):
            mask &= own[k][1]
        if mask.any():
            spans = {name: own[k][0] for name, own, k in zip(over, bins, chosen, strict=True)}
            cells.append(_cell(data, spans, mask, total))
    return ResidualMap(tuple(over), cells)


def all_maps(data: WindowResiduals) -> list[ResidualMap]:
    """Return the map over every variable alone, and over those of `DEFAULT` together."""
    return [*(residual_map(data, (name,)) for name in VARIABLES), residual_map(data)]


def maps_json(maps: Sequence[ResidualMap]) -> dict[str, Any]:
    """Return maps as a JSON object: lists of cells by the names of the variables."""
    return {",".join(m.over): [cell.to_json() for cell in m.cells] for m in maps}


def _cell(data: WindowResiduals, spans: dict[str, Span], mask: NDArray[np.bool_], total: float) -> Cell:
    mean: dict[str, complex] = {}
    chi2, squares = {}, 0.0
    for name, part in data.parts.items():
        here = part.at(mask)
        mean[name] = here.mean
        own = float(here.squares.sum())
        squares += own
        chi2[name] = own / here.rows
    turned = None
    z = np.asarray(data.windows.mean_tilt)[mask]
    tilted = np.abs(z) >= UPRIGHT
    if tilted.any() and COILS in data.parts:
        tilt = data.parts[COILS].at(mask)
        weight = tilt.weight[tilted]
        along = tilt.values[tilted] * np.conj(z[tilted]) / np.abs(z[tilted])
        turned = complex(np.sum(weight * along) / np.sum(weight))
    return Cell(spans, int(mask.sum()), mean, turned, chi2, squares / total if total else 0.0)


def _bins(name: str, w: Windows) -> list[tuple[Span, NDArray[np.bool_]]]:
    """Return the cells along a variable, each with its windows."""
    if not len(w):
        return []
    if name == "azimuth":
        octant = octants(w.mean_tilt)
        result = []
        for value in np.unique(octant):
            # 0 lies about the x axis; people count -180 .. 180 degrees
            middle = (value if value <= 4 else value - 8) * math.pi / 4.0
            span = (
                Span(middle - math.pi / 8.0, middle + math.pi / 8.0)
                if value >= 0
                else Span(math.nan, math.nan)
            )
            result.append((span, octant == value))
        return sorted(result, key=lambda pair: -10.0 if math.isnan(pair[0].low) else pair[0].low)
    if name == "speed":
        groups = speed_groups(w.mean_spin)
        if len(groups) <= _MOST:
            return [_group(w.mean_spin, np.isin(np.arange(len(w)), group)) for group in groups]
        return _cut(w.mean_spin, np.ptp(w.mean_spin) / _MOST)
    values, gap = {
        "tilt": (np.abs(w.mean_tilt), 0.2 * DEG),
        "time": (w.middle, math.inf),
        "temperature": (w.coil_temperature, 3.0),
    }[name]
    if name == "time":
        return _cut(values, max(float(np.ptp(values)), 1e-9) / _MOST)
    order = np.argsort(values, kind="stable")
    edges = np.flatnonzero(np.diff(values[order]) > gap)
    if len(edges) + 1 > _MOST:
        return _cut(values, float(np.ptp(values)) / _MOST)
    if float(np.ptp(values)) > 3.0 * gap and not len(edges):
        return _cut(values, float(np.ptp(values)) / 5.0)
    parts = np.split(order, edges + 1)
    return [_group(values, np.isin(np.arange(len(w)), part)) for part in parts]


def _group(values: Array, mask: NDArray[np.bool_]) -> tuple[Span, NDArray[np.bool_]]:
    return Span(float(values[mask].min()), float(values[mask].max())), mask


def _cut(values: Array, width: float) -> list[tuple[Span, NDArray[np.bool_]]]:
    """Return cells of one width from the smallest value on; empty ones are left out."""
    place = np.minimum(
        ((values - values.min()) / width).astype(int), round(float(np.ptp(values)) / width) - 1
    )
    return [_group(values, place == k) for k in np.unique(place)]
