"""Physical effects: one declaration each, from which simulation, regressors, formula and documentation come."""

from gyrowheel_sim.effects.declaration import Coefficient, Effect, Law
from gyrowheel_sim.effects.registry import EffectValues, get, parse_option, registry, validated

__all__ = ["Coefficient", "Effect", "EffectValues", "Law", "get", "parse_option", "registry", "validated"]
