"""Effects of the torque coils and their supply."""

from __future__ import annotations

import sympy as sp

from gyrowheel_sim.effects.declaration import Coefficient, Effect, Law, LawState
from gyrowheel_sim.effects.library.common import CONES, amplitude, constant, remembered, symbols
from gyrowheel_sim.effects.quantities import T_air, T_coil, T_ref, V_coil, i_motor, z, z_ref

(_g,) = symbols("g")

COIL_TILT = Effect(
    name="coil_tilt",
    title="torque constant of the coils changes with tilt",
    category="actuator",
    sentence="At a tilt the coils leave the uniform part of the magnets' field, which changes their torque per volt.",
    directions=(
        "At a tilt the coils leave the uniform part of the magnets' field, and a volt gives less torque.",
        "At a tilt the coils come into a stronger part of the magnets' field, and a volt gives more torque.",
    ),
    laws=(Law("coil_gain", _g * z * sp.conjugate(z) / z_ref**2),),
    coefficients=(
        amplitude(
            "g",
            "1",
            "relative change of the torque per volt at the reference tilt",
            (0.03, 0.10),
            0.9,
            "assumed; Huo et al. 2016, Section 4 (moment coefficients vary with tilt)",
            signed=True,
        ),
    ),
    validity="tilt up to 5 deg",
    source="even power series of the field about the centre",
    look_alikes={"cubic_stiffness": CONES},
)


(_a,) = symbols("a")

COIL_HEATING = Effect(
    name="coil_heating",
    title="torque constant of the coils changes with temperature",
    category="actuator",
    sentence="Temperature changes the resistance of the coils and the field of the magnets, so the torque per volt.",
    directions=(
        "Warm coils have more resistance and warm magnets less field, so a volt gives less torque.",
        "A volt gives more torque as the coils get warmer: neither copper nor magnets do that on a voltage drive.",
    ),
    laws=(Law("coil_gain", _a * (T_coil - T_ref)),),
    coefficients=(
        amplitude(
            "a",
            "1/K",
            "relative change of the torque per volt per kelvin",
            (0.001, 0.004),
            0.05,
            "copper: -0.0039/K on a voltage drive; NdFeB magnets: -0.0011/K",
            signed=True,
        ),
    ),
    validity="within 60 K of the reference temperature",
    source="temperature coefficient of resistance and remanence",
    look_alikes={"coil_gain_error": "pre-heat the coils by 20 K (plan preheat)"},
)


_behind, _soak = symbols("a", "tau")
_warm = remembered("s")

MAGNET_WARMING = Effect(
    name="magnet_warming",
    title="torque constant of the coils changes as their magnets warm behind them",
    category="actuator",
    sentence="The magnets warm minutes behind the coils, and lose field: the torque per volt lags the temperature.",
    directions=(
        "The magnets warm minutes behind the coils, and lose field: the torque per volt lags the temperature.",
        "A volt gives more torque as the magnets get warmer: the opposite of what magnets do.",
    ),
    laws=(Law("coil_gain", _behind * _warm),),
    states=(LawState("s", "K", (T_coil - T_air - _warm) / _soak),),
    coefficients=(
        amplitude(
            "a",
            "1/K",
            "relative change of the torque per volt per kelvin of the magnets",
            (0.001, 0.004),
            0.05,
            "ferrite: -0.002/K; NdFeB: -0.0011/K",
            signed=True,
        ),
        constant("tau", "s", "time in which the magnets follow the coils", 60.0, 40.0, (3.0, 2e3)),
    ),
    validity="magnets at air temperature at the start",
    source="temperature coefficient of remanence; one thermal mass",
    look_alikes={
        "coil_heating": "coils that are warm for minutes and cool again (plan preheat): what lags goes on",
    },
)


_kept, _time = symbols("k", "tau")
_past = remembered("s", complex=True)

COIL_REMANENCE = Effect(
    name="coil_remanence",
    title="iron of the coils keeps part of their field",
    category="actuator",
    sentence="The iron of the coils follows their current with a delay: part of the torque is that of past voltages.",
    directions=(
        "The torque of a new voltage fades in part, with a delay: the opposite of what iron does.",
        "The iron of the coils follows their current with a delay: part of the torque is that of past voltages.",
    ),
    laws=(Law("rotor_torque", _kept * _past),),
    states=(LawState("s", "V", (V_coil - _past) / _time, complex=True),),
    coefficients=(
        amplitude(
            "k",
            "N*m/V",
            "torque per volt of the past voltage",
            (1.0e-4, 4.0e-4),
            0.01,
            "assumed: 0.5 to 2 % of the torque per volt, as in iron with an air gap",
            signed=True,
        ),
        constant("tau", "s", "time in which the iron follows", 8.0, 6.0, (0.3, 2e3)),
    ),
    validity="iron far from saturation, without a field at the start",
    source="magnetic after-effect, one relaxation: Chikazumi, Physics of Ferromagnetism, 1997, chapter 20",
    look_alikes={
        "flexure_damping": "holds and cones: a damping is the same in both, what lags depends on the tilts before",
        "coil_gain_error": "tilts in both directions in turn: a gain does not depend on the tilts before",
    },
)


_px, _py = symbols("p_x", "p_y")

COIL_ANISOTROPY = Effect(
    name="coil_anisotropy",
    title="coils of the two axes differ",
    category="actuator",
    sentence="One pair of coils gives more torque per volt than the other, or the pairs are not at right angles.",
    laws=(Law("coil_anisotropy", _px + sp.I * _py),),
    coefficients=(
        amplitude(
            "p_x",
            "1",
            "half of the relative difference of the torques per volt, x over y",
            (0.01, 0.05),
            0.5,
            signed=True,
        ),
        amplitude(
            "p_y",
            "1",
            "half of the angle by which the pairs are off the right angle",
            (0.01, 0.05),
            0.5,
            signed=True,
        ),
    ),
    validity="constant over the recording",
    source="symmetric part of the matrix from voltages to torques",
    look_alikes={"coil_gain_error": "tilts about both axes"},
)


(_tau,) = symbols("t_L")

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
    look_alikes={
        "tilt_rotation": "holds: a lag shows only where the torque changes",
        "coil_voltage_delay": "a current of the coils, measured: the inductance delays it, an instrument of the "
        "voltage does not",
    },
)


(_Rs,) = symbols("R_s")

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
