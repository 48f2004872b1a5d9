"""Imperfect instruments, and events during a recording.

The events are effects that only a scenario declares, so that no diagnosis knows them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import sympy as sp

from gyrowheel_sim.bench import Bench
from gyrowheel_sim.blind import draw_effect
from gyrowheel_sim.effects import Coefficient, Effect, EffectValues, Law, registry
from gyrowheel_sim.effects.quantities import QUANTITIES
from gyrowheel_sim.effects.registry import for_bench
from gyrowheel_sim.parameter import INSTRUMENTS

Shape = Literal["step", "trend", "burst"]
#: Smallest and largest number of wrong instruments, by the kind of a case.
WRONG_AT_ONCE = {"none": (1, 3), "single": (0, 2), "pair": (0, 1), "outside": (0, 1), "event": (0, 1)}
#: Largest resolution step and hum, over the noise of the reading.
_STEPS, _HUM = 1.0, 0.5
_JITTER = 5.0e-6  # s
_CLOCK = 5.0e-5
#: Beginning of an event, as a fraction of the recording; duration of a trend or a burst [s].
_BEGINS = (0.15, 0.8)
_LASTS = {"trend": (20.0, 60.0), "burst": (6.0, 20.0)}

_t = QUANTITIES["t"].symbol
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
    """A hidden event.

    Attributes
    ----------
    name : str
        The effect that makes it, one of `events`.
    shape : str
        ``step``, ``trend`` (it grows from `begin` to `end` and stays) or ``burst``.
    begin, end : float
        Beginning and end [s]; a step does not end.
    """

    name: str
    shape: Shape
    begin: float
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

    Parameters
    ----------
    bench : Bench
        The bench as its file describes it.
    kind : str
        Kind of the case, which limits their number.
    stated : dict
        Parameters of the instruments, to which the errors are added.
    rng : Generator
        Source of chance.
    turn : callable
        Returns the first of the names: each in turn.
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
