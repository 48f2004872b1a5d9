"""Effects of the tilt sensors."""

from __future__ import annotations

import sympy as sp

from gyrowheel_sim.effects.declaration import Effect, Law
from gyrowheel_sim.effects.library.common import amplitude, symbols
from gyrowheel_sim.effects.quantities import theta_z, z

_Bx, _By = symbols("B_x", "B_y")

TILT_BIAS = Effect(
    name="tilt_bias",
    title="zero error of the tilt sensors",
    category="sensor",
    sentence="The tilt readings are off by a constant, so the rotor is held at a tilt other than the one shown.",
    laws=(Law("tilt_reading", _Bx + sp.I * _By),),
    coefficients=(
        amplitude("B_x", "rad", "zero error about case x", (0.001, 0.006), 0.05, signed=True),
        amplitude("B_y", "rad", "zero error about case y", (0.001, 0.006), 0.05, signed=True),
    ),
    validity="constant over the recording",
    source="sensor model",
    look_alikes={"fixed_torque": "several speeds: the holding torque changes, the constant torque does not"},
)


(_s,) = symbols("s")

TILT_SCALE = Effect(
    name="tilt_scale",
    title="scale error of the tilt sensors",
    category="sensor",
    sentence="The tilt readings are too large or too small by a factor.",
    directions=(
        "The tilt readings are too small by a factor.",
        "The tilt readings are too large by a factor.",
    ),
    laws=(Law("tilt_reading", _s * z),),
    coefficients=(amplitude("s", "1", "relative error of the readings", (0.005, 0.03), 0.3, signed=True),),
    validity="tilt up to 5 deg",
    source="sensor model",
    look_alikes={
        "coil_gain_error": "nothing on this bench: only an external autocollimator measures the tilt itself"
    },
)


(_alpha,) = symbols("a")

TILT_ROTATION = Effect(
    name="tilt_rotation",
    title="tilt sensors turned about the case axis",
    category="sensor",
    sentence="The sensors are turned relative to the coils, so each reads a part of the tilt about the other axis.",
    directions=(
        "The tilt readings are turned from the y towards the x axis of the coils: the sensors stand turned.",
        "The tilt readings are turned from the x towards the y axis of the coils: the sensors stand turned.",
    ),
    laws=(Law("tilt_reading", sp.I * _alpha * z),),
    coefficients=(
        amplitude("a", "rad", "angle by which the readings are turned", (0.005, 0.03), 0.3, signed=True),
    ),
    validity="small angles",
    source="sensor model",
    look_alikes={"aero_cross": "cones: a turned sensor turns the slewing torque, the air hardly acts on it"},
)


_Rx, _Ry = symbols("R_x", "R_y")

RUNOUT = Effect(
    name="runout",
    title="runout of the tilt sensors' target",
    category="sensor",
    # the torque of the products of inertia and the stiffness of the spinning rotor both grow as the square of the speed
    sentence="The surface that the sensors look at is not square to the spin axis and wobbles once a revolution. "
    "A principal axis of the rotor off its spin axis (dynamic imbalance) looks the same at every speed.",
    laws=(Law("tilt_reading", (_Rx + sp.I * _Ry) * sp.exp(sp.I * theta_z)),),
    coefficients=tuple(
        amplitude(
            name,
            "rad",
            f"angle of the target about {name[-1]} of the shaft",
            (5.0e-5, 5.0e-4),
            0.05,
            "assumed: 5 to 50 micrometres at the rim",
            signed=True,
        )
        for name in ("R_x", "R_y")
    ),
    validity="both sensors look at the same surface",
    source="sensor model",
    look_alikes={"static_imbalance": "several speeds: the torque of a weight does not depend on the speed"},
)


_Q_x, _Q_y = symbols("Q_x", "Q_y")

TARGET_FLATNESS = Effect(
    name="target_flatness",
    title="the tilt sensors' target is not flat",
    category="sensor",
    sentence="The surface that the sensors look at is saddle-shaped, and the readings wobble twice a revolution.",
    laws=(Law("tilt_reading", (_Q_x + sp.I * _Q_y) * sp.exp(2 * sp.I * theta_z)),),
    coefficients=tuple(
        amplitude(
            name,
            "rad",
            f"amplitude of the reading about {name[-1]} of the shaft",
            (2.0e-5, 2.0e-4),
            0.05,
            "assumed: 2 to 20 micrometres at the rim",
            signed=True,
        )
        for name in ("Q_x", "Q_y")
    ),
    validity="both sensors look at the same surface",
    source="sensor model",
    look_alikes={
        "stiffness_anisotropy": "several tilts: the wobble of a surface does not grow with the tilt"
    },
)
