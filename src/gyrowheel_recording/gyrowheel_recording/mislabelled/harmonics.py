"""Which way the tilt and the coil voltages turn twice a revolution."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.units import DEG
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.derived import angle_of

Complex = NDArray[np.complex128]

_LENGTH, _MOST = 0.4, 40  # s, windows
_TILTED, _STILL = 0.5 * DEG, 0.1  # least tilt, and its largest change within a window
_ORDERS = (1, -1, 2, -2)


@dataclass(frozen=True)
class Turning:
    """Amplitudes twice a revolution of a pair of columns x + i y in windows at rest.

    Attributes
    ----------
    forward, backward : complex ndarray (n,)
        Of exp(2 i theta) and exp(-2 i theta), theta the recorded angle.
    noise : float
        Standard deviation of an amplitude, from what no harmonic explains.
    """

    forward: Complex
    backward: Complex
    noise: float

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

    Parameters
    ----------
    recording : Recording
        The recording.
    angle_factor : float
        What the recorded angle must be multiplied by.
    absent : set of str
        Columns that were never measured: the angle is summed up from the speed, a coil's voltage counts as zero.
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
    # any unit will do: what is at rest is small beside the largest tilt
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
