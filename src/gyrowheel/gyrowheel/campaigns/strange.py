"""Laws that nobody has written down: random smooth fields and random formulas, hidden as effects outside the library.

They share nothing with the search for an unknown effect: neither its free forms nor the basis of its map.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
import sympy as sp

from gyrowheel_sim.effects import Coefficient, Effect, Law
from gyrowheel_sim.effects.quantities import Omega, Omega_ref, z, z_ref

Strange = Literal["rotor_field", "shaft_field", "rotor_formula", "shaft_formula"]
#: Kinds of laws, in the order in which cases take them.
STRANGE: tuple[Strange, ...] = ("rotor_field", "rotor_formula", "shaft_field", "shaft_formula")

_WAVES = 5  # of a field
#: Lengths over which a field changes, in reference tilts and in reference speeds (smallest, largest).
_LENGTH_TILT, _LENGTH_SPEED = (0.8, 2.5), (0.3, 1.5)

_r = Omega / Omega_ref
_x, _y = sp.re(z) / z_ref, sp.im(z) / z_ref
_size = sp.sqrt(z * sp.conjugate(z)) / z_ref
_direction = z / (sp.sqrt(z * sp.conjugate(z)) + sp.Float(1e-9))


def strange_effect(kind: Strange, rng: np.random.Generator) -> tuple[Effect, dict[str, float]]:
    """Draw a law, and coefficients for it; its amplitudes have the size of a noticeable torque."""
    return _field(kind, rng) if kind.endswith("field") else _formula(kind, rng)


def _effect(kind: Strange, law: sp.Expr, amplitudes: tuple[str, ...], shapes: dict[str, float]) -> Effect:
    rotor = kind.startswith("rotor")
    usual = (1e-4, 2e-3) if rotor else (5e-5, 1e-3)
    return Effect(
        name=f"strange_{kind}",
        title="a law that nobody has written down",
        category="other",
        sentence="Drawn at random.",
        laws=(Law("rotor_torque" if rotor else "shaft_torque", law),),
        coefficients=(
            *(Coefficient(name, "N*m", "size", usual, (-1.0, 1.0), "drawn", signed=True) for name in amplitudes),
            *(
                Coefficient(
                    name, "1", "shape", (value - 1.0, value + 1.0), (-100.0, 100.0), "drawn",
                    signed=True, shape=value, shape_uncertainty=1.0,
                )
                for name, value in shapes.items()
            ),
        ),
        validity="blind tests",
        source="drawn at random",
    )  # fmt: skip


def _field(kind: Strange, rng: np.random.Generator) -> tuple[Effect, dict[str, float]]:
    """Draw a smooth field: waves over tilt and speed; all fields of a kind are one law with other coefficients."""
    law = sp.S.Zero
    amplitudes: list[str] = []
    shapes: dict[str, float] = {}
    tilt, speed = (math.exp(rng.uniform(math.log(a), math.log(b))) for a, b in (_LENGTH_TILT, _LENGTH_SPEED))
    values: dict[str, float] = {}
    for k in range(_WAVES):
        names = [f"{letter}{k}" for letter in ("kx", "ky", "kr", "p")]
        drawn = [
            *(rng.standard_normal(2) / tilt),
            rng.standard_normal() / speed,
            rng.uniform(0.0, 2.0 * math.pi),
        ]
        shapes |= dict.fromkeys(names, 0.0)
        values |= dict(zip(names, map(float, drawn), strict=True))
        kx, ky, kr, p = (sp.Symbol(name, real=True) for name in names)
        wave = sp.cos(kx * _x + ky * _y + kr * _r + p)
        parts = (f"a{k}", f"b{k}") if kind.startswith("rotor") else (f"a{k}",)
        size = sp.Symbol(parts[0], real=True)
        law += (size + sp.I * sp.Symbol(parts[1], real=True) if len(parts) == 2 else size) * wave
        amplitudes += parts
        values |= {name: 1e-3 * float(rng.standard_normal()) for name in parts}
    return _effect(kind, law, tuple(amplitudes), shapes), values


#: Factors of a formula by |tilt| and by speed, as functions of two numbers between 0 and 1.
_OF_TILT: tuple[Any, ...] = (
    lambda p, q: _size ** _rounded(0.3 + 3.0 * p),
    lambda p, q: sp.tanh(_size / _rounded(0.2 + 0.8 * p)),
    lambda p, q: _size * sp.exp(-_size / _rounded(0.3 + p)),
    lambda p, q: sp.Max(_size - _rounded(0.2 + 0.5 * p), 0),
    lambda p, q: sp.sin(_rounded(1.5 + 3.0 * p) * _size),
)
_OF_SPEED: tuple[Any, ...] = (
    lambda p, q: _r ** _rounded(-1.5 + 5.0 * p),
    lambda p, q: 1 + sp.tanh((_r - _rounded(0.45 + 0.5 * p)) / _rounded(0.08 + 0.3 * q)),
    lambda p, q: sp.exp(-(((_r - _rounded(0.4 + 0.6 * p)) / _rounded(0.12 + 0.3 * q)) ** 2)),
    lambda p, q: sp.cos(_rounded(2.0 + 4.0 * p) * _r),
    lambda p, q: 1 / ((1 - (_r / _rounded(0.45 + 0.5 * p)) ** 2) ** 2 + _rounded(0.1 + 0.3 * q)),
)


def _rounded(value: float) -> sp.Float:
    return sp.Float(round(value, 3))


def _formula(kind: Strange, rng: np.random.Generator) -> tuple[Effect, dict[str, float]]:
    """Draw a formula of at most two factors; on the rotor it also has a direction."""
    of_tilt, of_speed = (
        own[int(rng.integers(len(own)))](*rng.uniform(size=2)) for own in (_OF_TILT, _OF_SPEED)
    )
    kept = int(rng.integers(3))  # both factors, or one of them
    law = (of_speed if kept == 2 else of_tilt) if kept else of_tilt * of_speed
    a, b = sp.symbols("a b", real=True)
    if kind.startswith("rotor"):
        turns = int(rng.choice((-2, -1, 0, 1, 1, 1, 2, 3)))
        along = _direction if turns >= 0 else sp.conjugate(_direction)
        law = (a + sp.I * b) * along ** abs(turns) * law
        turned = rng.uniform(0.0, 2.0 * math.pi)
        return _effect(kind, law, ("a", "b"), {}), {
            "a": 1e-3 * math.cos(turned), "b": 1e-3 * math.sin(turned)
        }  # fmt: skip
    return _effect(kind, a * law, ("a",), {}), {"a": 1e-3 * float(rng.choice((-1.0, 1.0)))}
