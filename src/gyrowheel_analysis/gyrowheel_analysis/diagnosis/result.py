"""The facts of a diagnosis: verdict, findings with evidence and ties, events, proof, limits, the next test.

All results of this folder for other folders are declared here; no procedure is imported, so that any module may
import it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from gyrowheel_analysis.reduction.windows import Coverage

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.correction_map import CorrectionMap
    from gyrowheel_analysis.fitting.events import Kind
    from gyrowheel_analysis.fitting.fit import Prior
    from gyrowheel_analysis.reduction.instrument_readings import ReadingFinding
    from gyrowheel_analysis.residuals.error_table import ErrorTable, Residuals
    from gyrowheel_analysis.residuals.growth import Growth
    from gyrowheel_analysis.residuals.maps import Region
    from gyrowheel_recording.mislabelled import WrongSetup

Left = Literal["", "recording", "speed", "azimuth", "time"]
Reason = Literal[
    "predicted",
    "unfixed",
    "event",
    "differs",
    "resembles",
    "misfit",
    "channel",
    "dependence",
    "no_gain",
    "not_tried",
    "map",
]
_RANGE = 1.96  # standard deviations of a 95 % interval
Verdict = Literal["nothing_missing", "effect", "ambiguous", "unknown", "insufficient_data"]


@dataclass(frozen=True)
class ErrorParts:
    """What the uncertainty of an estimate consists of, each as a standard deviation.

    Attributes
    ----------
    noise : float
        Of the readings' noise and slow drift, with a bench that is known exactly.
    bench : float
        Of the uncertainties of the bench and of known effects; with `noise` it is the standard error.
    undetected : float
        Of effects that these recordings would not show.
    middle : float
        The estimate if the undetected effects have their likeliest sizes.
    """

    noise: float
    bench: float
    undetected: float
    middle: float

    @property
    def deviation(self) -> float:
        """The three together."""
        return math.hypot(self.noise, self.bench, self.undetected)

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval from all three."""
        return self.middle - _RANGE * self.deviation, self.middle + _RANGE * self.deviation


@dataclass(frozen=True)
class Estimate:
    """A coefficient with its standard error, in `unit`.

    Attributes
    ----------
    value, standard_error : float
        By the data, and the prior if there is one.
    unit : str
        SI unit.
    prior : Prior or None
        Its prior; None where the data alone decide.
    data : tuple of float or None
        Estimate and standard error from the data alone; None without a prior, and where they do not determine it.
    source : str
        Where the prior comes from.
    parts : ErrorParts or None
        What its uncertainty consists of; None where it was not fitted.
    """

    value: float
    standard_error: float
    unit: str
    prior: Prior | None = None
    data: tuple[float, float] | None = None
    source: str = ""
    parts: ErrorParts | None = None

    @property
    def conflict(self) -> float | None:
        """Distance of the data from the prior in their joint standard errors; None without both."""
        if self.prior is None or self.data is None:
            return None
        return abs(self.data[0] - self.prior.mean) / math.hypot(self.data[1], self.prior.deviation)


@dataclass(frozen=True)
class TieReport:
    """A term that explains the recordings equally well, and the test that would separate the two.

    Attributes
    ----------
    name : str
        The term: an effect, or the error of a bench parameter (see `fitting.fit.ERRORS`).
    effect_title : str
        Title of the effect; empty for the error of a bench parameter.
    delta_chi2 : float
        Excess of its chi-squared.
    separating_plan : str or None
        None where no shipped plan separates the two.
    expected_separation, minutes : float or None
        Expected difference of chi-squared after that plan, and its length.
    in_model : bool
        Whether the model has the effect already, with another size.
    unusual : bool
        Whether it would need far more than its usual size.
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
    """A term in the place of the one found, and the excess of its chi-squared."""

    name: str
    delta_chi2: float


@dataclass(frozen=True)
class EffectFinding:
    """An effect that the recordings need.

    Attributes
    ----------
    name : str
        The effect, or the error of a bench parameter (see `fitting.fit.ERRORS`).
    effect_title, effect_sentence : str
        Title and physics of the effect as it declares them; empty for the error of a bench parameter.
    coefficients : dict of str to Estimate
        Its coefficients as fitted.
    delta_chi2 : float
        Increase of chi-squared without it, all else fitted again.
    formula : str
        Its law.
    growth : tuple of Growth
        The laws of the residual once everything but the effect is accounted for.
    rivals : tuple of RivalReport
        Other terms in its place that explain something, but less.
    ties : tuple of TieReport
        Terms that explain the recordings equally well.
    in_model : dict of str to Estimate, or None
        The coefficients that the model already has; None where the effect is missing.
    """

    name: str
    effect_title: str
    effect_sentence: str
    coefficients: dict[str, Estimate]
    delta_chi2: float
    formula: str
    growth: tuple[Growth, ...]
    rivals: tuple[RivalReport, ...]
    ties: tuple[TieReport, ...]
    in_model: dict[str, Estimate] | None = None


@dataclass(frozen=True)
class InstrumentFinding:
    """A deviation of an instrument from the bench file.

    Attributes
    ----------
    name : str
        Name for ``gyrowheel model add``: an effect of the category ``instrument``.
    channel : str
        The reading, say ``coil_voltage``.
    quantity : str
        The wrong parameter of the bench without the channel, say ``delay``.
    value, standard_error : float
        The parameter as found [`unit`].
    stated : float
        The parameter as the bench states it.
    unit : str
        SI unit.
    delta_chi2 : float
        Increase of chi-squared without it, all else fitted again.
    ties : tuple of TieReport
        Instruments or effects that explain the recordings equally well.
    title, sentence : str
        Title and physics as declared.
    """

    name: str
    channel: str
    quantity: str
    value: float
    standard_error: float
    stated: float
    unit: str
    delta_chi2: float
    ties: tuple[TieReport, ...]
    title: str = ""
    sentence: str = ""

    @property
    def deviation(self) -> float:
        """Difference from the stated value [`unit`]."""
        return self.value - self.stated


@dataclass(frozen=True)
class FreeForm:
    """A formula for a residual that no declared effect describes.

    `formula` has law and coefficients in one line, as ``gyrowheel model add --formula`` takes it; `declaration` goes
    into a model file, under `name`. Both begin from the exponents and edges that were found. `places` has those
    `coefficients` that are shares of a reference as tilts [rad] and spin rates [rad/s]: edges, centres and widths.
    `simple` is the same law with whole exponents, where those found are whole within their errors (`whole`); it can be
    added instead.
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
        The effect that it would show at its usual size, unlike the recordings at hand.
    """

    plan: str
    expected_separation: float
    minutes: float
    separates: tuple[str, str] | None = None
    reveals: str | None = None


@dataclass(frozen=True)
class NuisanceEstimate:
    """Estimate of a bench parameter, with its stated value."""

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
class Misstated:
    """A bench parameter that a model file has far from the value that the recordings show."""

    name: str
    value: float  # in the model file [`unit`]
    found: float  # by the recordings, with its standard error [`unit`]
    standard_error: float
    unit: str

    @property
    def far(self) -> float:
        """Distance [standard errors]."""
        return abs(self.value - self.found) / self.standard_error


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
class Beyond:
    """An impossible value, or one far from usual.

    Attributes
    ----------
    kind : str
        ``impossible``: a bench parameter outside its physical range. ``unusual``: an effect, or the error of a
        parameter, many times its usual size. ``not_as_stated``: an estimated bench parameter, many of its stated
        uncertainties away.
    name, coefficient : str
        The effect, error or bench parameter; of an effect its coefficient.
    value, limit : float
        The fitted value, and the limit that it exceeds [`unit`].
    unit : str
        Their unit.
    times : float
        Multiple of the largest usual size, or stated uncertainties; 0 where it is impossible.
    """

    kind: Literal["impossible", "unusual", "not_as_stated"]
    name: str
    coefficient: str
    value: float
    limit: float
    unit: str
    times: float


@dataclass(frozen=True)
class ChannelCheck:
    """Test of one channel: its mean squares in units of its noise, and what chance allows.

    Attributes
    ----------
    channel : str
        Which one.
    fitted, fitted_allowed : float
        χ²/N of the fitted rows, and its limit.
    unseen, unseen_allowed : float
        χ²/N of the rows that were predicted, by noise and uncertainty of the prediction, and its limit.
    """

    channel: str
    fitted: float
    fitted_allowed: float
    unseen: float
    unseen_allowed: float

    @property
    def floors(self) -> float:
        """Size of the residual where the channel is over its limit, by the larger of both [noise floors]; else 0."""
        return math.sqrt(max(self.fitted, self.unseen)) if self.over > 1.0 else 0.0

    @property
    def over(self) -> float:
        """The larger of both over its limit; up to 1 the channel passes."""
        return max(self.fitted / self.fitted_allowed, self.unseen / self.unseen_allowed)


@dataclass(frozen=True)
class Proof:
    """Whether a fit predicts data that were not fitted.

    Attributes
    ----------
    recording : str
        Predicted recordings: those for validation, or those of which parts were left out.
    proven : bool or None
        None where no prediction could be tried.
    reason : str
        ``predicted``: within noise and the uncertainty of the prediction. ``unfixed``: within it only because the fit
        does not determine `causes`. ``event``: within it except for an event there. ``differs``: the unknown in
        `causes` would need another value there. ``resembles``: fit and prediction together look like the term in
        `causes`. ``misfit``: none of these. ``channel``: all rows together are predicted, but those of `channel` are
        not, or do not fit. ``dependence``: what is left of `channel` depends on the variable in `causes`.
        ``no_gain``: the prediction without the findings is as good.
        ``not_tried``: no part could be left out. ``map``: a map was fitted to all recordings.
    left_out : str
        Kind of the parts left out in turn: ``recording``, ``speed``, ``azimuth``, ``time``; empty for a validation.
    parts : int
        Number of parts.
    causes : tuple of str
        See `reason`.
    value, fitted : float or None
        For ``differs``: the value of the unknown that the prediction needs, and that of the fit [`unit`].
    unit : str
        Their unit.
    chi2_per_n, allowed : float
        Of the prediction, and its limit by noise and uncertainty of the prediction.
    channel : str
        Channel in which the error falls most, or is largest where nothing was found.
    before, after, noise : float
        Its error without and with the findings, and its noise [SI]; where parts were left out, the noise with the
        uncertainty of their prediction.
    speed : float
        For ``channel``: spin rate at which the misfit is largest [rad/s].
    channels : tuple of ChannelCheck
        The test of every channel.
    smallest : float
        Smallest misfit that the test of every channel would have shown in four of five cases [noise floors].
    """

    recording: str
    proven: bool | None
    reason: Reason
    left_out: Left = ""
    parts: int = 0
    causes: tuple[str, ...] = ()
    value: float | None = None
    fitted: float | None = None
    unit: str = ""
    chi2_per_n: float = 0.0
    allowed: float = 0.0
    channel: str = ""
    before: float = 0.0
    after: float = 0.0
    noise: float = 0.0
    speed: float = 0.0
    channels: tuple[ChannelCheck, ...] = ()
    smallest: float = 0.0


@dataclass(frozen=True)
class DatedEvent:
    """A change in the middle of a recording.

    Attributes
    ----------
    recording : str
        The recording.
    time, time_error : float
        Its start, from the start of that recording, and the standard error [s].
    end, end_error : float or None
        End of a burst or a trend, and the standard error [s]; None for a step.
    kind : str
        ``step``, ``trend`` or ``burst``.
    channel : str
        The changed quantity, one of `fitting.events.QUANTITIES`.
    size, standard_error : float
        Size of the change and its standard error [`unit`].
    unit : str
        Unit of the size.
    gain : float
        Increase of twice the log likelihood of the recordings.
    ties : tuple of str
        Other quantities whose change explains the recordings equally well.
    """

    recording: str
    time: float
    time_error: float
    end: float | None
    end_error: float | None
    kind: Kind
    channel: str
    size: float
    standard_error: float
    unit: str
    gain: float
    ties: tuple[str, ...] = ()


@dataclass(frozen=True)
class DriftShape:
    """A drift that has a shape.

    Attributes
    ----------
    recording : str
        The recording.
    kind : str
        ``swing``; ``coil_temperature``, ``motor_temperature`` or ``air_temperature``, which it follows; ``after_tilt``:
        it relaxes after every move of the tilt.
    channel : str
        The drifting quantity, one of `fitting.events.QUANTITIES`.
    size, standard_error : float
        Amplitude of the swing; change from the coldest to the warmest window; effect of a tilt of the reference size
        just after the move, in `unit`.
    unit : str
        Unit of the size.
    time, time_error : float
        Period of the swing, or relaxation time, and the standard error [s]; 0 for a temperature.
    temperature_change : float
        From the coldest to the warmest window [K]; 0 for other shapes.
    gain : float
        Increase of twice the log likelihood of the recordings.
    """

    recording: str
    kind: Kind
    channel: str
    size: float
    standard_error: float
    unit: str
    time: float
    time_error: float
    temperature_change: float
    gain: float


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
    drift_shapes: tuple[DriftShape, ...] = ()
    readings: tuple[ReadingFinding, ...] = ()
    hum_unknown: tuple[tuple[str, str], ...] = ()
    setup: tuple[WrongSetup, ...] = ()
    misstated: tuple[Misstated, ...] = ()
    proof: Proof | None = None
    beyond: tuple[Beyond, ...] = ()
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
