"""Independent instruments, integrated between the samples together with the motion.

Tilts and angle are filtered at every step of the integrator, and are read at the delayed instant by a parabola through
the three nearest steps. Held voltages are filtered, and the converter averages over one sampling period that ends at
the delay before the sample.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Suffixes, prefixes and names of the lines of the bench file that describe instruments.
_ENDINGS = ("_delay", "_filter_time", "_filter_order", "_resolution", "_hum")
_OTHERS = ("tilt_cubic", "tilt_cross_talk", "mains_frequency", "clock_jitter", "clock_rate_error")
#: Lines of the bench file that an instrument error changes: {name: {coefficient: line}}.
WRONG = {
    **{
        f"{channel}_delay": {"d": f"{channel}_delay"}
        for channel in ("tilt", "spin_angle", "coil_voltage", "motor_voltage", "motor_current")
    },
    **{
        f"{channel}_filter": {"t_f": f"{channel}_filter_time"}
        for channel in ("tilt", "coil_voltage", "motor_voltage", "motor_current")
    },
    "encoder_zero": {"E_0": "encoder_zero"},
    "encoder_once": {"E_x": "encoder_once_x", "E_y": "encoder_once_y"},
    "encoder_twice": {"E_x": "encoder_twice_x", "E_y": "encoder_twice_y"},
    "tilt_nonlinearity": {"q": "tilt_cubic"},
    "tilt_cross_talk": {"c": "tilt_cross_talk"},
}
_MICRO = 8  # steps of a filter in one step of the integrator
_KEPT = 14  # samples that are kept


def is_instrument(line: str) -> bool:
    """Whether a line of the bench file describes an instrument."""
    return line.endswith(_ENDINGS) or line.startswith("encoder_") or line in _OTHERS


class _Poles:
    """Equal poles of first order, one after the other."""

    def __init__(self, time: float, order: float, step: float) -> None:
        self.take = 1.0 - math.exp(-step / time) if time > 0.0 else 1.0
        self.out = [0.0] * int(order) if time > 0.0 else []

    def settle(self, value: float) -> None:
        self.out = [value] * len(self.out)

    def pass_on(self, value: float) -> float:
        """Return the output after a step in which the input is `value` on average."""
        for pole, before in enumerate(self.out):
            self.out[pole] = before + self.take * (value - before)
            # the input of the next pole is the mean output of this one
            value = 0.5 * (before + self.out[pole])
        return self.out[-1] if self.out else value


class _Smooth:
    """A channel of a smooth motion."""

    def __init__(self, delay: float, time: float, order: float, step: float, substeps: int) -> None:
        if delay < -step:
            raise ValueError("what has not happened yet cannot be read")
        self._poles, self._step, self._delay = _Poles(time, order, step / _MICRO), step, delay
        self._past: deque[float] = deque(maxlen=_KEPT * substeps)
        self._before = self._last = 0.0

    def start(self, value: float, rate: float = 0.0) -> None:
        """Initialise with a uniform motion."""
        self._past.extend(value - rate * self._step * k for k in range(self._past.maxlen or 0, -1, -1))
        self._poles.settle(value)
        self._before, self._last = value - rate * self._step, value

    def note(self, value: float) -> None:
        """Advance to the value at the end of a step of the integrator."""
        if self._poles.out:
            shown = 0.0
            half, bend = 0.5 * (value - self._before), 0.5 * (value - 2.0 * self._last + self._before)
            for k in range(_MICRO):
                x = (k + 0.5) / _MICRO
                shown = self._poles.pass_on(self._last + x * (half + x * bend))
            self._past.append(shown)
        else:
            self._past.append(value)
        self._before, self._last = self._last, value

    def read(self) -> float:
        """Return what is read now."""
        age = self._delay / self._step
        middle = max(round(age), 1)
        old, here, new = (self._past[-1 - k] for k in (middle + 1, middle, middle - 1))
        x = middle - age  # from the middle one towards the newer
        return here + 0.5 * x * (new - old) + 0.5 * x * x * (new - 2.0 * here + old)


class _Held:
    """A channel of a voltage that is held between samples."""

    def __init__(self, delay: float, time: float, order: float, step: float, substeps: int) -> None:
        self._poles = _Poles(time, order, step / _MICRO)
        self._count = substeps * _MICRO
        self._late = delay / (step / _MICRO)
        self._need = math.ceil(max(self._late, 0.0)) + self._count + 2
        self._past: list[float] = []

    def start(self, voltage: float) -> None:
        """Initialise with a constant voltage."""
        self._past = [voltage] * self._need
        self._poles.settle(voltage)

    def _means(self, voltage: float, steps: int) -> list[float]:
        """Advance at a voltage and return the mean at the converter, in steps of the filter."""
        if not self._poles.out:
            return [voltage] * steps
        means, before = [], self._poles.out[-1]
        for _ in range(steps):
            after = self._poles.pass_on(voltage)
            means.append(0.5 * (before + after))
            before = after
        return means

    def note(self, voltage: float) -> None:
        """Advance with the voltage of a step of the integrator."""
        self._past += self._means(voltage, _MICRO)
        if len(self._past) > 20 * self._need:
            del self._past[: -self._need]

    def read(self, following: float) -> float:
        """Return the present reading; `following` is the voltage of the next interval."""
        means = self._past[-self._need :]
        end = len(means) - self._late
        if end > len(means):
            kept = list(self._poles.out)
            means = means + self._means(following, self._count)
            self._poles.out = kept
        first = end - self._count
        # whole steps, and parts of the first and the last one
        a, b = math.floor(first), math.floor(end)
        total = sum(means[a:b]) - (first - a) * means[a]
        if end > b:
            total += (end - b) * means[b]
        return total / self._count


class Instruments:
    """All channels with delay, filter and errors.

    Parameters
    ----------
    numbers : dict of str to float
        Every line of the bench file, with the values of the machine [SI].
    substeps : int
        Steps of the integrator per sample.
    """

    def __init__(self, numbers: Mapping[str, float], substeps: int) -> None:
        self._n = numbers
        step = numbers["sample_period"] / substeps

        def chain(name: str) -> tuple[float, float, float, float, int]:
            n = numbers
            time, order = n.get(f"{name}_filter_time", 0.0), n.get(f"{name}_filter_order", 1.0)
            return n[f"{name}_delay"], time, order, step, substeps

        self._tilt = [_Smooth(*chain("tilt")) for _ in range(2)]
        self._angle = _Smooth(*chain("spin_angle"))
        self._speed = _Smooth(*chain("motor_current"))
        self._volts = [
            _Held(*chain("coil_voltage")),
            _Held(*chain("coil_voltage")),
            _Held(*chain("motor_voltage")),
        ]
        self._driving = _Held(*chain("motor_current"))
        # without delay and filter the speed and all else are those of the sample
        self.perfect = not any(numbers[line] for line in numbers if line.endswith(("_delay", "_filter_time")))

    def start(self, tilt: tuple[float, float], angle: float, spin: float, volts: tuple[float, ...]) -> None:
        """Initialise with a machine at constant speed."""
        for channel, value in zip(self._tilt, tilt, strict=True):
            channel.start(value)
        self._angle.start(angle, spin)
        self._speed.start(spin)
        for held, voltage in zip((*self._volts, self._driving), (*volts, volts[2]), strict=True):
            held.start(voltage)

    def note(self, tilt: tuple[float, float], angle: float, spin: float, volts: tuple[float, ...]) -> None:
        """Advance to the state at the end of a step of the integrator, with the voltages of the step."""
        for channel, value in zip((*self._tilt, self._angle, self._speed), (*tilt, angle, spin), strict=True):
            channel.note(value)
        for held, voltage in zip((*self._volts, self._driving), (*volts, volts[2]), strict=True):
            held.note(voltage)

    def read(self, following: tuple[float, ...]) -> tuple[float, ...]:
        """Return the present readings: two tilts, angle, three voltages and the motor current."""
        n = self._n
        volts = [held.read(voltage) for held, voltage in zip(self._volts, following, strict=True)]
        current = self._driving.read(following[2]) - n["motor_constant"] * self._speed.read()
        tilts = [channel.read() for channel in self._tilt]
        return (*tilts, self.encoder(self._angle.read()), *volts, current / n["motor_resistance"])

    def encoder(self, angle: float) -> float:
        """Return the encoder reading of an angle."""
        n, turn = self._n, complex(math.cos(angle), -math.sin(angle))
        once = complex(n["encoder_once_x"], n["encoder_once_y"]) * turn
        twice = complex(n["encoder_twice_x"], n["encoder_twice_y"]) * turn**2
        return angle + n["encoder_zero"] + once.real + twice.real

    def sensor(self, x: float, y: float, true_x: float, true_y: float) -> tuple[float, float]:
        """Return the non-linear part of the tilt readings (x, y), of the tilt [rad]."""
        bent, cross = self._n["tilt_cubic"], self._n["tilt_cross_talk"]
        return x + bent * true_x**3 + cross * true_y, y + bent * true_y**3 + cross * true_x


#: Reading of every column of a recording, by the prefix of its lines in the bench file.
_CHANNELS = (
    "tilt", "tilt", "spin_angle", "spin_rate", "coil_voltage", "coil_voltage", "motor_voltage", "motor_current",
    "temperature", "temperature", "pressure",
)  # fmt: skip


def hum(numbers: Mapping[str, float], count: int) -> Array:
    """Return the hum of the mains in every reading, shape (count, 11)."""
    wave = np.sin(2.0 * math.pi * numbers["mains_frequency"] * np.arange(count) * numbers["sample_period"])
    return wave[:, None] * [numbers.get(f"{name}_hum", 0.0) for name in _CHANNELS]


def in_steps(numbers: Mapping[str, float], row: Array) -> Array:
    """Return readings rounded to the steps of their converters."""
    step = np.array([numbers[f"{name}_resolution"] for name in _CHANNELS])
    some = step > 0.0
    row[..., some] = np.floor(row[..., some] / step[some] + 0.5) * step[some]
    return row


def stamps(numbers: Mapping[str, float], count: int, rng: np.random.Generator | None) -> NDArray[np.int64]:
    """Return the stamps of the samples [ns]."""
    time = np.arange(count) * numbers["sample_period"] * (1.0 + numbers["clock_rate_error"])
    if rng is not None and numbers["clock_jitter"] > 0.0:
        limit = 0.4 * numbers["sample_period"]
        time = time + np.clip(numbers["clock_jitter"] * rng.standard_normal(count), -limit, limit)
    return np.asarray(np.maximum(np.round(time * 1e9), 0.0), dtype=np.int64)
