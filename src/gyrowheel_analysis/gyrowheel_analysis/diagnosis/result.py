"""What a diagnosis says: verdict, findings with evidence and ties, limits, the next test."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from gyrowheel_analysis.diagnosis.events import (
    DatedEvent,
    DriftShape,
)
from gyrowheel_analysis.diagnosis.instruments import (
    InstrumentFinding,
)
from gyrowheel_analysis.diagnosis.limits import Beyond
from gyrowheel_analysis.diagnosis.proof import Proof
from gyrowheel_analysis.reduction import Coverage
from gyrowheel_analysis.reduction.not_as_stated import ReadingFindings
from gyrowheel_analysis.residuals.error_table import ErrorTable, Residuals
from gyrowheel_analysis.residuals.growth import Growth
from gyrowheel_analysis.residuals.regions import Region
from gyrowheel_recording.mislabelled.fixes import WrongSetup

Verdict = Literal["nothing_missing", "effect", "ambiguous", "unknown", "insufficient_data"]


@dataclass(frozen=True)
class Estimate:
    """A coefficient with its standard error, in `unit`."""

    value: float
    standard_error: float
    unit: str


@dataclass(frozen=True)
class TieReport:
    """A term that explains the recordings as well, and the test that would separate the two.

    Attributes
    ----------
    name : str
        The term: an effect, or the error of a bench parameter (see `fitting.terms.ERRORS`).
    effect_title : str
        Title of the effect; empty for the error of a bench parameter.
    delta_chi2 : float
        By how much it is worse.
    separating_plan : str or None
        None where no shipped plan separates the two.
    expected_separation, minutes : float or None
        Expected difference of chi-squared after that plan, and its length.
    in_model : bool
        Whether the model has the effect already, with another size.
    unusual : bool
        Whether it would have to be far beyond its usual size.
    """

    name: str
    effect_title: str
    delta_chi2: float
    separating_plan: str | None
    expected_separation: float | None
    minutes: float | None
    in_model: bool = False
    unusual: bool = False


@dataclass(frozen=True)
class RivalReport:
    """A term in the place of the one found, and by how much it is worse."""

    name: str
    delta_chi2: float


@dataclass(frozen=True)
class EffectFinding:
    """An effect that the recordings ask for.

    Attributes
    ----------
    name : str
        The effect, or the error of a bench parameter (see `fitting.terms.ERRORS`).
    effect_title, effect_sentence : str
        Title and physics of the effect as it declares them; empty for the error of a bench parameter.
    coefficients : dict of str to Estimate
        Its coefficients as fitted.
    delta_chi2 : float
        By how much chi-squared is worse without it, all else fitted again.
    formula : str
        Its law.
    growth : list of Growth
        The laws that the residual follows once everything but the effect is accounted for.
    rivals : list of RivalReport
        Other terms in its place that explain something, but less.
    ties : list of TieReport
        Terms that explain the recordings as well.
    in_model : dict of str to Estimate, or None
        The coefficients with which the model has it already; None where it is missing.
    """

    name: str
    effect_title: str
    effect_sentence: str
    coefficients: dict[str, Estimate]
    delta_chi2: float
    formula: str
    growth: list[Growth]
    rivals: list[RivalReport]
    ties: list[TieReport]
    in_model: dict[str, Estimate] | None = None


@dataclass(frozen=True)
class FreeForm:
    """A formula that describes what no declared effect does.

    `formula` has law and coefficients in one line, as ``gyrowheel model add --formula`` takes it; `declaration` goes
    into a model file as it is, under `name`. Both begin from the exponents and edges that were found. `places` has what
    is a share of a reference among `coefficients` as tilts [rad] and spin rates [rad/s]: edges, centres and widths.
    `simple` is the same law with whole exponents, where those that were found are whole within their errors (`whole`);
    it can be added in its place.
    """

    formula: str
    delta_chi2: float
    coefficients: dict[str, Estimate]
    description: str
    name: str = ""
    declaration: dict[str, Any] = field(default_factory=dict)
    places: dict[str, Estimate] = field(default_factory=dict)
    simple: str = ""
    whole: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class NextTest:
    """The test to run next.

    Attributes
    ----------
    plan : str
        The plan.
    expected_separation : float
        Expected difference of chi-squared.
    minutes : float
        Length of the plan.
    separates : tuple of str, or None
        The two terms that it separates.
    reveals : str or None
        The effect that it would show at its usual size, which the recordings at hand cannot.
    """

    plan: str
    expected_separation: float
    minutes: float
    separates: tuple[str, str] | None = None
    reveals: str | None = None


@dataclass(frozen=True)
class NuisanceEstimate:
    """A bench parameter as fitted along, beside its stated value."""

    value: float
    standard_error: float
    prior_value: float
    prior_uncertainty: float
    unit: str

    @property
    def pull(self) -> float:
        """Distance from the stated value in stated uncertainties."""
        return (self.value - self.prior_value) / self.prior_uncertainty


@dataclass(frozen=True)
class DetectionLimit:
    """The smallest size of an effect that these recordings could have shown."""

    effect: str
    title: str
    coefficient: str
    value: float
    unit: str
    usual: tuple[float, float]

    @property
    def visible(self) -> bool:
        """Whether an effect of a usual size could have been seen."""
        return self.value <= self.usual[1]


@dataclass(frozen=True)
class Diagnosis:
    """What is missing in a model, by the evidence of recordings.

    Attributes
    ----------
    verdict : str
        ``nothing_missing``, ``effect``, ``ambiguous``, ``unknown`` or ``insufficient_data``.
    windows : int
        Steady windows in the recordings.
    effects : list of EffectFinding
        Physical effects that are missing, strongest first.
    free_form : list of FreeForm
        For ``unknown``: a formula that describes it.
    error : ErrorTable or None
        The error without and with what was found; None for ``insufficient_data``.
    where : list of Region
        Where the model fails without it.
    next_test : NextTest or None
        The test that settles what is open.
    nuisance : dict of str to NuisanceEstimate
        The bench's uncertain parameters as fitted along.
    detection_limits : list of DetectionLimit
        What could not have been seen.
    residuals : list of Residuals
        Window by window, without and with what was found.
    recordings, model : list of str, str
        What was diagnosed.
    drift_scales : dict of str to float
        Size of the slow drifts over the stated size.
    seconds : float
        How long it took [s].
    versions : dict of str to str
        Of the programs that found it.
    coverage : Coverage
        How much of the recordings takes part.
    events : list of DatedEvent
        What changed in the middle of a recording. In those that are fitted it is taken along; in those for validation
        it stays in the error.
    setup : list of WrongSetup
        Columns that cannot be what they are called: then the verdict is ``insufficient_data`` and nothing is diagnosed.
    beyond : list of Beyond
        Values beyond what is possible or far beyond what is usual, the gravest first.
    lack_of_fit : float
        By how many of its standard deviations chi-squared of the fit is above what is expected.
    proof : Proof or None
        Whether what was found predicts what was not fitted; None for ``insufficient_data``.
    instruments : list of InstrumentFinding
        Instruments that are not as stated, strongest first.
    drift_shapes : list of DriftShape
        Drifts that are no mere wandering: they are taken along in the fit like events.
    readings : ReadingFindings
        What the samples show of the instruments beside what is stated; it turns no torque and no verdict.
    """

    verdict: Verdict
    windows: int
    effects: list[EffectFinding]
    free_form: list[FreeForm]
    error: ErrorTable | None
    where: list[Region]
    next_test: NextTest | None
    nuisance: dict[str, NuisanceEstimate]
    detection_limits: list[DetectionLimit]
    residuals: list[Residuals]
    recordings: list[str]
    model: str
    drift_scales: dict[str, float]
    seconds: float
    versions: dict[str, str] = field(default_factory=dict)
    coverage: Coverage = field(default_factory=Coverage)
    events: list[DatedEvent] = field(default_factory=list)
    setup: list[WrongSetup] = field(default_factory=list)
    beyond: list[Beyond] = field(default_factory=list)
    lack_of_fit: float = 0.0
    proof: Proof | None = None
    instruments: list[InstrumentFinding] = field(default_factory=list)
    drift_shapes: list[DriftShape] = field(default_factory=list)
    readings: ReadingFindings = field(default_factory=ReadingFindings)

    @property
    def ties(self) -> dict[str, list[TieReport]]:
        """What ties with each finding, by the names of effects and of instruments."""
        return {f.name: f.ties for f in self.effects} | {f.name: f.ties for f in self.instruments}
