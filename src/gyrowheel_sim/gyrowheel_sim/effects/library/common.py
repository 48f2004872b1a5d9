"""Common parts of declarations: similarity, usual sources, tests that separate look-alikes."""

from __future__ import annotations

from typing import Any

import sympy as sp

from gyrowheel_sim.effects.declaration import Coefficient
from gyrowheel_sim.effects.quantities import Omega, Omega_ref, rho, rho_ref, z, z_ref

#: Spin rate and density over those to which coefficients refer, and the square of the tilt over that of its reference.
speed_ratio = Omega / Omega_ref
density_ratio = rho / rho_ref
tilt_squared = z * sp.conjugate(z) / z_ref**2

BALANCE = "average torque balance of the flex-gimbal rotor in the case frame, derived in mechanics.derivation"
CFD = "assumed: usual size from steady CFD of the published rotor and case (Huo et al. 2016, Table 2) at 3500 rpm"
#: Tests that separate look-alikes.
LOW_PRESSURE = "change the air: repeat speeds and tilts at low pressure (plan air_density)"
INVERT = "turn the rig upside down (plan inverted)"
YAW = "turn the rig by 180 deg about the vertical (plan yaw)"
CONES = "cones at two radii (plan cone): slewing torque shows the gain, not the flexure"


def symbols(*names: str) -> tuple[sp.Symbol, ...]:
    """Return the symbols of coefficients."""
    return tuple(sp.Symbol(name, real=True) for name in names)


def remembered(name: str, *, complex: bool = False) -> sp.Symbol:
    """Return the symbol of a state."""
    return sp.Symbol(name, complex=True) if complex else sp.Symbol(name, real=True)


def amplitude(
    name: str,
    unit: str,
    description: str,
    usual: tuple[float, float],
    limit: float,
    source: str = "assumed",
    **options: Any,
) -> Coefficient:
    """Return a coefficient that may be typed and searched within +-`limit`; see `Coefficient` for the options."""
    return Coefficient(name, unit, description, usual, (-limit, limit), source, **options)


def constant(
    name: str,
    unit: str,
    description: str,
    usual: float,
    uncertainty: float,
    bounds: tuple[float, float],
    source: str = "assumed",
) -> Coefficient:
    """Return the time or the way in which a state follows: its usual value with the standard uncertainty."""
    return Coefficient(
        name, unit, description, (usual - uncertainty, usual + uncertainty), bounds, source,
        shape=usual, shape_uncertainty=uncertainty,
    )  # fmt: skip


def exponent(usual: float, uncertainty: float, low: float, high: float) -> Coefficient:
    """Return the coefficient of an air torque's growth with the spin rate.

    Parameters
    ----------
    usual, uncertainty : float
        Usual value and its standard uncertainty.
    low, high : float
        Range met in practice.
    """
    return Coefficient(
        "n",
        "1",
        "exponent of the spin rate; by similarity the density enters with n - 1",
        (low, high),
        (0.5, 3.0),
        CFD,
        shape=usual,
        shape_uncertainty=uncertainty,
    )
