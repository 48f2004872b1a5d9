"""Covariance of white noise and a slow drift, in a time proportional to the number of rows.

The drift of a reading is an Ornstein-Uhlenbeck process, which is Markov. The Cholesky factor of its covariance plus a
diagonal therefore need not be formed: its inverse is exactly the recursion of a Kalman filter with one state. The
innovations over their standard deviations are the rows divided by the square root of their covariance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from gyrowheel_sim.jit import njit

Array = NDArray[np.float64]

_KEPT = 8  # scales whose results are kept: an optimiser moves one at a time


class DriftCovariance:
    """Covariance of rows with white noise and one drift: diag(d) + (scale * level)² exp(-|t - t'| / tau).

    Parameters
    ----------
    time : ndarray (n,)
        Times of the rows [s], in any order.
    diagonal : ndarray (n,)
        Variance of the white noise, positive [unit of the rows squared].
    level : float
        Standard deviation of the drift for a scale of one [unit of the rows].
    drift_time : float
        Correlation time of the drift [s].
    """

    def __init__(self, time: Array, diagonal: Array, level: float, drift_time: float) -> None:
        self.time = np.asarray(time, dtype=np.float64)
        self.diagonal = np.asarray(diagonal, dtype=np.float64)
        self.level, self.drift_time = level, drift_time
        order = np.argsort(self.time, kind="stable")
        self._order = None if np.array_equal(order, np.arange(len(order))) else order
        after = np.diff(self.time[order], prepend=-math.inf)
        self._fading = np.exp(-after / drift_time)
        # 1 - fading², which rounding would spoil where two rows are close
        self._renewed = -np.expm1(-2.0 * after / drift_time)
        self._sorted = self.diagonal[order]
        self._gains: dict[float, tuple[Array, Array]] = {}

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.time)

    def variance(self, scale: float) -> Array:
        """Return the variance of every row, the drift `scale` times as large as stated."""
        return self.diagonal + (scale * self.level) ** 2

    def dense(self, scale: float) -> Array:
        """Return the whole matrix (n, n)."""
        lag = np.abs(self.time[:, None] - self.time[None, :])
        return np.diag(self.diagonal) + (scale * self.level) ** 2 * np.exp(-lag / self.drift_time)

    def whiten(self, rows: Array, scale: float) -> Array:
        """Return rows (n, ...) divided by the square root of their covariance.

        For rows ordered by time that root is the lower Cholesky factor. Other rows are taken in the order of time, and
        each result is put in the place of its row.
        """
        gain, deviation = self._filter(scale)
        shape = np.shape(rows)
        flat = np.ascontiguousarray(rows, dtype=np.float64).reshape(len(self), math.prod(shape[1:]))
        out = np.empty_like(flat)
        order = np.arange(len(self)) if self._order is None else self._order
        _innovations(flat, order, self._fading, gain, deviation, out)
        return out.reshape(shape)

    def log_determinant(self, scale: float) -> float:
        """Return the logarithm of the determinant of the covariance."""
        return 2.0 * float(np.log(self._filter(scale)[1]).sum())

    def _filter(self, scale: float) -> tuple[Array, Array]:
        """Return gains of the filter and deviations of its innovations."""
        if scale not in self._gains:
            if len(self._gains) >= _KEPT:
                self._gains.pop(next(iter(self._gains)))
            gain, deviation = np.empty(len(self)), np.empty(len(self))
            _steady(self._fading, self._renewed, self._sorted, (scale * self.level) ** 2, gain, deviation)
            self._gains[scale] = gain, deviation
        return self._gains[scale]


class MarginalCost:
    """Minus twice the log likelihood of rows that regressors and drifts of unknown magnitude explain.

    The rows are normal with the covariance ``blockdiag(C_1(s), C_2(s), ...) + X Xᵀ``, where X are the regressors, each
    column scaled to one prior standard deviation. By the Woodbury identity and the matrix determinant lemma no larger
    matrix is needed than X has columns.

    Parameters
    ----------
    blocks : sequence of (DriftCovariance, str)
        The blocks of the covariance in the order of the rows, each with the name of its drift.
    residual : ndarray (N,)
        The rows.
    regressors : ndarray (N, p)
        The regressors X.
    """

    def __init__(
        self, blocks: Sequence[tuple[DriftCovariance, str]], residual: Array, regressors: Array
    ) -> None:
        self._blocks: list[tuple[DriftCovariance, str, Array]] = []
        both = np.column_stack([regressors, residual])
        at = 0
        for block, name in blocks:
            self._blocks.append((block, name, np.ascontiguousarray(both[at : at + len(block)])))
            at += len(block)
        if at != len(both):
            raise ValueError(f"{at} rows in the blocks, {len(both)} in the residual")
        self._size = both.shape[1]
        self._parts: dict[tuple[str, float], tuple[Array, float]] = {}

    def __call__(self, scales: Mapping[str, float]) -> float:
        """Return the cost for scales of the drifts, by name (without the constant N log 2π)."""
        gram, log_det = np.zeros((self._size, self._size)), 0.0
        for name in dict.fromkeys(name for _, name, _ in self._blocks):
            own, own_log_det = self._part(name, float(scales[name]))
            gram, log_det = gram + own, log_det + own_log_det
        # Xᵀ C⁻¹ X with the prior, Xᵀ C⁻¹ y, yᵀ C⁻¹ y
        factor = np.linalg.cholesky(gram[:-1, :-1] + np.eye(self._size - 1))
        along = solve_triangular(factor, gram[:-1, -1], lower=True, check_finite=False)
        log_det += 2.0 * float(np.log(np.diag(factor)).sum())
        return log_det + float(gram[-1, -1] - along @ along)

    def _part(self, name: str, scale: float) -> tuple[Array, float]:
        """Return the products of regressors and residual, and the log-determinant, of the blocks of one drift."""
        key = name, scale
        if key not in self._parts:
            gram, log_det = np.zeros((self._size, self._size)), 0.0
            for block, own, both in self._blocks:
                if own == name:
                    white = block.whiten(both, scale)
                    gram, log_det = gram + white.T @ white, log_det + block.log_determinant(scale)
            if len(self._parts) >= _KEPT * len(self._blocks):
                self._parts.pop(next(iter(self._parts)))
            self._parts[key] = gram, log_det
        return self._parts[key]


@njit(cache=True, error_model="numpy")
def _steady(fading: Any, renewed: Any, diagonal: Any, variance: float, gain: Any, deviation: Any) -> None:
    """Fill the gains and the deviations of the innovations of a drift of some variance."""
    left = variance  # of the drift, given the rows so far
    for k in range(len(diagonal)):
        ahead = fading[k] * fading[k] * left + renewed[k] * variance
        total = ahead + diagonal[k]
        gain[k] = ahead / total
        deviation[k] = math.sqrt(total)
        left = ahead * diagonal[k] / total


@njit(cache=True, error_model="numpy")
def _innovations(rows: Any, order: Any, fading: Any, gain: Any, deviation: Any, out: Any) -> None:
    """Fill `out` with the innovations of every column over their deviations."""
    columns = rows.shape[1]
    level = np.zeros(columns)
    for k in range(len(order)):
        place = order[k]
        for c in range(columns):
            ahead = fading[k] * level[c]
            new = rows[place, c] - ahead
            out[place, c] = new / deviation[k]
            level[c] = ahead + gain[k] * new
