"""Effects of the flexures and the inertias that swing with them."""

from __future__ import annotations

import sympy as sp

from gyrowheel_sim.effects.declaration import Effect, Law, LawState
from gyrowheel_sim.effects.library.common import CONES, LOW_PRESSURE, amplitude, remembered, symbols
from gyrowheel_sim.effects.quantities import Omega, axis, theta, theta_rate, z, z_ref

(_q,) = symbols("q")

CUBIC_STIFFNESS = Effect(
    name="cubic_stiffness",
    title="stiffness of the flexures changes with their angle",
    category="flexure",
    sentence="Crossed flexures stretch at larger angles, which changes their torque with the cube of the angle.",
    directions=(
        "The flexures soften at larger angles: the restoring torque falls behind by the cube of the angle.",
        "Crossed flexures stretch at larger angles, which adds a restoring torque with the cube of the angle.",
    ),
    laws=(Law("flexure_torque", -_q * theta**3),),
    coefficients=(
        amplitude(
            "q",
            "N*m/rad^3",
            "cubic stiffness of each flexure",
            (0.8, 4.0),
            50.0,
            "assumed: 5 to 25 % more stiffness at 5 deg",
            signed=True,
        ),
    ),
    validity="flexure angle up to 5 deg",
    source="odd power series of the flexure torque; the average over a revolution is (3/4) q |z|^2 z",
    look_alikes={"coil_tilt": CONES},
)


(_C,) = symbols("C")

FLEXURE_DAMPING = Effect(
    name="flexure_damping",
    title="additional viscous damping of the flexures",
    category="flexure",
    sentence="A tilted spinning rotor bends its flexures once a revolution; their loss needs a torque across the tilt.",
    laws=(Law("flexure_torque", -_C * theta_rate),),
    coefficients=(
        amplitude(
            "C", "N*m*s/rad", "damping of each flexure beyond that of the bench file", (3e-6, 2e-5), 1e-3
        ),
    ),
    validity="flexure angle up to 5 deg",
    source="viscous loss at the spin frequency; the average over a revolution is C (z' - i Omega z)",
    look_alikes={"aero_cross": LOW_PRESSURE},
)


(_h,) = symbols("h")

FLEXURE_HYSTERESIS = Effect(
    name="flexure_hysteresis",
    title="hysteresis of the flexures",
    category="flexure",
    sentence="Each bending of a flexure loses a share of its energy that does not depend on how fast it bends.",
    laws=(Law("flexure_torque", -_h * theta_rate / Omega),),
    coefficients=(
        amplitude(
            "h",
            "N*m/rad",
            "loss stiffness of each flexure",
            (0.0008, 0.005),
            0.05,
            "assumed: loss factor 0.006 to 0.04",
        ),
    ),
    validity="flexures that bend once a revolution",
    source="structural damping; the average over a revolution is h (z'/Omega - i z)",
    look_alikes={"flexure_damping": "several speeds", "aero_cross": "several speeds"},
)


(_k,) = symbols("k")
_largest = remembered("m")

STIFFNESS_MEMORY = Effect(
    name="stiffness_memory",
    title="stiffness of the flexures changes with the largest tilt so far",
    category="flexure",
    sentence="A flexure that was bent far is softer afterwards: its stiffness depends on the largest tilt so far.",
    directions=(
        "The flexures are stiffer after they were bent far: the stiffness grows with the largest tilt so far.",
        "The flexures are softer after they were bent far: the stiffness falls with the largest tilt so far.",
    ),
    laws=(Law("rotor_torque", _k * _largest / z_ref * z),),
    # followed within a turn, in which every flexure was bent by the tilt
    states=(LawState("m", "rad", sp.Max(sp.Abs(z) - _largest, 0) * Omega),),
    coefficients=(
        amplitude(
            "k",
            "N*m/rad",
            "loss of stiffness by the reference tilt",
            (0.002, 0.015),
            0.1,
            "assumed: 1.5 to 11 % of the stiffness",
            signed=True,
        ),
    ),
    validity="a joint that was at rest before the recording; it does not recover in it",
    source="Mullins 1969, Softening of rubber by deformation; bedding of a clamp in proportion to the largest bending",
    look_alikes={
        "stiffness_error": "small tilts before and after the largest one (plan survey)",
        "cubic_stiffness": "small tilts before and after the largest one (plan survey)",
        "coil_tilt": "small tilts before and after the largest one (plan survey)",
    },
)


(_k2,) = symbols("k")

STIFFNESS_ANISOTROPY = Effect(
    name="stiffness_anisotropy",
    title="the two flexures differ in stiffness",
    category="flexure",
    sentence="At a held tilt, a joint that is stiffer about one of its axes gives a torque twice a revolution.",
    directions=(
        "The outer flexure is stiffer than the inner one: at a held tilt the torque varies twice a revolution.",
        "The inner flexure is stiffer than the outer one: at a held tilt the torque varies twice a revolution.",
    ),
    laws=(Law("flexure_torque", -_k2 * axis * theta),),
    coefficients=(
        amplitude(
            "k",
            "N*m/rad",
            "added to the stiffness of the inner flexure and taken from the outer one",
            (0.004, 0.015),
            0.1,
            "assumed: 3 to 11 % of the stiffness",
            signed=True,
            possible=(-0.1343, 0.1343),
            possible_source="no stiffness is below zero (the stiffness in the bench file)",
        ),
    ),
    validity="flexure angle up to 5 deg",
    source="Huo et al. 2016, Remarks 1 and 2; torque -k conj(z) exp(2i theta_z) in the case",
    look_alikes={
        "inertia_anisotropy": "several speeds: the torque of the inertia grows with the square of the speed"
    },
)


(_d2,) = symbols("d")

INERTIA_ANISOTROPY = Effect(
    name="inertia_anisotropy",
    title="moments of inertia of the rotor across its axis differ",
    category="inertia",
    sentence="At a held tilt, a rotor with unequal transverse moments of inertia gives a torque twice a revolution.",
    directions=(
        "The rotor has more inertia about its y axis: at a held tilt the torque varies twice a revolution.",
        "The rotor has more inertia about its x axis: at a held tilt the torque varies twice a revolution.",
    ),
    laws=(Law("inertia_difference", _d2),),
    coefficients=(
        amplitude(
            "d",
            "kg*m^2",
            "half of the difference of the moments of inertia, x less y",
            (5.0e-7, 5.0e-6),
            1e-4,
            "assumed: 0.05 to 0.5 %",
            signed=True,
        ),
    ),
    validity="rigid rotor",
    source="eq (6) with unequal Irx and Iry",
    look_alikes={
        "stiffness_anisotropy": "several speeds: the torque of the inertia grows with the square of the speed"
    },
)
