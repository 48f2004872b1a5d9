"""Which channels of a recording separate two explanations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrowheel_analysis.channels import CHANNELS
from gyrowheel_analysis.fitting.fit import ERRORS, Fit
from gyrowheel_analysis.fitting.preparation import one_thread, prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.residuals.error_table import channel_values
from gyrowheel_recording.bags import Recording


@dataclass(frozen=True)
class Discrimination:
    """Separation of two explanations by one channel.

    Attributes
    ----------
    part : str
        The channel, see `channels.CHANNELS`.
    title : str
        The same in words.
    delta_chi2 : float
        Excess of chi-squared of the second explanation over the first there.
    """

    part: str
    title: str
    delta_chi2: float


@one_thread()
def discriminating_channels(
    recordings: Sequence[Recording], model: Model, name: str, rival: str
) -> list[Discrimination]:
    """Return the separation of an effect from another by each channel, the most separating channel first.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings that separate the two.
    model : Model
        The model without them.
    name, rival : str
        The effect, or error of a bench parameter, that explains the recordings, and the one that does not.
    """
    problem = prepare(recordings, model).problem
    # a rival that may move the very parameter would explain the rows by it, at the price of its stated uncertainty
    others = _with_known(problem, ERRORS.get(name, ()))
    best, worse = problem.fit([problem.unknowns.term(name)]), others.fit([others.unknowns.term(rival)])
    found = [
        Discrimination(part, kind.measured, _chi2(problem, worse, part) - _chi2(problem, best, part))
        for part, kind in CHANNELS.items()
        if all(row in b.rows for row in kind.rows for b in problem.balances)
    ]
    return sorted(found, key=lambda t: -t.delta_chi2)


def _with_known(problem: Problem, groups: Sequence[str]) -> Problem:
    """Return a problem in which some groups of bench parameters are known to be as stated."""
    if not groups:
        return problem
    known = {
        p.name: replace(p, uncertainty=1.0e-3 * p.uncertainty)
        for group, parameters in problem.unknowns.nuisances
        if group in groups
        for p in parameters
    }
    bench = replace(problem.bench, parameters={**problem.bench.parameters, **known})
    return Problem.of(problem.balances, problem.unknowns.on_bench(bench)).with_noise(problem.noise)


def _chi2(problem: Problem, fit: Fit, part: str) -> float:
    white = problem.noise.whiten(fit.residual)
    own = [channel_values(problem.balances, white, row) for row in CHANNELS[part].rows]
    return float(np.sum(np.square(own)))
