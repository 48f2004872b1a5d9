"""The explanation of recordings that a model leaves open: effects, a free form, events, and the noise that is left.

What is noise depends on what else explains the recordings: a law that a model lacks looks like a drift. Comparison,
diagnosis and addition therefore take the noise of the same explanation, so that their numbers agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from gyrowheel_analysis.diagnosis.event_dating import Found
from gyrowheel_analysis.diagnosis.events import explain
from gyrowheel_analysis.diagnosis.motion_laws import MotionLaw
from gyrowheel_analysis.diagnosis.selection import Progress, Selection, select
from gyrowheel_analysis.diagnosis.unknown import Proposal, settled
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.preparation import Prepared
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_recording.bags import Recording


@dataclass(frozen=True)
class Explanation:
    """The explanation of recordings: effects, an optional free form, and events.

    `fitted` has the noise and the events; `weighed` the same noise without events, their part still in the rows.
    `rejected` are terms that were found and make the prediction of unused data worse. `laws` look like events and are
    none, and nothing that was found describes them.
    """

    fitted: Prepared
    weighed: Prepared
    selection: Selection
    proposal: Proposal | None
    happened: list[Found]
    rejected: tuple[str, ...] = ()
    laws: tuple[MotionLaw, ...] = ()

    @property
    def problem(self) -> Problem:
        """The problem with the events."""
        return self.fitted.problem

    @property
    def best(self) -> Fit:
        """The fit with everything found."""
        return self.proposal.fit if self.proposal else self.selection.best

    @property
    def before(self) -> Fit:
        """The fit of the model alone: if it lacks something, the bench stays within its stated uncertainties."""
        missing = self.proposal is not None or self.selection.best.terms
        return self.problem.fit_within() if missing else self.best


def unexplained(first: Prepared) -> Explanation:
    """Return prepared recordings with nothing that explains them: the noise is as prepared."""
    plain = first.problem.fit(())
    return Explanation(first, first, Selection(first.problem, plain, plain, (), 1.0), None, [])


def explained(first: Prepared, recordings: Sequence[Recording], progress: Progress | None) -> Explanation:
    """Return the explanation of prepared recordings, with the noise that it leaves."""
    selection = select(first.problem, progress=progress)
    weighed = first.reweighed(selection.best)
    if weighed is not first:
        selection = select(weighed.problem, progress=progress)
    outcome = explain(weighed.problem, selection, recordings, progress)
    fitted, proposal = replace(weighed, problem=outcome.problem), outcome.proposal
    if proposal is not None:
        fitted = replace(fitted, problem=fitted.problem.with_drift_estimated(proposal.fit))
        proposal = settled(fitted.problem, proposal)
    weighed = replace(weighed, problem=weighed.problem.with_scales(fitted.problem.noise.scales))
    laws = () if proposal is not None else outcome.laws
    return Explanation(fitted, weighed, outcome.selection, proposal, outcome.events, laws=laws)
