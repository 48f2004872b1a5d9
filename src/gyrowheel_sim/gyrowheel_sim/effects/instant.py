"""What the compiled laws are evaluated with, and what they do together: the two ends of the generated code."""

from __future__ import annotations

from typing import NamedTuple

# --- kernel ---


class Instant(NamedTuple):
    """The quantities of `gyrowheel_sim.effects.quantities` at an instant, complex ones by their components [SI]."""

    zx: float
    zy: float
    zx_rate: float
    zy_rate: float
    theta_z: float
    Omega: float
    theta_x: float
    theta_y: float
    theta_x_rate: float
    theta_y_rate: float
    T_coil: float
    T_air: float
    T_winding: float
    T_motor: float
    rho: float
    i_motor: float
    t: float
    up: float
    up_x: float
    up_y: float
    home_xx: float
    home_xy: float
    home_yx: float
    home_yy: float


class Action(NamedTuple):
    """What all laws together do to the motion, beside changing bench parameters.

    Torques on the rotor across its spin axis (case axes) and along it, on the motor shaft, and of the flexures [N m];
    rate of the case [rad/s]; mirrored part of the coils' torque.
    """

    across_x: float
    across_y: float
    along: float
    shaft: float
    flexure_x: float
    flexure_y: float
    case_rate_x: float
    case_rate_y: float
    mirror_x: float
    mirror_y: float
