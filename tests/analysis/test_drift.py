"""The covariance of noise and drift without its matrix, against the matrix."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import lsq_linear, minimize
from scipy.stats import multivariate_normal

from gyrowheel_analysis.fitting.noise import _lowest
from gyrowheel_analysis.fitting.solver import bounded
from gyrowheel_analysis.fitting.variance import DriftCovariance, MarginalCost

Array = NDArray[np.float64]


@st.composite
def covariances(draw: Any, *, sorted_: bool = False, most: int = 40) -> DriftCovariance:
    n = draw(st.integers(1, most))
    seed = draw(st.integers(0, 2**32 - 1))
    random = np.random.default_rng(seed)
    # from rows that follow one another within a millisecond to rows that know nothing of one another
    time = random.uniform(0.0, 10.0 ** draw(st.floats(-2.0, 4.0)), n)
    diagonal = 10.0 ** random.uniform(-3.0, 1.0, n)
    return DriftCovariance(
        np.sort(time) if sorted_ else time, diagonal, 10.0 ** draw(st.floats(-2.0, 2.0)), 20.0
    )


SCALES = st.floats(0.1, 8.0)


@given(covariances(sorted_=True), SCALES)
@settings(max_examples=50, deadline=None)
def test_rows_in_order_are_divided_by_the_cholesky_factor(noise: DriftCovariance, scale: float) -> None:
    factor = np.linalg.cholesky(noise.dense(scale))
    rows = np.random.default_rng(len(noise)).normal(size=(len(noise), 3))
    expected = np.linalg.solve(factor, rows)
    assert noise.whiten(rows, scale) == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())
    assert noise.whiten(rows[:, 0], scale) == pytest.approx(
        expected[:, 0], rel=1e-6, abs=1e-6 * np.abs(expected).max()
    )


@given(covariances(), SCALES)
@settings(max_examples=50, deadline=None)
def test_rows_in_any_order_are_whitened_and_stay_in_their_place(noise: DriftCovariance, scale: float) -> None:
    whitening = noise.whiten(np.eye(len(noise)), scale)
    assert whitening @ noise.dense(scale) @ whitening.T == pytest.approx(np.eye(len(noise)), abs=1e-6)
    order = np.argsort(noise.time)
    ordered = DriftCovariance(noise.time[order], noise.diagonal[order], noise.level, noise.drift_time)
    rows = np.random.default_rng(len(noise)).normal(size=len(noise))
    assert noise.whiten(rows, scale)[order] == pytest.approx(ordered.whiten(rows[order], scale))


@given(covariances(), SCALES)
@settings(max_examples=50, deadline=None)
def test_determinant_and_variances_equal_those_of_the_dense_matrix(
    noise: DriftCovariance, scale: float
) -> None:
    dense = noise.dense(scale)
    assert noise.log_determinant(scale) == pytest.approx(np.linalg.slogdet(dense)[1], rel=1e-7, abs=1e-6)
    assert noise.variance(scale) == pytest.approx(np.diag(dense))


@given(
    st.lists(covariances(most=15), min_size=1, max_size=4),
    st.integers(0, 6),
    st.tuples(SCALES, SCALES),
    st.integers(0, 1000),
)
@settings(max_examples=50, deadline=None)
def test_cost_is_minus_twice_the_log_of_the_likelihood(
    noises: list[DriftCovariance], regressors: int, scales: tuple[float, float], seed: int
) -> None:
    random = np.random.default_rng(seed)
    names = ["current", "voltage"]
    blocks = [(noise, names[k % 2]) for k, noise in enumerate(noises)]
    total = sum(map(len, noises))
    x, y = random.normal(size=(total, regressors)), random.normal(size=total)
    cost = MarginalCost(blocks, y, x)
    for factor in (1.0, 1.3):  # once afresh, once where half of it is known already
        by_name = {"current": scales[0] * factor, "voltage": scales[1]}
        covariance = block_diag(*(noise.dense(by_name[name]) for noise, name in blocks)) + x @ x.T
        expected = -2.0 * multivariate_normal(cov=covariance).logpdf(y) - total * np.log(2.0 * np.pi)
        assert cost(by_name) == pytest.approx(expected, rel=1e-6, abs=1e-5)


def test_empty_covariance_is_accepted() -> None:
    nothing = DriftCovariance(np.zeros(0), np.zeros(0), 1.0, 20.0)
    assert nothing.whiten(np.zeros((0, 3)), 1.0).shape == (0, 3)
    assert nothing.log_determinant(1.0) == 0.0


def test_row_count_must_equal_that_of_the_blocks() -> None:
    noise = DriftCovariance(np.arange(3.0), np.ones(3), 1.0, 20.0)
    with pytest.raises(ValueError, match="3 rows in the blocks, 4 in the residual"):
        MarginalCost([(noise, "current")], np.zeros(4), np.zeros((4, 1)))


@pytest.mark.parametrize("middle", [(0.3, 1.1), (-2.0, 0.7), (5.0, -3.0)])
def test_the_lowest_place_between_bounds_is_that_of_scipy(middle: tuple[float, float]) -> None:
    def cost(x: Array) -> float:
        off = x - np.array(middle)
        return float(np.log(1.0 + off @ off + off[0] * off[1]) * 40.0)

    x, least = _lowest(cost, np.array([0.05, 0.05]), 0.0, 2.0)
    expected = minimize(cost, [0.05, 0.05], bounds=[(0.0, 2.0)] * 2, tol=1e-12)
    assert x == pytest.approx(expected.x, abs=1e-4)
    assert least <= expected.fun + 1e-6


@pytest.mark.parametrize("seed", range(20))
def test_bounded_least_squares_are_those_of_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 15))
    design = np.vstack([rng.standard_normal((30, n)) * 10.0 ** rng.uniform(-2.0, 2.0, n), np.eye(n)])
    target = np.concatenate([100.0 * rng.standard_normal(30), rng.standard_normal(n)])
    low, high = -rng.uniform(0.0, 3.0, n), rng.uniform(0.1, 3.0, n)
    expected = lsq_linear(design, target, (low, high), method="bvls", tol=1e-14).x
    assert bounded(design, target, low, high) == pytest.approx(expected, abs=1e-6)
