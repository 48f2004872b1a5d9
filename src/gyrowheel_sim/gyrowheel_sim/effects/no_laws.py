"""The laws of no effect at all: stands in for the generated code where the kernel is read, checked and documented."""

from __future__ import annotations

from typing import Any

from numba.extending import register_jitable


@register_jitable
def evaluate_laws(
    coef: Any, active: Any, env: Any, zx: float, zy: float, zx_rate: float, zy_rate: float, theta_z: float,
    Omega: float, theta_x: float, theta_y: float, theta_x_rate: float, theta_y_rate: float,
    T_coil: float, T_air: float, T_winding: float, T_motor: float, rho: float, i_motor: float, t: float,
) -> Any:  # fmt: skip
    """Return what every active effect does to the motion at an instant.

    (T_x, T_y, axial, shaft, flexure x, y, inertia difference, case rate x, y, coil gain, coil anisotropy x, y,
    motor gain, winding resistance)
    """
    return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0


@register_jitable
def evaluate_samples(
    coef: Any, active: Any, env: Any, zx: float, zy: float, zx_rate: float, zy_rate: float, theta_z: float,
    Omega: float, theta_x: float, theta_y: float, theta_x_rate: float, theta_y_rate: float,
    T_coil: float, T_air: float, T_winding: float, T_motor: float, rho: float, i_motor: float, t: float,
) -> Any:  # fmt: skip
    """Return what every active effect does once a sample: (coil lag, supply drop, tilt reading x, y)."""
    return 0.0, 0.0, 0.0, 0.0
