"""What a case may hide outside the library: further effects, imperfect instruments, and events.

Only a scenario declares these effects and events, so that no diagnosis knows them. Laws that
nobody has written down are random smooth fields, formulas and states; they share nothing with the search for an unknown
effect: neither its free forms nor the basis of its map.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import sympy as sp

from gyrowheel_sim.bench import Bench
from gyrowheel_sim.blind import draw_effect
from gyrowheel_sim.effects import Coefficient, Effect, EffectValues, Law, LawState, registry
from gyrowheel_sim.effects.quantities import QUANTITIES, Omega, Omega_ref, rho, rho_ref, z, z_rate, z_ref
from gyrowheel_sim.effects.registry import for_bench
from gyrowheel_sim.parameter import INSTRUMENTS
from gyrowheel_sim.plant.scenario import UNREGISTERED

_c, _n, _p, _w, _T, _s = (sp.Symbol(name, real=True) for name in ("c", "n", "p", "w", "T", "s"))
_size = sp.sqrt(z * sp.conjugate(z))
_r, _d = Omega / Omega_ref, rho / rho_ref
_t = QUANTITIES["t"].symbol


@dataclass(frozen=True)
class OutsideForm:
    """An effect outside the library."""

    effect: Effect
    resembles: str | None = None  # the library effect that is right with another exponent; None without one
    exponent: str = ""  # that exponent


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
    coefficients=(Coefficient("w", "N*m", "size", (5e-4, 3e-3), (-0.5, 0.5), "assumed"), _exponent(2.4, 3.0)),
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


Shape = Literal["step", "trend", "burst"]
#: Smallest and largest number of wrong instruments, by the kind of a case.
WRONG_AT_ONCE = {
    "none": (1, 3),
    "single": (0, 2),
    "pair": (0, 1),
    "outside": (0, 1),
    "alike": (0, 1),
    "memory": (0, 1),
    "event": (0, 1),
}
#: Largest resolution step and hum, over the noise of the reading.
_STEPS, _HUM = 1.0, 0.5
_JITTER = 5.0e-6  # s
_CLOCK = 5.0e-5
#: Beginning of an event, as a fraction of the recording; duration of a trend or a burst [s].
_BEGINS = (0.15, 0.8)
_LASTS = {"trend": (20.0, 60.0), "burst": (6.0, 20.0)}

_A, _x, _y, _begin, _end = (sp.Symbol(name, real=True) for name in ("A", "A_x", "A_y", "t_0", "t_1"))
#: Course of the change over time, from 0 to 1.
_COURSES: dict[Shape, sp.Expr] = {
    "step": (1 + sp.sign(_t - _begin)) / 2,
    "trend": sp.Min(sp.Max((_t - _begin) / (_end - _begin), 0), 1),
    "burst": (sp.sign(_t - _begin) - sp.sign(_t - _end)) / 2,
}


@dataclass(frozen=True)
class _Changed:
    """A quantity that an event changes: target of the law, unit, usual sizes, and title."""

    target: str
    unit: str
    usual: tuple[float, float]
    words: str
    complex: bool


_CHANGED = {
    "torque": _Changed("rotor_torque", "N*m", (1e-4, 2e-3), "torque on the rotor", True),
    "friction": _Changed("shaft_torque", "N*m", (1e-4, 1e-3), "friction on the shaft", False),
    "tilt_zero": _Changed("tilt_reading", "rad", (5e-4, 6e-3), "zero of the tilt sensors", True),
}


@dataclass(frozen=True)
class HiddenEvent:
    """A hidden event."""

    name: str  # of `events`
    shape: Shape  # a trend grows from `begin` to `end` and stays
    begin: float  # beginning and end [s]; a step does not end
    end: float = math.inf


def _event(name: str, changed: _Changed, shape: Shape) -> Effect:
    size = _x + sp.I * _y if changed.complex else -_A
    keys = ("A_x", "A_y") if changed.complex else ("A",)
    instants = ("t_0",) if shape == "step" else ("t_0", "t_1")
    return Effect(
        name=name,
        title=f"{changed.words}: {shape}",
        category="other",
        sentence=f"Something happens, and changes the {changed.words}.",
        laws=(Law(changed.target, size * _COURSES[shape]),),
        coefficients=(
            *(
                Coefficient(key, changed.unit, "size", changed.usual, (-1.0, 1.0), "assumed", signed=True)
                for key in keys
            ),
            *(
                Coefficient(
                    key,
                    "s",
                    "instant",
                    (1.0, 1e4),
                    (0.0, 1e6),
                    "assumed",
                    shape=100.0 + i,
                    shape_uncertainty=50.0,
                )
                for i, key in enumerate(instants)
            ),
        ),
        validity="blind tests",
        source="assumed",
    )


_EVENTS: dict[str, tuple[Shape, Effect]] = {
    f"{what}_{shape}": (shape, _event(f"{what}_{shape}", changed, shape))
    for what, changed in _CHANGED.items()
    for shape in _COURSES
}


def events() -> dict[str, Effect]:
    """Return the declarations of all events by name; a scenario declares all of them, so that one plant is compiled."""
    return {name: effect for name, (_, effect) in _EVENTS.items()}


def shape_of(name: str) -> Shape:
    """Return the shape of an event by its name."""
    return _EVENTS[name][0]


def draw_event(
    bench: Bench, name: str, seconds: float, rng: np.random.Generator
) -> tuple[HiddenEvent, dict[str, float]]:
    """Draw the time of an event in a recording of a length [s], and its coefficients."""
    shape, effect = _EVENTS[name]
    begin = float(rng.uniform(*_BEGINS)) * seconds
    end = math.inf
    if shape != "step":
        end = min(begin + float(rng.uniform(*_LASTS[shape])), 0.95 * seconds)
    values = draw_effect(for_bench(effect, bench), rng) | {"t_0": begin}
    if shape != "step":
        values["t_1"] = end
    return HiddenEvent(name, shape, begin, end), values


def draw_amounts(bench: Bench, rng: np.random.Generator) -> dict[str, float]:
    """Draw the instruments' parameters: those stated as uncertain, and steps, hum, jitter and rate of the clock."""
    v = bench.value
    values = {}
    for group in bench.groups().values():
        factor = float(np.clip(rng.standard_normal(), -2.5, 2.5))
        if group[0].name in INSTRUMENTS:
            values.update({p.name: p.value + factor * p.uncertainty for p in group})
    for name in INSTRUMENTS:
        reading, _, kind = name.rpartition("_")
        if kind == "resolution":
            values[name] = _STEPS * float(rng.uniform()) * v(f"{reading}_noise")
        elif kind == "hum":
            values[name] = _HUM * float(rng.uniform()) * v(f"{reading}_noise")
    values["clock_jitter"] = _JITTER * float(rng.uniform())
    values["clock_rate_error"] = _CLOCK * float(rng.uniform(-1.0, 1.0))
    return values


def draw_wrong(
    bench: Bench,
    kind: str,
    stated: Mapping[str, float],
    rng: np.random.Generator,
    turn: Callable[[tuple[str, ...]], str],
) -> EffectValues:
    """Draw wrong instruments.

    The kind of the case limits their number. `stated` are the parameters to which the errors are added. `turn` chooses
    the first of some names, each in turn.
    """
    known = {name: e for name, e in registry().items() if e.category == "instrument"}
    fewest, most = WRONG_AT_ONCE[kind]
    count = int(rng.integers(fewest, most + 1))
    if not count:
        return {}
    first = turn(tuple(known))
    others = [name for name in known if name != first]
    chosen = [first, *(str(name) for name in rng.choice(others, count - 1, replace=False))]
    result: EffectValues = {}
    for name in chosen:
        values: dict[str, Any] = draw_effect(for_bench(known[name], bench), rng)
        if name.endswith("_delay"):
            # no reading is earlier than the sample interval of its stamp
            values["d"] = max(values["d"], -bench.sample_period - stated.get(name, 0.0))
        result[name] = values
    return result


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

_speed_ratio = Omega / Omega_ref
_tilt_x, _tilt_y = sp.re(z) / z_ref, sp.im(z) / z_ref
_tilt_ratio = sp.sqrt(z * sp.conjugate(z)) / z_ref
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
        wave = sp.cos(kx * _tilt_x + ky * _tilt_y + kr * _speed_ratio + p)
        parts = (f"a{k}", f"b{k}") if kind.startswith("rotor") else (f"a{k}",)
        size = sp.Symbol(parts[0], real=True)
        law += (size + sp.I * sp.Symbol(parts[1], real=True) if len(parts) == 2 else size) * wave
        amplitudes += parts
        values |= {name: 1e-3 * float(rng.standard_normal()) for name in parts}
    return _effect(kind, law, tuple(amplitudes), tuple(shapes)), values


#: Factors of a formula by |tilt| and by speed, as functions of two numbers between 0 and 1.
_OF_TILT: tuple[Any, ...] = (
    lambda p, q: _tilt_ratio ** _rounded(0.3 + 3.0 * p),
    lambda p, q: sp.tanh(_tilt_ratio / _rounded(0.2 + 0.8 * p)),
    lambda p, q: _tilt_ratio * sp.exp(-_tilt_ratio / _rounded(0.3 + p)),
    lambda p, q: sp.Max(_tilt_ratio - _rounded(0.2 + 0.5 * p), 0),
    lambda p, q: sp.sin(_rounded(1.5 + 3.0 * p) * _tilt_ratio),
)
_OF_SPEED: tuple[Any, ...] = (
    lambda p, q: _speed_ratio ** _rounded(-1.5 + 5.0 * p),
    lambda p, q: 1 + sp.tanh((_speed_ratio - _rounded(0.45 + 0.5 * p)) / _rounded(0.08 + 0.3 * q)),
    lambda p, q: sp.exp(-(((_speed_ratio - _rounded(0.4 + 0.6 * p)) / _rounded(0.12 + 0.3 * q)) ** 2)),
    lambda p, q: sp.cos(_rounded(2.0 + 4.0 * p) * _speed_ratio),
    lambda p, q: 1 / ((1 - (_speed_ratio / _rounded(0.45 + 0.5 * p)) ** 2) ** 2 + _rounded(0.1 + 0.3 * q)),
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
        drive, loss = (
            (z_rate / z_ref / way, sp.Abs(z_rate) / z_ref / way)
            if rotor
            else (_speed_ratio / lag, _speed_ratio / lag)
        )
        state = LawState("m", "1", drive - m * (loss + 1 / (_RECOVERS * lag)), complex=rotor)
        law = m * _speed_ratio ** _rounded(rng.uniform(-1.0, 2.0))
    return _sized(kind, law, rng, (time,), (state,))
