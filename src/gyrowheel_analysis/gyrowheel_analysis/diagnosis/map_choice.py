"""Which map to offer: with which explanation, and only torques that predict data that were left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import (
    BESIDE_FORM_GAIN,
    CROSS_VALIDATION_LOSS,
    EVENT_GAIN,
    FORM_GAIN,
    NOISE_REACHED,
    PREDICTING_GAIN,
)
from gyrowheel_analysis.diagnosis.channel_checks import places_of
from gyrowheel_analysis.diagnosis.map_fit import MapFit, fit_map
from gyrowheel_analysis.diagnosis.proof import parts_left_out
from gyrowheel_analysis.diagnosis.selection import left_out
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_sim.effects.torque_map import TARGETS, Target

Array = NDArray[np.float64]

#: Channels that a torque on the rotor, and one on the shaft, must predict better.
CHANNELS: Mapping[Target, tuple[str, ...]] = {
    "rotor_torque": ("tilt_x", "tilt_y"),
    "shaft_torque": ("spin", "motor_voltage"),
}


def predicting(found: MapFit) -> tuple[Target, ...]:
    """Return the targets whose torque predicts rows that are left out better than nothing does.

    Speeds, directions, times and recordings are left out in turn. A speed at an end of the range is not: a map refuses
    beyond its range.
    """
    problem, kinds = found.problem, parts_left_out(found.problem)
    size = len(found.rows)
    best = _solved(found.design, found.rows)
    plain = found.design[:, : found.others]
    alone = _solved(plain, found.rows)
    places = places_of(problem.balances)
    before, after, count = (dict.fromkeys(places, 0.0) for _ in range(3))
    spin = np.concatenate([np.tile(b.windows.mean_spin, len(b.rows)) for b in problem.balances])
    for kind, masks in kinds.items():
        for mask in masks:
            inside = spin.min() < spin[mask].min() and spin[mask].max() < spin.max()
            if kind == "speed" and not inside:
                continue
            with_map = np.zeros(size)
            without = np.zeros(size)
            with_map[mask] = left_out(
                found.design, found.rows - found.design @ best, np.ones(len(best)), mask
            ).residual
            without[mask] = left_out(plain, found.rows - plain @ alone, np.ones(len(alone)), mask).residual
            for name, own in places.items():
                before[name] += float(without[own] @ without[own])
                after[name] += float(with_map[own] @ with_map[own])
                count[name] += float(mask[own].sum())
    result = []
    for target, names in CHANNELS.items():
        there = [name for name in names if count.get(name)]
        gain = sum(before[name] - after[name] for name in there)
        if found.gains.get(target, 0.0) < FORM_GAIN:
            continue
        worse = any(
            after[name] > before[name] + CROSS_VALIDATION_LOSS + np.sqrt(2.0 * count[name]) for name in there
        )
        if gain > PREDICTING_GAIN * len(kinds) and not worse:
            result.append(target)
    return tuple(result)


def _is_noise(found: MapFit) -> bool:
    """Whether a map leaves noise alone in every channel that a torque acts on."""
    left = found.rows - found.design @ _solved(found.design, found.rows)
    places = places_of(found.problem.balances)
    own = [places[name] for names in CHANNELS.values() for name in names if name in places]
    return all(float(np.mean(left[rows] ** 2)) <= NOISE_REACHED**2 for rows in own)


def _solved(design: Array, rows: Array) -> Array:
    return np.asarray(np.linalg.solve(np.eye(design.shape[1]) + design.T @ design, design.T @ rows))


def best_map(options: Sequence[tuple[Problem, Fit]], name: str) -> MapFit | None:
    """Return the likeliest map with one of several explanations, if it predicts rows that are left out.

    Effects next to it must bring their usual gain. Events are tried only where a map alone leaves more than noise: a
    smooth function of what is set explains an edge at a commanded change better than an event does.
    """
    found: list[tuple[float, MapFit]] = []
    for problem, base in sorted(options, key=lambda option: bool(option[0].events)):
        if problem.events and found and _is_noise(min(found, key=lambda pair: pair[0])[1]):
            break
        own = fit_map(problem, base, name)
        price = BESIDE_FORM_GAIN * len(base.terms) + EVENT_GAIN * len(problem.events)
        found.append((own.cost + price, own))
    _, best = min(found, key=lambda pair: pair[0])
    targets = predicting(best)
    if not targets:
        return None
    if len(targets) < len(TARGETS):
        best = fit_map(best.problem, best.base, name, targets)
        if predicting(best) != targets:
            return None
    return best
