"""Spectra over the order of the rotation: what is left in the samples, by its number of periods in a revolution.

The balance has rows at a few orders alone. The samples have all orders up to half the sampling rate over the speed.
They are taken over the angle of the shaft, in blocks of whole revolutions, so that what turns with the rotor is a line
at every speed. The orders that a channel has rows for are the residual of the model; at all others, and for quantities
without such rows, the spectrum is of the measured signal without its slow course.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import chdtri, fdtri

from gyrowheel_analysis.channels import CHANNELS, Quantity
from gyrowheel_analysis.residuals.error_table import WindowResiduals
from gyrowheel_core.readings import Readings
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

TURNS = 8  # revolutions of a block: orders are multiples of one over it
LOWEST, HIGHEST = 0.5, 10.0  # orders; below the lowest is the slow motion of a window
_SLOW_TERMS = 12  # of the polynomial of the slow course, at most; and never more than half the revolutions
_AROUND = 1.0  # orders to both sides from which the level of noise is taken
#: Neighbouring orders of a tapered block share noise, and a median uses this part of what is independent.
_INDEPENDENT, _OF_MEDIAN = 2.0 / 3.0, 2.0 / math.pi
_NOISE = 0.95  # of spectra of noise alone stay below the level at every order
_TURN = 2.0 * math.pi

#: What the sensors show of a quantity: the reading, or two as x + i y, and the parameter of the bench that it is times.
_SHOWN: Mapping[Quantity, tuple[Callable[[Readings], Any], str]] = {
    "coil_torque": (lambda own: own.coil_voltage_x + 1j * own.coil_voltage_y, "coil_constant"),
    "motor_torque": (lambda own: own.motor_current, "motor_constant"),
    "shaft_torque": (lambda own: own.motor_current, "motor_constant"),
    "motor_voltage": (lambda own: own.motor_voltage, ""),
    "winding_voltage": (lambda own: own.motor_voltage, ""),
    "encoder_angle": (lambda own: np.unwrap(own.spin_angle), ""),
}


@dataclass(frozen=True)
class OrderSpectrum:
    """Root mean square amplitudes over order, and the level that noise seldom exceeds.

    Attributes
    ----------
    quantity : str
        The quantity.
    order : ndarray (n,)
        Periods in a revolution.
    forward, backward : ndarray (n,)
        Amplitudes of exp(i o theta_z) and exp(-i o theta_z) in x + i y; of a real signal `forward` is the amplitude of
        its wave, and `backward` is empty [unit of the quantity].
    forward_level, backward_level : ndarray (n,)
        What noise with the spectrum of the neighbourhood exceeds at any order in 5 of 100 spectra [the same unit].
    predicted : tuple of int
        Orders, forward, at which the prediction of the model is taken out.
    blocks : int
        Blocks of `TURNS` revolutions that are averaged.
    left_out : int
        Windows that are too short or lack samples.
    """

    quantity: Quantity
    order: Array
    forward: Array
    backward: Array
    forward_level: Array
    backward_level: Array
    predicted: tuple[int, ...]
    blocks: int
    left_out: int


def order_spectrum(
    recordings: Sequence[Recording],
    data: WindowResiduals,
    quantity: Quantity,
    bench: Bench,
    chosen: Sequence[int] | None = None,
) -> OrderSpectrum:
    """Return the spectrum of a quantity over the order of the rotation, in some windows or in all.

    `recordings` are those of the residuals, in their order; the constants of the bench turn readings into torques.
    """
    shown, constant = _SHOWN[quantity]
    size = bench.value(constant) if constant else 1.0
    parts = [
        part for name, part in data.parts.items() if CHANNELS[name].quantity == quantity and part.kind.order
    ]
    w = data.windows
    rows = range(len(w)) if chosen is None else chosen
    powers, tops, left_out = list[Array](), list[float](), 0
    for k in rows:
        own = recordings[int(data.recording[k])]
        step = w.duration[k] / w.samples[k]
        i, j = np.searchsorted(own.time, w.start[k] + np.array([0.5 * step, w.duration[k] + 0.5 * step]))
        values = size * shown(own.readings[i:j])
        residual = {part.kind.order: complex(part.values[k]) for part in parts}
        found = _block_powers(own.time[i:j], np.unwrap(own.readings.spin_angle[i:j]), values, residual)
        if found is None:
            left_out += 1
            continue
        powers.append(found)
        tops.append(math.pi / (step * w.mean_spin[k]))  # half the sampling rate over the speed
    order = np.arange(round(LOWEST * TURNS), round(HIGHEST * TURNS) + 1) / TURNS
    order = order[order < min(tops, default=0.0)]
    sides = 2 if quantity == "coil_torque" else 1
    if not len(order):
        powers, order = [], np.zeros(0)
    every = np.concatenate(powers) if powers else np.zeros((0, sides, 1))
    lines = [_averaged(every[:, side, : len(order)], len(order)) for side in range(sides if powers else 0)]
    lines += [(np.zeros(0), np.zeros(0))] * (2 - len(lines))
    return OrderSpectrum(
        quantity=quantity,
        order=order,
        forward=lines[0][0],
        backward=lines[1][0],
        forward_level=lines[0][1],
        backward_level=lines[1][1],
        predicted=tuple(sorted(part.kind.order for part in parts)),
        blocks=len(every),
        left_out=left_out,
    )


def _block_powers(time: Array, angle: Array, values: Any, residual: Mapping[int, complex]) -> Array | None:
    """Return the squares of the amplitudes in each block of a window (blocks, forward and backward, orders).

    `residual` are the amplitudes that are left by the model at the orders that it predicts. None if there is no block,
    or a sample is missing.
    """
    n = len(angle)
    # the first sample stands for the interval before it
    turns = (angle[-1] - angle[0]) / _TURN * n / (n - 1) if n > 1 else 0.0
    blocks = math.floor(turns / TURNS + 1e-3) if turns > 0.0 else 0
    if not blocks or not np.isfinite(values).all() or np.ptp(time) > (n - 0.5) * np.median(np.diff(time)):
        return None
    x = np.linspace(-1.0, 1.0, n)
    slow = np.polynomial.legendre.legvander(x, min(_SLOW_TERMS, int(turns) // 2) - 1)
    waves = {order: np.exp(1j * order * angle) for order in residual}
    sides = [part for wave in waves.values() for part in (wave.real, wave.imag)]
    fit, *_ = np.linalg.lstsq(np.column_stack([slow, *sides]), values, rcond=None)
    values = values - slow @ fit[: slow.shape[1]]
    real = not np.iscomplexobj(values)
    for (order, wave), (cosine, sine) in zip(waves.items(), fit[slow.shape[1] :].reshape(-1, 2), strict=True):
        # what is measured gives way to what the model leaves of it
        change = (residual[order] - 0.5 * (cosine - 1j * sine)) * wave
        values = values + (2.0 * change.real if real else change)
    share = (angle - angle[0]) / (_TURN * TURNS)
    starts = np.searchsorted(share, np.arange(blocks + 1) - 1e-9)
    end = starts[-1]
    taper = 1.0 - np.cos(_TURN * share[:end])
    weighted = (2.0 if real else 1.0) * taper * values[:end]
    first = round(LOWEST * TURNS)
    base = np.exp(-1j * angle[:end] / TURNS)
    all_orders = np.vander(base, round(HIGHEST * TURNS) + 1, increasing=True)[:, first:]
    sums = [
        np.add.reduceat(weighted[:, None] * own, starts[:-1], axis=0)
        for own in ([all_orders] if real else [all_orders, all_orders.conj()])
    ]
    return np.abs(np.stack(sums, axis=1) / np.add.reduceat(taper, starts[:-1])[:, None, None]) ** 2


def _averaged(powers: Array, count: int) -> tuple[Array, Array]:
    """Return the amplitudes (orders,) of the powers of all blocks (blocks, orders), and the level of noise."""
    mean = powers.mean(axis=0)
    strength = np.median(powers, axis=1)
    # blocks that are noisier than others count for more, so that the mean scatters as that of fewer
    blocks = float(strength.sum() ** 2 / np.sum(strength**2)) if strength.any() else float(len(powers))
    near = min(2 * round(_AROUND * TURNS) + 1, count)
    of_median = chdtri(2.0 * blocks, 0.5) / (2.0 * blocks)
    around = ndimage.median_filter(mean, near, mode="nearest") / of_median
    free = 2.0 * blocks * max(near * _INDEPENDENT * _OF_MEDIAN, 1.0)
    chance = _NOISE ** (1.0 / max(count * _INDEPENDENT, 1.0))
    level = around * fdtri(2.0 * blocks, free, chance)
    return np.sqrt(mean), np.sqrt(level)
