"""Effects of the spin bearing and the motor."""

from __future__ import annotations

import sympy as sp

from gyrowheel_sim.effects.declaration import Effect, Law, LawState
from gyrowheel_sim.effects.library.common import (
    BALANCE,
    LOW_PRESSURE,
    amplitude,
    constant,
    remembered,
    speed_ratio,
    symbols,
)
from gyrowheel_sim.effects.quantities import N_ripple, Omega, T_motor, T_ref, T_winding, theta_z

_T, _b = symbols("T", "b")

BEARING_COULOMB = Effect(
    name="bearing_coulomb",
    title="additional Coulomb friction of the spin bearing",
    category="bearing",
    sentence="Dry friction brakes the spin with a torque that does not depend on the speed.",
    laws=(Law("shaft_torque", -_T),),
    coefficients=(
        amplitude("T", "N*m", "friction torque beyond that of the bench file", (0.0008, 0.003), 0.02),
    ),
    validity="shaft turning forward",
    source=BALANCE,
    look_alikes={"windage": "coast-down over many speeds"},
)


BEARING_VISCOUS = Effect(
    name="bearing_viscous",
    title="additional viscous friction of the spin bearing",
    category="bearing",
    sentence="The lubricant brakes the spin in proportion to the speed.",
    laws=(Law("shaft_torque", -_b * Omega),),
    coefficients=(
        amplitude("b", "N*m*s/rad", "friction coefficient beyond that of the bench file", (2e-6, 1e-5), 1e-3),
    ),
    validity="turning shaft, constant lubricant temperature",
    source=BALANCE,
    look_alikes={"windage": LOW_PRESSURE},
)


_v, _tau = symbols("v", "tau")
_warmth = remembered("s")

GREASE_WARMING = Effect(
    name="grease_warming",
    title="viscous friction of the bearing changes as its grease warms",
    category="bearing",
    sentence="The loss of the spin warms the grease within minutes and thins it: its friction lags behind the speed.",
    directions=(
        "The bearing brakes more as it warms: not what warm grease does, rather a preload that grows.",
        "The loss of the spin warms the grease within minutes and thins it: its friction lags behind the speed.",
    ),
    laws=(Law("shaft_torque", _v * _warmth * Omega),),
    states=(LawState("s", "1", (speed_ratio**2 - _warmth) / _tau),),
    coefficients=(
        amplitude(
            "v",
            "N*m*s/rad",
            "friction coefficient that is lost in the long run at the reference speed",
            (1e-6, 6e-6),
            1e-3,
            "assumed: a mineral grease loses half of its viscosity in 12 K",
            signed=True,
        ),
        constant(
            "tau", "s", "time in which the bearing warms", 60.0, 40.0, (3.0, 2e3), "assumed: a small bearing"
        ),
    ),
    validity="bearing at the temperature of the room at the start",
    source="Walther's law (ASTM D341) to first order; loss in proportion to the square of the speed, one thermal mass",
    look_alikes={
        "bearing_run_in": "a second run after a rest of minutes: what warmed has cooled, what ran in has not",
        "bearing_viscous": "the same speed early and late (plan survey)",
        "windage": "the same speed early and late (plan survey)",
    },
)


_f, _w, _rest = symbols("f", "w", "t_r")
_fresh = remembered("s")

BEARING_RUN_IN = Effect(
    name="bearing_run_in",
    title="friction of the bearing runs in, and comes back at rest",
    category="bearing",
    sentence="Fresh grease is pushed out of the way of the balls in some thousand turns, and flows back at rest.",
    laws=(Law("shaft_torque", -_f * _fresh),),
    states=(LawState("s", "1", (1 - _fresh) / _rest - _fresh * speed_ratio / _w, sp.S.One),),
    coefficients=(
        amplitude("f", "N*m", "additional friction of the fresh bearing", (0.0008, 0.004), 0.05),
        constant("w", "s", "time in which it runs in at the reference speed", 40.0, 25.0, (3.0, 2e3)),
        constant("t_r", "s", "time in which it comes back at rest", 1500.0, 500.0, (100.0, 1e5)),
    ),
    validity="bearing at rest for long before the recording",
    source="Lugt 2009, A review on grease lubrication in rolling bearings (churning phase); reflow of first order",
    look_alikes={
        "grease_warming": "a second run after a rest of minutes: what warmed has cooled, what ran in has not",
        "bearing_coulomb": "the same speed early and late (plan survey)",
    },
)


(_e,) = symbols("e")

EDDY_DRAG = Effect(
    name="eddy_drag",
    title="eddy-current drag on the rotor",
    category="motor",
    sentence="Stray fields induce currents in the turning rotor that brake it along its own axis.",
    laws=(Law("axial_torque", -_e * Omega),),
    coefficients=(amplitude("e", "N*m*s/rad", "drag torque per spin rate", (2e-6, 1e-5), 1e-3),),
    validity="fields small enough that the currents follow the speed in proportion",
    source="induction at low magnetic Reynolds number",
    look_alikes={
        "windage": LOW_PRESSURE,
        "bearing_viscous": "tilts at high speed: eddies brake along the tilted axis, the bearing along the shaft",
    },
)


(_m,) = symbols("m")

MOTOR_HEATING = Effect(
    name="motor_heating",
    title="motor constant changes with the magnets' temperature",
    category="motor",
    sentence="Temperature changes the field of the motor's magnets, and so back-EMF and torque per ampere.",
    directions=(
        "Warm magnets have less field, and so less back-EMF and less torque per ampere.",
        "Back-EMF and torque per ampere grow as the motor gets warmer: magnets alone do the opposite.",
    ),
    laws=(Law("motor_gain", _m * (T_motor - T_ref)),),
    coefficients=(
        amplitude(
            "m",
            "1/K",
            "relative change of the motor constant per kelvin",
            (0.0005, 0.002),
            0.05,
            "NdFeB magnets: -0.0011/K; ferrite: -0.002/K",
            signed=True,
        ),
    ),
    validity="motor at air temperature at the start; temperatures computed from the current, to 10 %",
    source="temperature coefficient of remanence; heating by the winding's loss",
    look_alikes={"motor_constant_error": "long runs after a hard spin-up: the motor cools, a constant stays"},
)


(_a2,) = symbols("a")

WINDING_HEATING = Effect(
    name="winding_heating",
    title="resistance of the winding changes with its temperature",
    category="motor",
    sentence="The current heats the copper of the winding, and the motor needs more voltage for the same current.",
    laws=(Law("winding_resistance", _a2 * (T_winding - T_ref)),),
    coefficients=(
        amplitude(
            "a",
            "1/K",
            "relative change of the resistance per kelvin",
            (0.002, 0.006),
            0.05,
            "copper: 0.0039/K",
        ),
    ),
    validity="motor at air temperature at the start; temperatures computed from the current, to 10 %",
    source="temperature coefficient of resistance; heating by the winding's loss",
    look_alikes={
        "motor_heating": "changes of speed: the resistance shows with the current, the magnets with the speed"
    },
)


_Cx, _Cy = symbols("C_x", "C_y")

_phase = N_ripple * theta_z

COGGING = Effect(
    name="cogging",
    title="cogging of the motor",
    category="motor",
    sentence="The magnets of the motor prefer some angles, and the speed ripples several times a revolution.",
    laws=(Law("shaft_torque", _Cx * sp.cos(_phase) + _Cy * sp.sin(_phase)),),
    coefficients=tuple(
        amplitude(name, "N*m", f"torque in {word} of the ripple's phase", (0.001, 0.008), 0.1, signed=True)
        for name, word in (("C_x", "the cosine"), ("C_y", "the sine"))
    ),
    validity="one harmonic, whose order is a parameter of the bench",
    source="motor model",
    look_alikes={
        "commutation_ripple": "the current: cogging changes it only by the back-EMF of the speed ripple"
    },
)


COMMUTATION_RIPPLE = Effect(
    name="commutation_ripple",
    title="ripple of the motor constant",
    category="motor",
    sentence="The commutation makes torque per ampere and back-EMF ripple several times a revolution.",
    laws=(Law("motor_gain", _Cx * sp.cos(_phase) + _Cy * sp.sin(_phase)),),
    coefficients=tuple(
        amplitude(name, "1", f"relative ripple in {word} of its phase", (0.003, 0.03), 0.5, signed=True)
        for name, word in (("C_x", "the cosine"), ("C_y", "the sine"))
    ),
    validity="one harmonic, whose order is a parameter of the bench",
    source="motor model",
    look_alikes={"cogging": "the current, which ripples with the back-EMF"},
)
