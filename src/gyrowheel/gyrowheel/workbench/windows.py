"""Numbers for the pictures of the residual: windows, maps over every variable, and what a region looks like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel.comparison.picture import arrow_scale, axis_title, cell_label, longest_arrow
from gyrowheel.show.sentences.residuals import region_description, region_name
from gyrowheel.workbench.derived import Channel
from gyrowheel.workbench.library import ROLES
from gyrowheel.workbench.residual import other_models
from gyrowheel.workbench.session import Session
from gyrowheel_analysis.channels import CHANNELS, COILS
from gyrowheel_analysis.reduction.windows import UPRIGHT, Windows, octants
from gyrowheel_analysis.residuals.error_table import WindowResiduals
from gyrowheel_analysis.residuals.maps import VARIABLES, Cell, regions, residual_map
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM, Unit, unit_for

Array = NDArray[np.float64]

#: Ranges of a variable below which nothing can depend on it visibly [rad, rad/s, s, K].
_STILL = {"tilt": 0.3 * DEG, "speed": 50.0 * RPM, "time": 1.0, "temperature": 1.0}
_BETTER = 0.25  # of the variance: what direction, time and temperature must explain beyond tilt and speed


def windows(session: Session) -> dict[str, Any] | None:
    """Return the windows of the comparison with their residuals, for the linked pictures."""
    found = session.step.comparison
    if found is None:
        return None
    data, keys = found.data, [key for key, _ in session.keyed(ROLES[0])]
    w, tilt = data.windows, data.parts.get(COILS)
    unit = unit_for(0.0 if tilt is None else float(np.median(np.abs(tilt.values))), "N·m")
    channel, variable = worst_place(data)
    return {
        "recording": [keys[int(k)] for k in data.recording],
        "start": w.start.tolist(),
        "duration": w.duration.tolist(),
        "speed": (w.mean_spin / RPM).round(1).tolist(),
        "tilt_x": (np.real(w.mean_tilt) / DEG).round(4).tolist(),
        "tilt_y": (np.imag(w.mean_tilt) / DEG).round(4).tolist(),
        "over": {name: _shown(name, values_of(w, name)) for name in VARIABLES}
        | {own.text: _means(session, own, keys, data) for own in session.derived},
        "of_coils": tilt is not None,
        "longest": longest_arrow(data),
        "unit": unit.label,
        **_left_by(data, unit),
        "others": {title: _left_by(own.data, unit) for title, own in other_models(session).items()},
        "fails": found.fails,
        "worst": channel,
        "variable": variable,
    }


def _left_by(data: WindowResiduals, unit: Unit) -> dict[str, Any]:
    """Return what a model leaves in every window: residual of the coils, its arrows [deg a unit], χ²/N by channel."""
    tilt = data.parts.get(COILS)
    # without both coil voltages there is no residual of the coils
    values = np.zeros(len(data.windows), dtype=complex) if tilt is None else tilt.values
    noisy = np.zeros(len(values), dtype=bool) if tilt is None else tilt.noisy
    return {
        "residual_x": (np.real(values) / unit.size).tolist(),
        "residual_y": (np.imag(values) / unit.size).tolist(),
        "scale": 0.0 if tilt is None else arrow_scale(data) * unit.size,
        "noisy": noisy.tolist(),
        "chi2": {
            name: {"title": CHANNELS[name].title, "values": (part.chi2 / len(part.kind.rows)).tolist()}
            for name, part in data.parts.items()
        },
    }


def _told(colour: Array, w: Windows, variable: str) -> float:
    """Return the share of the variance of some values that a smooth function of a variable explains, adjusted.

    The function is a parabola; of the direction it is a wave once and twice around, and a value of upright windows. It
    is adjusted for the number of its coefficients, which explain a part of anything.
    """
    at, one = values_of(w, variable), np.ones(len(colour))
    if variable == "azimuth":
        tilted = np.abs(np.asarray(w.mean_tilt)) >= UPRIGHT
        waves = [part(n * at) * tilted for n in (1, 2) for part in (np.cos, np.sin)]
        design = np.column_stack([one, 1.0 * tilted, *waves])
    else:
        reach = float(np.ptp(at))
        if reach <= _STILL[variable]:
            return 0.0
        design = np.vander((at - at.mean()) / reach, 3)
    basis, size, _ = np.linalg.svd(design, full_matrices=False)
    basis = basis[:, size > 1e-9 * size[0]]
    free = len(colour) - basis.shape[1]
    whole = float(np.sum((colour - colour.mean()) ** 2))
    left = float(np.sum((colour - basis @ (basis.T @ colour)) ** 2))
    return 1.0 - left / whole * (len(colour) - 1) / free if whole > 0.0 and free > 0 else 0.0


def _shown(variable: str, values: Array) -> list[float]:
    """Return values of a variable in the unit of `axis_title`."""
    size = {"tilt": DEG, "azimuth": DEG, "speed": RPM}.get(variable, 1.0)
    shown: list[float] = (values / size - (273.15 if variable == "temperature" else 0.0)).round(4).tolist()
    return shown


def maps(session: Session) -> list[dict[str, Any]]:
    """Return χ²/N of every channel over every variable, each cell with its windows."""
    if session.step.comparison is None:
        return []
    data = session.step.comparison.data
    return [
        {
            "variable": variable,
            "title": axis_title(variable),
            "cells": [
                {
                    "label": cell_label(variable, cell),
                    "chi2": {name: round(value, 3) for name, value in cell.chi2_per_n.items()},
                    "windows": np.flatnonzero(members(data, variable, cell)).tolist(),
                }
                for cell in residual_map(data, (variable,)).cells
            ],
        }
        for variable in VARIABLES
    ]


def variables(session: Session) -> list[dict[str, str]]:
    """Return the variables over which windows are drawn, with their titles: those of the maps, and derived channels."""
    own = [{"variable": name, "title": axis_title(name)} for name in VARIABLES]
    return own + [{"variable": each.text, "title": each.title} for each in session.derived]


def _means(session: Session, own: Channel, keys: Sequence[str], data: WindowResiduals) -> list[float]:
    """Return the mean of a derived channel in every window."""
    w, found = data.windows, np.full(len(data.windows), np.nan)
    for number, key in enumerate(keys):
        opened, mine = session.opened[key], np.flatnonzero(data.recording == number)
        values = session.derived.one(own, opened.recording, session.step.model.bench).values
        ends = np.searchsorted(opened.recording.time, [w.start[mine], w.start[mine] + w.duration[mine]])
        found[mine] = [float(np.mean(values[a:b])) if b > a else np.nan for a, b in ends.T]
    return [float(f"{value:.7g}") for value in found]


def members(data: WindowResiduals, variable: str, cell: Cell) -> NDArray[np.bool_]:
    """Return a mask of the windows in a cell of a map over one variable."""
    w, span = data.windows, cell.spans[variable]
    if variable == "azimuth":
        tilt = np.asarray(w.mean_tilt)
        if span.low != span.low:
            return np.abs(tilt) < UPRIGHT
        return octants(tilt) == int(octants(np.exp(1j * span.middle)))
    values = values_of(w, variable)
    return np.asarray((values >= span.low) & (values <= span.high))


def values_of(w: Windows, variable: str) -> Array:
    """Return the value of a variable of the maps in every window [rad, rad/s, s or K]."""
    tilt = np.asarray(w.mean_tilt)
    return np.asarray({
        "tilt": np.abs(tilt), "azimuth": np.angle(tilt), "speed": w.mean_spin, "time": w.middle,
        "temperature": w.coil_temperature,
    }[variable])  # fmt: skip


def worst_place(data: WindowResiduals) -> tuple[str, str]:
    """Return the channel with the largest χ²/N, and the variable that distinguishes its windows best.

    What counts is what the colours show: the logarithm of χ²/N above noise. Most laws depend on tilt and
    speed, and a plan sets these one after the other, in some directions: direction, time and temperature count only
    where they distinguish clearly better.
    """
    channel = max(data.parts, key=lambda name: data.parts[name].chi2.sum() / max(data.parts[name].rows, 1))
    part = data.parts[channel]
    colour = np.log10(np.maximum(part.chi2 / len(part.kind.rows), 1.0))
    score = {
        variable: _told(colour, data.windows, variable) - (0.0 if variable in ("tilt", "speed") else _BETTER)
        for variable in VARIABLES
    }
    best = max(score, key=lambda name: score[name])
    return channel, best if score[best] > 0.0 else "speed"


def region(session: Session, chosen: Sequence[int]) -> dict[str, Any]:
    """Return the share of the misfit in some windows, and sentences about their residual."""
    result = session.step.comparison
    if result is None:
        raise InputError("windows: nothing is compared yet")
    data = result.data
    mask = np.zeros(len(data.windows), dtype=bool)
    if not chosen or not all(0 <= k < len(mask) for k in chosen):
        raise InputError(f"windows: must be of 0 .. {len(mask) - 1}")
    mask[list(chosen)] = True
    some = replace(
        data,
        windows=data.windows.select(mask),
        recording=data.recording[mask],
        parts={name: part.at(mask) for name, part in data.parts.items()},
    )
    return {
        "share": some.chi2 / data.chi2 if data.chi2 else 0.0,
        "said": [
            {"where": region_name(own), "share": own.share_of_chi2, "looks": region_description(own)}
            for own in regions(some, session.step.model.details.bench)
        ],
    }
