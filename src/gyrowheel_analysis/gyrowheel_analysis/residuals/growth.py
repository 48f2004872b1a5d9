"""The law of a residual: its pattern over the motion, and its amplitude over speed and other variables."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import LAW_EXCESS, LAW_EXCESS_OF_AVERAGE, LAW_OF_TIME, LAW_PLAINER, LAW_SHARE
from gyrowheel_analysis.reduction.windows import Windows, speed_groups
from gyrowheel_analysis.residuals.error_table import Part, WindowResiduals
from gyrowheel_core.units import DEG


def pattern(name: str, w: Windows, load: NDArray[Any] | None = None) -> NDArray[Any]:
    """Return a dependence of a residual on the motion, for an amplitude of one; zero where it is absent.

    ``tilt``: the tilt [rad]; ``mirror``: its mirror image; ``square``: its square; ``cube``: its cube;
    ``rate``: its rate [rad/s]; ``load``: predicted torque of the coils [N m]; ``still``: one; ``acceleration``: of the
    spin [rad/s^2]; ``table``: rate of the table about the axes of the case [rad/s]; ``room``: a direction that is fixed
    in the room while the rig turns.
    """
    z = np.asarray(w.mean_tilt)
    if name == "tilt":
        return z
    if name == "mirror":
        return np.conj(z)
    if name == "cube":
        return z * np.abs(z) ** 2
    if name == "square":
        return np.abs(z) ** 2
    if name == "rate":
        return np.where(np.abs(w.mean_tilt_rate) > 0.5 * DEG, w.mean_tilt_rate, 0.0)
    if name == "load":
        return np.zeros(len(w)) if load is None else load
    if name == "acceleration":
        return np.where(np.abs(w.mean_spin_acceleration) > 1.0, w.mean_spin_acceleration, 0.0)
    if name == "table":
        return np.asarray(w.table_rate * w.up_across)
    if name == "room":
        # where the rig is not turned it equals a direction in the case
        return w.home_x if np.ptp(np.angle(w.home_x * np.exp(0.1j))) > 0.1 else np.zeros(len(w))
    return np.ones(len(w))


Array = NDArray[np.float64]
Speeds = Sequence[NDArray[np.int64]]

#: Variables, besides speed and tilt, with which an amplitude may change: the smallest informative range.
_VARIABLES = {
    "coils": 4.0,  # K
    "motor": 4.0,
    "magnets": 2.0,
    "air": 0.1,  # atmospheres
    "up": 0.5,
    "time": 5.0,  # s
}


@dataclass(frozen=True)
class BySpeed:
    """A pattern with a separate amplitude at every speed.

    Attributes
    ----------
    pattern : str
        See `growth.pattern`.
    speed : ndarray (k,)
        The speeds [rad/s], slowest first.
    amplitude : ndarray (k,)
        Amplitude at each, complex for a kind of two rows [unit of the kind, over that of the pattern].
    weight : ndarray (k,)
        Weight of each in the sum of squares: the inverse variance of white noise.
    explained : float
        Part of the sum of squares that the pattern explains.
    sure : ndarray (k,)
        Inverse variance of the amplitudes: `weight`, except for averages, which may drift together at a speed.
    """

    pattern: str
    speed: Array
    amplitude: NDArray[Any]
    weight: Array
    explained: float
    sure: Array

    @property
    def mean(self) -> complex:
        """Mean amplitude."""
        return complex(np.sum(self.weight * self.amplitude) / np.sum(self.weight))

    @property
    def sizes(self) -> Array:
        """The amplitudes (k,) along the mean one."""
        mean = self.mean
        return np.asarray(np.real(self.amplitude * np.conj(mean)) / max(abs(mean), 1e-300))


@dataclass(frozen=True)
class Change:
    """Change of the amplitude of a pattern with a variable other than the speed.

    Attributes
    ----------
    pattern, variable : str
        The pattern and the variable.
    low, high : float
        Range of the variable [K, atmospheres, 1 or s].
    at_low, at_high : float
        Amplitude at its ends, along `direction`.
    direction : complex
        Direction of the amplitude, of size one.
    gain : float
        Part of the sum of squares that it explains.
    """

    pattern: str
    variable: str
    low: float
    high: float
    at_low: float
    at_high: float
    direction: complex
    gain: float


def by_speed(name: str, part: Part, w: Windows, speeds: Speeds) -> BySpeed | None:
    """Return the amplitudes of the pattern `name` in a residual at every speed; None where the windows lack it.

    `speeds` are the windows of each speed, see `speed_groups`.
    """
    p, weight = pattern(name, w, part.load), part.weight
    real = not np.iscomplexobj(part.values)
    rows = []
    for index in speeds:
        g, q, r = weight[index], p[index], part.values[index]
        norm = float(np.sum(g * np.abs(q) ** 2))
        if norm > 0.0:
            a = np.sum(g * r * np.conj(q)) / norm
            alone = norm / len(index) if part.kind.group == "average" else norm
            rows.append((float(np.mean(w.mean_spin[index])), a.real if real else a, norm, alone))
    if not rows:
        return None
    speed, amplitude, norms, sure = (np.array(column) for column in zip(*rows, strict=True))
    return BySpeed(name, speed, amplitude, norms, float(np.sum(np.abs(amplitude) ** 2 * norms)), sure)


def where_usual(found: BySpeed, part: Part, w: Windows) -> BySpeed:
    """Return the amplitudes in windows in which only the speed varies, if every speed has such windows."""
    usual = _usual(w)
    if usual.all():
        return found
    alike = by_speed(found.pattern, part.at(usual), w.select(usual), speed_groups(w.mean_spin[usual]))
    return alike if alike is not None and len(alike.speed) == len(found.speed) else found


def _usual(w: Windows) -> NDArray[np.bool_]:
    """Return which windows have the median air pressure, attitude and coil temperature."""
    air, up = float(np.median(w.air_pressure)), float(np.median(w.up))
    same = (np.abs(w.air_pressure / air - 1.0) < 0.2) & (np.abs(w.up - up) < 0.5)
    return same & (np.abs(w.coil_temperature - np.median(w.coil_temperature)) < 8.0)


def linear(name: str, part: Part, w: Windows) -> Iterator[Change]:
    """Yield a pattern whose amplitude is a straight line in a variable, for each variable; its gain is the whole."""
    p = pattern(name, w, part.load)
    if not np.any(np.abs(p) > 0.0):
        return
    root = np.sqrt(part.weight)
    for variable, v in _variables(w, part).items():
        low, high = float(v.min()), float(v.max())
        design = np.column_stack([p * root, p * (v - low) * root])
        own = design.astype(complex) if np.iscomplexobj(part.values) else design.real
        solution, *_ = np.linalg.lstsq(own, part.values * root, rcond=1e-9)
        ends = np.array([solution[0], solution[0] + solution[1] * (high - low)])
        unit = _direction(complex(ends[int(np.argmax(np.abs(ends)))]), part)
        at = np.real(ends * np.conj(unit))
        explained = float(np.sum(np.abs(design @ solution) ** 2))
        yield Change(name, variable, low, high, float(at[0]), float(at[1]), unit, explained)


def along_variable(best: BySpeed, part: Part, w: Windows, speeds: Speeds) -> Change | None:
    """Return the variable with which the amplitude varies at a given speed, if that explains much of the residual."""
    total = float(np.sum(part.squares))
    p, weight = pattern(best.pattern, w, part.load), part.weight
    level = best.mean
    everywhere = weight * np.abs(p) ** 2
    found: list[Change] = []
    for name, v in _variables(w, part).items():
        gain, slopes, weights = 0.0, [], []
        for index in speeds:
            g, q, r, x = weight[index], p[index], part.values[index], v[index]
            norm = g * np.abs(q) ** 2
            if norm.sum() == 0.0 or np.ptp(x) < 0.2 * _VARIABLES[name]:
                continue
            x = x - np.sum(norm * x) / norm.sum()
            spread = float(np.sum(norm * x**2))
            if spread <= 0.0:
                continue
            slope = np.sum(g * x * r * np.conj(q)) / spread
            gain += abs(slope) ** 2 * spread
            slopes.append(slope)
            weights.append(spread)
        if not slopes:
            continue
        slope = complex(np.average(slopes, weights=weights))
        middle = float(np.sum(everywhere * v) / everywhere.sum())
        low, high = float(v.min()), float(v.max())
        unit = _direction(slope if abs(slope) * (high - low) > abs(level) else level, part)
        base, rise = (level * np.conj(unit)).real, (slope * np.conj(unit)).real
        at_low, at_high = base + rise * (low - middle), base + rise * (high - middle)
        found.append(Change(best.pattern, name, low, high, at_low, at_high, unit, gain))
    change = max(found, key=lambda c: c.gain, default=None)
    return change if change is not None and change.gain > 0.2 * total else None


def _variables(w: Windows, part: Part) -> dict[str, Array]:
    """Return the variables that vary enough in these windows.

    The temperatures of the motor follow the plan and matter to the motor only.
    """
    values = {
        "coils": w.coil_temperature,
        "motor": w.motor_temperatures[:, 0],
        "magnets": w.motor_temperatures[:, 1],
        "air": w.air_pressure / 101325.0,
        "up": w.up,
        "time": w.middle,
    }
    if part.kind.quantity == "coil_torque":
        del values["motor"], values["magnets"]
    return {name: v for name, v in values.items() if float(np.ptp(v)) >= _VARIABLES[name]}


def _direction(amplitude: complex, part: Part) -> complex:
    """Return the direction of an amplitude, of size one; one for a kind of one row, whose amplitudes are real."""
    turning = np.iscomplexobj(part.values) and abs(amplitude) > 0.0
    return amplitude / abs(amplitude) if turning else 1.0 + 0.0j


_MOST_STEPS, _CLOSE = 50, 1e-9  # of the fit of a power law
_PARTS = (1.0, 0.5, 0.2, 0.05, 0.01)  # of a step that are tried


def exponent(speed: Array, sizes: Array, weight: Array) -> tuple[float, float] | None:
    """Return the exponent of a power law of the speed and its standard error; None where a power law does not fit.

    `weight` is the inverse variance of the `sizes` at the speeds [rad/s], all (k,).
    """
    if float(speed.max() / speed.min()) < 1.3:
        return None
    reference = float(np.exp(np.average(np.log(speed), weights=weight)))
    largest = float(np.abs(sizes).max())
    if largest == 0.0:
        return None
    sizes, weight = sizes / largest, weight * largest**2

    def law(x: Array, amplitude: float, n: float) -> Array:
        return np.asarray(amplitude * (x / reference) ** n)

    def slopes(x: Array, amplitude: float, n: float) -> Array:
        power = (x / reference) ** n
        return np.column_stack([power, amplitude * power * np.log(x / reference)])

    found, root = np.array([np.average(sizes, weights=weight), 1.0]), np.sqrt(weight)
    for _ in range(_MOST_STEPS):
        off = root * (sizes - law(speed, *found))
        step, *_ = np.linalg.lstsq(root[:, None] * slopes(speed, *found), off, rcond=None)
        for part in _PARTS:
            there = root * (sizes - law(speed, *(found + part * step)))
            if there @ there <= off @ off:
                break
        else:
            break  # no step along this direction comes nearer
        found = found + part * step
        if np.abs(step).max() < _CLOSE:
            break
    else:
        return None
    design = slopes(speed, *found)
    covariance = np.linalg.pinv(design.T @ (weight[:, None] * design), hermitian=True)
    left = float(np.sum(weight * (sizes - law(speed, *found)) ** 2))
    # where the scatter exceeds the noise, the scatter gives the uncertainty
    error = float(np.sqrt(covariance[1, 1] * max(1.0, left / max(len(speed) - 2, 1))))
    if left > 0.05 * float(np.sum(weight * sizes**2)):
        return None
    return (float(found[1]), error) if error < 0.5 and abs(found[1]) < 6.0 else None


_MOST_LAWS = 3


@dataclass(frozen=True)
class SpeedLaw:
    """Dependence of an amplitude on the spin rate.

    Attributes
    ----------
    exponent, exponent_error : float or None
        Of a power law, with its standard error; None where no power law fits.
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
        Its dependence on the motion, see `pattern`.
    amplitude : complex or None
        Mean amplitude [unit of the kind, over that of the pattern]; None where it changes so much with
        `change.variable` that a mean is meaningless.
    uniform : bool
        Whether the amplitude is nearly the same at every spin rate.
    speed : SpeedLaw or None
        Its dependence on the spin rate; None where unknown.
    change : Change or None
        Its dependence on another variable, if any.
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
    """Return the law of one part; None where nothing describes more than half of it."""
    part, w = data.parts[name], data.windows
    kind, total = part.kind, float(np.sum(part.squares))
    half = 0.5 * (total - part.rows)
    speeds = speed_groups(w.mean_spin)
    tried = [d for d in (by_speed(p, part, w, speeds) for p in kind.patterns) if d is not None]
    if not tried:
        return None
    # of patterns that describe it equally well the plainest one, which comes first
    most = max(d.explained for d in tried)
    best = next(d for d in tried if d.explained > most - LAW_PLAINER * total)
    alone = max(
        (change for p in kind.patterns for change in linear(p, part, w)),
        key=lambda c: c.gain - (LAW_OF_TIME * total if c.variable == "time" else 0.0),
        default=None,
    )
    if alone is not None and alone.gain > max(most + LAW_PLAINER * total, half):
        # two numbers are a better description than an amplitude for every speed
        return Growth(name, alone.pattern, None, change=alone)
    other = along_variable(best, part, w, speeds)
    if best.explained + (other.gain if other is not None else 0.0) < half or abs(best.mean) == 0.0:
        return None
    if other is not None and other.gain > best.explained:
        # the amplitude is hardly ever the mean one, and may change its sign: both ends describe it
        return Growth(name, other.pattern, None, change=other)
    best = where_usual(best, part, w)
    sizes = best.sizes
    alike = float(np.ptp(sizes)) < 0.1 * float(np.abs(sizes).max())
    return Growth(name, best.pattern, best.mean, alike, _speed_law(best), other)


def _speed_law(found: BySpeed) -> SpeedLaw | None:
    """Return the dependence of a size on the spin rate: a power law where it fits, else both ends."""
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
