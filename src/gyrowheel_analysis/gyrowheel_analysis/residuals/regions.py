"""The regions of the data that carry most of the misfit, and what the residual looks like there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.reduction import Windows
from gyrowheel_analysis.reduction.groups import speed_groups
from gyrowheel_analysis.residuals.windows import Part, WindowResiduals
from gyrowheel_analysis.residuals.words import constant_axes, phase
from gyrowheel_core.quantities import size_and_noise
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench

_SHOWN = 5


@dataclass(frozen=True)
class Region:
    """A part of the data and its share of the misfit.

    Attributes
    ----------
    region : str
        Which part: channel, speed, kind of motion, air, coils.
    share_of_chi2 : float
        Its share of the sum of squares of the residuals in units of their noise.
    description : str
        What the residual looks like there.
    """

    region: str
    share_of_chi2: float
    description: str

    def to_json(self) -> dict[str, Any]:
        """Return the region as a JSON object."""
        return {"region": self.region, "share_of_chi2": self.share_of_chi2, "description": self.description}


def regions(data: WindowResiduals, bench: Bench) -> list[Region]:
    """Return the few regions that carry most of the misfit, largest share first."""
    labels = np.array(_labels(data.windows, bench))
    tilt, total = np.asarray(data.windows.mean_tilt), data.chi2
    found = []
    for part in data.parts.values():
        squares = part.squares
        for label in dict.fromkeys(labels):
            mask = labels == label
            share = float(squares[mask].sum()) / total if total else 0.0
            found.append((share, part, label, mask))
    found.sort(key=lambda item: -item[0])
    return [
        Region(f"{part.kind.title}, {label}", share, _describe(part.at(mask), tilt[mask]))
        for share, part, label, mask in found[:_SHOWN]
    ]


def _labels(w: Windows, bench: Bench) -> list[str]:
    name = [""] * len(w)
    for group in speed_groups(w.mean_spin):
        speed = float(np.median(w.mean_spin[group])) / RPM
        for index in group:
            name[index] = f"{round(speed / 10) * 10:.0f} rpm"
    ambient = bench.value("air_pressure")
    labels = []
    for index in range(len(w)):
        parts = [name[index]]
        if abs(w.mean_tilt_rate[index]) > 0.5 * DEG:
            parts.append("cone")
        if w.air_pressure[index] < 0.8 * ambient:
            parts.append("low pressure")
        if w.coil_temperature[index] - bench.value("air_temperature") > 8.0:
            parts.append("warm coils")
        if w.up[index] < 0:
            parts.append("inverted")
        labels.append(", ".join(parts))
    return labels


def _describe(part: Part, tilt: NDArray[Any]) -> str:
    """Return in words what a residual looks like in windows with these tilts."""
    kind, r = part.kind, part.values
    rms, noise = _rms(r), _rms(part.sigma)
    if not np.iscomplexobj(r):
        mean = part.mean.real
        if abs(mean) > 0.5 * rms:
            side = "more" if mean > 0 else "less"
            about = size_and_noise(abs(mean), noise, kind.unit, f" {side} than the model")
            return f"{kind.subject} {about}"
    text = f"{kind.subject} beyond the model {size_and_noise(rms, noise, kind.unit, ' rms')}"
    if len(r) < 2 or float(np.abs(tilt).max()) < 0.5 * DEG:
        return text
    if rms < 1.5 * noise * (math.sqrt(2.0) if np.iscomplexobj(r) else 1.0):
        return f"{text}; hardly more than noise"
    if not kind.rows[0].startswith("tilt"):
        return text
    power = float(np.mean(np.abs(r) ** 2))
    # a constant, and a part in proportion to the tilt (its mirror image where it comes twice a revolution)
    p = np.conj(tilt) if kind.rows[0].startswith("tilt_2n") else tilt
    design = np.column_stack([np.ones(len(p)), p])
    (constant, slope), *_ = np.linalg.lstsq(design, r, rcond=None)
    left = r - design @ np.array([constant, slope])
    if abs(slope) ** 2 * float(np.var(p)) > 0.5 * power:
        turns = f"turns with the tilt, {phase(slope)}"
        return f"{text}; {turns if kind.rows[0] == 'tilt_x' else 'in proportion to the tilt'}"
    if abs(constant) ** 2 > 0.5 * power:
        return f"{text}; constant{constant_axes(complex(constant), kind)}"
    if float(np.mean(np.abs(left) ** 2)) > 0.5 * power:
        return f"{text}; neither constant nor in proportion to the tilt"
    return text


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2))) if len(values) else 0.0
