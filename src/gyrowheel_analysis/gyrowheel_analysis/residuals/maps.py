"""Where a residual is: maps over tilt, azimuth, speed, time and temperature, and regions with most of the misfit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.channels import COILS
from gyrowheel_analysis.reduction.windows import UPRIGHT, Windows, octants, speed_groups
from gyrowheel_analysis.residuals.error_table import Part, WindowResiduals, weighted_rms
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

#: Possible variables of a map.
VARIABLES = ("tilt", "azimuth", "speed", "time", "temperature")
#: Map that a comparison contains and shows by default.
DEFAULT = ("speed", "tilt")
_MOST = 8  # cells along a variable


@dataclass(frozen=True)
class Span:
    """The range of a cell along a variable.

    `low` and `high` are its smallest and largest value [rad, rad/s, s or K]; for an azimuth, -pi .. pi, the edges of
    the eighth of the circle; nan for upright windows, which have none.
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
        Its ranges, by variable.
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
        """Return the cell as a JSON object; a missing number becomes null."""
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
        Cells with windows, in the order of the variables.
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
    """Return a map of the residual over some of `VARIABLES`."""
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
        own = float(here.chi2.sum())
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
            half = math.pi / 8.0
            span = Span(middle - half, middle + half) if value >= 0 else Span(math.nan, math.nan)
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


_SHOWN = 5

#: Conditions that distinguish windows of one spin rate.
Condition = Literal["cone", "low_pressure", "warm_coils", "inverted"]
#: Form of a residual: an offset from the model; nothing but noise; in proportion to the tilt; constant;
#: neither of these; or of no single kind.
Form = Literal["offset", "noise", "tilt", "constant", "neither", "mixed"]


@dataclass(frozen=True)
class Look:
    """Form of a residual in some windows.

    Attributes
    ----------
    form : str
        Of `Form`.
    size : float
        Of an ``offset`` the mean residual without its sign, else its RMS, of a complex residual its modulus, weighted
        with the inverse variance of the noise [unit of the kind].
    noise : float
        The same of its noise [unit of the kind].
    value : complex
        Of an ``offset`` and of a ``constant`` the mean; of ``tilt`` the slope [unit of the kind per rad]; else 0.
    """

    form: Form
    size: float
    noise: float
    value: complex = 0.0


@dataclass(frozen=True)
class Region:
    """A part of the data and its share of the misfit.

    Attributes
    ----------
    part : str
        Which residual, see `channels.CHANNELS`.
    spin_rate : float
        Spin rate [rad/s].
    conditions : tuple of str
        Of `Condition`: further common properties of its windows.
    share_of_chi2 : float
        Its share of chi-squared.
    look : Look
        Form of the residual there.
    """

    part: str
    spin_rate: float
    conditions: tuple[Condition, ...]
    share_of_chi2: float
    look: Look


def regions(data: WindowResiduals, bench: Bench) -> list[Region]:
    """Return the few regions that carry most of the misfit, largest share first."""
    places = _places(data.windows, bench)
    tilt, total = np.asarray(data.windows.mean_tilt), data.chi2
    masks = {place: np.array([own == place for own in places]) for place in dict.fromkeys(places)}
    found = []
    for name, part in data.parts.items():
        for place, mask in masks.items():
            share = float(part.chi2[mask].sum()) / total if total else 0.0
            found.append((share, name, place, mask))
    found.sort(key=lambda item: -item[0])
    return [
        Region(name, tens * 10.0 * RPM, conditions, share, _look(data.parts[name].at(mask), tilt[mask]))
        for share, name, (tens, conditions), mask in found[:_SHOWN]
    ]


def _places(w: Windows, bench: Bench) -> list[tuple[int, tuple[Condition, ...]]]:
    """Return the spin rate of each window in tens of rpm, as its group has it, and its conditions."""
    tens = [0] * len(w)
    for group in speed_groups(w.mean_spin):
        speed = float(np.median(w.mean_spin[group])) / RPM
        for index in group:
            tens[index] = round(speed / 10)
    ambient, room = bench.value("air_pressure"), bench.value("air_temperature")
    places = []
    for index in range(len(w)):
        holds: dict[Condition, bool] = {
            "cone": abs(w.mean_tilt_rate[index]) > 0.5 * DEG,
            "low_pressure": w.air_pressure[index] < 0.8 * ambient,
            "warm_coils": w.coil_temperature[index] - room > 8.0,
            "inverted": w.up[index] < 0,
        }
        places.append((tens[index], tuple(name for name, true in holds.items() if true)))
    return places


def _look(part: Part, tilt: NDArray[Any]) -> Look:
    """Return the form of a residual in windows with these tilts."""
    kind, r = part.kind, part.values
    sigma = np.atleast_2d(part.sigma).repeat(len(kind.rows), axis=0)
    rms, noise = weighted_rms(r, part.sigma), weighted_rms(sigma, sigma)
    if not np.iscomplexobj(r):
        mean = part.mean.real
        if abs(mean) > 0.5 * rms:
            return Look("offset", abs(mean), noise, mean)
    if len(r) < 2 or float(np.abs(tilt).max()) < 0.5 * DEG:
        return Look("mixed", rms, noise)
    if rms < 1.5 * noise:
        return Look("noise", rms, noise)
    if not kind.rows[0].startswith("tilt"):
        return Look("mixed", rms, noise)
    power = float(np.mean(np.abs(r) ** 2))
    # a constant, and a part in proportion to the tilt (its mirror image where it comes twice a revolution)
    p = np.conj(tilt) if kind.rows[0].startswith("tilt_2n") else tilt
    design = np.column_stack([np.ones(len(p)), p])
    (constant, slope), *_ = np.linalg.lstsq(design, r, rcond=None)
    left = r - design @ np.array([constant, slope])
    if abs(slope) ** 2 * float(np.var(p)) > 0.5 * power:
        return Look("tilt", rms, noise, complex(slope))
    if abs(constant) ** 2 > 0.5 * power:
        return Look("constant", rms, noise, complex(constant))
    if float(np.mean(np.abs(left) ** 2)) > 0.5 * power:
        return Look("neither", rms, noise)
    return Look("mixed", rms, noise)
