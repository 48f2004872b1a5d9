"""The effects that come with the project, in the order in which they are shown."""

from __future__ import annotations

import sympy as sp

from gyrowheel_sim.effects.declaration import Coefficient, Effect, Law
from gyrowheel_sim.effects.quantities import (
    Omega,
    Omega_ref,
    T_coil,
    T_ref,
    rho,
    rho_ref,
    theta,
    theta_rate,
    up,
    z,
    z_ref,
)

_r = Omega / Omega_ref
_d = rho / rho_ref
_BALANCE = (
    "average torque balance of the flex-gimbal rotor in the case frame, derived in gyrowheel_sim.dynamics"
)
_CFD = "assumed: usual size from steady CFD of the published rotor and case (Huo et al. 2016, Table 2) at 3500 rpm"
_LOW_PRESSURE = "change the air: repeat speeds and tilts at low pressure (plan air_density)"
_INVERT = "turn the rig upside down (plan inverted)"


def _symbols(*names: str) -> tuple[sp.Symbol, ...]:
    return tuple(sp.Symbol(name, real=True) for name in names)


def _exponent(usual: float, uncertainty: float, low: float, high: float) -> Coefficient:
    return Coefficient(
        "n",
        "1",
        "exponent of the spin rate; by similarity the density enters with n - 1",
        (low, high),
        (0.5, 3.0),
        _CFD,
        shape=usual,
        shape_uncertainty=uncertainty,
    )


_k, _c, _n, _w = _symbols("k", "c", "n", "w")

AERO_RESTORING = Effect(
    name="aero_restoring",
    title="restoring torque of the air on the tilted rotor",
    category="air",
    sentence="Pressure in the end gaps turns the tilted rotor back towards the case axis, in phase with the tilt.",
    laws=(Law("rotor_torque", -_k * _r**_n * _d ** (_n - 1) * z),),
    coefficients=(
        Coefficient(
            "k",
            "N*m/rad",
            "torque per tilt at the reference speed and density",
            (0.010, 0.040),
            (-0.5, 0.5),
            _CFD,
        ),
        _exponent(2.05, 0.03, 2.0, 2.1),
    ),
    validity="steady tilt up to 5 deg, 1000 to 4000 rpm, 0.2 to 1.2 of the reference density",
    source="Huo et al. 2016, Section 3; similarity T = rho Omega^2 R^5 f(Re)",
    look_alikes={
        "gimbal_inertia_error": _LOW_PRESSURE,
        "stiffness_error": "several speeds",
        "gravity_offset": "several speeds",
    },
)

AERO_CROSS = Effect(
    name="aero_cross",
    title="cross torque of the air on the tilted rotor",
    category="air",
    sentence="The swirling air drags the tilted rotor round the case axis, a quarter turn ahead of the tilt.",
    laws=(Law("rotor_torque", sp.I * _c * _r**_n * _d ** (_n - 1) * z),),
    coefficients=(
        Coefficient(
            "c",
            "N*m/rad",
            "torque per tilt at the reference speed and density",
            (0.003, 0.010),
            (-0.5, 0.5),
            _CFD,
        ),
        _exponent(1.98, 0.05, 1.9, 2.06),
    ),
    validity="steady tilt up to 5 deg, 1000 to 4000 rpm, 0.2 to 1.2 of the reference density",
    source="Huo et al. 2016, Section 3; similarity T = rho Omega^2 R^5 f(Re)",
    look_alikes={"flexure_damping": _LOW_PRESSURE, "windage": "spin channel"},
)

WINDAGE = Effect(
    name="windage",
    title="drag of the air on the spin",
    category="air",
    sentence="Shear of the air in the gaps brakes the spin; along a tilted axis half of it shows in the tilt channel.",
    laws=(Law("axial_torque", -_w * _r**_n * _d ** (_n - 1)),),
    coefficients=(
        Coefficient(
            "w", "N*m", "drag torque at the reference speed and density", (0.0008, 0.0013), (-0.1, 0.1), _CFD
        ),
        _exponent(1.48, 0.03, 1.45, 1.55),
    ),
    validity="laminar separate boundary layers (Daily & Nece regime II), 1000 to 4000 rpm",
    source="Daily & Nece 1960; Bilgen & Boulos 1973; Huo et al. 2016, Section 3",
    look_alikes={"bearing_viscous": _LOW_PRESSURE, "bearing_coulomb": "coast-down over many speeds"},
)

_T, _b = _symbols("T", "b")
BEARING_COULOMB = Effect(
    name="bearing_coulomb",
    title="additional Coulomb friction of the spin bearing",
    category="bearing",
    sentence="Dry friction brakes the spin with a torque that does not depend on the speed.",
    laws=(Law("shaft_torque", -_T),),
    coefficients=(
        Coefficient(
            "T",
            "N*m",
            "friction torque beyond that of the bench file",
            (0.0008, 0.003),
            (-0.02, 0.02),
            "assumed",
        ),
    ),
    validity="shaft turning forward",
    source=_BALANCE,
    look_alikes={"windage": "coast-down over many speeds"},
)

BEARING_VISCOUS = Effect(
    name="bearing_viscous",
    title="additional viscous friction of the spin bearing",
    category="bearing",
    sentence="The lubricant brakes the spin in proportion to the speed.",
    laws=(Law("shaft_torque", -_b * Omega),),
    coefficients=(
        Coefficient(
            "b",
            "N*m*s/rad",
            "friction coefficient beyond that of the bench file",
            (2e-6, 1e-5),
            (-1e-3, 1e-3),
            "assumed",
        ),
    ),
    validity="turning shaft, constant lubricant temperature",
    source=_BALANCE,
    look_alikes={"windage": _LOW_PRESSURE},
)

(_g,) = _symbols("g")
COIL_TILT = Effect(
    name="coil_tilt",
    title="torque constant of the coils changes with tilt",
    category="actuator",
    sentence="At a tilt the coils leave the uniform part of the magnets' field, and a volt gives less torque.",
    laws=(Law("coil_gain", _g * z * sp.conjugate(z) / z_ref**2),),
    coefficients=(
        Coefficient(
            "g",
            "1",
            "relative change of the torque per volt at the reference tilt",
            (0.03, 0.10),
            (-0.9, 0.9),
            "assumed; Huo et al. 2016, Section 4 (moment coefficients vary with tilt)",
            signed=True,
        ),
    ),
    validity="tilt up to 5 deg",
    source="even power series of the field about the centre",
    look_alikes={
        "cubic_stiffness": "cones at two radii (plan cone): slewing torque shows the gain, not the flexure"
    },
)

(_a,) = _symbols("a")
COIL_HEATING = Effect(
    name="coil_heating",
    title="torque constant of the coils changes with their temperature",
    category="actuator",
    sentence="Warm coils have more resistance and warm magnets less field, so a volt gives less torque.",
    laws=(Law("coil_gain", _a * (T_coil - T_ref)),),
    coefficients=(
        Coefficient(
            "a",
            "1/K",
            "relative change of the torque per volt per kelvin",
            (0.001, 0.004),
            (-0.05, 0.05),
            "copper: -0.0039/K on a voltage drive; NdFeB magnets: -0.0011/K",
            signed=True,
        ),
    ),
    validity="within 60 K of the reference temperature",
    source="temperature coefficient of resistance and remanence",
    look_alikes={"coil_gain_error": "pre-heat the coils by 20 K (plan preheat)"},
)

(_q,) = _symbols("q")
CUBIC_STIFFNESS = Effect(
    name="cubic_stiffness",
    title="flexures stiffen with their angle",
    category="flexure",
    sentence="Crossed flexures stretch at larger angles, which adds a restoring torque with the cube of the angle.",
    laws=(Law("flexure_torque", -_q * theta**3),),
    coefficients=(
        Coefficient(
            "q",
            "N*m/rad^3",
            "cubic stiffness of each flexure",
            (0.8, 4.0),
            (-50.0, 50.0),
            "assumed: 5 to 25 % more stiffness at 5 deg",
            signed=True,
        ),
    ),
    validity="flexure angle up to 5 deg",
    source="odd power series of the flexure torque; the average over a revolution is (3/4) q |z|^2 z",
    look_alikes={
        "coil_tilt": "cones at two radii (plan cone): slewing torque shows the gain, not the flexure"
    },
)

(_C,) = _symbols("C")
FLEXURE_DAMPING = Effect(
    name="flexure_damping",
    title="additional viscous damping of the flexures",
    category="flexure",
    sentence="A tilted spinning rotor bends its flexures once a revolution; their loss needs a torque across the tilt.",
    laws=(Law("flexure_torque", -_C * theta_rate),),
    coefficients=(
        Coefficient(
            "C",
            "N*m*s/rad",
            "damping of each flexure beyond that of the bench file",
            (3e-6, 2e-5),
            (-1e-3, 1e-3),
            "assumed",
        ),
    ),
    validity="flexure angle up to 5 deg",
    source="viscous loss at the spin frequency; the average over a revolution is C (z' - i Omega z)",
    look_alikes={"aero_cross": _LOW_PRESSURE},
)

(_G,) = _symbols("G")
GRAVITY_OFFSET = Effect(
    name="gravity_offset",
    title="centre of gravity of the rotor off the pivot, along the spin axis",
    category="gravity",
    sentence="The weight of the rotor acts at a lever along the spin axis and turns the tilted rotor over, or back.",
    laws=(Law("rotor_torque", _G * up * z / sp.sqrt(1 + z * sp.conjugate(z))),),
    coefficients=(
        Coefficient(
            "G",
            "N*m/rad",
            "mass times g times the offset of the centre of gravity above the pivot",
            (0.0008, 0.006),
            (-0.2, 0.2),
            "assumed: 0.9 kg, 0.1 to 0.7 mm",
            signed=True,
        ),
    ),
    validity="spin axis vertical, up or down",
    source="torque of the weight about the pivot",
    look_alikes={"stiffness_error": _INVERT},
)

_Fx, _Fy = _symbols("F_x", "F_y")
FIXED_TORQUE = Effect(
    name="fixed_torque",
    title="constant torque on the rotor in the case frame",
    category="gravity",
    sentence="A lead or a stray magnetic field pulls the rotor with a torque that no tilt or speed changes.",
    laws=(Law("rotor_torque", _Fx + sp.I * _Fy),),
    coefficients=(
        Coefficient(
            "F_x", "N*m", "torque about case x", (0.0008, 0.003), (-0.05, 0.05), "assumed", signed=True
        ),
        Coefficient(
            "F_y", "N*m", "torque about case y", (0.0008, 0.003), (-0.05, 0.05), "assumed", signed=True
        ),
    ),
    validity="rig not turned",
    source=_BALANCE,
    look_alikes={"tilt_bias": "several speeds: the holding torque changes, the constant torque does not"},
)

_Bx, _By = _symbols("B_x", "B_y")
TILT_BIAS = Effect(
    name="tilt_bias",
    title="zero error of the tilt sensors",
    category="sensor",
    sentence="The tilt readings are off by a constant, so the rotor is held at a tilt other than the one shown.",
    laws=(Law("tilt_reading", _Bx + sp.I * _By),),
    coefficients=(
        Coefficient(
            "B_x", "rad", "zero error about case x", (0.001, 0.006), (-0.05, 0.05), "assumed", signed=True
        ),
        Coefficient(
            "B_y", "rad", "zero error about case y", (0.001, 0.006), (-0.05, 0.05), "assumed", signed=True
        ),
    ),
    validity="constant over the recording",
    source="sensor model",
    look_alikes={"fixed_torque": "several speeds: the holding torque changes, the constant torque does not"},
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
)
