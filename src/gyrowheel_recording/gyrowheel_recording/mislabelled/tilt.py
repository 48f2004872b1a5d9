"""Setups of tilts and coil voltages: which change of the columns makes the precession right."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.units import DEG
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.derived import angle_of
from gyrowheel_recording.mislabelled import Fix, Kind, WrongSetup
from gyrowheel_recording.mislabelled.blocks import (
    BLOCK,
    COIL,
    EVERY,
    TILT,
    Averages,
    asked_speed,
    asked_tilt,
    commanded,
)
from gyrowheel_recording.mislabelled.relations import precession, precession_ratio, slews
from gyrowheel_recording.mislabelled.spin import PARTS, SPINNING, Change, best_lag, measured_alone
from gyrowheel_sim.bench import Bench

Complex = NDArray[np.complex128]

_LENGTH, _MOST = 0.4, 40  # s, windows
_TILTED, _STILL = 0.5 * DEG, 0.1  # least tilt, and its largest change within a window
_ORDERS = (1, -1, 2, -2)


@dataclass(frozen=True)
class Turning:
    """Amplitudes twice a revolution of a pair of columns x + i y in windows at rest."""

    #: Shape (n,): coefficients of exp(2 i theta) and exp(-2 i theta), theta the recorded angle.
    forward: Complex
    backward: Complex
    noise: float  # standard deviation of an amplitude, from what no harmonic explains

    def changed(self, along: complex, across: complex) -> Turning:
        """Return the amplitudes of ``along * pair + across * conj(pair)``."""
        return Turning(
            along * self.forward + across * np.conj(self.backward),
            along * self.backward + across * np.conj(self.forward),
            self.noise * (abs(along) + abs(across)),
        )

    @property
    def direction(self) -> float:
        """Share of the power that turns forward less that backward, -1 .. 1; 0 where it is lost in noise."""
        if not len(self.forward):
            return 0.0
        forward, backward = (float(np.mean(np.abs(a) ** 2)) for a in (self.forward, self.backward))
        if max(forward, backward) < 25.0 * self.noise**2:
            return 0.0
        return (forward - backward) / (forward + backward)


def harmonics(
    recording: Recording, *, angle_factor: float = 1.0, absent: Set[str] = frozenset()
) -> tuple[Turning, Turning]:
    """Return how tilt and coil voltages turn twice a revolution; empty where no tilt is held.

    The recorded angle is multiplied by `angle_factor`. Of columns that were never measured (`absent`), the angle is
    integrated from the speed, and a coil's voltage counts as zero.
    """
    readings, time = recording.readings, recording.time
    if absent:
        readings = readings.copy()
        for name in absent & {"coil_voltage_x", "coil_voltage_y"}:
            readings[name][:] = 0.0
        if "spin_angle" in absent and "spin_rate" not in absent:
            readings["spin_angle"][:] = angle_of(time, readings.spin_rate)
    period = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    n = max(round(_LENGTH / period), 8)
    count = len(time) // n
    tilt = readings.tilt_x[: count * n] + 1j * readings.tilt_y[: count * n]
    parts = tilt.reshape(count, n)[:, :: max(n // 8, 1)]
    size, change = np.abs(parts.mean(axis=1)), np.abs(parts - parts[:, :1]).max(axis=1, initial=0.0)
    # any unit will do: at rest it is small compared with the largest tilt
    most = float(np.nanmax(size, initial=0.0))
    with np.errstate(invalid="ignore"):
        still = np.flatnonzero((change < _STILL * size) & (size > min(_TILTED, 0.2 * most)))
    chosen = still[np.linspace(0, len(still) - 1, min(len(still), _MOST)).astype(int)]
    x = np.linspace(-1.0, 1.0, n)
    slow = x[:, None] ** np.arange(4)
    rows, noise = [], []
    for k in chosen:
        own = readings[k * n : (k + 1) * n]
        pair = np.column_stack([own.tilt_x + 1j * own.tilt_y, own.coil_voltage_x + 1j * own.coil_voltage_y])
        angle = own.spin_angle
        if abs(angle_factor) in (0.5, 2.0):
            angle = np.unwrap(angle)  # the turns of another gear
        design = np.hstack([slow, *(np.exp(1j * h * angle_factor * angle)[:, None] for h in _ORDERS)])
        if not (np.isfinite(pair).all() and np.isfinite(design).all()):
            continue
        fit, *_ = np.linalg.lstsq(design, pair, rcond=None)
        rows.append(fit[-2:])
        noise.append(np.mean(np.abs(pair - design @ fit) ** 2, axis=0) / n)
    if not rows:
        none = Turning(np.zeros(0, complex), np.zeros(0, complex), 0.0)
        return none, none
    amplitudes, spread = np.array(rows), np.sqrt(np.median(np.array(noise), axis=0))
    first, second = (Turning(amplitudes[:, 0, k], amplitudes[:, 1, k], float(spread[k])) for k in (0, 1))
    return first, second


#: From this part on the law of precession fails grossly; a cure must leave less than `_MENDED`, and of what it was less
#: than `_BETTER`.
GROSS, _MENDED, _BETTER = 0.3, 0.12, 0.35
#: From this part on nothing is left of the law: the columns are not of one recording.
_FOREIGN = 0.85
#: Twice a revolution everything turns with the rotor; from this direction on it turns against it.
_AGAINST = -0.5
_FOLLOWS = 0.15  # part by which a tilt may differ from what was asked for, and a voltage from the command
_LATE, _LATEST = (
    0.3,
    0.3,
)  # part by which tilts that are late differ from what was asked for; least lateness [s]
_ON_TIME = 0.2  # of its changes: by what the speed may differ from what was asked for
_TWICE = 0.04  # how near to 2 or 1/2 a factor must be
_SAME = 0.02  # part by which two columns of one signal may differ
_UNITS = {"deg": DEG, "mrad": 1e-3, "arcmin": DEG / 60.0, "urad": 1e-6, "rad twice converted": 1.0 / DEG}
_VOLTS = {"mV": 1e-3, "uV": 1e-6, "kV": 1e3, "MV": 1e6}
_STEP, _NEAR, _COARSE = (
    EVERY * BLOCK,
    3,
    0.5,
)  # s between lags, lags about the likeliest one, s between those of the speed
_FINEST = 3e-6  # rad; no tilt sensor has less noise, nor moves less in a test


@dataclass(frozen=True)
class _Trial:
    """A change of tilts and coil voltages, and what it leaves unexplained."""

    kind: Kind
    unit: str
    columns: tuple[str, ...]
    cure: Fix
    after: float
    doubts: float

    @property
    def order(self) -> tuple[float, int]:
        return self.doubts, len(self.columns)


def wrong_tilt_columns(
    recording: Recording, now: Averages, bench: Bench, turning: Sequence[Turning]
) -> list[WrongSetup]:
    """Return what is wrong with tilts and coil voltages; the columns of the spin are right.

    `turning` is how tilt and coil voltages turn twice a revolution; setpoints and commands of the recording are used.
    """
    if not len(now) or not now.measured(*TILT) or now.absent >= set(COIL) or not slews(now, bench):
        return []
    doubled = _same(now, bench)
    if doubled is not None:
        return [doubled]
    asked = asked_tilt(recording, len(now))
    commands = commanded(recording, len(now)) if now.measured(*COIL) else None
    judge = _Judge(now, bench, turning, asked, commands)
    before = precession(now, bench)
    if before <= GROSS and judge.forward(Fix()):
        own = (
            _halved(now, bench, asked)
            or _one_halved(now, bench, asked, commands, before)
            or _late_together(now, asked, commands, recording)
        )
        return [] if own is None else [replace(own, before=before)]
    trials = [t for t in judge.trials(measured_alone(_plain(), now)) if _mends(before, t.after)]
    if before > GROSS:
        for changes in (_lags(now), _lags_of_speed(now)):
            further = () if trials else judge.trials(measured_alone(changes, now))
            trials = trials or [t for t in further if _mends(before, t.after)]
    if trials:
        first = min(trials, key=lambda t: (*t.order, t.after))
        others = [t.columns for t in trials if t.order == first.order and t.columns != first.columns]
        alike = tuple(dict.fromkeys(others))
        kind, columns, cure, unit = first.kind, first.columns, first.cure, first.unit
        return [WrongSetup(kind, columns, cure, unit, alike, before, first.after)]
    if before > GROSS and (other := _other_signal(now, bench, asked, commands, before)) is not None:
        return [other]
    if before > _FOREIGN:
        return [WrongSetup("foreign", (*TILT, *COIL), before=before)]
    return []


class _Judge:
    """Scores changes of tilts and coil voltages."""

    def __init__(
        self,
        now: Averages,
        bench: Bench,
        turning: Sequence[Turning],
        asked: Complex | None,
        commands: Complex | None,
    ) -> None:
        self._now, self._bench, self._turning = now, bench, turning
        self._asked, self._commands = asked, commands

    def forward(self, cure: Fix) -> bool:
        """Whether nothing turns against the rotor twice a revolution."""
        return all(
            not self._now.measured(*names) or pair.changed(*_complex(cure, names)).direction > _AGAINST
            for pair, names in zip(self._turning, (TILT, COIL), strict=True)
        )

    def trials(self, changes: Iterable[Change]) -> Iterator[_Trial]:
        """Yield the changes after which everything turns with the rotor."""
        for kind, unit, columns, cure in changes:
            if not self.forward(cure):
                continue
            mended = cure.applied(self._now)
            if not self._possible(mended):
                continue
            after = precession(mended, self._bench)
            # a wheel that turns the other way leaves tilts and voltages as they are
            doubts = self._doubts(self._now if kind == "reversed" else mended)
            yield _Trial(kind, unit, columns, cure, after, doubts)

    def _possible(self, a: Averages) -> bool:
        """Whether tilts and voltages are within what the bench can do, and not below the noise of any sensor."""
        v = self._bench.value
        tilt, coil = (np.nanmax(np.abs(x), initial=0.0) for x in (a.tilt, a.coil))
        return bool(_FINEST * 100.0 < tilt < 2.0 * v("tilt_limit") and coil < 2.0 * v("coil_voltage_limit"))

    def _doubts(self, a: Averages) -> float:
        """Return how many of tilt and voltages are not what was asked for and commanded."""
        doubts = 0.0
        for wanted, own in ((self._asked, a.tilt), (self._commands, a.coil)):
            if wanted is not None:
                doubts += _off(own, wanted) > _FOLLOWS
        return doubts


def _plain() -> Iterator[Change]:
    """Yield the exchanges of axes, turned signs, units and factors."""
    for pair in (TILT, COIL):
        yield "exchanged", "", pair, Fix(exchange=(pair,))
        for name in pair:
            yield "sign", "", (name,), Fix(scale={name: -1.0})
        yield "sign", "", pair, Fix(scale=dict.fromkeys(pair, -1.0))
        for name in pair:
            # a quarter turn
            yield "exchanged", "sign", pair, Fix(exchange=(pair,), scale={name: -1.0})
    # mirrored axes, or a wheel that turns the other way: no torque distinguishes them
    mirrored = Fix(scale={TILT[1]: -1.0, COIL[1]: -1.0})
    yield "reversed", "", SPINNING, mirrored
    yield "exchanged", "", (*TILT, *COIL), Fix(exchange=(TILT, COIL))
    for axis in (0, 1):
        own = (TILT[axis], COIL[axis])
        yield "sign", "", own, Fix(scale=dict.fromkeys(own, -1.0))
    for pair, units in ((TILT, _UNITS), (COIL, _VOLTS)):
        for columns in (pair, *((name,) for name in pair)):
            for unit, factor in units.items():
                yield "unit", unit, columns, Fix(scale=dict.fromkeys(columns, factor))
                if columns == pair:
                    yield ("unit", unit, columns, Fix(scale=dict.fromkeys(columns, -factor)))
    for name, factor in itertools.product((*TILT, *COIL), (2.0, 0.5)):
        yield "scale", "", (name,), Fix(scale={name: factor})


def _complex(cure: Fix, names: tuple[str, ...]) -> tuple[complex, complex]:
    """Return what a cure makes of a pair x + i y: (factor of the pair, factor of its conjugate)."""
    x, y = (cure.scale.get(name, 1.0) for name in names)
    along, across = 0.5 * (x + y), 0.5 * (x - y)
    if names in cure.exchange:
        return -1j * across, 1j * along
    return complex(along), complex(across)


def _mends(before: float, after: float) -> bool:
    # what turns against the rotor may fail with the torques as they are
    return after < _MENDED and (before <= GROSS or after < _BETTER * before)


def _off(own: Complex, wanted: Complex) -> float:
    """Return by what part a pair differs from what was asked for."""
    known = np.isfinite(own) & np.isfinite(wanted)
    size = float(np.linalg.norm(wanted[known]))
    return float(np.linalg.norm(own[known] - wanted[known])) / size if size > 0.0 else 0.0


def _same(a: Averages, bench: Bench) -> WrongSetup | None:
    """Return that one signal stands in both columns of a pair; of two tilts only to the last digit."""
    for names, pair, part in ((COIL, a.coil, _SAME), (TILT, a.tilt, 1e-9)):
        if not a.measured(*names):
            continue
        known = pair[np.isfinite(pair)]
        size = float(np.std(known.real)) if len(known) else 0.0
        noise = bench.value("coil_voltage_noise" if names is COIL else "tilt_noise")
        off = float(np.sqrt(np.mean((known.real - known.imag) ** 2))) if len(known) else 0.0
        if size > 10.0 * noise and off < part * size:
            return WrongSetup("same", names)
    return None


def _halved(a: Averages, bench: Bench, asked: Complex | None) -> WrongSetup | None:
    """Return that the tilts are read twice or half as large as they are.

    The coils' torque then fits the precession by half or twice. A constant of the coils or an inertia may be as
    wrong, so the tilt must differ from what was asked for by the same factor.
    """
    ratio = precession_ratio(a, bench).value
    if asked is None or not ratio > 0.0:
        return None
    factor = 2.0 if ratio > 1.0 else 0.5
    known = np.isfinite(a.tilt)
    own = float(np.real(np.vdot(asked[known], a.tilt[known])) / np.linalg.norm(asked[known]) ** 2)
    if not own > 0.0 or abs(math.log(own * factor)) > _TWICE or not 0.6 < ratio / factor < 1.7:
        return None
    off = _off(factor * a.tilt, asked)
    return WrongSetup("scale", TILT, Fix(scale=dict.fromkeys(TILT, factor))) if off < _FOLLOWS else None


def _other_signal(
    a: Averages, bench: Bench, asked: Complex | None, commands: Complex | None, before: float
) -> WrongSetup | None:
    """Return that one coil voltage or tilt is another signal, if the precession is right without it.

    A coil tilts across its axis. Whichever of the two is as it was commanded, or asked for, is right. They must
    contradict each other all the time: a sensor that fails for a while is no other signal.
    """
    slewing = [part for part in a.parts(PARTS) if slews(part, bench)]
    if not a.measured(*COIL) or any(precession(part, bench) <= GROSS for part in slewing):
        return None
    left = {name: precession(a.without(name), bench) for name in COIL}
    coil = min(COIL, key=lambda own: left[own])
    if not _mends(before, left[coil]):
        return None
    tilt = TILT[1 - COIL.index(coil)]
    found = WrongSetup("foreign", (coil,), Fix(without=(coil,)), before=before, after=left[coil])
    if commands is not None and _off(a.coil, commands) < _FOLLOWS:
        return replace(found, columns=(tilt,), cure=Fix(), after=math.nan)
    known = asked is not None and _off(a.tilt, asked) < _FOLLOWS
    return found if known else replace(found, otherwise=((tilt,),))


def _one_halved(
    a: Averages, bench: Bench, asked: Complex | None, commands: Complex | None, before: float
) -> WrongSetup | None:
    """Return that one tilt or one coil voltage is read twice or half as large as it is.

    The law of precession does not always fail grossly then, so the reading must differ from what was asked for, or
    commanded, by the same factor.
    """
    for names, wanted in ((TILT, asked), (COIL, commands)):
        if wanted is None:
            continue
        for name, factor in itertools.product(names, (2.0, 0.5)):
            cure = Fix(scale={name: factor})
            mended = cure.applied(a)
            pair = mended.tilt if names is TILT else mended.coil
            if _off(pair, wanted) > _FOLLOWS:
                continue
            known = np.isfinite(pair) & np.isfinite(wanted)
            part = np.real if name == names[0] else np.imag
            own, due = part(pair[known]), part(wanted[known])
            gain = float(own @ due) / max(float(due @ due), 1e-300)
            if not gain > 0.0 or abs(math.log(gain)) > _TWICE:
                continue
            after = precession(mended, bench)
            if after < _BETTER * before:
                return WrongSetup("scale", (name,), cure, after=after)
    return None


def _late_together(
    a: Averages, asked: Complex | None, commands: Complex | None, recording: Recording
) -> WrongSetup | None:
    """Return that tilts and voltages belong to another time than the spin.

    They agree with each other, and nearly with any speed, so the tilt must be what was asked for at that other time,
    and the speed what was asked for at its own. Where all is late, the setpoints may have another clock.
    """
    speed = asked_speed(recording, len(a))
    if asked is None or speed is None or _off(a.tilt, asked) < _LATE:
        return None
    lag = best_lag(a.tilt, asked)
    cure = Fix(shift=dict.fromkeys((*TILT, *COIL), lag))
    if abs(lag) < _LATEST or _off(cure.applied(a).tilt, asked) > _FOLLOWS:
        return None
    if commands is not None and abs(best_lag(a.coil, commands) - lag) > 2.0 * _STEP:
        return None
    known = np.isfinite(a.rate)
    own, wanted = a.rate[known], speed[known]
    off = float(np.linalg.norm(own - wanted)) if len(own) else math.inf
    changes = float(np.linalg.norm(wanted - wanted.mean())) if len(wanted) else 0.0
    if off > _ON_TIME * changes:
        return None
    return WrongSetup("shifted", (*TILT, *COIL), cure)


def _lags(a: Averages) -> Iterator[Change]:
    """Yield shifts of columns that may belong to another time: where the precession resembles the torque most."""
    slewing = -1j * a.rate * a.tilt_rate
    lag = best_lag(a.coil, slewing)
    likely: list[tuple[tuple[str, ...], float]] = [(COIL, lag), (TILT, -lag)]
    for k, part in ((0, np.real), (1, np.imag)):
        lag = best_lag(part(a.coil), part(slewing))
        likely += [((COIL[k],), lag), ((TILT[1 - k],), -lag)]
    for columns, lag in likely:
        for step in range(-_NEAR, _NEAR + 1):
            yield "shifted", "", columns, Fix(shift=dict.fromkeys(columns, lag + step * _STEP))


def _lags_of_speed(a: Averages) -> Iterator[Change]:
    """Yield shifts of tilts and voltages together: the precession of another time has another momentum."""
    both = (*TILT, *COIL)
    half = _COARSE * (len(a) * _STEP // (2.0 * _COARSE))
    for lag in np.arange(-half, half, _COARSE):
        yield "shifted", "", both, Fix(shift=dict.fromkeys(both, float(lag)))
