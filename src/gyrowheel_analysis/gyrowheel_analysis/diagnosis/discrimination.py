"""Which rows of a recording tell two explanations apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrowheel_analysis.fitting.preparation import one_thread, prepare
from gyrowheel_analysis.fitting.problem import Fit, Problem
from gyrowheel_analysis.fitting.terms import ERRORS, Term
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.recording import Recording
from gyrowheel_analysis.residuals.error_table import channel_values
from gyrowheel_analysis.residuals.windows import PARTS


@dataclass(frozen=True)
class Telling:
    """How much one kind of row tells two explanations apart.

    Attributes
    ----------
    part : str
        Which rows, see `where.residuals.PARTS`.
    title : str
        The same in words.
    delta_chi2 : float
        By how much the second explanation is worse there than the first.
    """

    part: str
    title: str
    delta_chi2: float


@one_thread()
def telling_channels(recordings: Sequence[Recording], model: Model, name: str, rival: str) -> list[Telling]:
    """Return which rows tell an effect from another, those that tell most first.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings that tell them apart.
    model : Model
        The model without them.
    name, rival : str
        The effect, or error of a bench parameter, that explains the recordings, and the one that does not.
    """
    problem = prepare(recordings, model).problem
    problem.estimate_noise()
    # a rival that may move the very parameter would meet the rows by it, at the price of its stated uncertainty
    others = _with_known(problem, ERRORS.get(name, ()))
    best, worse = problem.fit([_term(problem, name)]), others.fit([_term(others, rival)])
    found = [
        Telling(part, kind.measured, _chi2(problem, worse, part) - _chi2(problem, best, part))
        for part, kind in PARTS.items()
        if all(row in b.channels for row in kind.rows for b in problem.balances)
    ]
    return sorted(found, key=lambda t: -t.delta_chi2)


def _with_known(problem: Problem, groups: Sequence[str]) -> Problem:
    """Return a problem in which some groups of bench parameters are known to be as stated."""
    if not groups:
        return problem
    known = {
        p.name: replace(p, uncertainty=1.0e-3 * p.uncertainty)
        for group, parameters in problem.nuisances
        if group in groups
        for p in parameters
    }
    bench = replace(problem.bench, parameters={**problem.bench.parameters, **known})
    result = Problem(problem.balances, bench, problem.known, problem.known_errors, problem.library)
    result.noise = problem.noise
    return result


def _term(problem: Problem, name: str) -> Term:
    return Term(name) if name in ERRORS else Term(name, problem.library[name])


def _chi2(problem: Problem, fit: Fit, part: str) -> float:
    white = problem.noise.whiten(fit.residual)
    own = [channel_values(problem.balances, white, row) for row in PARTS[part].rows]
    return float(np.sum(np.square(own)))
