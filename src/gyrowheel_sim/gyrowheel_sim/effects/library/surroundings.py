"""Effects of gravity, fields, leads and the turning Earth."""

from __future__ import annotations

import sympy as sp

from gyrowheel_sim.effects.declaration import Effect, Law, LawState
from gyrowheel_sim.effects.library.common import (
    BALANCE,
    INVERT,
    YAW,
    amplitude,
    constant,
    remembered,
    symbols,
)
from gyrowheel_sim.effects.quantities import home_x, home_y, theta_z, up, up_across, z, z_rate

(_G,) = symbols("G")

GRAVITY_OFFSET = Effect(
    name="gravity_offset",
    title="centre of gravity off the pivot, along the spin axis",
    category="gravity",
    sentence="The weight of the rotor acts at a lever along the spin axis and turns the tilted rotor over, or back.",
    directions=(
        "The centre of mass lies below the joint: upright, the weight turns the tilted rotor back.",
        "The centre of mass lies above the joint: upright, the weight turns the tilted rotor over.",
    ),
    laws=(Law("rotor_torque", _G * (up * z - sp.I * up_across) / sp.sqrt(1 + z * sp.conjugate(z))),),
    coefficients=(
        amplitude(
            "G",
            "N*m/rad",
            "mass times g times the offset of the centre of gravity above the pivot",
            (0.0008, 0.006),
            0.2,
            "assumed: 0.9 kg, 0.1 to 0.7 mm",
            signed=True,
        ),
    ),
    validity="any attitude of the rig",
    source="torque of the weight about the pivot",
    look_alikes={"stiffness_error": INVERT},
)


_Sx, _Sy = symbols("S_x", "S_y")

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
        amplitude(
            name,
            "N*m",
            f"weight times the offset along {name[-1]} of the shaft",
            (2.0e-5, 2.0e-4),
            0.05,
            "assumed: 0.9 kg, 2 to 20 micrometres",
            signed=True,
        )
        for name in ("S_x", "S_y")
    ),
    validity="pivot at rest; to first order in the tilt",
    source="torque of the weight about the pivot",
    look_alikes={"runout": "several speeds: a runout needs torque that grows with the square of the speed"},
)


_Fx, _Fy = symbols("F_x", "F_y")

FIXED_TORQUE = Effect(
    name="fixed_torque",
    title="constant torque on the rotor in the case frame",
    category="gravity",
    sentence="A lead or a stray magnetic field pulls the rotor with a torque that no tilt or speed changes.",
    laws=(Law("rotor_torque", _Fx + sp.I * _Fy),),
    coefficients=(
        amplitude("F_x", "N*m", "torque about case x", (0.0008, 0.003), 0.05, signed=True),
        amplitude("F_y", "N*m", "torque about case y", (0.0008, 0.003), 0.05, signed=True),
    ),
    validity="rig not turned",
    source=BALANCE,
    look_alikes={"tilt_bias": "several speeds: the holding torque changes, the constant torque does not"},
)


(_D,) = symbols("D")

EXTERNAL_DAMPING = Effect(
    name="external_damping",
    title="damping of the tilt in the case",
    category="environment",
    sentence="Eddy currents in the case, or leads, resist the motion of the spin axis through the case.",
    laws=(Law("rotor_torque", -_D * z_rate),),
    coefficients=(amplitude("D", "N*m*s/rad", "torque per tilt rate", (0.002, 0.01), 0.2),),
    validity="tilt rates up to 1 rad/s",
    source=BALANCE,
    look_alikes={
        "tilt_rotation": "holds at low speed: a turned sensor turns the holding torque, damping does not"
    },
)


_F, _b = symbols("F", "b")
_pull = remembered("s", complex=True)

CABLE_FRICTION = Effect(
    name="cable_friction",
    title="friction of a cable, with a memory of the way",
    category="environment",
    sentence="A cable slips only after it was bent some way, so that its pull depends on the way to a tilt.",
    laws=(Law("rotor_torque", -_F * _pull),),
    states=(LawState("s", "1", (z_rate - _pull * sp.Abs(z_rate)) / _b, complex=True),),
    coefficients=(
        amplitude("F", "N*m", "torque of the cable once it slips", (3e-4, 2e-3), 0.05),
        constant("b", "rad", "tilt over which the pull builds up", 0.02, 0.01, (0.002, 0.2)),
    ),
    validity="tilt up to 5 deg",
    source="Dahl 1968, A solid friction model, with the exponent 1 and a direction in the plane",
    look_alikes={
        "external_damping": "the same tilt reached from opposite sides (plan check): friction stays in a hold",
        "fixed_torque": "the same tilt reached from opposite sides (plan check): a constant torque does not change",
        "tilt_bias": "the same tilt reached from opposite sides (plan check): a zero error does not change",
    },
)


_Ex, _Ey = symbols("E_x", "E_y")

#: Rate of the Earth, 15.04 deg/h [rad/s]; its uncertainty is far below anything on a bench.
_EARTH = 7.292115e-5

EARTH_RATE = Effect(
    name="earth_rate",
    title="the Earth turns the rig",
    category="environment",
    sentence="The case turns with the Earth, and the spinning rotor answers as a gyroscope does.",
    laws=(Law("case_rate", _Ex * home_x + _Ey * home_y),),
    coefficients=tuple(
        amplitude(
            name,
            "rad/s",
            f"horizontal rate of the Earth along the home axis {name[-1]}",
            (2.0e-5, 6.0e-5),
            1e-3,
            "7.292e-5 rad/s times the cosine of the latitude",
            signed=True,
            possible=(-_EARTH, _EARTH),
            possible_source="the Earth turns with 15.04 deg/h (IERS Conventions 2010), horizontally at the equator",
        )
        for name in ("E_x", "E_y")
    ),
    validity="rig upright or inverted; the vertical part of the rate is left out",
    source="gyroscopic torque Irz Omega x omega, exact in the case frame",
    look_alikes={"fixed_torque": YAW},
    greatest=_EARTH,
)
