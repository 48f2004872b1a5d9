"""The angle of a shaft from pulses: their edges, and the angle between them."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG

Array = NDArray[np.float64]

#: Part of the height of a pulse within which a sample lies on its edge, and about the level that it must leave to count
#: again.
_ON_EDGE, _PLAY = (0.1, 0.9), 0.15
_RESOLVED: Final = 0.5  # part of the edges that must show a sample on them
_LOW, _HIGH = 1.0, 99.0  # percentiles; a short pulse is high in few samples


@dataclass(frozen=True)
class Edges:
    """Edges of pulses."""

    times: Array  # (m,): when they were [s], ascending
    #: (m,): each was within this of its time [s]: half a sample where all that is known is between which two it was.
    within: Array
    #: Part of the time for which the signal is high; of a pulse shorter than a sample only those are seen that are
    #: high at one, so that its edge was just before that.
    high: float = 1.0

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.times)


def edges_of_level(times: Array, values: Array, level: float = math.nan) -> Edges:
    """Return the rising edges of a signal, (n,) times [s] and values, NaN where there is none.

    Where edges show samples on their way up, the crossing of `level` is interpolated; where the signal jumps from one
    sample to the next, the edge was anywhere between the two. The level is the middle between low and high if NaN.
    """
    known = np.isfinite(values)
    if known.sum() < 2:
        return Edges(np.zeros(0), np.zeros(0))
    low, high = levels(values[known])
    height = high - low
    middle = 0.5 * (low + high) if math.isnan(level) else level
    if not height > 0.0:
        return Edges(np.zeros(0), np.zeros(0))
    # a signal that wavers about the level has one edge: it counts again when it was clearly below
    state = np.zeros(len(values), dtype=np.int8)
    state[known & (values >= middle)] = 1
    state[known & (values < middle - _PLAY * height)] = -1
    last = np.maximum.accumulate(np.where(state != 0, np.arange(len(values)), -1))
    held = np.where(last >= 0, state[np.maximum(last, 0)], 0)
    up = np.flatnonzero((held[1:] == 1) & (held[:-1] == -1) & known[1:] & known[:-1]) + 1
    if not len(up):
        return Edges(np.zeros(0), np.zeros(0))
    before, after = values[up - 1], values[up]
    part = np.clip((middle - before) / np.maximum(after - before, 1e-300), 0.0, 1.0)
    step = times[up] - times[up - 1]
    inside = (values - low) / height
    on = np.zeros(len(up), dtype=bool)
    for k in (up - 1, up):
        on |= (inside[k] > _ON_EDGE[0]) & (inside[k] < _ON_EDGE[1])
    if float(np.mean(on)) > _RESOLVED:
        return Edges(times[up - 1] + part * step, np.zeros(len(up)))
    return Edges(times[up] - 0.5 * step, 0.5 * step, float(np.mean(held[known] == 1)))


def levels(values: Array) -> tuple[float, float]:
    """Return the low and the high level of a signal of pulses."""
    low, high = (float(np.percentile(values, at)) for at in (_LOW, _HIGH))
    if not high - low > 0.5 * float(np.ptp(values)):  # pulses in fewer samples than that
        low, high = float(values.min()), float(values.max())
    return low, high


def edges_of_count(times: Array, counts: Array) -> Edges:
    """Return the edges of a running count of pulses: it changed between two samples.

    A counter that wraps changes there, too; one that counts more than once between two samples has one edge.
    """
    known = np.flatnonzero(np.isfinite(counts))
    up = np.flatnonzero(np.diff(counts[known]) != 0.0)
    first, then = times[known[up]], times[known[up + 1]]
    return Edges(0.5 * (first + then), 0.5 * (then - first))


def edges_of_times(times: Array) -> Edges:
    """Return edges whose times a counter took; one that is repeated until the next comes counts once."""
    found = np.unique(times[np.isfinite(times)])
    return Edges(found, np.zeros(len(found)))


TURN: Final = 2.0 * math.pi
_FEWEST: Final = 8  # edges
#: Part of the way between two edges by which one may be early or late, in addition to the uncertainty of its time.
_OFF: Final = 0.25
_PULL: Final = 0.2  # part by which an edge moves where the next ones are expected
_LOST: Final = 12  # edges in a row that are out of place before they are taken for the place
_MOST_OUT: Final = 0.2  # part of the edges that may be out of place
_SAME: Final = 0.02  # part by which the speed may differ from that of the pulses
_WHOLE: Final = 0.1  # by which a step may differ from a whole number of edges
_BLOCK: Final = 1.0  # s
_WANDERS: Final = tuple(10.0**k for k in range(-7, 3))  # (rad/s)²/s, of the rate of what is left
_SAID: Final = 1e-3  # part by which the speed is off before it is reported
#: The speed from edges alone: every so long, from edges before and after that are so near [s], and to how much [rad].
_STEP, _SPANS, _FINE = 0.05, (0.8, 0.4, 0.2, 0.1, 0.05), 2e-3
_FINEST: Final = 1e-4  # rad; no shaft is better known


class PulseError(InputError):
    """Pulses that cannot be those of the shaft."""


@dataclass(frozen=True)
class ShaftAngle:
    """How a shaft turned, by its pulses."""

    angle: Array  # (n,): the angle at the samples [rad], not cut at whole turns
    uncertainty: float  # how far off it may be (1 sigma) [rad]
    remarks: tuple[str, ...]  # bridged gaps, and the deviation of the speed from the pulses


def angle_from_pulses(
    time: Array, rate: Array | None, edges: Edges, pulses: int, *, at: float = 0.0
) -> ShaftAngle:
    """Return the angle of a shaft from the edges of its pulses.

    `time` (n,): times of the samples [s], ascending; `rate` (n,): speed [rad/s]; NaN where it was not read.
    If None, it is computed from the edges. `pulses`: pulses per turn; `at`: the angle at an edge [rad].
    Raises PulseError if there are too few, or they contradict the speed.
    """
    inside = (edges.times >= time[0]) & (edges.times <= time[-1])
    when, within = edges.times[inside], edges.within[inside]
    if len(when) < _FEWEST:
        raise PulseError(
            f"{len(when)} rising edges; allowed: {_FEWEST} or more (does it hold pulses? `level:` says what an edge "
            "crosses)"
        )
    known = rate is not None and bool(np.isfinite(rate).any())
    if rate is not None and known:
        finite = np.isfinite(rate)
        speed = np.interp(time, time[finite], rate[finite])
    else:
        speed = _speed_of(time, when, within, pulses)
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))])
    sign = 1.0 if summed[-1] >= summed[0] else -1.0
    turning = sign * summed
    if known:
        _check(turning, time, when, pulses)
    per_step = pulses / TURN
    wide = within * np.abs(np.interp(when, time, speed)) * per_step
    number, kept = _counted(np.interp(when, time, turning) * per_step, np.minimum(_OFF + wide, 0.5))
    out = 1.0 - float(np.mean(kept))
    if out > _MOST_OUT:
        raise PulseError(
            f"{out:.0%} of its {len(when)} edges do not come where the speed has them; allowed: up to {_MOST_OUT:.0%} "
            "(is `level:` right, and `pulses:`, how many there are a turn?)"
        )
    when, within, number = when[kept], within[kept], number[kept]
    # a pulse that is shorter than a sample was high at the one that shows it
    short = edges.high * (TURN / pulses) / np.maximum(np.abs(np.interp(when, time, speed)), 1e-9)
    half = np.minimum(within, 0.5 * short)
    cut, when, within = half < within, when + within - half, half
    place = number * (TURN / pulses)
    sum_there = np.interp(when, time, turning)
    share = np.polyfit(sum_there - sum_there.mean(), place - place.mean(), 1)[0]
    if known and abs(share - 1.0) > _SAME:
        raise PulseError(_differ(1.0 / share, pulses))
    left = place - share * sum_there
    width = within * np.abs(np.interp(when, time, speed)) * share
    left, unequal = _evened(left, width, number, pulses)
    moved, uncertainty = _smoothed(time, when, left, width)
    if known:
        uncertainty = math.hypot(uncertainty, _walk(time, speed))
    # how short they are is known by how many are seen, which depends on how the turns keep step with the samples
    if cut.any():
        uncertainty = math.hypot(uncertainty, float(np.mean(width[cut])) / math.sqrt(3.0))
    remarks = _bridged(number, out, len(inside), pulses)
    if unequal:
        remarks.append(f"the {pulses} pulses of a turn are unequal by up to {unequal / DEG:.2g} deg")
    if not known:
        remarks.append("the speed is taken from the pulses, too")
    elif abs(share - 1.0) > _SAID:
        remarks.append(
            f"the speed reads {abs(1.0 / share - 1.0):.2%} {'more' if share < 1.0 else 'less'} than they show"
        )
    return ShaftAngle(sign * (share * turning + moved) + at, max(uncertainty, _FINEST), tuple(remarks))


def _speed_of(time: Array, when: Array, within: Array, pulses: int) -> Array:
    """Return the speed by edges alone [rad/s]: from as many of them as lie on a parabola to what each is known."""
    # the library takes long to load, and few tables have pulses
    from scipy.signal import medfilt

    step = np.diff(when)
    usual = medfilt(step, min(11, len(step) - (len(step) + 1) % 2))
    number = np.concatenate([[0.0], np.cumsum(np.rint(step / np.maximum(usual, 1e-12)))])
    place = number * (TURN / pulses)
    # the steps around every row, of which a pause has none
    steps = np.floor((np.clip(time, when[0], when[-1]) - when[0]) / _STEP)
    steps = steps[np.concatenate([[True], np.diff(steps) != 0.0])]
    at = when[0] + _STEP * np.unique(np.concatenate([steps, steps + 1.0]))
    rates = np.empty(len(at))
    for k, now in enumerate(at):
        for span in _SPANS:
            i, j = np.searchsorted(when, (now - span, now + span))
            i, j = max(min(i, j - _FEWEST, len(when) - _FEWEST), 0), min(max(j, i + _FEWEST), len(when))
            x = when[i:j] - now
            design = np.column_stack([np.ones(j - i), x, x**2])
            fit = np.linalg.lstsq(design, place[i:j], rcond=None)[0]
            rates[k] = fit[1]
            off = float(np.sqrt(np.mean((place[i:j] - design @ fit) ** 2)))
            if off <= abs(fit[1]) * float(np.sqrt(np.mean(within[i:j] ** 2) / 3.0)) + _FINE:
                break
    return np.interp(time, at, rates)


def _walk(time: Array, speed: Array) -> float:
    """Return how far the sum of a noisy speed walks at random from one block of edges to the next [rad]."""
    bent = np.abs(np.diff(speed, 2))
    noise = float(np.median(bent)) / (0.6745 * math.sqrt(6.0))
    return noise * math.sqrt(float(np.median(np.diff(time))) * _BLOCK / 6.0)


def _check(turning: Array, time: Array, when: Array, pulses: int) -> None:
    """Refuse another number of pulses a turn than there are, as the speed shows it."""
    steps = np.diff(np.interp(when, time, turning)) * pulses / TURN
    usual = float(np.median(steps))
    whole = round(usual)
    if abs(usual - 1.0) < 0.5:
        return
    if whole >= 2 and float(np.mean(np.abs(steps / whole - np.round(steps / whole)) < _WHOLE)) > 0.8:
        raise PulseError(_differ(usual, pulses))
    if usual <= 0.5:
        raise PulseError(_differ(usual, pulses))


def _differ(ratio: float, pulses: int) -> str:
    """Return that the speed is another one than that of the pulses, with what would fit."""
    fitting = pulses / ratio
    cure = f"set `pulses: {round(fitting)}`?" if abs(fitting - round(fitting)) < 0.05 * fitting else ""
    return (
        f"by {pulses} pulses a turn the speed reads {ratio:.4g} times what they show; "
        f"allowed: {_SAME:.0%} between them ({cure or 'are `pulses:`, and unit and scale of columns.spin_rate right?'})"
    )


def _counted(expected: Array, allowed: Array) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the number of every edge, and which of them are at their place.

    `expected` is how many edges there should have been by the sum of the speed, `allowed` by how much of the way to
    the next one each may be off. Of several edges at one place the nearest counts; one that is farther off is left out.
    """
    number = np.zeros(len(expected), dtype=np.int64)
    kept = np.ones(len(expected), dtype=bool)
    off, errors, out = expected[0], np.zeros(len(expected)), 0
    last = -1
    for k, value in enumerate(expected.tolist()):
        own = round(value - off)
        error = value - off - own
        if abs(error) > allowed[k]:
            kept[k], out = False, out + 1
            if out >= _LOST:  # they have another place now
                off, out = value - own, 0
            continue
        out = 0
        if last >= 0 and own <= number[last]:
            worse = k if abs(error) >= abs(errors[last]) else last
            kept[worse] = False
            if worse == k:
                continue
        number[k], errors[k], last = own, error, k
        off += _PULL * error
    return number, kept


def _evened(left: Array, width: Array, number: NDArray[np.int64], pulses: int) -> tuple[Array, float]:
    """Return what is left with the spacing of the pulses of a turn taken out, and how unequal that is [rad]."""
    if pulses == 1 or len(left) < 20 * pulses:
        return left, 0.0
    which = number % pulses
    slow = np.convolve(np.pad(left, pulses // 2, mode="edge"), np.ones(pulses) / pulses, mode="same")
    slow = slow[pulses // 2 : pulses // 2 + len(left)]
    beside = left - slow
    off = np.array([np.median(beside[which == k]) if np.any(which == k) else 0.0 for k in range(pulses)])
    error = np.array(
        [np.std(beside[which == k]) / math.sqrt(max(np.sum(which == k), 1)) for k in range(pulses)]
    )
    # less than that shows nothing: edges that keep step with the samples are all early or late
    if not np.any(np.abs(off) > 5.0 * error + np.median(width)):
        return left, 0.0
    off = off - off.mean()
    return left - off[which], float(np.abs(off).max())


def _smoothed(time: Array, when: Array, left: Array, width: Array) -> tuple[Array, float]:
    """Return what is left between edges and sum at all times, as smooth as the edges ask, and how far off it may be."""
    block = np.floor((when - when[0]) / _BLOCK)
    starts = np.r_[0, np.flatnonzero(np.diff(block)) + 1, len(when)]
    middles, values, variances = [], [], []
    for i, j in itertools.pairwise(starts.tolist()):
        own, wide = left[i:j], width[i:j]
        low, high = float(np.max(own - wide)), float(np.min(own + wide))
        square = float(np.mean(wide**2)) / 3.0
        if high > low:
            # all of it: edges that keep step with the samples are off alike in the next block, too; and no narrower
            # than so many edges leave it on average
            least = 18.0 * square / ((j - i + 1.0) * (j - i + 2.0))
            value, variance = 0.5 * (low + high), max((high - low) ** 2 / 4.0, least)
        else:
            value, variance = float(np.mean(own)), max(float(np.var(own)), square) / (j - i)
        middles.append(float(np.mean(when[i:j])))
        values.append(value)
        variances.append(variance + _FINEST**2)
    from scipy.interpolate import CubicHermiteSpline

    at, seen, noise = np.array(middles), np.array(values), np.array(variances)
    if len(at) < 2:
        return np.full(len(time), seen[0]), math.sqrt(noise[0])
    tried = [_walked(at, seen, noise, wander) for wander in (0.0, *_WANDERS)]
    _, smooth, rates, variance, innovation = max(tried, key=lambda own: own[0])
    # edges of neighbouring blocks that are off alike are one and the same evidence
    alike = float(np.mean(innovation[1:] * innovation[:-1])) if len(innovation) > 4 else 0.0
    alike = min(max(alike, 0.0), 0.9)
    spline = CubicHermiteSpline(at, smooth, rates)
    inside = np.clip(time, at[0], at[-1])
    moved = spline(inside) + np.where(time < at[0], rates[0], rates[-1]) * (time - inside)
    return np.asarray(moved), math.sqrt(float(np.mean(variance)) * (1.0 + alike) / (1.0 - alike))


def _walked(at: Array, seen: Array, noise: Array, wander: float) -> tuple[float, Array, Array, Array, Array]:
    """Return how likely values are whose rate walks at random, and the smoothed values, rates and variances.

    A Kalman filter forth and the smoother of Rauch, Tung and Striebel (AIAA Journal 3, 1965) back. The last result
    are the innovations over their standard deviations.
    """
    n = len(at)
    states, covariances = np.zeros((n, 2)), np.zeros((n, 2, 2))
    before, before_covariances = np.zeros((n, 2)), np.zeros((n, 2, 2))
    moves = np.zeros((n, 2, 2))
    likelihood, innovations = 0.0, np.zeros(n)
    state, covariance = np.array([seen[0], 0.0]), np.diag([1e2, 1.0])
    for k in range(n):
        step = at[k] - at[k - 1] if k else 0.0
        move = np.array([[1.0, step], [0.0, 1.0]])
        walk = wander * np.array([[step**3 / 3.0, step**2 / 2.0], [step**2 / 2.0, step]])
        state, covariance = move @ state, move @ covariance @ move.T + walk
        before[k], before_covariances[k], moves[k] = state, covariance, move
        total = covariance[0, 0] + noise[k]
        off = seen[k] - state[0]
        if k > 1:
            likelihood -= 0.5 * (math.log(total) + off**2 / total)
        innovations[k] = off / math.sqrt(total)
        gain = covariance[:, 0] / total
        state, covariance = state + gain * off, covariance - np.outer(gain, covariance[0])
        states[k], covariances[k] = state, covariance
    for k in range(n - 2, -1, -1):
        gain_back = covariances[k] @ moves[k + 1].T @ np.linalg.inv(before_covariances[k + 1])
        states[k] += gain_back @ (states[k + 1] - before[k + 1])
        covariances[k] += gain_back @ (covariances[k + 1] - before_covariances[k + 1]) @ gain_back.T
    return likelihood, states[:, 0], states[:, 1], covariances[:, 0, 0], innovations[2:]


def _bridged(number: NDArray[np.int64], out: float, seen: int, pulses: int) -> list[str]:
    """Return the remarks on edges that were missed or are left out."""
    missed = int(number[-1] - number[0]) + 1 - len(number)
    found = [f"{len(number)} edges of {pulses} pulse{'s' * (pulses > 1)} a turn"]
    if missed:
        found.append(f"{missed} missed edges are bridged by the speed")
    if left_out := round(out * seen):
        found.append(f"{left_out} edges that are too many, or out of place, are left out")
    return found
