"""Setups of angle, speed, motor voltage and motor current: which change of the columns makes physics hold."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.units import DEG, RPM
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mislabelled import Fix, Kind, WrongSetup
from gyrowheel_recording.mislabelled.blocks import BLOCK, EVERY, NAMES, Averages, averages, blocks_of
from gyrowheel_recording.mislabelled.relations import Spin, spin
from gyrowheel_sim.bench import Bench

_ANGLE, _RATE, _VOLTAGE, _CURRENT = SPINNING = ("spin_angle", "spin_rate", "motor_voltage", "motor_current")
#: A cure must leave every relation at this part of what is gross, and the worst at this part of what it was.
_MENDED, _BETTER = 0.4, 0.35
#: Parts of a recording in each of which another signal contradicts the others.
PARTS = 4
_STEP = EVERY * BLOCK
_NEAR = 5  # steps about the likeliest lag that are tried
#: Units that are mistaken for the right one, with the factor to it.
_ANGLES = {"deg": DEG, "turns": 2.0 * math.pi}
_RATES = {"rpm": RPM, "Hz": 2.0 * math.pi, "deg/s": DEG}
_THOUSANDS = {"m": 1e-3, "k": 1e3, "u": 1e-6}

Change = tuple[Kind, str, tuple[str, ...], Fix]


def wrong_spin_columns(
    recording: Recording, now: Averages, bench: Bench
) -> list[tuple[WrongSetup, Averages]]:
    """Return what may be wrong with the columns of the spin, and the averages as they should be; likeliest first.

    A wheel that turns the other way is not seen here: all four columns then have the other sign.
    """
    before = spin(now, bench)
    if before.worst <= 1.0:
        return []
    mending = _mending(recording, now, bench, before, measured_alone(_plain(), now))
    if not mending:
        mending = _mending(recording, now, bench, before, measured_alone(_lags(now, bench), now))
    if not mending:
        mending = _by_other_times(now, bench, before) or _by_leaving_out(now, bench, before)
    fewest = min((len(found.columns) for found, _ in mending), default=0)
    simple = [item for item in mending if len(item[0].columns) == fewest]
    simple.sort(key=lambda item: item[0].after)
    # of the lags of one column the best alone
    unique = {item[0].columns: item for item in reversed(simple)}
    result = [item for item in simple if unique[item[0].columns] is item]
    return [
        (replace(found, otherwise=tuple(o.columns for o, _ in result if o is not found)), mended)
        for found, mended in result
    ]


def _mending(
    recording: Recording, now: Averages, bench: Bench, before: Spin, changes: Iterable[Change]
) -> list[tuple[WrongSetup, Averages]]:
    result = []
    for kind, unit, columns, cure in changes:
        mended = _cured(recording, now, unit, cure)
        after = spin(mended, bench).worst
        if after < _MENDED and after < _BETTER * before.worst:
            result.append((WrongSetup(kind, columns, cure, unit, before=before.worst, after=after), mended))
    return result


def _by_other_times(a: Averages, bench: Bench, before: Spin) -> list[tuple[WrongSetup, Averages]]:
    """Return that the times count too slowly or too fast, if the spin agrees once they are those of the speed."""
    finite = np.isfinite(a.turning + a.rate)
    turning, rate = a.turning[finite], a.rate[finite]
    factor = float(turning @ rate) / max(float(turning @ turning), 1e-300)
    if not (a.measured(_ANGLE, _RATE) and 0.0 < factor < math.inf):
        return []
    # each derivative has one more power of the time; that of the angle is its mean already
    powers = np.where(np.array(NAMES) == _ANGLE, 1.0, 0.0)
    means, rates, bends = (
        own * factor ** (powers + order) for order, own in enumerate((a.means, a.rates, a.bends))
    )
    mended = Averages(means, rates, bends, a.absent)
    after = spin(mended, bench).worst
    if not (after < _MENDED and after < _BETTER * before.worst):
        return []
    wrong = WrongSetup("clock", (_ANGLE, _RATE), before=before.worst, after=after, value=factor)
    return [(wrong, mended)]


def _by_leaving_out(a: Averages, bench: Bench, before: Spin) -> list[tuple[WrongSetup, Averages]]:
    """Return that one column is another signal, if the others agree.

    It must contradict the others all the time: a sensor that fails for a while is no other signal.
    """
    result = []
    for name in SPINNING if a.measured(*SPINNING) else ():
        mended = a.without(name)
        after = spin(mended, bench).worst
        if after >= min(_MENDED, _BETTER * before.worst):
            continue
        if all(spin(part, bench).worst > 1.0 for part in a.parts(PARTS)):
            cure = Fix(without=(name,))
            result.append((WrongSetup("foreign", (name,), cure, before=before.worst, after=after), mended))
    return result


def measured_alone(changes: Iterable[Change], a: Averages) -> Iterator[Change]:
    """Yield the changes of columns that were measured."""
    return (change for change in changes if a.measured(*change[3].columns))


def _plain() -> Iterator[Change]:
    """Yield the changes of signs and units, and the exchange of voltage and current."""
    signs = ((_ANGLE,), (_RATE,), (_VOLTAGE,), (_CURRENT,), (_ANGLE, _RATE), (_VOLTAGE, _CURRENT))
    for columns in signs:
        yield "sign", "", columns, Fix(scale=dict.fromkeys(columns, -1.0))
    for unit, factor in _ANGLES.items():
        yield "unit", unit, (_ANGLE,), Fix(scale={_ANGLE: factor})
    for factor in (0.5, 2.0, -0.5, -2.0):
        yield "scale", "", (_ANGLE,), Fix(scale={_ANGLE: factor})
    for unit, factor in _RATES.items():
        for sign in (1.0, -1.0):
            yield "unit", unit, (_RATE,), Fix(scale={_RATE: sign * factor})
        for own, size in _ANGLES.items():
            both = Fix(scale={_ANGLE: size, _RATE: factor})
            yield "unit", f"{own}, {unit}", (_ANGLE, _RATE), both
    for prefix, factor in _THOUSANDS.items():
        yield "unit", f"{prefix}V", (_VOLTAGE,), Fix(scale={_VOLTAGE: factor})
        yield "unit", f"{prefix}A", (_CURRENT,), Fix(scale={_CURRENT: factor})
        both = Fix(scale={_VOLTAGE: factor, _CURRENT: factor})
        yield "unit", f"{prefix}V, {prefix}A", (_VOLTAGE, _CURRENT), both
    for sign in (1.0, -1.0):
        scale = {} if sign > 0.0 else {_VOLTAGE: sign, _CURRENT: sign}
        yield "exchanged", "", (_VOLTAGE, _CURRENT), Fix(exchange=((_VOLTAGE, _CURRENT),), scale=scale)


def _cured(recording: Recording, now: Averages, unit: str, cure: Fix) -> Averages:
    if _ANGLE not in cure.scale or not unit:
        return cure.applied(now)
    # the turns of an angle in another unit must be counted again
    blocks = blocks_of(recording, angle_scale=cure.scale[_ANGLE], absent=now.absent)
    anew, place = averages(blocks, now.absent), NAMES.index(_ANGLE)
    parts = {name: getattr(now, name).copy() for name in ("means", "rates", "bends")}
    for name, own in parts.items():
        own[:, place] = getattr(anew, name)[:, place]
    others = Fix(scale={name: factor for name, factor in cure.scale.items() if name != _ANGLE})
    return others.applied(replace(now, **parts))


def _lags(a: Averages, bench: Bench) -> Iterator[Change]:
    """Yield shifts of columns that may belong to another time: where their changes resemble those of the others."""
    v = bench.value
    turning, rate = (np.gradient(x) if len(a) > 1 else x for x in (a.turning, a.rate))
    expected = v("motor_resistance") * a.current + v("motor_constant") * a.rate
    pairs = (
        ((_RATE,), rate, turning),
        ((_ANGLE,), turning, rate),
        ((_VOLTAGE,), a.voltage, expected),
        ((_CURRENT,), a.current, a.acceleration),
        ((_VOLTAGE, _CURRENT), a.current, a.acceleration),
        ((_ANGLE, _RATE), a.acceleration, a.current),
    )
    for columns, own, other in pairs:
        lag = best_lag(own, other)
        for step in range(-_NEAR, _NEAR + 1):
            yield "shifted", "", columns, Fix(shift=dict.fromkeys(columns, lag + step * _STEP))


def best_lag(own: NDArray[np.inexact], other: NDArray[np.inexact]) -> float:
    """Return by how much `own` must be moved to later times to resemble `other` most [s]; real or complex.

    Both are at the times of the averages; what is not finite does not count.
    """
    known = np.isfinite(own) & np.isfinite(other)
    if not known.any():
        return 0.0
    first, second = (np.where(known, x - np.mean(x[known]), 0.0) for x in (own, other))
    size = 2 * len(first)
    product = np.fft.ifft(np.fft.fft(second, size) * np.conj(np.fft.fft(first, size))).real
    k = int(np.argmax(product))
    return float((k if k < len(first) else k - size) * _STEP)
