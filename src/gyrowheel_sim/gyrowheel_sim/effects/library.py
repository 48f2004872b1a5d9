"""The effects that come with the project, in the order in which they are shown."""

from __future__ import annotations

import sympy as sp

from gyrowheel_sim.effects.declaration import Coefficient, Effect, Law
from gyrowheel_sim.effects.quantities import (
    N_ripple,
    Omega,
    Omega_ref,
    T_coil,
    T_motor,
    T_ref,
    T_winding,
    axis,
    home_x,
    home_y,
    i_motor,
    rho,
    rho_ref,
    theta,
    theta_rate,
    theta_z,
    up,
    up_across,
    z,
    z_rate,
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
_YAW = "turn the rig by 180 deg about the vertical (plan yaw)"
_CONES = "cones at two radii (plan cone): slewing torque shows the gain, not the flexure"
_size2 = z * sp.conjugate(z) / z_ref**2


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
    laws=(Law("rotor_torque", _G * (up * z - sp.I * up_across) / sp.sqrt(1 + z * sp.conjugate(z))),),
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
    validity="any attitude of the rig",
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

WINDAGE_TILT = Effect(
    name="windage_tilt",
    title="drag of the air on the spin grows with the tilt",
    category="air",
    sentence="A tilted rotor narrows its gaps, and the air brakes the spin more than it does in the middle.",
    laws=(Law("axial_torque", -_w * _size2 * _r**_n * _d ** (_n - 1)),),
    coefficients=(
        Coefficient(
            "w",
            "N*m",
            "additional drag torque at the reference tilt, speed and density",
            (0.0002, 0.0006),
            (-0.1, 0.1),
            "assumed: less than half of the drag in the middle",
        ),
        _exponent(1.48, 0.03, 1.45, 1.55),
    ),
    validity="steady tilt up to 5 deg, 1000 to 4000 rpm",
    source="even power series of the drag in the tilt; similarity as for windage",
    look_alikes={"windage": "several tilts at each speed"},
)

(_e,) = _symbols("e")
EDDY_DRAG = Effect(
    name="eddy_drag",
    title="eddy-current drag on the rotor",
    category="motor",
    sentence="Stray fields of the coils' magnets induce currents in the turning rotor that brake it along its own axis.",
    laws=(Law("axial_torque", -_e * Omega),),
    coefficients=(
        Coefficient("e", "N*m*s/rad", "drag torque per spin rate", (2e-6, 1e-5), (-1e-3, 1e-3), "assumed"),
    ),
    validity="fields small enough that the currents follow the speed in proportion",
    source="induction at low magnetic Reynolds number",
    look_alikes={
        "windage": _LOW_PRESSURE,
        "bearing_viscous": "tilts at high speed: eddies brake along the tilted axis, the bearing along the shaft",
    },
)

(_h,) = _symbols("h")
FLEXURE_HYSTERESIS = Effect(
    name="flexure_hysteresis",
    title="hysteresis of the flexures",
    category="flexure",
    sentence="Each bending of a flexure loses a share of its energy that does not depend on how fast it bends.",
    laws=(Law("flexure_torque", -_h * theta_rate / Omega),),
    coefficients=(
        Coefficient(
            "h",
            "N*m/rad",
            "loss stiffness of each flexure",
            (0.0008, 0.005),
            (-0.05, 0.05),
            "assumed: loss factor 0.006 to 0.04",
        ),
    ),
    validity="flexures that bend once a revolution",
    source="structural damping; the average over a revolution is h (z'/Omega - i z)",
    look_alikes={"flexure_damping": "several speeds", "aero_cross": "several speeds"},
)

(_D,) = _symbols("D")
EXTERNAL_DAMPING = Effect(
    name="external_damping",
    title="damping of the tilt in the case",
    category="environment",
    sentence="Eddy currents in the case, or leads, resist the motion of the spin axis through the case.",
    laws=(Law("rotor_torque", -_D * z_rate),),
    coefficients=(
        Coefficient(
            "D", "N*m*s/rad", "torque per tilt rate", (0.002, 0.01), (-0.2, 0.2), "assumed", signed=False
        ),
    ),
    validity="tilt rates up to 1 rad/s",
    source=_BALANCE,
    look_alikes={
        "tilt_rotation": "holds at low speed: a turned sensor turns the holding torque, damping does not"
    },
)

_Ex, _Ey = _symbols("E_x", "E_y")
EARTH_RATE = Effect(
    name="earth_rate",
    title="the Earth turns the rig",
    category="environment",
    sentence="The case turns with the Earth, and the spinning rotor answers as a gyroscope does.",
    laws=(Law("case_rate", _Ex * home_x + _Ey * home_y),),
    coefficients=tuple(
        Coefficient(
            name,
            "rad/s",
            f"horizontal rate of the Earth along the home axis {name[-1]}",
            (2.0e-5, 6.0e-5),
            (-1e-3, 1e-3),
            "7.292e-5 rad/s times the cosine of the latitude",
            signed=True,
        )
        for name in ("E_x", "E_y")
    ),
    validity="rig upright or inverted; the vertical part of the rate is left out",
    source="gyroscopic torque Irz Omega x omega, exact in the case frame",
    look_alikes={"fixed_torque": _YAW},
)

(_s,) = _symbols("s")
TILT_SCALE = Effect(
    name="tilt_scale",
    title="scale error of the tilt sensors",
    category="sensor",
    sentence="The tilt readings are too large or too small by a factor.",
    laws=(Law("tilt_reading", _s * z),),
    coefficients=(
        Coefficient(
            "s", "1", "relative error of the readings", (0.005, 0.03), (-0.3, 0.3), "assumed", signed=True
        ),
    ),
    validity="tilt up to 5 deg",
    source="sensor model",
    look_alikes={
        "coil_gain_error": "nothing on this bench: it takes an external autocollimator to measure the tilt itself"
    },
)

(_alpha,) = _symbols("a")
TILT_ROTATION = Effect(
    name="tilt_rotation",
    title="tilt sensors turned about the case axis",
    category="sensor",
    sentence="The sensors stand turned against the coils, so a torque about one axis seems to answer the other.",
    laws=(Law("tilt_reading", sp.I * _alpha * z),),
    coefficients=(
        Coefficient(
            "a",
            "rad",
            "angle by which the readings are turned",
            (0.005, 0.03),
            (-0.3, 0.3),
            "assumed",
            signed=True,
        ),
    ),
    validity="small angles",
    source="sensor model",
    look_alikes={"aero_cross": "cones: a turned sensor turns the slewing torque, the air hardly acts on it"},
)

_px, _py = _symbols("p_x", "p_y")
COIL_ANISOTROPY = Effect(
    name="coil_anisotropy",
    title="coils of the two axes differ",
    category="actuator",
    sentence="One pair of coils gives more torque per volt than the other, or the pairs are not at right angles.",
    laws=(Law("coil_anisotropy", _px + sp.I * _py),),
    coefficients=(
        Coefficient(
            "p_x",
            "1",
            "half of the relative difference of the torques per volt, x over y",
            (0.01, 0.05),
            (-0.5, 0.5),
            "assumed",
            signed=True,
        ),
        Coefficient(
            "p_y",
            "1",
            "half of the angle by which the pairs are off the right angle",
            (0.01, 0.05),
            (-0.5, 0.5),
            "assumed",
            signed=True,
        ),
    ),
    validity="constant over the recording",
    source="symmetric part of the matrix from voltages to torques",
    look_alikes={"coil_gain_error": "tilts about both axes"},
)

(_tau,) = _symbols("t_L")
COIL_INDUCTANCE = Effect(
    name="coil_inductance",
    title="the coils' torque lags their voltage",
    category="actuator",
    sentence="The inductance of the coils delays their current, and so their torque, by L/R.",
    laws=(Law("coil_lag", _tau),),
    coefficients=(
        Coefficient(
            "t_L",
            "s",
            "time constant L/R of a coil pair",
            (1.0e-4, 4.0e-4),
            (0.0, 2e-3),
            "assumed: 1 to 3 mH",
        ),
    ),
    validity="one time constant for both pairs",
    source="first-order circuit",
    look_alikes={"tilt_rotation": "holds: a lag shows only where the torque changes"},
)

(_m,) = _symbols("m")
MOTOR_HEATING = Effect(
    name="motor_heating",
    title="motor constant changes with the magnets' temperature",
    category="motor",
    sentence="Warm magnets have less field, and so less back-EMF and less torque per ampere.",
    laws=(Law("motor_gain", _m * (T_motor - T_ref)),),
    coefficients=(
        Coefficient(
            "m",
            "1/K",
            "relative change of the motor constant per kelvin",
            (0.0005, 0.002),
            (-0.05, 0.05),
            "NdFeB magnets: -0.0011/K; ferrite: -0.002/K",
            signed=True,
        ),
    ),
    validity="motor at the temperature of the air at the start; temperatures reckoned from the current, to 10 %",
    source="temperature coefficient of remanence; heating by the winding's loss",
    look_alikes={"motor_constant_error": "long runs after a hard spin-up: the motor cools, a constant stays"},
)

(_a2,) = _symbols("a")
WINDING_HEATING = Effect(
    name="winding_heating",
    title="resistance of the motor's winding changes with its temperature",
    category="motor",
    sentence="The current heats the copper of the winding, and the motor needs more voltage for the same current.",
    laws=(Law("winding_resistance", _a2 * (T_winding - T_ref)),),
    coefficients=(
        Coefficient(
            "a",
            "1/K",
            "relative change of the resistance per kelvin",
            (0.002, 0.006),
            (-0.05, 0.05),
            "copper: 0.0039/K",
        ),
    ),
    validity="motor at the temperature of the air at the start; temperatures reckoned from the current, to 10 %",
    source="temperature coefficient of resistance; heating by the winding's loss",
    look_alikes={
        "motor_heating": "changes of speed: the resistance shows with the current, the magnets with the speed"
    },
)

_Sx, _Sy = _symbols("S_x", "S_y")
_turning_S = (_Sx + sp.I * _Sy) * sp.exp(sp.I * theta_z)
STATIC_IMBALANCE = Effect(
    name="static_imbalance",
    title="centre of gravity of the rotor off its spin axis",
    category="gravity",
    sentence="The weight of the rotor acts at a lever that turns with it: a torque once a revolution.",
    laws=(
        Law("rotor_torque", sp.I * up * _turning_S),
        Law("axial_torque", -sp.im(sp.conjugate(_turning_S) * up_across)),
    ),
    coefficients=tuple(
        Coefficient(
            name,
            "N*m",
            f"weight times the offset along {name[-1]} of the shaft",
            (2.0e-5, 2.0e-4),
            (-0.05, 0.05),
            "assumed: 0.9 kg, 2 to 20 micrometres",
            signed=True,
        )
        for name in ("S_x", "S_y")
    ),
    validity="pivot at rest; to first order in the tilt",
    source="torque of the weight about the pivot",
    look_alikes={"runout": "several speeds: a runout needs torque that grows with the square of the speed"},
)

_Rx, _Ry = _symbols("R_x", "R_y")
RUNOUT = Effect(
    name="runout",
    title="runout of the tilt sensors' target",
    category="sensor",
    sentence="The surface that the tilt sensors look at is not square to the spin axis and seems to wobble once a revolution.",
    laws=(Law("tilt_reading", (_Rx + sp.I * _Ry) * sp.exp(sp.I * theta_z)),),
    coefficients=tuple(
        Coefficient(
            name,
            "rad",
            f"angle of the target about {name[-1]} of the shaft",
            (5.0e-5, 5.0e-4),
            (-0.05, 0.05),
            "assumed: 5 to 50 micrometres at the rim",
            signed=True,
        )
        for name in ("R_x", "R_y")
    ),
    validity="both sensors look at the same surface",
    source="sensor model",
    look_alikes={"static_imbalance": "several speeds: the torque of a weight does not depend on the speed"},
)

(_k2,) = _symbols("k")
STIFFNESS_ANISOTROPY = Effect(
    name="stiffness_anisotropy",
    title="the two flexures differ in stiffness",
    category="flexure",
    sentence="A shaft that is stiffer about one of its axes pulls at a held tilt twice a revolution (Remark 1 of the paper).",
    laws=(Law("flexure_torque", -_k2 * axis * theta),),
    coefficients=(
        Coefficient(
            "k",
            "N*m/rad",
            "added to the stiffness of the inner flexure and taken from the outer one",
            (0.004, 0.015),
            (-0.1, 0.1),
            "assumed: 3 to 11 % of the stiffness",
            signed=True,
        ),
    ),
    validity="flexure angle up to 5 deg",
    source="Huo et al. 2016, Remarks 1 and 2; torque -k conj(z) exp(2i theta_z) in the case",
    look_alikes={
        "inertia_anisotropy": "several speeds: the torque of the inertia grows with the square of the speed"
    },
)

(_d2,) = _symbols("d")
INERTIA_ANISOTROPY = Effect(
    name="inertia_anisotropy",
    title="moments of inertia of the rotor across its axis differ",
    category="inertia",
    sentence="A rotor that is not round nutates and pulls at a held tilt twice a revolution (Remark 2 of the paper).",
    laws=(Law("inertia_difference", _d2),),
    coefficients=(
        Coefficient(
            "d",
            "kg*m^2",
            "half of the difference of the moments of inertia, x less y",
            (5.0e-7, 5.0e-6),
            (-1e-4, 1e-4),
            "assumed: 0.05 to 0.5 %",
            signed=True,
        ),
    ),
    validity="rigid rotor",
    source="eq (6) with Irx and Iry apart",
    look_alikes={
        "stiffness_anisotropy": "several speeds: the torque of the inertia grows with the square of the speed"
    },
)

_Cx, _Cy = _symbols("C_x", "C_y")
_phase = N_ripple * theta_z
COGGING = Effect(
    name="cogging",
    title="cogging of the motor",
    category="motor",
    sentence="The magnets of the motor prefer some angles, and the speed ripples several times a revolution.",
    laws=(Law("shaft_torque", _Cx * sp.cos(_phase) + _Cy * sp.sin(_phase)),),
    coefficients=tuple(
        Coefficient(
            name,
            "N*m",
            f"torque in {word} of the ripple's phase",
            (0.001, 0.008),
            (-0.1, 0.1),
            "assumed",
            signed=True,
        )
        for name, word in (("C_x", "the cosine"), ("C_y", "the sine"))
    ),
    validity="one harmonic, whose order is a parameter of the bench",
    source="motor model",
    look_alikes={
        "commutation_ripple": "the current: cogging leaves it alone but for the back-EMF of the ripple"
    },
)

COMMUTATION_RIPPLE = Effect(
    name="commutation_ripple",
    title="ripple of the motor constant",
    category="motor",
    sentence="The commutation makes torque per ampere and back-EMF ripple several times a revolution.",
    laws=(Law("motor_gain", _Cx * sp.cos(_phase) + _Cy * sp.sin(_phase)),),
    coefficients=tuple(
        Coefficient(
            name,
            "1",
            f"relative ripple in {word} of its phase",
            (0.003, 0.03),
            (-0.5, 0.5),
            "assumed",
            signed=True,
        )
        for name, word in (("C_x", "the cosine"), ("C_y", "the sine"))
    ),
    validity="one harmonic, whose order is a parameter of the bench",
    source="motor model",
    look_alikes={"cogging": "the current, which ripples with the back-EMF"},
)

(_Rs,) = _symbols("R_s")
SUPPLY_SAG = Effect(
    name="supply_sag",
    title="the supply falls under the motor's current",
    category="actuator",
    sentence="The internal resistance of the supply takes voltage from motor and coils while the motor draws current.",
    laws=(Law("supply_drop", _Rs * sp.Abs(i_motor)),),
    coefficients=(
        Coefficient("R_s", "ohm", "internal resistance of the supply", (0.2, 1.0), (0.0, 5.0), "assumed"),
    ),
    validity="unregulated drive of the coils",
    source="circuit model",
    look_alikes={"coil_gain_error": "changes of speed, in which the motor draws amperes"},
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
    STIFFNESS_ANISOTROPY,
    INERTIA_ANISOTROPY,
    COGGING,
    COMMUTATION_RIPPLE,
    SUPPLY_SAG,
)
