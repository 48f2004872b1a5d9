"""Unregistered effects for blind tests, which an analysis must report as unknown.

Only the simulation knows them; no search for effects reads this module.
"""

from __future__ import annotations

import sympy as sp

from gyrowheel_sim.effects.declaration import Coefficient, Effect, Law
from gyrowheel_sim.effects.quantities import Omega, Omega_ref, z, z_ref

_A, _p, _w = (sp.Symbol(name, real=True) for name in ("A", "p", "w"))
_size = sp.sqrt(z * sp.conjugate(z))


def _amplitude(unit: str, low: float, high: float, *, signed: bool = True) -> Coefficient:
    return Coefficient("A", unit, "size", (low, high), (-1.0, 1.0), "assumed", signed=signed)


def _shape(name: str, low: float, high: float, description: str) -> Coefficient:
    middle, spread = 0.5 * (low + high), 0.5 * (high - low)
    return Coefficient(
        name, "1", description, (low, high), (0.0, 10.0), "assumed", shape=middle, shape_uncertainty=spread
    )


SPEED_BUMP = Effect(
    name="speed_bump",
    title="resonance of the structure at one speed",
    category="other",
    sentence="Near one speed the mount resonates and adds a torque in proportion to the tilt.",
    laws=(Law("rotor_torque", _A * sp.exp(-(((Omega / Omega_ref - _p) / _w) ** 2)) * z),),
    coefficients=(
        _amplitude("N*m/rad", 0.02, 0.06),
        _shape("p", 0.45, 0.95, "speed"),
        _shape("w", 0.08, 0.15, "width"),
    ),
    validity="blind tests",
    source="assumed",
)
THREE_LOBED = Effect(
    name="three_lobed",
    title="three-lobed torque",
    category="other",
    sentence="A field of three lobes fixed in the case turns the rotor towards the nearest lobe.",
    laws=(Law("rotor_torque", _A * sp.conjugate(z) ** 2 / z_ref**2),),
    coefficients=(_amplitude("N*m", 0.0015, 0.005),),
    validity="blind tests",
    source="assumed",
)
CONTACT = Effect(
    name="contact",
    title="contact beyond a tilt",
    category="other",
    sentence="Beyond some tilt the rotor touches a lead that pushes it back.",
    laws=(Law("rotor_torque", -_A * sp.Max(_size / z_ref - _p, 0) * z / (_size + sp.Float(1e-9))),),
    coefficients=(
        _amplitude("N*m", 0.006, 0.02, signed=False),
        _shape("p", 0.4, 0.55, "tilt where it begins"),
    ),
    validity="blind tests",
    source="assumed",
)

UNREGISTERED: tuple[Effect, ...] = (SPEED_BUMP, THREE_LOBED, CONTACT)
