"""Laws that nobody has written down: random smooth fields, formulas and states, hidden as effects outside the library.

They share nothing with the search for an unknown effect: neither its free forms nor the basis of its map.
"""

from __future__ import annotations

import itertools
import math
from typing import Any, Literal

import numpy as np
import sympy as sp

from gyrowheel_sim.effects import Coefficient, Effect, Law, LawState
from gyrowheel_sim.effects.quantities import Omega, Omega_ref, z, z_rate, z_ref

Strange = Literal[
    "rotor_field", "shaft_field", "rotor_formula", "shaft_formula", "rotor_state", "shaft_state"
]  # fmt: skip
#: Kinds of laws, in the order in which cases take them.
STRANGE: tuple[Strange, ...] = (
    "rotor_field", "rotor_formula", "shaft_field", "shaft_formula", "rotor_state", "shaft_state"
)  # fmt: skip

_WAVES = 5  # of a field
#: Lengths over which a field changes, in reference tilts and in reference speeds (smallest, largest).
_LENGTH_TILT, _LENGTH_SPEED = (0.8, 2.5), (0.3, 1.5)

_r = Omega / Omega_ref
_x, _y = sp.re(z) / z_ref, sp.im(z) / z_ref
_size = sp.sqrt(z * sp.conjugate(z)) / z_ref
_direction = z / (sp.sqrt(z * sp.conjugate(z)) + sp.Float(1e-9))


def strange_effect(kind: Strange, rng: np.random.Generator) -> tuple[Effect, dict[str, float]]:
    """Draw a law, and coefficients for it; its amplitudes have the size of a noticeable torque."""
    drawn = {"field": _field, "formula": _formula, "state": _state}
    return drawn[kind.partition("_")[2]](kind, rng)


def _effect(
    kind: Strange,
    law: sp.Expr,
    amplitudes: tuple[str, ...],
    shapes: tuple[Coefficient, ...] = (),
    states: tuple[LawState, ...] = (),
) -> Effect:
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
            *shapes,
        ),
        validity="blind tests",
        source="drawn at random",
        states=states,
    )  # fmt: skip


def _shape(name: str, value: float, unit: str = "1") -> Coefficient:
    return Coefficient(
        name, unit, "shape", (value - 1.0, value + 1.0), (-100.0, 100.0), "drawn",
        signed=True, shape=value, shape_uncertainty=1.0,
    )  # fmt: skip


def _field(kind: Strange, rng: np.random.Generator) -> tuple[Effect, dict[str, float]]:
    """Draw a smooth field: waves over tilt and speed; all fields of a kind are one law with other coefficients."""
    law = sp.S.Zero
    amplitudes: list[str] = []
    shapes: list[Coefficient] = []
    tilt, speed = (math.exp(rng.uniform(math.log(a), math.log(b))) for a, b in (_LENGTH_TILT, _LENGTH_SPEED))
    values: dict[str, float] = {}
    for k in range(_WAVES):
        names = [f"{letter}{k}" for letter in ("kx", "ky", "kr", "p")]
        drawn = [
            *(rng.standard_normal(2) / tilt),
            rng.standard_normal() / speed,
            rng.uniform(0.0, 2.0 * math.pi),
        ]
        shapes += map(_shape, names, itertools.repeat(0.0))
        values |= dict(zip(names, map(float, drawn), strict=True))
        kx, ky, kr, p = (sp.Symbol(name, real=True) for name in names)
        wave = sp.cos(kx * _x + ky * _y + kr * _r + p)
        parts = (f"a{k}", f"b{k}") if kind.startswith("rotor") else (f"a{k}",)
        size = sp.Symbol(parts[0], real=True)
        law += (size + sp.I * sp.Symbol(parts[1], real=True) if len(parts) == 2 else size) * wave
        amplitudes += parts
        values |= {name: 1e-3 * float(rng.standard_normal()) for name in parts}
    return _effect(kind, law, tuple(amplitudes), tuple(shapes)), values


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
#: Times by which a state lags [s], and ways over which a moved one is pulled along, in reference tilts.
_LAG, _WAY = (2.0, 60.0), (0.2, 1.5)
_RECOVERS = 10.0  # time in which a driven state recovers, in lags


def _rounded(value: float) -> sp.Float:
    return sp.Float(round(value, 3))


def _product(kind: Strange, rng: np.random.Generator) -> sp.Expr:
    """Draw a formula of at most two factors; on the rotor it also has a direction."""
    of_tilt, of_speed = (
        own[int(rng.integers(len(own)))](*rng.uniform(size=2)) for own in (_OF_TILT, _OF_SPEED)
    )
    kept = int(rng.integers(3))  # both factors, or one of them
    law = (of_speed if kept == 2 else of_tilt) if kept else of_tilt * of_speed
    if kind.startswith("rotor"):
        turns = int(rng.choice((-2, -1, 0, 1, 1, 1, 2, 3)))
        along = _direction if turns >= 0 else sp.conjugate(_direction)
        law = along ** abs(turns) * law
    return law


def _sized(
    kind: Strange,
    law: sp.Expr,
    rng: np.random.Generator,
    shapes: tuple[Coefficient, ...] = (),
    states: tuple[LawState, ...] = (),
) -> tuple[Effect, dict[str, float]]:
    """Return a law with an amplitude of random sign, on the rotor of random direction."""
    a, b = sp.symbols("a b", real=True)
    if kind.startswith("rotor"):
        turned = rng.uniform(0.0, 2.0 * math.pi)
        law, values = (a + sp.I * b) * law, {"a": 1e-3 * math.cos(turned), "b": 1e-3 * math.sin(turned)}
    else:
        law, values = a * law, {"a": 1e-3 * float(rng.choice((-1.0, 1.0)))}
    return _effect(kind, law, tuple(values), shapes, states), values | {c.name: c.default for c in shapes}


def _formula(kind: Strange, rng: np.random.Generator) -> tuple[Effect, dict[str, float]]:
    return _sized(kind, _product(kind, rng), rng)


def _state(kind: Strange, rng: np.random.Generator) -> tuple[Effect, dict[str, float]]:
    """Draw a law with a state, which lags behind a formula, or is driven by motion and recovers."""
    rotor = kind.startswith("rotor")
    m = sp.Symbol("m", complex=True) if rotor else sp.Symbol("m", real=True)
    time = _shape("T", round(_LAG[0] * (_LAG[1] / _LAG[0]) ** rng.uniform(), 2), "s")
    lag = time.symbol
    if rng.uniform() < 0.5:
        behind = _product(kind, rng)
        start = behind if rng.uniform() < 0.5 else sp.S.Zero
        state = LawState("m", "1", (behind - m) / lag, start, complex=rotor)
        law = m
    else:
        # a tilt pulls along what it moves over; a shaft wears with its turns
        way = _rounded(rng.uniform(*_WAY))
        drive, loss = (z_rate / z_ref / way, sp.Abs(z_rate) / z_ref / way) if rotor else (_r / lag, _r / lag)
        state = LawState("m", "1", drive - m * (loss + 1 / (_RECOVERS * lag)), complex=rotor)
        law = m * _r ** _rounded(rng.uniform(-1.0, 2.0))
    return _sized(kind, law, rng, (time,), (state,))
