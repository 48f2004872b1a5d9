"""The instruments' response to the true motion and voltages, and its inverse.

A reading is late and weakened by the filter before its converter, and the angle that defines all harmonics has errors
of its own. A harmonic is described by its amplitude of exp(i h angle); the reading's amplitude over the true one is one
complex number for every channel and order (`Instruments.smooth`, `Instruments.held`). Slow motion is shifted in time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.reduction.windows import HARMONICS, Windows
from gyrowheel_sim.effects.targets import INSTRUMENT_PARAMETERS, added
from gyrowheel_sim.instruments import held_response, smooth_response
from gyrowheel_sim.jit import njit

Array = NDArray[np.float64]
Smooth = Literal["tilt", "spin_angle"]
Held = Literal["coil_voltage", "motor_voltage", "motor_current"]

#: Parameters of instruments that change the motion that goes into the balance; the others change rows alone.
OF_MOTION = frozenset(
    ("tilt_delay", "tilt_filter_time", "spin_angle_delay", "encoder_zero", "tilt_cubic", "tilt_cross_talk")
)
#: Those that show in harmonics alone, as the tilt's rate is small.
_OF_HARMONICS = OF_MOTION - {"tilt_cubic", "tilt_cross_talk"}
_ENCODER = ("encoder_once_x", "encoder_once_y", "encoder_twice_x", "encoder_twice_y")
#: Angles of a turn, close enough for the products of the encoder's errors with the harmonics.
_TURN: Array = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
#: Relative errors of the tilt sensors up to which one repetition, and two, find the true tilt.
_SMALL, _LARGE = 1.0e-3, 3.0e-2


@dataclass(frozen=True)
class Instruments:
    """The instruments of a bench, as changed by effects.

    `values` are delay and time constant of every channel and the errors of encoder and tilt sensors, by bench parameter
    [SI]; `orders` are the numbers of poles of every filter, by channel; `period` is the sampling period [s], and
    `ripple_order` the number of periods of the motor's ripple in a turn.
    """

    values: Mapping[str, float]
    orders: Mapping[str, int]
    period: float
    ripple_order: float

    @classmethod
    def of(cls, values: Mapping[str, float], laws: Mapping[str, Any]) -> Instruments:
        """Return the instruments of bench parameters and laws."""
        found = {name: values[name] for name in INSTRUMENT_PARAMETERS}
        for name in laws.keys() & found.keys():  # the target of such a law has the name of the parameter
            found[name] = float(np.mean(added(laws, values, "offset", name, start=values[name])))
        orders = {
            name.removesuffix("_filter_time"): round(values[name.replace("_time", "_order")])
            for name in INSTRUMENT_PARAMETERS
            if name.endswith("_filter_time")
        }
        return cls(found, orders, values["sample_period"], values["motor_ripple_order"])

    def as_perfect(self) -> Instruments:
        """Return instruments without errors and delays."""
        return replace(self, values=dict.fromkeys(self.values, 0.0))

    @property
    def perfect(self) -> bool:
        """Whether every reading is exact and immediate."""
        return not any(self.values.values())

    def turns_motion(self, other: Instruments, *, harmonics: bool) -> bool:
        """Whether the true motion differs between these instruments and others.

        `harmonics`: whether the readings of the tilt have harmonics of the shaft angle.
        """
        names = OF_MOTION if harmonics else OF_MOTION - _OF_HARMONICS
        return any(self.values[name] != other.values[name] for name in names)

    def turns_current(self, other: Instruments) -> bool:
        """Whether the true current differs between these instruments and others."""
        names = (n for n in self.values if n.startswith(("motor_current", "spin_angle", "encoder")))
        return any(self.values[name] != other.values[name] for name in names)

    def phase(self, spin: Any) -> Any:
        """Return the lead of the true angle at a stamp over the reading [rad], without its ripple."""
        return spin * self.values["spin_angle_delay"] - self.values["encoder_zero"]

    def smooth(self, channel: Smooth, order: float, spin: Any) -> Any:
        """Return amplitude of the reading over true amplitude of exp(i order angle), for a smooth quantity."""
        response = smooth_response(order * spin, *self._chain(channel)) if self._acts(channel) else 1.0
        return self._turned(order, spin, response)

    def held(self, channel: Held, order: float, spin: Any) -> Any:
        """Return the same for a quantity that is held for each sampling period."""
        held = self._acts(channel)
        own = held_response(order * spin, *self._chain(channel), period=self.period) if held else 1.0
        return self._turned(order, spin, own)

    def angle(self, order: float, spin: Any) -> Any:
        """Return the same for a quantity that is read at the stamp itself."""
        return self._turned(order, spin, 1.0)

    def _turned(self, order: float, spin: Any, response: Any) -> Any:
        if self.values["spin_angle_delay"] == 0.0 and self.values["encoder_zero"] == 0.0:
            return response
        return response * np.exp(1j * order * self.phase(spin))

    def _chain(self, channel: str) -> tuple[float, float, int]:
        """Return delay, time constant and number of poles of a channel."""
        return (
            self.values[f"{channel}_delay"],
            self.values.get(f"{channel}_filter_time", 0.0),
            self.orders.get(channel, 1),
        )

    def _acts(self, channel: str) -> bool:
        delay, time, _ = self._chain(channel)
        return delay != 0.0 or time != 0.0

    def lateness(self, channel: str) -> float:
        """Return the delay of a reading of slow motion [s]."""
        delay, time, order = self._chain(channel)
        return delay + order * time

    @cached_property
    def _encoder(self) -> Array | None:
        """What an encoder without zero error reads at the angles of `_TURN` [rad]; None if that is the angle."""
        once_x, once_y, twice_x, twice_y = (self.values[name] for name in _ENCODER)
        if not (once_x or once_y or twice_x or twice_y):
            return None
        once = once_x * np.cos(_TURN) + once_y * np.sin(_TURN)
        return np.asarray(_TURN + once + twice_x * np.cos(2.0 * _TURN) + twice_y * np.sin(2.0 * _TURN))

    @cached_property
    def _slope(self) -> Any:
        """The derivative of the reading `_encoder` by the angle."""
        assert self._encoder is not None
        error = np.fft.rfft(self._encoder - _TURN)
        return 1.0 + np.fft.irfft(1j * np.arange(len(error)) * error, len(_TURN))

    def _by_reading(self, values: Any, order: int) -> Any:
        """Return the amplitude of exp(i order reading) of values (..., angles) at the angles of `_TURN`."""
        assert self._encoder is not None
        wave = np.exp(-1j * order * (self._encoder + self.values["encoder_zero"])) * self._slope
        return values @ wave / len(_TURN)

    def encoder(self, order: int) -> complex:
        """Return the amplitude of exp(i order reading) in the error of the angle reading, without its zero [rad]."""
        if (reading := self._encoder) is None:
            return 0.0j
        return complex(self._by_reading(reading - _TURN, order))

    @cached_property
    def mixing(self) -> NDArray[np.complex128] | None:
        """The amplitudes of exp(i h reading), row by row, of exp(i h angle), column by column, for h in `HARMONICS`.

        Both angles have the zero error of the encoder. None where the encoder has no other error.
        """
        if self._encoder is None:
            return None
        waves = np.exp(1j * np.outer(HARMONICS, _TURN + self.values["encoder_zero"]))
        return np.array([self._by_reading(waves, to) for to in HARMONICS])

    def true_motion(self, windows: Windows) -> Windows:
        """Return windows in which tilt and spin rate are the true ones, harmonics by the true angle."""
        spin, half = windows.mean_spin, 0.5 * windows.duration
        late = self.lateness("tilt")
        harmonics = windows.tilt_harmonics
        if np.any(harmonics):
            one = np.ones(len(windows), dtype=complex)
            turned = np.stack([one / self.smooth("tilt", h, spin) for h in HARMONICS], axis=1)
            early = harmonics + late * _rate(harmonics, half[:, None, None])
            harmonics = turned[:, :, None] * self._unmixed(early)
        return replace(
            windows,
            tilt=windows.tilt + late * _rate(windows.tilt, half[:, None]),
            tilt_harmonics=harmonics,
            spin=windows.spin + self.values["spin_angle_delay"] * _rate(windows.spin, half[:, None]),
        )

    def true_current(self, windows: Windows) -> Windows:
        """Return windows in which the harmonics and the ripple of the current are the true ones, by the true angle."""
        spin = windows.mean_spin
        one = np.ones(len(windows), dtype=complex)
        turned = np.stack([one / self.held("motor_current", h, spin) for h in HARMONICS], axis=1)
        return replace(
            windows,
            current_harmonics=turned[:, :, None] * self._unmixed(windows.current_harmonics),
            current_ripple=windows.current_ripple / self.held("motor_current", self.ripple_order, spin),
        )

    def _unmixed(self, amplitudes: Any) -> Any:
        """Return amplitudes (n, harmonics, terms) by the true angle from those by a reading with encoder errors."""
        if self.mixing is None:
            return amplitudes
        try:
            unmixed = np.linalg.inv(self.mixing)
        except np.linalg.LinAlgError:  # a trial of a fit to absurd readings: its cost becomes infinite
            unmixed = np.full(self.mixing.shape, np.nan)
        return np.einsum("th,nhk->ntk", unmixed, amplitudes)

    def true_tilt(self, reading: Any, rate: Any, acceleration: Any) -> tuple[Any, Any, Any]:
        """Return the true tilt for readings of sensors with cubic error and cross-talk, and its two derivatives.

        `reading` is free of zero and scale errors; `rate` and `acceleration` are its derivatives [rad], [rad/s],
        [rad/s²].
        """
        cubic, cross = self.values["tilt_cubic"], self.values["tilt_cross_talk"]
        if cubic == 0.0 and cross == 0.0:
            return reading, rate, acceleration
        # sensors with the same mutual cross-talk: two equations, solved at once
        straight = [
            (part - 1j * cross * np.conj(part)) / (1.0 - cross**2) if cross else part
            for part in (reading, rate, acceleration)
        ]
        if cubic == 0.0:
            return straight[0], straight[1], straight[2]
        size = 3.0 * abs(cubic) * float(np.abs(straight[0]).max(initial=0.0)) ** 2
        times = 1 if size < _SMALL else 2 if size < _LARGE else 4
        shape = np.broadcast_shapes(*map(np.shape, straight))
        flat = [
            np.ascontiguousarray(np.broadcast_to(part, shape), dtype=complex).view(float).ravel()
            for part in straight
        ]
        out = np.empty((3, flat[0].size))
        _without_cubic(*flat, cubic, times, out)
        z, dz, ddz = (part.view(complex).reshape(shape) for part in out)
        return z, dz, ddz


@njit(cache=True, error_model="numpy")
def _without_cubic(x: Any, dx: Any, ddx: Any, cubic: float, times: int, out: Any) -> None:
    """Fill `out` with the true angles and their derivatives for readings with a cubic error, found by repetition."""
    for k in range(len(x)):
        value, first, second = x[k], dx[k], ddx[k]
        for _ in range(times):
            square = 3.0 * value * value
            error = cubic * square * value / 3.0
            error_first = cubic * square * first
            error_second = cubic * (6.0 * value * first * first + square * second)
            value, first, second = x[k] - error, dx[k] - error_first, ddx[k] - error_second
        out[0, k], out[1, k], out[2, k] = value, first, second


def _rate(polynomial: Any, half: Any) -> Any:
    """Return the time derivative of polynomials in x over the last axis, with as many terms."""
    result = np.zeros_like(polynomial)
    result[..., :-1] = polynomial[..., 1:] * np.arange(1, polynomial.shape[-1])
    return result / half
