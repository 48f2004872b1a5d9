"""The law that a residual follows: its pattern over the motion, and how its amplitude grows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrowheel_analysis.criteria import LAW_EXCESS, LAW_EXCESS_OF_AVERAGE, LAW_OF_TIME, LAW_PLAINER, LAW_SHARE
from gyrowheel_analysis.reduction.groups import speed_groups
from gyrowheel_analysis.residuals.fits import (
    BySpeed,
    Change,
    along_variable,
    by_speed,
    exponent,
    linear,
    where_usual,
)
from gyrowheel_analysis.residuals.windows import Part, WindowResiduals

_MOST_LAWS = 3


@dataclass(frozen=True)
class SpeedLaw:
    """How an amplitude goes with the spin rate.

    Attributes
    ----------
    exponent, exponent_error : float or None
        Of a power law, with its standard error; None where no power describes it.
    constant : bool
        Whether the exponent is zero within its error.
    low, high : float
        Smallest and largest spin rate [rad/s].
    at_low, at_high : float
        Amplitudes there [unit of the kind, over that of the pattern].
    """

    exponent: float | None
    exponent_error: float | None
    constant: bool
    low: float
    high: float
    at_low: float
    at_high: float


@dataclass(frozen=True)
class Growth:
    """The law that one part of the residual follows.

    Attributes
    ----------
    part : str
        Which residual, see `channels.CHANNELS`.
    pattern : str
        How it goes with the motion, see `patterns.pattern`.
    amplitude : complex or None
        Mean amplitude [unit of the kind, over that of the pattern]; None where it changes so much with
        `change.variable` that a mean says nothing.
    uniform : bool
        Whether the amplitude is nearly the same at every spin rate.
    speed : SpeedLaw or None
        How it goes with the spin rate; None where that says nothing.
    change : Change or None
        How it changes with something else; None where it does not.
    """

    part: str
    pattern: str
    amplitude: complex | None
    uniform: bool = False
    speed: SpeedLaw | None = None
    change: Change | None = None


def growth(data: WindowResiduals) -> list[Growth]:
    """Return the laws that the residual follows, of the parts that carry most of the misfit.

    Only a law that describes more than half of a part is returned.
    """
    laws = [_law(name, data) for name in _failing(data)]
    return [law for law in laws if law is not None][:_MOST_LAWS]


def _failing(data: WindowResiduals) -> list[str]:
    """Return the names of the parts that are clearly more than noise, the worst first."""
    excess = {name: float(part.squares.sum()) - part.rows for name, part in data.parts.items()}
    whole = sum(max(value, 0.0) for value in excess.values())
    names = [name for name, part in data.parts.items() if excess[name] > max(_least(part), LAW_SHARE * whole)]
    return sorted(names, key=lambda n: -excess[n])


def _least(part: Part) -> float:
    if part.kind.group == "average":
        return (LAW_EXCESS_OF_AVERAGE - 1.0) * part.rows
    return LAW_EXCESS * math.sqrt(2.0 * part.rows)


def _law(name: str, data: WindowResiduals) -> Growth | None:
    """Return how one part goes with the motion; None where nothing describes more than half of it."""
    part, w = data.parts[name], data.windows
    kind, total = part.kind, float(np.sum(part.squares))
    half = 0.5 * (total - part.rows)
    speeds = speed_groups(w.mean_spin)
    tried = [d for d in (by_speed(p, part, w, speeds) for p in kind.patterns) if d is not None]
    if not tried:
        return None
    # of patterns that describe it as well as any other the plainest one, which comes first
    most = max(d.explained for d in tried)
    best = next(d for d in tried if d.explained > most - LAW_PLAINER * total)
    alone = max(
        (change for p in kind.patterns for change in linear(p, part, w)),
        key=lambda c: c.gain - (LAW_OF_TIME * total if c.variable == "time" else 0.0),
        default=None,
    )
    if alone is not None and alone.gain > max(most + LAW_PLAINER * total, half):
        # two numbers say more than an amplitude for every speed
        return Growth(name, alone.pattern, None, change=alone)
    other = along_variable(best, part, w, speeds)
    if best.explained + (other.gain if other is not None else 0.0) < half or abs(best.mean) == 0.0:
        return None
    if other is not None and other.gain > best.explained:
        # the amplitude is hardly ever the mean one, and may change its sign: both ends say what it is
        return Growth(name, other.pattern, None, change=other)
    best = where_usual(best, part, w)
    sizes = best.sizes
    alike = float(np.ptp(sizes)) < 0.1 * float(np.abs(sizes).max())
    return Growth(name, best.pattern, best.mean, alike, _speed_law(best), other)


def _speed_law(found: BySpeed) -> SpeedLaw | None:
    """Return how a size goes with the spin rate: a power where that describes it, else both ends."""
    speed, sizes = found.speed, found.sizes
    if len(speed) < 2:
        return None
    ends = float(speed[0]), float(speed[-1]), float(sizes[0]), float(sizes[-1])
    law = exponent(speed, sizes, found.sure) if len(speed) > 2 else None
    if law is not None:
        value, error = law
        return SpeedLaw(value, error, abs(value) < max(2.0 * error, 0.08) and abs(value) < 0.2, *ends)
    largest = float(np.abs(sizes).max())
    if max(abs(ends[2]), abs(ends[3])) == 0.0 or np.ptp(sizes) < 0.15 * largest:
        return None
    return SpeedLaw(None, None, False, *ends)
