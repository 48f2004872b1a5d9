"""The laws of no effect at all: stands in for the generated code where the kernel is read, checked and documented."""

from __future__ import annotations

from typing import Any

from numba.extending import register_jitable


@register_jitable
def evaluate_laws(
    coef: Any, active: Any, zx: float, zy: float, zx_rate: float, zy_rate: float, Omega: float,
    theta_x: float, theta_y: float, theta_x_rate: float, theta_y_rate: float,
    T_coil: float, T_air: float, rho: float, up: float, t: float,
) -> Any:  # fmt: skip
    """Return (T_x, T_y, axial, shaft, flexure x, flexure y, coil gain, tilt reading x, y) of every active effect."""
    return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
