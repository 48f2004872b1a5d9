"""The library of effects.

It contains every `Effect` that a module of this folder defines: a new effect needs only its declaration.
"""

from __future__ import annotations

import importlib
import pkgutil

from gyrowheel_sim.effects.declaration import Effect

#: Effects in fixed order, in which they are shown and a seed of a blind test draws. The others follow by module.
_FIRST = (
    "aero_restoring", "aero_cross", "windage", "bearing_coulomb", "bearing_viscous", "coil_tilt",
    "coil_heating", "cubic_stiffness", "flexure_damping", "gravity_offset", "fixed_torque", "tilt_bias",
    "windage_tilt", "eddy_drag", "flexure_hysteresis", "external_damping", "earth_rate", "tilt_scale",
    "tilt_rotation", "coil_anisotropy", "coil_inductance", "motor_heating", "winding_heating",
    "static_imbalance", "runout", "target_flatness", "stiffness_anisotropy", "inertia_anisotropy", "cogging",
    "commutation_ripple", "supply_sag",
)  # fmt: skip


def _declared() -> tuple[Effect, ...]:
    found: dict[str, Effect] = {}
    for module in sorted(info.name for info in pkgutil.iter_modules(__path__)):
        for value in vars(importlib.import_module(f"{__name__}.{module}")).values():
            if isinstance(value, Effect) and found.setdefault(value.name, value) is not value:
                raise ValueError(f"effects.library.{module}: the name {value.name} is taken")
    return (*(found.pop(name) for name in _FIRST), *found.values())


LIBRARY: tuple[Effect, ...] = _declared()
