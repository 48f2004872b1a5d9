"""Hidden effects outside the library, in addition to those of the simulation.

Only a scenario declares them, so that no diagnosis knows them.
"""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp

from gyrowheel_sim.effects.declaration import Coefficient, Effect, Law
from gyrowheel_sim.effects.quantities import QUANTITIES, Omega, Omega_ref, rho, rho_ref, z
from gyrowheel_sim.plant.unregistered_effects import UNREGISTERED

_c, _n, _p, _w, _T, _s = (sp.Symbol(name, real=True) for name in ("c", "n", "p", "w", "T", "s"))
_size = sp.sqrt(z * sp.conjugate(z))
_r, _d = Omega / Omega_ref, rho / rho_ref
_t = QUANTITIES["t"].symbol


@dataclass(frozen=True)
class OutsideForm:
    """An effect outside the library.

    Attributes
    ----------
    effect : Effect
        Its declaration.
    resembles : str or None
        The library effect that is right with another exponent; None without one.
    exponent : str
        That exponent.
    """

    effect: Effect
    resembles: str | None = None
    exponent: str = ""


def _exponent(low: float, high: float) -> Coefficient:
    middle, spread = 0.5 * (low + high), 0.5 * (high - low)
    return Coefficient(
        "n", "1", "exponent", (low, high), (0.0, 6.0), "assumed", shape=middle, shape_uncertainty=spread
    )


_STEEP_WINDAGE = Effect(
    name="steep_windage",
    title="drag on the spin with an exponent far from that of windage",
    category="other",
    sentence="A fan on the shaft brakes the spin with more than the square of the speed.",
    laws=(Law("axial_torque", -_w * _r**_n * _d),),
    coefficients=(
        Coefficient("w", "N*m", "size", (5e-4, 3e-3), (-0.5, 0.5), "assumed"),
        _exponent(2.4, 3.0),
    ),
    validity="blind tests",
    source="assumed",
)
_STEEP_CROSS = Effect(
    name="steep_cross",
    title="torque across the tilt with an exponent far from that of the air",
    category="other",
    sentence="A lossy part turns with the rotor and drags it across the tilt with more than the square of the speed.",
    laws=(Law("rotor_torque", sp.I * _c * _r**_n * z),),
    coefficients=(
        Coefficient("c", "N*m/rad", "size", (3e-3, 1e-2), (-0.5, 0.5), "assumed"),
        _exponent(3.2, 4.0),
    ),
    validity="blind tests",
    source="assumed",
)
_RUNNING_IN = Effect(
    name="running_in",
    title="friction that fades with time",
    category="other",
    sentence="The grease of the bearing spreads, so that its friction fades while the test runs.",
    laws=(Law("shaft_torque", -_T * sp.exp(-_t / _s)),),
    coefficients=(
        Coefficient("T", "N*m", "friction at the start", (1e-3, 4e-3), (-0.5, 0.5), "assumed"),
        Coefficient(
            "s",
            "s",
            "time in which it fades",
            (20.0, 60.0),
            (1.0, 1e4),
            "assumed",
            shape=40.0,
            shape_uncertainty=20.0,
        ),
    ),
    validity="blind tests",
    source="assumed",
)

_BACKLASH = Effect(
    name="backlash",
    title="backlash of a preloaded joint",
    category="other",
    sentence="Within its play a joint holds the rotor stiffly; beyond it the preload pulls with a constant torque.",
    laws=(Law("rotor_torque", -_c * sp.Min(_size / _p, 1) * z / (_size + sp.Float(1e-9))),),
    coefficients=(
        Coefficient("c", "N*m", "torque of the preload", (5e-4, 2e-3), (-0.5, 0.5), "assumed"),
        Coefficient(
            "p",
            "rad",
            "half of the play",
            (0.003, 0.015),
            (1e-4, 0.1),
            "assumed",
            shape=0.009,
            shape_uncertainty=0.006,
        ),
    ),
    validity="blind tests",
    source="assumed",
)

_OWN = (
    OutsideForm(_STEEP_WINDAGE, "windage", "n"),
    OutsideForm(_STEEP_CROSS, "aero_cross", "n"),
    OutsideForm(_RUNNING_IN),
    OutsideForm(_BACKLASH),
)
_SHIPPED = {effect.name for effect in UNREGISTERED}


def outside_forms() -> tuple[OutsideForm, ...]:
    """Return every form that may be hidden as an effect outside the library."""
    return (
        *(OutsideForm(effect) for effect in UNREGISTERED),
        *(f for f in _OWN if f.effect.name not in _SHIPPED),
    )


def declared() -> dict[str, Effect]:
    """Return the forms that the simulation lacks, which a scenario must declare."""
    return {form.effect.name: form.effect for form in _OWN if form.effect.name not in _SHIPPED}
