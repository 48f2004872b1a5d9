"""The diagnosis: verdict, findings, events, proof, limits, the next test.

The facts of this folder stand here and in `estimates`, `findings`, `dated_changes` and `proof_result`. These modules
import no procedure, so that any module may import them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from gyrowheel_analysis.reduction.windows import Coverage

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.correction_map import CorrectionMap
    from gyrowheel_analysis.diagnosis.dated_changes import DatedEvent, DriftShape, MissingLaw
    from gyrowheel_analysis.diagnosis.estimates import Beyond, DetectionLimit, Misstated, NuisanceEstimate
    from gyrowheel_analysis.diagnosis.findings import (
        EffectFinding,
        FreeForm,
        InstrumentFinding,
        NextTest,
        TieReport,
    )
    from gyrowheel_analysis.diagnosis.proof_result import Proof
    from gyrowheel_analysis.reduction.instrument_readings import ReadingFinding
    from gyrowheel_analysis.residuals.error_table import ErrorTable, Residuals
    from gyrowheel_analysis.residuals.maps import Region
    from gyrowheel_recording.mislabelled import WrongSetup

Verdict = Literal["nothing_missing", "effect", "ambiguous", "unknown", "insufficient_data"]


@dataclass(frozen=True)
class Diagnosis:
    """The effects that a model lacks, with the evidence of recordings.

    Attributes
    ----------
    verdict : str
        ``nothing_missing``, ``effect``, ``ambiguous``, ``unknown`` or ``insufficient_data``.
    windows : int
        Number of steady windows in the recordings.
    recordings : tuple of str
        Paths of the recordings.
    model : str
        File or name of the model.
    effects : tuple of EffectFinding
        The missing physical effects, strongest first.
    instruments : tuple of InstrumentFinding
        Deviations of instruments from the bench file, strongest first.
    free_form : tuple of FreeForm
        For ``unknown``: formulas for the residual that no known effect explains.
    rejected : tuple of str
        Effects and forms that the recordings seemed to need, and that make the prediction of unused data worse.
    map : CorrectionMap or None
        For ``unknown``: the missing torque as a smooth function, where that predicts data left out better than nothing
        and describes the recordings better than all else that was found.
    error : ErrorTable or None
        The error before and after adding the findings; None for ``insufficient_data``.
    where : tuple of Region
        Regions where the model fails without the findings, worst first.
    next_test : NextTest or None
        The test to run next.
    limits : tuple of DetectionLimit
        Detection limits: the smallest size of every known effect that these recordings would show.
    events : tuple of DatedEvent
        Changes in the middle of a recording. Those in fitted recordings are part of the fit; those in recordings for
        validation stay in the error.
    turned : tuple of DatedEvent
        Changes of the torque along the tilt that a turning of the rig explains as well, where a recording does not
        state how it stood; part of the fit like events.
    laws : tuple of MissingLaw
        What looks like events and is a law of the motion, or an offset, that nothing found describes.
    drift_shapes : tuple of DriftShape
        Drifts with a shape, which are part of the fit like events.
    readings : tuple of ReadingFinding
        Deviations of the instruments that the samples show: hum, steps, jitter, rate of the clock. They cause no
        torque and change no verdict.
    hum_unknown : tuple of (str, str)
        Recordings in which hum at the stated mains frequency cannot be measured, and why (`hum.unobservable`).
    setup : tuple of WrongSetup
        Columns that cannot have their labelled quantity; the verdict is then ``insufficient_data`` without a diagnosis.
    misstated : tuple of Misstated
        Bench parameters that the model file has far from their values; the verdict is then ``insufficient_data``
        without a diagnosis.
    proof : Proof or None
        Whether the findings predict data that were not fitted; None for ``insufficient_data``.
    beyond : tuple of Beyond
        Impossible or unusual values, the gravest first.
    ended : bool
        Whether the search was ended early (`SearchEnded`): what it did not compare may explain the recordings better.
    lack_of_fit : float
        Excess of chi-squared of the fit over its expectation, in standard deviations.
    nuisance : dict of str to NuisanceEstimate
        Bench parameters that are estimated in the fit.
    drift_scales : dict of str to float
        Size of the slow drifts over the stated size.
    residuals : tuple of Residuals
        Residuals window by window, before and after adding the findings.
    coverage : Coverage
        Share of the recordings that is used.
    seconds : float
        Computing time [s].
    versions : dict of str to str
        Versions of the programs.
    """

    verdict: Verdict
    windows: int
    recordings: tuple[str, ...]
    model: str
    effects: tuple[EffectFinding, ...] = ()
    instruments: tuple[InstrumentFinding, ...] = ()
    free_form: tuple[FreeForm, ...] = ()
    rejected: tuple[str, ...] = ()
    map: CorrectionMap | None = None
    error: ErrorTable | None = None
    where: tuple[Region, ...] = ()
    next_test: NextTest | None = None
    limits: tuple[DetectionLimit, ...] = ()
    events: tuple[DatedEvent, ...] = ()
    turned: tuple[DatedEvent, ...] = ()
    laws: tuple[MissingLaw, ...] = ()
    drift_shapes: tuple[DriftShape, ...] = ()
    readings: tuple[ReadingFinding, ...] = ()
    hum_unknown: tuple[tuple[str, str], ...] = ()
    setup: tuple[WrongSetup, ...] = ()
    misstated: tuple[Misstated, ...] = ()
    proof: Proof | None = None
    beyond: tuple[Beyond, ...] = ()
    ended: bool = False
    lack_of_fit: float = 0.0
    nuisance: dict[str, NuisanceEstimate] = field(default_factory=dict)
    drift_scales: dict[str, float] = field(default_factory=dict)
    residuals: tuple[Residuals, ...] = ()
    coverage: Coverage = field(default_factory=Coverage)
    seconds: float = 0.0
    versions: dict[str, str] = field(default_factory=dict)

    @property
    def ties(self) -> dict[str, tuple[TieReport, ...]]:
        """Ties of each finding, by the names of effects and of instruments."""
        return {f.name: f.ties for f in self.effects} | {f.name: f.ties for f in self.instruments}
