"""The effects that come with the project, in the order in which they are shown."""

from __future__ import annotations

from gyrowheel_sim.effects.declaration import Effect
from gyrowheel_sim.effects.library.air import AERO_CROSS, AERO_RESTORING, WINDAGE, WINDAGE_TILT
from gyrowheel_sim.effects.library.coils import (
    COIL_ANISOTROPY,
    COIL_HEATING,
    COIL_INDUCTANCE,
    COIL_TILT,
    SUPPLY_SAG,
)
from gyrowheel_sim.effects.library.drive import (
    BEARING_COULOMB,
    BEARING_VISCOUS,
    COGGING,
    COMMUTATION_RIPPLE,
    EDDY_DRAG,
    MOTOR_HEATING,
    WINDING_HEATING,
)
from gyrowheel_sim.effects.library.flexures import (
    CUBIC_STIFFNESS,
    FLEXURE_DAMPING,
    FLEXURE_HYSTERESIS,
    INERTIA_ANISOTROPY,
    STIFFNESS_ANISOTROPY,
)
from gyrowheel_sim.effects.library.sensors import (
    RUNOUT,
    TARGET_FLATNESS,
    TILT_BIAS,
    TILT_ROTATION,
    TILT_SCALE,
)
from gyrowheel_sim.effects.library.surroundings import (
    EARTH_RATE,
    EXTERNAL_DAMPING,
    FIXED_TORQUE,
    GRAVITY_OFFSET,
    STATIC_IMBALANCE,
)

LIBRARY: tuple[Effect, ...] = (
    AERO_RESTORING,
    AERO_CROSS,
    WINDAGE,
    BEARING_COULOMB,
    BEARING_VISCOUS,
    COIL_TILT,
    COIL_HEATING,
    CUBIC_STIFFNESS,
    FLEXURE_DAMPING,
    GRAVITY_OFFSET,
    FIXED_TORQUE,
    TILT_BIAS,
    WINDAGE_TILT,
    EDDY_DRAG,
    FLEXURE_HYSTERESIS,
    EXTERNAL_DAMPING,
    EARTH_RATE,
    TILT_SCALE,
    TILT_ROTATION,
    COIL_ANISOTROPY,
    COIL_INDUCTANCE,
    MOTOR_HEATING,
    WINDING_HEATING,
    STATIC_IMBALANCE,
    RUNOUT,
    TARGET_FLATNESS,
    STIFFNESS_ANISOTROPY,
    INERTIA_ANISOTROPY,
    COGGING,
    COMMUTATION_RIPPLE,
    SUPPLY_SAG,
)
