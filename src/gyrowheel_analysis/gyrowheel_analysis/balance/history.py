"""The whole motion of a recording, windows and what lies between them, and the states of effects along it.

A law with a memory needs what was before each window. Within windows the motion is that of the windows, free of the
noise of the readings, so that a rate that counts every movement counts no noise. Between them, where the rotor moves
and settles, it is the readings averaged over revolutions, and the harmonics of some revolutions. What the rotor moves
below the noise of the readings is added to the rates as a motion of the same size (`unseen_motion`).
"""

from __future__ import annotations

import functools
import itertools
import math
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.unseen_motion import spread, unseen_rates
from gyrowheel_analysis.reduction.motor_temperature import motor_temperatures
from gyrowheel_analysis.reduction.quality import readable
from gyrowheel_analysis.reduction.samples import Array, Samples
from gyrowheel_analysis.reduction.windows import FORWARD, HARMONICS, MEAN, Windows, attitude, without_noise
from gyrowheel_core.arrays import running_mean
from gyrowheel_recording.bags.reader import pauses
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.declaration import Effect, LawState
from gyrowheel_sim.effects.law_code import (
    Instant,
    coefficient_arrays,
    memory_layout,
    memory_size,
    states_source,
)
from gyrowheel_sim.environment import Environment
from gyrowheel_sim.jit import compile_kernels, compile_source

_MOST = 8_000_000  # points of a course; a longer recording has them farther apart
_ROW = 0.1  # s, between rows of slow quantities
_KEPT = 24  # histories of states
_PARTS = 64  # of a step, at most, unless one is longer than a second: a pause may last for years
_ROUGH = 8  # sampling instants between the points of a rough or thin course
_THIN = 1.0e-4  # of the range of a state in the windows: error of a thin course that is accepted
#: Grid of the coefficients at which that is checked: a factor from value to value; for a pure number a difference, at
#: least this part of the usual value.
_FACTOR, _DIFFERENCE, _PART = 2.0, 0.2, 0.5
_BLOCK = 1 << 16  # points at once
_TURN = 1.5  # rad, the largest turn between two points at which harmonics are followed
_REVOLUTIONS = 4  # of a block between windows whose harmonics are taken
_SLOW_TERMS = 4  # of the slow motion in it
_DOUBTFUL = 2.0  # deviations of its noise that a harmonic of a block loses
_UNSETTLED = 3.0  # noise variances that motion leaves in a block, beyond which its harmonics are not taken
_SMOOTH, _AROUND = 3.0, 40  # samples: of a Gaussian that smooths readings between windows, and of local means
_REACH = 12  # samples of that Gaussian on each side
#: Deviation of the rate of smoothed readings, for unit noise and unit step.
_SMOOTHED = (4.0 * math.sqrt(math.pi) * _SMOOTH**3) ** -0.5
_SLOW = ("T_coil", "T_air", "T_winding", "T_motor", "rho", "i_motor", "Vx", "Vy")


@dataclass(frozen=True)
class Course:
    """The motion of a recording at equal intervals.

    `points` (n, 6) has tilt and its rate (x, y each), spin angle and spin rate; `slow` (m, 15) the slow quantities of
    the laws, a row for every `per_row` points; `start` and `step` are in seconds.
    """

    points: NDArray[np.float32]
    slow: Array
    per_row: int
    start: float
    step: float

    def place(self, time: float) -> int:
        """Return the number of the first point not before a time."""
        return min(max(math.ceil((time - self.start) / self.step - 1e-6), 0), len(self.points))


class History:
    """The states of effects along the motion of a recording.

    Parameters
    ----------
    windows : Windows
        Its windows.
    bench : Bench
        The bench as stated, whose zero and scale of the tilt readings hold.
    samples : Samples, optional
        Its samples; without them the motion between windows is taken as straight.
    """

    def __init__(self, windows: Windows, bench: Bench, samples: Samples | None = None) -> None:
        self._windows, self._bench, self._samples, self._every = windows, bench, samples, 1
        self._found: OrderedDict[Any, dict[str, Any]] = OrderedDict()
        self._checked: dict[Any, bool] = {}

    @cached_property
    def rough(self) -> History:
        """The states along the windows alone, at some of the sampling instants: enough for a size."""
        result = History(self._windows, self._bench)
        result._every = _ROUGH
        return result

    def breaks(self, longest: float) -> bool:
        """Whether the motion is unknown for more than a time [s]: between two samples, or between two windows."""
        times = [np.sort(self._windows.start)]
        if self._samples is not None:
            times.append(self._samples.time)
        return any(len(pauses(own, longest)) for own in times)

    @cached_property
    def course(self) -> Course:
        """The motion of the whole recording."""
        return course_of(self._windows, self._bench, self._samples, self._every)

    @cached_property
    def _thin(self) -> History | None:
        """The states at some of the sampling instants: enough for a state that follows no swift motion."""
        course = self.course
        every = max(k for k in range(1, _ROUGH + 1) if course.per_row % k == 0)
        if self._every > 1 or every == 1:
            return None
        result = History(self._windows, self._bench, self._samples)
        result._every = every
        result.course = replace(
            course,
            points=np.ascontiguousarray(course.points[::every]),
            per_row=course.per_row // every,
            step=course.step * every,
        )
        return result

    @cached_property
    def _fits(self) -> list[tuple[slice, Any]]:
        """The points of each window, and the matrix that fits Legendre terms and harmonics of a revolution to them."""
        course, w, result = self.course, self._windows, []
        for start, duration in zip(w.start.tolist(), w.duration.tolist(), strict=True):
            own = slice(course.place(start), max(course.place(start + duration), course.place(start) + 1))
            own = slice(min(own.start, len(course.points) - 1), own.stop)
            time = course.start + course.step * np.arange(own.start, own.stop)
            x = np.clip((time - start) / (0.5 * duration) - 1.0, -1.0, 1.0)
            design = _terms(x, course.points[own, 4].astype(float))
            result.append((own, np.linalg.pinv(design, rcond=1e-6)))
        return result

    def states(self, effect: Effect, values: Mapping[str, float], nodes: Any, phases: Any) -> dict[str, Any]:
        """Return the states of an effect in every window at nodes and spin angles, arrays (n, nodes, phases).

        `values` are the coefficients of the effect, `nodes` times from the middle of a window over half its duration.
        The state of a flexure is a pair.
        """
        names = _names_in(effect.states)
        key = effect.states, effect.each_flexure, tuple((k, v) for k, v in values.items() if k in names)
        if key in self._found:
            self._found.move_to_end(key)
            return self._found[key]
        basis = np.stack([_terms(np.full(len(phases), x), phases) for x in nodes])
        fitted = self._in_windows(effect, values, basis)
        result: dict[str, Any] = {}
        for (_, name), places in memory_layout([effect]).items():
            parts = [fitted[place] for place in places]
            if effect.each_flexure:
                result[name] = tuple(parts)
            else:
                result[name] = parts[0] if len(parts) == 1 else parts[0] + 1j * parts[1]
        self._found[key] = result
        if len(self._found) > _KEPT:
            self._found.popitem(last=False)
        return result

    def _in_windows(self, effect: Effect, values: Mapping[str, float], basis: Array) -> Array:
        """Return the states of an effect in the windows, by the terms of a `basis` (nodes, phases, terms).

        A thin course is taken where it agrees with the whole one at the nearest coefficients of a grid. So the choice
        follows from the coefficients alone, whatever was computed before.
        """
        if self._thin is None:
            return self._fitted(effect, values, basis)
        nearest = _nearest(effect, values)
        key = effect.states, effect.each_flexure, tuple(nearest.items())
        if key not in self._checked:
            few, whole = (
                course._fitted(effect, {**values, **nearest}, basis) for course in (self._thin, self)
            )
            error = np.abs(few - whole).max(axis=(1, 2, 3), initial=0.0)
            self._checked[key] = (
                bool(np.all(error <= _THIN * np.ptp(whole, axis=(1, 2, 3)))) if whole.size else True
            )
            if all(values[name] == value for name, value in nearest.items()):
                return few if self._checked[key] else whole
        return (self._thin if self._checked[key] else self)._fitted(effect, values, basis)

    def _fitted(self, effect: Effect, values: Mapping[str, float], basis: Array) -> Array:
        """Return the states (states, windows, nodes, phases) of an effect along the course, fitted in the windows."""
        along = self._along(effect, values)
        terms = np.array([matrix @ along[own] for own, matrix in self._fits])
        # every state apart, so that its values follow each other in memory
        terms = terms.reshape(-1, basis.shape[2], along.shape[1])
        return np.einsum("kpt,nts->snkp", basis, terms, order="C")

    def _along(self, effect: Effect, values: Mapping[str, float]) -> Array:
        """Return the states (points, numbers) of an effect along the course."""
        course = self.course
        rates, starts = _addresses(effect)
        coefficients, active = coefficient_arrays([effect], {effect.name: dict(values)}, self._bench)
        size = memory_size([effect])
        out = np.empty((len(course.points), size // 3))
        parts = max(math.ceil(course.step / (_ROUGH * self._bench.sample_period) - 1e-6), 1)
        parts = min(parts, max(_PARTS, math.ceil(course.step)))
        compile_kernels(*_KERNELS).states_along(
            rates, starts, coefficients, active, np.zeros(size), effect.each_flexure,
            course.points, course.slow, course.per_row, course.start, course.step, parts, out,
        )  # fmt: skip
        return out


@functools.lru_cache(maxsize=1024)
def _names_in(states: tuple[LawState, ...]) -> frozenset[str]:
    """Return the names in rates and starts of states."""
    return frozenset(s.name for own in states for e in (own.rate, own.start) for s in e.free_symbols)


def _nearest(effect: Effect, values: Mapping[str, float]) -> dict[str, float]:
    """Return the coefficients in the states of an effect, moved to a grid about their usual values."""
    result, names = {}, _names_in(effect.states)
    for c in effect.coefficients:
        if c.name in names and c.name in values:
            near, usual = values[c.name], c.default
            if c.unit == "1":
                step = max(_DIFFERENCE, _PART * abs(usual))
                near = usual + step * round((near - usual) / step)
            elif near * usual > 0.0:
                near = usual * _FACTOR ** round(math.log(near / usual, _FACTOR))
            result[c.name] = min(max(near, c.bounds[0]), c.bounds[1])
    return result


_KERNELS = (
    ("gyrowheel_sim", "mechanics/dynamics.py"),
    ("gyrowheel_sim", "effects/law_code.py"),
    ("gyrowheel_analysis", "balance/history_kernel.py"),
)
_codes: dict[Any, tuple[int, int]] = {}


def _addresses(effect: Effect) -> tuple[int, int]:
    """Return where the code is that writes rates and start values of the states of an effect.

    Effects that differ in names and values alone share it.
    """
    key = effect.states, effect.each_flexure, tuple(c.name for c in effect.coefficients)
    if key not in _codes:
        code = compile_source(states_source(replace(effect, name="law")), "the states of a law")
        _codes[key] = code.law_rates.address, code.law_starts.address
    return _codes[key]


def _terms(x: Any, angle: Any) -> Array:
    """Return Legendre terms of a time in a window, and harmonics of a revolution, at points (n,): (n, terms)."""
    waves = [part for order in FORWARD for part in (np.cos(order * angle), np.sin(order * angle))]
    return np.column_stack([np.ones_like(x), x, 1.5 * x**2 - 0.5, *waves])


def course_of(windows: Windows, bench: Bench, samples: Samples | None, every: int = 1) -> Course:
    """Return the motion of a recording from its windows, and between them from its samples if there are any.

    Its points are the sampling instants, or one in `every` so many.
    """
    data = None if samples is None or not len(samples.time) else readable(samples, bench)[0]
    if data is not None and len(data.time) < 2:
        data = None
    w, period = without_noise(windows), every * bench.sample_period
    begin = float(data.time[0]) if data is not None else 0.0
    end = float(data.time[-1]) if data is not None else 0.0
    if len(w):
        begin, end = min(begin, float(w.start[0])), max(end, float(np.max(w.start + w.duration)))
    step = period * max(math.ceil((end - begin) / period / _MOST), 1)
    count = max(round((end - begin) / step), 1) + 1
    points = np.zeros((count, 6), dtype=np.float32)
    per_row = max(round(_ROW / step), 1)
    course = Course(points, _slow(w, bench, data, (begin, end), per_row * step), per_row, begin, step)
    _set_spin(course, w, data)
    bias, scale = complex(bench.value("tilt_bias_x"), bench.value("tilt_bias_y")), bench.value("tilt_scale")
    noise = float(np.median(w.noise("tilt_noise"))) / scale if len(w) else 0.0
    speeds, sizes = unseen_rates(w, bench, data) if data is not None else (np.zeros(0), np.zeros(0))

    def unseen(spin: Any) -> Any:
        return np.interp(spin, speeds, sizes) if len(speeds) else 0.0 * spin

    edge, last = 0, None
    order = np.argsort(w.start, kind="stable").tolist()
    for number in order:
        first, stop = (course.place(w.start[number] + part) for part in (0.0, w.duration[number]))
        if stop - first < 2 or first < edge:
            continue
        half = 0.5 * w.duration[number]
        x = (begin + step * np.arange(first, stop) - w.start[number]) / half - 1.0
        series = (w.tilt[number] - bias * (np.arange(w.tilt.shape[1]) == 0)) / scale
        slow = np.polynomial.polynomial.polyval(x, series)
        rate = np.polynomial.polynomial.polyval(x, np.polynomial.polynomial.polyder(series)) / half
        waves = w.tilt_harmonics[number] @ MEAN[: w.tilt_harmonics.shape[2]] / scale
        before = (slow[0], waves) if last is None else last
        _fill_gap(course, slice(edge, first), before, (slow[0], waves), data, (bias, scale), noise, unseen)
        _fill(course, slice(first, stop), slow, rate, waves)
        edge, last = stop, (slow[-1], waves)
    if last is None:
        last = (0.0j, np.zeros(len(HARMONICS), dtype=complex))
    _fill_gap(course, slice(edge, count), last, (None, last[1]), data, (bias, scale), noise, unseen)
    if data is not None:
        _add_unseen(course, unseen)
    return course


def _add_unseen(course: Course, unseen: Callable[[Any], Any]) -> None:
    """Add what the rotor moves below the noise of the readings to the tilt rates; `unseen` is its size by the speed."""
    for first in range(0, len(course.points), _BLOCK):
        own = course.points[first : first + _BLOCK]
        rate = unseen(own[:, 5]) * spread(first, first + len(own))
        own[:, 2] += rate.real
        own[:, 3] += rate.imag


def _fill(course: Course, where: slice, slow: Any, rate: Any, waves: Any) -> None:
    """Write tilt and rate for slow tilt angles and harmonics, (harmonics,) or (points, harmonics)."""
    angle, spin = course.points[where, 4].astype(float), course.points[where, 5].astype(float)
    tilt, speed = slow + 0.0j, rate + 0.0j
    if np.any(waves) and course.step * float(spin.max(initial=0.0)) < _TURN:
        turn = np.exp(1j * angle)
        for order, amplitude in zip(HARMONICS, waves.T, strict=True):
            part = amplitude * turn**order
            tilt, speed = tilt + part, speed + 1j * order * spin * part
    z = np.tan(tilt.real) + 1j * np.tan(tilt.imag)
    course.points[where, 0], course.points[where, 1] = z.real, z.imag
    course.points[where, 2] = speed.real * (1.0 + z.real**2)
    course.points[where, 3] = speed.imag * (1.0 + z.imag**2)


def _fill_gap(
    course: Course,
    where: slice,
    before: Any,
    after: Any,
    data: Samples | None,
    reading: tuple[complex, float],
    noise: float,
    unseen: Callable[[float], float],
) -> None:
    """Write the motion between two windows: readings averaged over revolutions, or a straight line without them."""
    count = where.stop - where.start
    if count <= 0:
        return
    begin, end = (course.start + course.step * place for place in (where.start - 1, where.stop))
    knots: list[Array] = []
    values: list[Any] = []
    spin = float(np.mean(course.points[where, 5]))
    if data is not None and spin > 0.0:
        first, stop = np.searchsorted(data.time, (begin, end))
        revolutions = int((end - begin) * spin / (2.0 * math.pi))
        if stop - first >= 4 * revolutions > 0:
            edges = np.linspace(first, stop, revolutions + 1).astype(int)
            own = data.readings.tilt_x[first:stop] + 1j * data.readings.tilt_y[first:stop]
            sizes = np.diff(edges)
            knots = [np.add.reduceat(data.time[first:stop], edges[:-1] - first) / sizes]
            values = [(np.add.reduceat(own, edges[:-1] - first) / sizes - reading[0]) / reading[1]]
    from_start, to_end = where.start > 0, after[0] is not None
    at = np.concatenate([[begin] * from_start, *knots, [end] * to_end])
    tilt = np.concatenate([[before[0]] * from_start, *values, [after[0]] * to_end])
    if not len(at):
        at, tilt = np.array([begin]), np.array([before[0]])
    slopes = np.diff(tilt) / np.diff(at) if len(at) > 1 else np.zeros(1, dtype=complex)
    middles, between = _waves_between(data, (begin, end), spin, reading[1], noise)
    middles = np.concatenate([[begin], middles, [end]])
    between = np.vstack([before[1], between, after[1]])
    for first in range(where.start, where.stop, _BLOCK):
        part = slice(first, min(first + _BLOCK, where.stop))
        time = course.start + course.step * np.arange(part.start, part.stop)
        slow = np.interp(time, at, tilt.real) + 1j * np.interp(time, at, tilt.imag)
        place = np.clip(np.searchsorted(at, time) - 1, 0, max(len(at) - 2, 0))
        inside = (time >= at[0]) & (time <= at[-1])
        waves = np.column_stack(
            [
                np.interp(time, middles, own.real) + 1j * np.interp(time, middles, own.imag)
                for own in between.T
            ]
        )
        _fill(course, part, slow, np.where(inside, slopes[place], 0.0), waves)
    if data is not None and course.step < 1.5 * data.period(course.step):
        _add_sudden(course, where, data, reading, math.hypot(noise * _SMOOTHED / course.step, unseen(spin)))


def _add_sudden(
    course: Course, where: slice, data: Samples, reading: tuple[complex, float], noise: float
) -> None:
    """Add to the rates between windows what the readings move by more than noise beyond it, as where a ramp ends.

    `noise` [rad/s] is that of each axis of the rate of smoothed readings, with what the rotor moves unseen.
    """
    own, time = course.points[where], course.start + course.step * np.arange(where.start, where.stop)
    first, stop = np.searchsorted(data.time, (time[0], time[-1]))
    part = slice(max(first - 1, 0), stop + 1)
    read = np.column_stack(
        [np.interp(time, data.time[part], data.readings[name][part]) for name in ("tilt_x", "tilt_y")]
    )
    read = np.tan((read - [reading[0].real, reading[0].imag]) / reading[1])
    reach = np.arange(-_REACH, _REACH + 1)
    gaussian = np.exp(-0.5 * (reach / _SMOOTH) ** 2)
    slope = -reach / _SMOOTH**2 * gaussian / gaussian.sum()
    ended = np.pad(read - own[:, :2], ((_REACH, _REACH), (0, 0)), "symmetric")
    left = np.column_stack([np.convolve(axis, slope, "valid") for axis in ended.T]) / course.step
    power = running_mean((left**2).sum(axis=1), _AROUND, "symmetric")
    kept = np.maximum(1.0 - _DOUBTFUL * 2.0 * noise**2 / np.maximum(power, 1e-30), 0.0)
    own[:, 2:4] += left * kept[:, None]


def _waves_between(
    data: Samples | None, between: tuple[float, float], spin: float, scale: float, noise: float
) -> tuple[Array, Any]:
    """Return times, and the harmonics of the tilt (times, harmonics) of some revolutions about each that are steady."""
    nothing = np.zeros(0), np.zeros((0, len(HARMONICS)), dtype=complex)
    if data is None:
        return nothing
    begin, end = np.searchsorted(data.time, between).tolist()
    # by the samples: a pause has no revolutions
    seconds = (end - begin) * float(np.median(np.diff(data.time[begin:end]))) if end - begin > 1 else 0.0
    blocks = int(seconds * spin / (2.0 * math.pi * _REVOLUTIONS))
    if blocks < 1:
        return nothing
    edges = np.linspace(begin, end, blocks + 1).astype(int)
    times, found = [], []
    for first, stop in itertools.pairwise(edges):
        if stop - first < 2 * (_SLOW_TERMS + len(HARMONICS)):
            continue
        time, angle = data.time[first:stop], data.readings.spin_angle[first:stop]
        x = 2.0 * (time - time[0]) / (time[-1] - time[0]) - 1.0
        design = np.hstack([np.vander(x, _SLOW_TERMS), np.exp(1j * np.outer(angle, HARMONICS))])
        tilt = data.readings.tilt_x[first:stop] + 1j * data.readings.tilt_y[first:stop]
        waves = np.linalg.solve(design.conj().T @ design, design.conj().T @ tilt)
        left = float(np.mean(np.abs(tilt - design @ waves) ** 2))
        if left > _UNSETTLED * 2.0 * (scale * noise) ** 2:
            continue
        waves = waves[_SLOW_TERMS:]
        # harmonics of the noise alone vanish
        doubt = _DOUBTFUL**2 * left / len(time) / np.maximum(np.abs(waves) ** 2, 1e-30)
        waves = waves * np.maximum(1.0 - doubt, 0.0)
        times.append(0.5 * (time[0] + time[-1]))
        found.append(waves / scale)
    return (np.array(times), np.array(found)) if found else nothing


def _set_spin(course: Course, w: Windows, data: Samples | None) -> None:
    """Write spin angle and spin rate."""
    time = course.start + course.step * np.arange(len(course.points))
    if data is not None:
        course.points[:, 5] = np.interp(time, data.time, data.readings.spin_rate)
        angle = np.interp(time, data.time, np.unwrap(data.readings.spin_angle))
    else:
        speeds = w.mean_spin if len(w) else np.zeros(1)
        course.points[:, 5] = np.interp(time, w.middle if len(w) else np.zeros(1), speeds)
        angle = np.cumsum(course.points[:, 5], dtype=float) * course.step
    course.points[:, 4] = angle % (2.0 * math.pi)


def _slow(w: Windows, bench: Bench, data: Samples | None, between: tuple[float, float], row: float) -> Array:
    """Return the slow quantities of the laws between two times, a row every `row` seconds."""
    begin, end = between
    time = begin + row * (np.arange(max(math.ceil((end - begin) / row), 1) + 1) + 0.5)
    still = {"T_coil": "air_temperature", "T_air": "air_temperature", "T_winding": "air_temperature"}
    columns: dict[str, Array] = {name: np.full(len(time), bench.value(own)) for name, own in still.items()}
    columns["T_motor"] = columns["T_air"]
    pressure, current = np.full(len(time), bench.value("air_pressure")), np.zeros(len(time))
    coils = dict.fromkeys(("Vx", "Vy"), current)
    if data is not None:
        block = np.clip(((data.time - begin) / row).astype(np.int64), 0, len(time) - 1)
        number = np.bincount(block, minlength=len(time))
        known = np.flatnonzero(number)

        def averaged(name: str) -> Array:
            sums = np.bincount(block, weights=data.readings[name], minlength=len(time))
            return np.interp(time, time[known], sums[known] / number[known])

        columns["T_coil"], columns["T_air"] = averaged("coil_temperature"), averaged("air_temperature")
        pressure, current = averaged("air_pressure"), averaged("motor_current")
        # voltages that were never taken count as none
        coils = {name: np.nan_to_num(averaged(f"coil_voltage_{name[-1]}")) for name in coils}
        when, warm, _ = motor_temperatures(data, bench)
        columns["T_winding"], columns["T_motor"] = (np.interp(time, when, warm[:, k]) for k in (0, 1))
    elif len(w):
        shown = {"T_coil": w.coil_temperature, "T_air": w.air_temperature}
        shown |= {"T_winding": w.motor_temperatures[:, 0], "T_motor": w.motor_temperatures[:, 1]}
        columns |= {name: np.interp(time, w.middle, values) for name, values in shown.items()}
        pressure, current = (np.interp(time, w.middle, own) for own in (w.air_pressure, w.motor_current))
        means = {"Vx": w.coil_voltage.real, "Vy": w.coil_voltage.imag}
        coils = {name: np.interp(time, w.middle, values) for name, values in means.items()}
    columns["rho"] = np.maximum(pressure, 0.0) / (bench.value("gas_constant") * columns["T_air"])
    columns |= {"i_motor": current, **coils}
    return np.column_stack([*(columns[name] for name in _SLOW), _attitude(w, data, time)])


def _attitude(w: Windows, data: Samples | None, time: Any) -> Array:
    """Return the directions of the rig at some times (m, 7), as `Instant` has them."""
    if data is None and len(w):
        row = np.clip(np.searchsorted(w.start, time, side="right") - 1, 0, len(w) - 1)
        own = {name: getattr(w, name)[row] for name in ("up", "up_across", "home_x", "home_y")}
    else:
        events = sorted(data.environment if data is not None else (), key=lambda event: event.time)
        states = [attitude(event) for event in (Environment(), *events)]
        row = np.searchsorted([event.time for event in events], time, side="right")
        own = {name: np.array([state[name] for state in states])[row] for name in states[0]}
    across = (part for name in ("up_across", "home_x", "home_y") for part in (own[name].real, own[name].imag))
    assert Instant._fields[-7:] == ("up", "up_x", "up_y", "home_xx", "home_xy", "home_yx", "home_yy")
    return np.column_stack([own["up"], *across])
