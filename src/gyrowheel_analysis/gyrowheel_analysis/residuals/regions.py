"""The regions of the data that carry most of the misfit, and what the residual looks like there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.reduction.windows import Windows, speed_groups
from gyrowheel_analysis.residuals.windows import Part, WindowResiduals
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench

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
        Of an ``offset`` the mean residual without its sign, else its RMS [unit of the kind].
    noise : float
        RMS of its noise [unit of the kind].
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
        About which spin rate [rad/s].
    conditions : tuple of str
        Of `Condition`: what else its windows have in common.
    share_of_chi2 : float
        Its share of the sum of squares of the residuals in units of their noise.
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
        squares = part.squares
        for place, mask in masks.items():
            share = float(squares[mask].sum()) / total if total else 0.0
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
    rms, noise = _rms(r), _rms(part.sigma)
    if not np.iscomplexobj(r):
        mean = part.mean.real
        if abs(mean) > 0.5 * rms:
            return Look("offset", abs(mean), noise, mean)
    if len(r) < 2 or float(np.abs(tilt).max()) < 0.5 * DEG:
        return Look("mixed", rms, noise)
    if rms < 1.5 * noise * (math.sqrt(2.0) if np.iscomplexobj(r) else 1.0):
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


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2))) if len(values) else 0.0
