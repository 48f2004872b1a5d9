"""The products of events in linear time are those of whole matrices."""

from __future__ import annotations

import numpy as np
import pytest

from gyrowheel_analysis.criteria import BURST_BESIDE
from gyrowheel_analysis.diagnosis.event_scan import _BURST_EDGES, _SHORT_BURST, _Bursts, _Steps, _Swings
from gyrowheel_analysis.diagnosis.evidence import Profiles, Rows, _White
from gyrowheel_analysis.fitting.events import Event
from gyrowheel_analysis.fitting.variance import DriftCovariance

N = 40


def rows_of(kind: str, seed: int) -> tuple[Rows, np.ndarray]:
    """Return rows with a drift, or without one, and the inverse of their covariance, scatter included."""
    rng = np.random.default_rng(seed)
    time, factor = np.cumsum(rng.uniform(0.3, 4.0, N)), rng.uniform(1.0, 2.0, N)
    time[20:] += 500.0  # a pause over which the drift is forgotten
    if kind == "drift":
        covariance = DriftCovariance(time, rng.uniform(0.5, 2.0, N), 1.7, 9.0)
        root = np.linalg.inv(np.linalg.cholesky(covariance.dense(1.3))) / factor[:, None]
        return Rows(covariance, 1.3, factor), root.T @ root
    deviation = rng.uniform(0.5, 2.0, N)
    return Rows(_White(deviation), 1.0, factor), np.diag(1.0 / (deviation * factor) ** 2)


@pytest.mark.parametrize("kind", ["drift", "white"])
def test_whitening_and_back_is_the_inverse_of_the_covariance(kind: str) -> None:
    rows, inverse = rows_of(kind, 1)
    given = np.random.default_rng(2).standard_normal((N, 3))
    assert rows.whiten_back(rows.whiten(given)) == pytest.approx(inverse @ given, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("kind", ["drift", "white"])
def test_events_have_the_products_of_their_courses(kind: str) -> None:
    rows, inverse = rows_of(kind, 3)
    rng = np.random.default_rng(4)
    between = np.arange(N - 1.0) + 0.5
    left, right, many = rng.standard_normal(N), rng.standard_normal(N), rng.standard_normal((7, N))
    start, duration = np.arange(1.0, N + 1.0), rng.uniform(0.2, 1.0, N)
    swings = _Swings(start, duration, np.array([7.0, 20.0]))
    for profiles in (_Steps(between), _Bursts(between), swings):
        course = np.arange(N)[None, :] > profiles.edges[:, :1]
        if profiles.kind == "burst":
            course &= np.arange(N)[None, :] < profiles.edges[:, 1:]
        weights = course.astype(float)
        if profiles is swings:
            events = (Event(0, "", "swing", *own) for own in profiles.edges.tolist())
            weights = np.array([event.profile(start, duration) for event in events])
        dense = Profiles(profiles.kind, profiles.edges, weights)
        for one, other in ((left, left), (left, right)):
            expected = np.einsum("en,nm,em->e", weights * one, inverse, weights * other)
            assert profiles.squares(rows, one, other) == pytest.approx(expected, rel=1e-9, abs=1e-12)
            assert dense.squares(rows, one, other) == pytest.approx(expected, rel=1e-9, abs=1e-12)
        assert profiles.sums(many) == pytest.approx(dense.sums(many), abs=1e-12)
        assert profiles.explained(many, many) == pytest.approx(dense.explained(many, many), abs=1e-11)
        assert profiles.places == len(profiles)


@pytest.mark.slow
def test_all_short_bursts_of_a_long_recording_are_tried() -> None:
    """The bursts tried grow with the windows, those possible with their square."""
    counts = []
    for n in (4 * _BURST_EDGES, 16 * _BURST_EDGES):
        bursts = _Bursts(np.arange(n - 1.0) + 0.5)
        pairs = {(int(a + 0.5), int(b + 0.5)) for a, b in bursts.edges}
        assert len(pairs) == len(bursts)
        first = range(BURST_BESIDE, n - BURST_BESIDE - _SHORT_BURST + 1)
        assert all((k, k + size) in pairs for k in first for size in (1, _SHORT_BURST))
        edges = n - 2 * BURST_BESIDE + 1
        assert bursts.places == edges * (edges - 1) // 2
        # products in parts are those at once
        values = np.random.default_rng(n).standard_normal((2, n))
        assert bursts.explained(values, values) == pytest.approx((bursts.sums(values) ** 2).sum(axis=0))
        counts.append(len(bursts))
    assert counts[1] < 4 * counts[0]
