"""Physical effects: one declaration each, from which simulation, regressors, formula and documentation come."""

from gyrowheel_sim.effects.declaration import Coefficient, Effect, EffectValues, Law, LawState
from gyrowheel_sim.effects.registry import get, parse_option, physical, registry, remembering, validated
from gyrowheel_sim.effects.user_defined import effect_from_mapping, effect_to_mapping
from gyrowheel_sim.effects.user_defined_line import effect_from_text

__all__ = [
    "Coefficient", "Effect", "EffectValues", "Law", "LawState", "effect_from_mapping", "effect_from_text",
    "effect_to_mapping", "get", "parse_option", "physical", "registry", "remembering",
    "validated",
]  # fmt: skip
