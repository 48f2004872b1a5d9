"""How a residual stands to the motion and how it grows, as sentences that can be checked."""

from __future__ import annotations

import math

import numpy as np

from gyrowheel_analysis.balance.balance import CHANNELS as AVERAGES
from gyrowheel_analysis.reduction import Windows
from gyrowheel_analysis.reduction.groups import speed_groups
from gyrowheel_analysis.residuals.fits import BySpeed, along_variable, by_speed, exponent, linear, where_usual
from gyrowheel_analysis.residuals.windows import Kind, Part, WindowResiduals
from gyrowheel_analysis.residuals.words import amounts, beyond, beyond_changing, ends, power
from gyrowheel_core.units import RPM

#: A part is spoken of if its misfit is this many deviations beyond that of noise, that of the averages, which may drift
#: together, this many times that of noise; and if it has this share of the whole.
_BEYOND = 6.0
_DRIFTING = 4.0
_SHARE = 0.03
#: By this part of the sum of squares time, which stands in for all that changes, must describe it better than that.
_STANDS_IN = 0.03
_PLAINER = 0.01  # of the sum of squares that a plainer description may leave
_MOST_SENTENCES = 3


def growth(data: WindowResiduals) -> list[str]:
    """Return how the residual stands to the motion and how it grows, as sentences that can be checked.

    The parts that carry most of the misfit are spoken of, and only what describes more than half of a part is said.
    """
    sentences = [_grows(part, data.windows) for part in _failing(data)]
    return [sentence for sentence in sentences if sentence is not None][:_MOST_SENTENCES]


def _failing(data: WindowResiduals) -> list[Part]:
    """Return the parts that are clearly more than noise, the worst first."""
    excess = {name: float(part.squares.sum()) - part.rows for name, part in data.parts.items()}
    whole = sum(max(value, 0.0) for value in excess.values())
    names = [name for name, part in data.parts.items() if excess[name] > max(_least(part), _SHARE * whole)]
    return [data.parts[name] for name in sorted(names, key=lambda n: -excess[n])]


def _least(part: Part) -> float:
    if part.kind.rows[0] in AVERAGES:
        return (_DRIFTING - 1.0) * part.rows
    return _BEYOND * math.sqrt(2.0 * part.rows)


def _grows(part: Part, w: Windows) -> str | None:
    """Return how one part goes with the motion; None where nothing describes more than half of it."""
    kind, total = part.kind, float(np.sum(part.squares))
    half = 0.5 * (total - part.rows)
    speeds = speed_groups(w.mean_spin)
    tried = [d for d in (by_speed(name, part, w, speeds) for name in kind.patterns) if d is not None]
    if not tried:
        return None
    # of patterns that describe it as well as any other the plainest one, which comes first
    most = max(d.explained for d in tried)
    best = next(d for d in tried if d.explained > most - _PLAINER * total)
    alone = max(
        (change for name in kind.patterns for change in linear(name, part, w)),
        key=lambda c: c.gain - (_STANDS_IN * total if c.variable == "time" else 0.0),
        default=None,
    )
    if alone is not None and alone.gain > max(most + _PLAINER * total, half):
        # two numbers say more than an amplitude for every speed
        return beyond_changing(kind, alone)
    other = along_variable(best, part, w, speeds)
    if best.explained + (other.gain if other is not None else 0.0) < half or abs(best.mean) == 0.0:
        return None
    if other is not None and other.gain > best.explained:
        # the amplitude is hardly ever the mean one, and may change its sign: both ends say what it is
        return beyond_changing(kind, other)
    best = where_usual(best, part, w)
    sizes = best.sizes
    alike = float(np.ptp(sizes)) < 0.1 * float(np.abs(sizes).max())
    text = beyond(kind, best.pattern, best.mean, alone=alike) + _growing(best, kind)
    return text + (f"; it goes {ends(kind, other)}" if other is not None else "")


def _growing(found: BySpeed, kind: Kind) -> str:
    """Return how a size grows with the speed: a power where that describes it, else both ends."""
    speed, sizes = found.speed, found.sizes
    if len(speed) < 2:
        return ""
    law = exponent(speed, sizes, found.sure) if len(speed) > 2 else None
    if law is not None:
        value, error = law
        if abs(value) < max(2.0 * error, 0.08) and abs(value) < 0.2:
            return ", at every speed"
        return f", and {'grows' if value > 0 else 'falls'} as {power(value, error)}"
    low, high = float(sizes[0]), float(sizes[-1])
    if max(abs(low), abs(high)) == 0.0 or np.ptp(sizes) < 0.15 * float(np.abs(sizes).max()):
        return ""
    (a, b), unit = amounts([low, high], kind, found.pattern)
    return f", from {a} to {b} {unit} between {speed[0] / RPM:.0f} and {speed[-1] / RPM:.0f} rpm"
