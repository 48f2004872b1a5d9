"""Findings of a diagnosis with their evidence: effects, instruments, formulas, ties, and the test to run next."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.estimates import Estimate
    from gyrowheel_analysis.residuals.growth import Growth


@dataclass(frozen=True)
class TieReport:
    """A term, or two together, that explain the recordings equally well, and the test that would separate them.

    Attributes
    ----------
    name : str
        The term: an effect, the error of a bench parameter (see `fitting.fit.ERRORS`), or a free form. Two together are
        joined by `` + ``.
    effect_title : str
        Title of the effect, of two both; the name of the error of a bench parameter; empty for a form.
    delta_chi2 : float
        Excess of its chi-squared; of a form that of twice the log likelihood. That of two together is negative, by
        about the price of a further term.
    separating_plan : str or None
        None where no shipped plan separates the two.
    expected_separation, minutes : float or None
        Expected difference of chi-squared after that plan, and its length.
    in_model : bool
        Whether the model has the effect already, with another size.
    unusual : bool
        Whether it would need far more than its usual size.
    form : FreeForm, or None
        The free form, fitted in the place of the other.
    """

    name: str
    effect_title: str
    delta_chi2: float
    separating_plan: str | None
    expected_separation: float | None
    minutes: float | None
    in_model: bool = False
    unusual: bool = False
    form: FreeForm | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The term, or the two."""
        return tuple(self.name.split(" + "))


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
    added instead. `ties` are other forms that describe the recordings as well, likeliest first.
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
    ties: tuple[TieReport, ...] = ()


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
