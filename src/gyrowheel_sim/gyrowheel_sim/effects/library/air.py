"""Effects of torques and drag of the air."""

from __future__ import annotations

import sympy as sp

from gyrowheel_sim.effects.declaration import Effect, Law
from gyrowheel_sim.effects.library.common import (
    CFD,
    LOW_PRESSURE,
    amplitude,
    density_ratio,
    exponent,
    speed_ratio,
    symbols,
    tilt_squared,
)
from gyrowheel_sim.effects.quantities import z

_k, _c, _n, _w = symbols("k", "c", "n", "w")

AERO_RESTORING = Effect(
    name="aero_restoring",
    title="restoring torque of the air on the tilted rotor",
    category="air",
    sentence="Pressure in the end gaps turns the tilted rotor back towards the case axis, in phase with the tilt.",
    laws=(Law("rotor_torque", -_k * speed_ratio**_n * density_ratio ** (_n - 1) * z),),
    coefficients=(
        amplitude(
            "k", "N*m/rad", "torque per tilt at the reference speed and density", (0.010, 0.040), 0.5, CFD
        ),
        exponent(2.05, 0.03, 2.0, 2.1),
    ),
    validity="steady tilt up to 5 deg, 1000 to 4000 rpm, 0.2 to 1.2 of the reference density",
    source="Huo et al. 2016, Section 3; similarity T = rho Omega^2 R^5 f(Re)",
    look_alikes={
        "gimbal_inertia_error": LOW_PRESSURE,
        "stiffness_error": "several speeds",
        "gravity_offset": "several speeds",
    },
)


AERO_CROSS = Effect(
    name="aero_cross",
    title="cross torque of the air on the tilted rotor",
    category="air",
    sentence="The swirling air drags the tilted rotor round the case axis, a quarter turn ahead of the tilt.",
    laws=(Law("rotor_torque", sp.I * _c * speed_ratio**_n * density_ratio ** (_n - 1) * z),),
    coefficients=(
        amplitude(
            "c", "N*m/rad", "torque per tilt at the reference speed and density", (0.003, 0.010), 0.5, CFD
        ),
        exponent(1.98, 0.05, 1.9, 2.06),
    ),
    validity="steady tilt up to 5 deg, 1000 to 4000 rpm, 0.2 to 1.2 of the reference density",
    source="Huo et al. 2016, Section 3; similarity T = rho Omega^2 R^5 f(Re)",
    look_alikes={"flexure_damping": LOW_PRESSURE, "windage": "spin channel"},
)


WINDAGE = Effect(
    name="windage",
    title="drag of the air on the spin",
    category="air",
    sentence="Shear of the air in the gaps brakes the spin; along a tilted axis half of it shows in the tilt channel.",
    laws=(Law("axial_torque", -_w * speed_ratio**_n * density_ratio ** (_n - 1)),),
    coefficients=(
        amplitude("w", "N*m", "drag torque at the reference speed and density", (0.0008, 0.0013), 0.1, CFD),
        exponent(1.48, 0.03, 1.45, 1.55),
    ),
    validity="laminar separate boundary layers (Daily & Nece regime II), 1000 to 4000 rpm",
    source="Daily & Nece 1960; Bilgen & Boulos 1973; Huo et al. 2016, Section 3",
    look_alikes={"bearing_viscous": LOW_PRESSURE, "bearing_coulomb": "coast-down over many speeds"},
)


WINDAGE_TILT = Effect(
    name="windage_tilt",
    title="drag of the air on the spin changes with the tilt",
    category="air",
    sentence="A tilted rotor changes the flow in its gaps, and with it the drag of the air on the spin.",
    directions=(
        "A tilted rotor changes the flow in its gaps: the air brakes the spin less than in the middle.",
        "A tilted rotor changes the flow in its gaps: the air brakes the spin more than in the middle.",
    ),
    laws=(Law("axial_torque", -_w * tilt_squared * speed_ratio**_n * density_ratio ** (_n - 1)),),
    coefficients=(
        amplitude(
            "w",
            "N*m",
            "additional drag torque at the reference tilt, speed and density",
            (0.0001, 0.0006),
            0.1,
            "own flow computations: -0.15 mN*m (see the page of the air); assumed otherwise",
            signed=True,
        ),
        exponent(1.48, 0.03, 1.45, 1.55),
    ),
    validity="steady tilt up to 5 deg, 1000 to 4000 rpm",
    source="even power series of the drag in the tilt; similarity as for windage",
    look_alikes={"windage": "several tilts at each speed"},
)
