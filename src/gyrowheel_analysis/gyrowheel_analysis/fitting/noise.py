"""Covariance of the rows of a balance: white noise and slow drift, and the estimate of the drift's magnitude."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.channels import DRIFTS, in_groups
from gyrowheel_analysis.criteria import DRIFT_SCALE_BOUNDS, DRIFT_SCALE_SPREAD, NOISE_CHANGED
from gyrowheel_analysis.fitting.variance import (
    DriftCovariance,
    MarginalCost,
    amplitude_variance,
    average_covariance,
    precision_root,
)
from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

#: Error of readings to which no model can be fitted.
NOT_FINITE = (
    "the model cannot be fitted: at these readings its likelihood or its derivatives are not finite (gyrowheel info "
    "shows their ranges)"
)

#: Prior width of the sizes of events, over their large sizes: practically free; the likelihood counts them as if large.
_FLAT = 1.0e3


@dataclass(frozen=True)
class Noise:
    """Noise of several recordings: for each, one covariance a row of averages and one deviation an amplitude.

    `averages` has, for each recording, the covariances of the averages in the order of their rows, each with the name
    of its drift; `amplitudes` the standard deviations of its further rows, which carry no drift; `scales` are the
    magnitudes of each drift over the stated one. `events` (N, events) are rows of changes in the middle of a recording,
    by large sizes. Whitening projects them out of all rows, which fits their sizes along with everything else.
    """

    averages: tuple[tuple[tuple[DriftCovariance, str], ...], ...]
    amplitudes: tuple[Array, ...]
    scales: Mapping[str, float]
    events: Array | None = None

    @classmethod
    def stated(cls, balances: Sequence[Balance], predicted: Sequence[Array]) -> Noise:
        """Return the noise on the benches of the balances with drifts as large as stated.

        There is one balance for each recording, with independent drifts; its `predicted` rows give the accuracy of the
        model.
        """
        benches = [balance.bench for balance in balances]
        amplitudes = _amplitudes(balances, predicted, benches)
        return cls(_averages(balances, predicted, benches), amplitudes, dict.fromkeys(DRIFTS, 1.0))

    def with_scales(self, scales: Mapping[str, float]) -> Noise:
        """Return the noise with other magnitudes of the drifts."""
        return replace(self, scales=dict(scales))

    def with_events(self, columns: Array) -> Noise:
        """Return the noise with other events; see `events`."""
        return replace(self, events=columns if columns.shape[1] else None)

    def on_bench_of(
        self,
        balances: Sequence[Balance],
        predicted: Sequence[Array],
        values: Mapping[str, float],
        lateness: Mapping[str, float] | None = None,
    ) -> Noise:
        """Return the noise on a bench of other `values` [SI]; the same object where it hardly differs.

        The noise of a torque twice a revolution comes mostly from the readings of the tilt, times the rotor's
        resistance there. That almost vanishes for a disc, but not for a rotor with a very different inertia. That of an
        average comes from the rates, times an inertia, and counts by the constant of coils or motor.
        `predicted` are the rows with these values; `lateness` are unstated delays of readings [s], by channel.
        """
        try:
            benches = [balance.bench.with_values(values) for balance in balances]
        except InputError:  # the fit diverged
            return self
        averages = _averages(balances, predicted, benches)
        amplitudes = _amplitudes(balances, predicted, benches, lateness)
        pairs = list(zip(self.amplitudes, amplitudes, strict=True))
        for before, after in zip(self.averages, averages, strict=True):
            pairs += [
                (np.sqrt(a.diagonal), np.sqrt(b.diagonal))
                for (a, _), (b, _) in zip(before, after, strict=True)
            ]
        other = any(np.any(np.abs(np.log(b / a)) > NOISE_CHANGED) for a, b in pairs)
        return replace(self, averages=averages, amplitudes=amplitudes) if other else self

    def whiten(self, rows: Array) -> Array:
        """Return rows (N, ...) divided by the square root of their covariance, less the part that events explain."""
        white = self.whitened(rows)
        if self.events is None:
            return white
        return np.asarray(white - self._basis @ (self._basis.T @ white))

    @cached_property
    def _basis(self) -> Array:
        """Orthonormal basis (N, events) of the whitened events."""
        assert self.events is not None  # only then is it needed
        basis, _ = np.linalg.qr(self.whitened(self.events))
        return np.asarray(basis)

    def whitened(self, rows: Array) -> Array:
        """Return rows (N, ...) divided by the square root of their covariance, recording after recording."""
        parts = [
            own / (block if own.ndim == 1 else block[:, None])
            if isinstance(block, np.ndarray)
            else block.whiten(own, self.scales[drift])
            for block, drift, own in self._blocks(rows)
        ]
        return np.concatenate(parts) if parts else np.zeros_like(rows)

    def _blocks(self, rows: Array) -> Iterator[tuple[DriftCovariance | Array, str, Array]]:
        """Yield the covariance of every average with its drift, then deviations of amplitudes, all with their rows."""
        at = 0
        for averages, deviation in zip(self.averages, self.amplitudes, strict=True):
            blocks: list[tuple[DriftCovariance | Array, str]] = [*averages, (deviation, "")]
            for block, drift in blocks:
                yield block, drift, rows[at : at + len(block)]
                at += len(block)

    def shares(self, rows: Array) -> Array:
        """Return the part of chi-squared that belongs to every row (N,): their sum is that of the whitened rows.

        See `DriftCovariance.shares`.
        """
        if self.events is not None:
            rows = rows - self.events @ np.linalg.lstsq(self.whitened(self.events), self.whitened(rows))[0]
        parts = [
            (own / block) ** 2 if isinstance(block, np.ndarray) else block.shares(own, self.scales[drift])
            for block, drift, own in self._blocks(rows)
        ]
        return np.concatenate(parts) if parts else np.zeros_like(rows)

    def deviation(self) -> Array:
        """Return the standard deviation of every row [unit of the row]."""
        parts = []
        for averages, deviation in zip(self.averages, self.amplitudes, strict=True):
            parts += [np.sqrt(covariance.variance(self.scales[drift])) for covariance, drift in averages]
            parts.append(deviation)
        return np.concatenate(parts)

    def best_scales(self, residual: Array, regressors: Array) -> tuple[dict[str, float], float]:
        """Return the most likely scales of the drifts and minus twice the log of their marginal likelihood.

        `residual` (N,) are rows measured minus predicted; `regressors` (N, p) are all possible explanations, each
        column scaled to one prior standard deviation. The part that they can explain does not count as drift.

        Raises
        ------
        InputError
            If the likelihood cannot be computed: the readings are absurd.
        """
        names = list(DRIFTS)
        blocks, residual, regressors, turning_cost = self.of_averages(residual, regressors)
        marginal = MarginalCost(blocks, residual, regressors)

        def cost(log_scale: Array) -> float:
            scale = dict(zip(names, np.exp(log_scale).tolist(), strict=True))
            return marginal(scale) + scale_cost(scale)

        low, high = np.log(DRIFT_SCALE_BOUNDS)
        best, least = _lowest(cost, np.full(len(names), 0.05), float(low), float(high))
        if not math.isfinite(least):
            raise InputError(NOT_FINITE)
        return dict(zip(names, np.exp(best).tolist(), strict=True)), least + turning_cost

    def beside_events(self, regressors: Array) -> Array:
        """Return regressors (N, p) with those of the events, whose sizes are practically free."""
        return regressors if self.events is None else np.hstack([regressors, _FLAT * self.events])

    def of_averages(
        self, residual: Array, regressors: Array
    ) -> tuple[list[tuple[DriftCovariance, str]], Array, Array, float]:
        """Return the averages among the rows, which alone show the drift, given the amplitudes.

        Returns
        -------
        blocks : list of (DriftCovariance, str)
            The covariances of the averages, each with the name of its drift.
        residual, regressors : ndarray (n,), ndarray (n, p)
            Their rows, with the regressors of the events, given the information of the amplitudes on the regressors.
        cost : float
            Minus twice the log likelihood of the amplitudes.
        """
        flat = 0.0 if self.events is None else 2.0 * math.log(_FLAT) * self.events.shape[1]
        regressors = self.beside_events(regressors)
        blocks: list[tuple[DriftCovariance, str]] = []
        kept: list[Any] = []
        start = 0
        for own, deviation in zip(self.averages, self.amplitudes, strict=True):
            for covariance, drift in own:
                n = len(covariance)
                blocks.append((covariance, drift))
                kept.append(np.arange(start, start + n))
                start += n
            start += len(deviation)
        averages = np.concatenate(kept) if kept else np.zeros(0, dtype=int)
        turning = np.setdiff1d(np.arange(start), averages)
        residual, regressors, cost = _narrowed(residual, regressors, averages, turning, self.amplitudes)
        return blocks, residual, regressors, cost - flat


_DIFFERENCE = 1e-3  # of a logarithm, for derivatives
_MOST_STEPS, _FARTHEST = 30, 1.5  # of the search, and of a logarithm in one step


def _lowest(cost: Callable[[Array], float], start: Array, low: float, high: float) -> tuple[Array, float]:
    """Return where a smooth function of few numbers between two bounds is lowest, and its value there.

    Newton's method with differences; where the function bends the other way it goes downhill.
    """
    x, here, every = start, cost(start), np.eye(len(start)) * _DIFFERENCE
    for _ in range(_MOST_STEPS):
        up, down = (np.array([cost(x + sign * own) for own in every]) for sign in (1.0, -1.0))
        slope = (up - down) / (2.0 * _DIFFERENCE)
        bend = np.diag(up - 2.0 * here + down) / _DIFFERENCE**2
        for i, j in itertools.combinations(range(len(x)), 2):
            both = cost(x + every[i] + every[j]) - up[i] - up[j] + here
            bend[i, j] = bend[j, i] = both / _DIFFERENCE**2
        if not np.isfinite(bend).all():
            break  # absurd readings: no direction is better than another
        free = ~((x <= low) & (slope > 0.0) | (x >= high) & (slope < 0.0))
        size, axes = np.linalg.eigh(bend[np.ix_(free, free)])
        step = np.zeros(len(x))
        step[free] = -axes @ ((axes.T @ slope[free]) / np.maximum(np.abs(size), 1e-3))
        step *= min(1.0, _FARTHEST / max(float(np.abs(step).max(initial=0.0)), 1e-300))
        for part in (1.0, 0.5, 0.25, 0.1, 0.01):
            trial = np.clip(x + part * step, low, high)
            if (there := cost(trial)) < here:
                break
        else:
            break
        gain, x, here = here - there, trial, there
        if gain < 1e-7:
            break
    return x, here


def scale_cost(scales: Mapping[str, float]) -> float:
    """Return minus twice the log of the prior density of the scales of drifts, up to a constant."""
    return float(sum(np.log(scale) ** 2 for scale in scales.values())) / DRIFT_SCALE_SPREAD**2


def _narrowed(
    residual: Array, regressors: Array, averages: Any, turning: Any, white: Sequence[Array]
) -> tuple[Array, Array, float]:
    """Return residual and regressors of the averages, given the rows of the amplitudes.

    The regressors belong to coefficients of unit prior deviation. The amplitudes, whose noise is known, turn this prior
    into a posterior: its mean is subtracted from the residual, and its deviation scales the regressors. The number is
    minus twice the log likelihood of the amplitudes themselves, up to a constant.
    """
    if not len(turning):
        return residual[averages], regressors[averages], 0.0
    sigma = np.concatenate(list(white))
    design, rows = regressors[turning] / sigma[:, None], residual[turning] / sigma
    root = precision_root(design)
    mean = cho_solve((root, True), design.T @ rows)
    cost = float(rows @ rows - (design.T @ rows) @ mean + 2.0 * np.log(np.diag(root)).sum())
    cost += 2.0 * float(np.log(sigma).sum())
    spread = solve_triangular(root, np.eye(len(root)), lower=True).T
    return residual[averages] - regressors[averages] @ mean, regressors[averages] @ spread, cost


def _averages(
    balances: Sequence[Balance], predicted: Sequence[Array], benches: Sequence[Bench]
) -> tuple[tuple[tuple[DriftCovariance, str], ...], ...]:
    """Return the covariances of the averages of every recording, each with its drift."""
    return tuple(
        tuple(
            (average_covariance(balance, rows, channel, row, bench), channel.drift)
            for channel in in_groups("average")
            for row in channel.rows
            if row in balance.rows
        )
        for balance, rows, bench in zip(balances, predicted, benches, strict=True)
    )


def _amplitudes(
    balances: Sequence[Balance],
    predicted: Sequence[Array],
    benches: Sequence[Bench],
    lateness: Mapping[str, float] | None = None,
) -> tuple[Array, ...]:
    """Return the standard deviations of the rows of the amplitudes of every recording."""
    result = []
    for balance, rows, bench in zip(balances, predicted, benches, strict=True):
        variances = [np.zeros(0)]
        for channel in in_groups("revolution", "ripple"):
            if channel.rows[0] in balance.rows:  # of an amplitude, both parts or none
                variances += [amplitude_variance(balance, bench, rows, channel, lateness)] * len(channel.rows)
        result.append(np.sqrt(np.concatenate(variances)))
    return tuple(result)
