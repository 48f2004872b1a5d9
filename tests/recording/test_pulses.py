"""The angle of a shaft from the edges of its pulses: where it is between them, and how well that is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gyrowheel_recording.mapping.pulses import (
    Edges,
    PulseError,
    angle_from_pulses,
    edges_of_count,
    edges_of_level,
    edges_of_times,
)

TURN = 2.0 * math.pi
RATE = 1000.0  # samples a second


def machine(seconds: float = 20.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, the angle, and noisy readings of the speed: five speeds held, ramps between them."""
    rng = np.random.default_rng(3)
    time = np.arange(0.0, seconds, 1.0 / RATE)
    # at round speeds a turn takes a whole number of samples: the edges keep step with them
    held = np.array([209.44, 314.2, 261.0, 157.1, 350.0])
    corners = np.linspace(0.0, seconds, 11)
    speed = np.interp(time, corners, [*np.repeat(held, 2).tolist(), held[-1]])
    angle = 0.7 + np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) / RATE)])
    return time, angle, speed + rng.normal(0.0, 0.05, len(time))


def level(angle: np.ndarray, pulses: int, part: float = 0.4) -> np.ndarray:
    rng = np.random.default_rng(4)
    high = np.mod(angle * pulses / TURN, 1.0) < part
    return np.where(high, 4.8, 0.2) + rng.normal(0.0, 0.02, len(angle))


def off(found: np.ndarray, angle: np.ndarray, pulses: int) -> np.ndarray:
    """Return by how much an angle is off; pulses do not tell whole steps between them."""
    step = TURN / pulses
    return np.remainder(found - angle + 0.5 * step, step) - 0.5 * step


def disturbed(edges: Edges, *, missed: float, doubled: float) -> Edges:
    rng = np.random.default_rng(5)
    keep = rng.random(len(edges)) > missed
    times, within = edges.times[keep], edges.within[keep]
    more = rng.random(len(times)) < doubled
    times = np.concatenate([times, times[more] + 1e-3])
    order = np.argsort(times)
    return Edges(times[order], np.concatenate([within, within[more]])[order], edges.high)


@pytest.mark.parametrize("pulses", [1, 3])
@pytest.mark.parametrize("scale", [1.0, 1.004])
def test_angle_error_agrees_with_its_uncertainty(pulses: int, scale: float) -> None:
    time, angle, rate = machine()
    found = angle_from_pulses(time, scale * rate, edges_of_level(time, level(angle, pulses)), pulses)
    wrong = off(found.angle, angle, pulses)
    # an edge alone is known to 0.1 rad; all of them say more
    assert float(np.sqrt(np.mean(wrong**2))) < 3.0 * found.uncertainty < 0.1
    assert any("0.40%" in remark for remark in found.remarks) == (scale != 1.0)


def test_missed_and_doubled_edges_are_bridged_and_reported() -> None:
    time, angle, rate = machine()
    edges = disturbed(edges_of_level(time, level(angle, 1)), missed=0.05, doubled=0.03)
    found = angle_from_pulses(time, rate, edges, 1)
    wrong = off(found.angle, angle, 1)
    assert float(np.abs(wrong).max()) < 0.15
    told = "; ".join(found.remarks)
    assert "missed edges are bridged" in told
    assert "too many, or out of place" in told


def test_pulses_shorter_than_a_sample_are_seen_now_and_then() -> None:
    time, angle, rate = machine()
    found = angle_from_pulses(time, rate, edges_of_level(time, level(angle, 1, 0.01)), 1)
    wrong = off(found.angle, angle, 1)
    assert float(np.sqrt(np.mean(wrong**2))) < 3.0 * found.uncertainty < 0.3


def test_speed_is_computed_from_the_edges_if_not_recorded() -> None:
    time, angle, _ = machine()
    found = angle_from_pulses(time, None, edges_of_level(time, level(angle, 3)), 3)
    wrong = off(found.angle, angle, 3)
    assert float(np.sqrt(np.mean(wrong**2))) < 3.0 * found.uncertainty < 0.3
    assert "the speed is taken from the pulses, too" in found.remarks


def test_levels_counts_and_times_give_the_same_edges() -> None:
    time, angle, rate = machine(6.0)
    exact = np.interp(np.arange(1, math.floor(angle[-1] / TURN) + 1) * TURN, angle, time)
    count = np.floor(angle / TURN)
    last = exact[np.maximum(np.searchsorted(exact, time, side="right") - 1, 0)]
    found = [
        angle_from_pulses(time, rate, edges, 1)
        for edges in (
            edges_of_level(time, level(angle, 1)),
            edges_of_count(time, np.mod(count, 16.0)),
            edges_of_times(last),
        )
    ]
    assert found[2].uncertainty < 0.3 * found[0].uncertainty
    for own in found:
        assert float(np.sqrt(np.mean(off(own.angle, angle, 1) ** 2))) < 3.0 * own.uncertainty


def test_unequal_pulses_are_reported_and_corrected() -> None:
    time, angle, rate = machine()
    spaced = np.array([0.0, 0.35, 0.64]) * TURN  # the second comes 6 deg late
    turns = np.arange(0, math.floor(angle[-1] / TURN))
    exact = np.sort((turns[:, None] * TURN + spaced).ravel())
    exact = exact[(exact > angle[0]) & (exact < angle[-1])]
    found = angle_from_pulses(time, rate, edges_of_times(np.interp(exact, angle, time)), 3)
    assert any("unequal by up to" in remark for remark in found.remarks)
    assert float(np.std(off(found.angle, angle, 3))) < 0.01


@pytest.mark.parametrize(
    ("pulses", "told"), [(3, "`pulses: 1`"), (2, "`pulses: 1`")], ids=["three for one", "two for one"]
)
def test_wrong_number_of_pulses_is_refused_with_the_right_one(pulses: int, told: str) -> None:
    time, angle, rate = machine(6.0)
    with pytest.raises(PulseError, match=told):
        angle_from_pulses(time, rate, edges_of_level(time, level(angle, 1)), pulses)


def test_a_column_without_pulses_is_refused() -> None:
    time, _, rate = machine(6.0)
    with pytest.raises(PulseError, match=r"^0 rising edges; allowed: 8 or more"):
        angle_from_pulses(time, rate, edges_of_level(time, np.full(len(time), 3.0)), 1)


@pytest.mark.parametrize("pause", [5.0, 5e6])
def test_a_pause_is_refused_at_once_however_long_it_is(pause: float) -> None:
    """Over a pause nobody counts the turns, and no time in it is looked at."""
    time, rate, angle = machine(8.0)
    late = time + np.where(time > 4.0, pause, 0.0)
    for speed in (rate, None):
        with pytest.raises(PulseError, match="do not come where the speed has them"):
            angle_from_pulses(late, speed, edges_of_level(late, level(angle, 3)), 3)
