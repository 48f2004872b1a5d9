"""Instruments that are not as stated, as findings of a diagnosis: one for every parameter that is wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import registry
from gyrowheel_sim.effects.targets import INSTRUMENT_PARAMETERS

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.result import EffectFinding, TieReport

#: Channels of the instruments, as the parameters of the bench begin.
CHANNELS = ("tilt", "spin_angle", "coil_voltage", "motor_voltage", "motor_current")


@dataclass(frozen=True)
class InstrumentFinding:
    """An instrument that is not as the bench states it.

    Attributes
    ----------
    name : str
        What ``gyrowheel model add`` takes: an effect of the category ``instrument``.
    channel : str
        The reading, say ``coil_voltage``.
    quantity : str
        What is wrong with it: the parameter of the bench without the channel, say ``delay``.
    value, standard_error : float
        The parameter as found [`unit`].
    stated : float
        The parameter as the bench states it.
    unit : str
        SI unit.
    delta_chi2 : float
        By how much chi-squared is worse without it, all else fitted again.
    ties : list of TieReport
        What explains the recordings as well: instruments or effects.
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
    ties: list[TieReport]
    title: str = ""
    sentence: str = ""

    @property
    def deviation(self) -> float:
        """By how much it is off [`unit`]."""
        return self.value - self.stated


def is_instrument(name: str) -> bool:
    """Whether a finding of this name is an instrument that is not as stated."""
    effect = registry().get(name)
    return effect is not None and effect.category == "instrument"


def instrument_findings(finding: EffectFinding, bench: Bench) -> list[InstrumentFinding]:
    """Return what is wrong with an instrument, one finding for each of its parameters.

    Parameters
    ----------
    finding : EffectFinding
        The effect of the category ``instrument``, as fitted.
    bench : Bench
        The bench as stated.
    """
    result = []
    for law in registry()[finding.name].laws:
        if law.target not in INSTRUMENT_PARAMETERS:
            continue
        (symbol,) = law.expression.free_symbols
        estimate, stated = finding.coefficients[symbol.name], bench.value(law.target)
        channel = channel_of(law.target)
        result.append(
            InstrumentFinding(
                name=finding.name,
                channel=channel,
                quantity=law.target.removeprefix(f"{channel}_"),
                value=stated + estimate.value,
                standard_error=estimate.standard_error,
                stated=stated,
                unit=bench.parameters[law.target].unit,
                delta_chi2=finding.delta_chi2,
                ties=finding.ties,
                title=finding.effect_title,
                sentence=finding.effect_sentence,
            )
        )
    return result


def channel_of(parameter: str) -> str:
    """Return the channel to which a parameter of an instrument belongs; the encoder reads the angle of the shaft."""
    if parameter.startswith("encoder_"):
        return "spin_angle"
    return next(channel for channel in CHANNELS if parameter.startswith(f"{channel}_"))
