"""Instruments that are not as stated, as findings of a diagnosis: one for every parameter that is wrong."""

from __future__ import annotations

from gyrowheel_analysis.diagnosis.result import EffectFinding, InstrumentFinding
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import registry
from gyrowheel_sim.effects.targets import INSTRUMENT_PARAMETERS

#: Channels of the instruments, as the parameters of the bench begin.
CHANNELS = ("tilt", "spin_angle", "coil_voltage", "motor_voltage", "motor_current")


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
