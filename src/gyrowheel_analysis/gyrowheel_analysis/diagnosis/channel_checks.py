"""Tests of a fit channel by channel: size of the residual, fitted and unseen, and what it still depends on.

One chi-squared of all rows hides a channel that fails among nine that do not. The chance of each test is that of the
whole family over the number of channels (Bonferroni).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.channels import LISTED
from gyrowheel_analysis.criteria import CHANNEL_CHANCE, CHANNEL_POWER, NOISE_ERROR
from gyrowheel_analysis.diagnosis.proof_result import ChannelCheck
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.reduction.windows import concatenate
from gyrowheel_analysis.residuals.dependence import Dependence, dependences, judged, whiteness
from gyrowheel_analysis.residuals.error_table import channel_values, channels_of, window_residuals
from gyrowheel_core.units import RPM

Array = NDArray[np.float64]
Places = dict[str, NDArray[np.int64]]


def places_of(balances: Sequence[Balance]) -> Places:
    """Return the numbers of the rows of every channel that all recordings have."""
    every = np.arange(sum(len(balance) for balance in balances), dtype=np.float64)
    return {
        name: np.concatenate([channel_values(balances, every, row) for row in LISTED[name].rows]).astype(int)
        for name in channels_of(balances)
    }


def checks(problem: Problem, fit: Fit, unseen: Mapping[str, tuple[float, int]]) -> tuple[ChannelCheck, ...]:
    """Return the test of every channel.

    `unseen` has the chi-squared of the predicted rows by noise and uncertainty of the prediction, and their number.
    """
    white = problem.noise.whiten(fit.residual)
    design = problem.noise.whiten(fit.jacobian)
    leverage = np.einsum("ij,jk,ik->i", design, fit.covariance, design)
    places = places_of(problem.balances)
    tests = 2 * max(len(places), 1)
    result = []
    for name, own in places.items():
        if name not in unseen or not own.size:
            continue
        degrees = max(own.size - float(leverage[own].sum()), 1.0)
        chi2, n = unseen[name]
        result.append(
            ChannelCheck(
                name,
                float(white[own] @ white[own]) / degrees,
                _limit(degrees, tests) / degrees,
                chi2 / n,
                _limit(n, tests) / n,
            )
        )
    return tuple(result)


def _limit(degrees: float, tests: int) -> float:
    """Return the chi-squared that chance exceeds in one of the tests with `CHANNEL_CHANCE`."""
    chance = CHANNEL_CHANCE / tests
    by_noise = NOISE_ERROR * degrees * -float(ndtri(chance))
    return degrees + math.hypot(float(chdtri(degrees, chance)) - degrees, by_noise)


def smallest(found: Sequence[ChannelCheck], unseen: Mapping[str, tuple[float, int]]) -> float:
    """Return the smallest misfit that the test of every channel would have shown [noise floors]."""
    sizes = [0.0]
    for check in found:
        n = unseen[check.channel][1]
        limit = check.unseen_allowed * n
        # the sum of squares of noise and a misfit is normal to good approximation
        deviation = math.sqrt(2.0 * n + 4.0 * max(limit - n, 0.0))
        excess = limit - n + float(ndtri(CHANNEL_POWER)) * deviation
        sizes.append(math.sqrt(excess / n))
    return max(sizes)


def speed_of_misfit(balances: Sequence[Balance], white: Array, channel: str) -> float:
    """Return the spin rate [rad/s] at which the mean square of a channel is largest."""
    squares = sum(channel_values(balances, white, row) ** 2 for row in LISTED[channel].rows)
    spin = np.concatenate([balance.windows.mean_spin for balance in balances])
    steps = np.round(spin / (100.0 * RPM))
    worst = max(np.unique(steps), key=lambda step: float(np.mean(np.asarray(squares)[steps == step])))
    return float(np.mean(spin[steps == worst]))


def dependence_left(problem: Problem, fit: Fit) -> Dependence | None:
    """Return the strongest dependence of the residual of a fit on a variable that chance does not explain."""
    windows = concatenate([b.windows for b in problem.balances])
    data = window_residuals(problem.balances, windows, fit.residual, problem.noise)
    tests = dependences(data, problem.balances, fit.residual, problem.noise.whiten)
    noise = whiteness(data, problem.balances, problem.noise.whiten(fit.residual))
    stated = [d for part in judged(tests, noise) for d in part.stated if d.p_beside <= CHANNEL_CHANCE]
    return max(stated, key=lambda d: d.share_beside, default=None)
