"""Amplitude of a line in the readings themselves.

A hum of the tilt readings goes round the tilt loop: the coils answer it and turn the rotor. What the coils were told,
and what the rotor does with it, is taken off, so that what is left stands in the readings alone.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.reduction.spectra import CHANNELS, COMMANDED, FEWEST, Array, Complex, Spectra
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.instruments.response import held_response, smooth_response

_MOTION_KNOWN = (
    0.05  # part to which the answer of the rotor is known: constants, and instants of the readings
)
_STIFF = 0.15  # of the gyroscopic torque: below it the rotor resonates, and its answer is not known
_BESIDE = (
    5.0,
    6.5,
    8.0,
    9.5,
    11.0,
)  # over 1/length: where beside a line the response of the readings is looked at


def line_amplitudes(
    spectra: Spectra, chosen: NDArray[np.bool_], frequency: float, level: Array, bench: Bench
) -> dict[str, tuple[float, float]]:
    """Return the amplitude of a line in the readings of every channel, with its standard error."""
    lines = spectra.at(frequency, chosen)
    at = {name: lines[:, k] for k, name in enumerate(spectra.columns)}
    noise = {name: level[:, k] for k, name in enumerate(spectra.columns)}
    result = {name: _mean_size([at[name]], [noise[name]]) for name in ("motor_voltage", "motor_current")}
    spin = 2.0 * math.pi * spectra.spin[chosen]
    known = spectra.columns[-1] == COMMANDED[-1]
    if known:
        # what the reading makes of what was commanded: as it does at the frequencies around, where there is no hum
        length = float(np.median(spectra.length))
        beside = [frequency + sign * d / length for sign in (-1.0, 1.0) for d in _BESIDE]
        sums = np.zeros(2, dtype=complex)
        around = {f: spectra.at(f, chosen) for f in beside}
        pairs = [(spectra.columns.index(r), spectra.columns.index(c)) for r, c in _pairs()]
        for rows in around.values():
            for r, c in pairs:
                sums += (np.vdot(rows[:, c], rows[:, r]), np.vdot(rows[:, c], rows[:, c]))
        gain = sums[0] / sums[1] if abs(sums[1]) > 0.0 else 1.0
        left = [at[r] - gain * at[c] for r, c in _pairs()]
        scatter = math.sqrt(
            np.mean(
                [
                    np.mean(np.abs(rows[:, r] - gain * rows[:, c]) ** 2)
                    for rows in around.values()
                    for r, c in pairs
                ]
            )
        )
        size, error = _mean_size(left, [np.full(len(left[0]), scatter)] * 2)
        gain_error = scatter / math.sqrt(abs(sums[1]))
        told = math.sqrt(float(np.mean([np.mean(np.abs(at[c]) ** 2) for _, c in _pairs()])))
        result["coil_voltage"] = (size, math.hypot(error, math.sqrt(0.5) * gain_error * told))
    # the tilt: what is left once the answer of the rotor to the coils is taken off
    drive = [at[c if known else r] for r, c in _pairs()]
    held = min(bench.sample_period, spectra.period)
    forward, backward = _turned(at["tilt_x"], at["tilt_y"])
    moved, resists = [], []
    for amplitude, sign in zip(_turned(*drive), (1.0, -1.0), strict=True):
        omega = sign * 2.0 * math.pi * frequency
        answer, clear = _answer(amplitude, omega, spin, bench, held, commanded=known)
        moved.append(answer)
        resists.append(clear)
    clear = resists[0] & resists[1]
    if clear.sum() >= FEWEST:
        left = [(forward - moved[0])[clear], (backward - moved[1])[clear]]
        own = np.sqrt(0.5 * (noise["tilt_x"] ** 2 + noise["tilt_y"] ** 2))[clear] / math.sqrt(2.0)
        size, error = _mean_size(left, [own, own])
        motion = math.sqrt(float(np.mean([np.mean(np.abs(m[clear]) ** 2) for m in moved])))
        # from amplitudes forward and backward to that of one axis
        result["tilt"] = (math.sqrt(2.0) * size, math.sqrt(2.0) * math.hypot(error, _MOTION_KNOWN * motion))
    return result


def _pairs() -> tuple[tuple[str, str], ...]:
    return tuple(zip(CHANNELS["coil_voltage"], COMMANDED, strict=True))


def _turned(x: Complex, y: Complex) -> tuple[Complex, Complex]:
    """Return the amplitudes of exp(i w t) and exp(-i w t) in x + i y, from twice those of exp(i w t) in x and y."""
    return 0.5 * (x + 1j * y), 0.5 * (np.conj(x) + 1j * np.conj(y))


def _answer(
    voltage: Complex, omega: float, spin: Array, bench: Bench, held: float, *, commanded: bool
) -> tuple[Complex, NDArray[np.bool_]]:
    """Return what the tilt sensors show of the rotor's answer to the coils, and where it is known.

    `voltage` is the amplitude of exp(i omega t) in the voltages x + i y, as read or as commanded for the interval that
    ends at the stamp; `held` is how long that is [s].
    """
    v, half = bench.value, 0.5 * omega * held
    acting = voltage * np.exp(1j * half) * np.sinc(half / math.pi)
    if not commanded:
        acting = acting / held_response(omega, *_chain(bench, "coil_voltage"), period=held)
    inertia = v("rotor_inertia_x") + 0.5 * v("gimbal_inertia_x")
    stiffness = 0.5 * (v("flexure_stiffness_x") + v("flexure_stiffness_y"))
    gyro = bench.precession_inertia * spin * omega
    resistance = stiffness + gyro - inertia * omega**2
    clear = np.abs(resistance) > _STIFF * np.abs(gyro)
    moved = v("coil_constant") * acting / np.where(clear, resistance, np.inf)
    return moved * smooth_response(omega, *_chain(bench, "tilt")), clear


def _chain(bench: Bench, channel: str) -> tuple[float, float, int]:
    v = bench.value
    return v(f"{channel}_delay"), v(f"{channel}_filter_time"), round(v(f"{channel}_filter_order"))


def _mean_size(lines: list[Complex], noise: list[Array]) -> tuple[float, float]:
    """Return the root mean square amplitude of lines, less what noise adds to it, and its standard error."""
    square = float(np.mean([np.mean(np.abs(line) ** 2) for line in lines]))
    own = float(np.mean([np.mean(n**2) for n in noise]))
    count = sum(len(line) for line in lines)
    size = math.sqrt(max(square - own, 0.0))
    # each amplitude has the noise `own`, half of it along the line
    spread = math.sqrt((2.0 * own * size**2 + own**2) / count)
    return size, spread / (2.0 * size) if size**2 > 0.5 * spread else math.sqrt(spread)
