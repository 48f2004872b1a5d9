"""Machine, controller, sensors and noise combined: from a secret to the columns of a recording."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.independent.controller import Controller
from benchmarks.independent.instruments import hum, in_steps, stamps
from benchmarks.independent.machine import Machine, Secret, bench_file
from benchmarks.independent.sequence import References

Array = NDArray[np.float64]

#: Columns of the readings.
COLUMNS = (
    "tilt_x", "tilt_y", "spin_angle", "spin_rate", "coil_voltage_x", "coil_voltage_y", "motor_voltage",
    "motor_current", "coil_temperature", "air_temperature", "air_pressure",
)  # fmt: skip
_NOISE = (
    "tilt_noise", "tilt_noise", "spin_angle_noise", "spin_rate_noise", "coil_voltage_noise", "coil_voltage_noise",
    "motor_voltage_noise", "motor_current_noise", "temperature_noise", "temperature_noise", "pressure_noise",
)  # fmt: skip
_DRIFT = {
    4: "coil_voltage_drift",
    5: "coil_voltage_drift",
    6: "motor_voltage_drift",
    7: "motor_current_drift",
}
_KNOT = 0.05  # s between the values of a drift, which is straight between them


@dataclass(frozen=True)
class Run:
    """Readings and commands.

    Attributes
    ----------
    readings : ndarray (n, 11)
        Columns in the order of `COLUMNS` [SI].
    commands : ndarray (n, 3)
        Voltages that answer each sample; they act from the next one on [V].
    stamps : ndarray (n,)
        Time stamp of each sample [ns].
    """

    readings: Array
    commands: Array
    stamps: NDArray[np.int64]


def run(
    secret: Secret,
    asked: References,
    rng: np.random.Generator | None,
    *,
    gain: float = 1.0,
    noise: float = 1.0,
    drift: float = 1.0,
    substeps: int = 4,
) -> Run:
    """Run a sequence on a machine.

    Parameters
    ----------
    secret : Secret
        The machine.
    asked : References
        Setpoints.
    rng : Generator or None
        Source of the noise; None for readings without noise.
    gain : float
        Factor of the controller gains.
    noise, drift : float
        Factors of white noise and slow drift of the bench file.
    substeps : int
        Steps of the integrator per sample.
    """
    n = len(asked.spin)
    stated = {name: line.value for name, line in bench_file().items()}
    white = _white(stated, n, rng, noise)
    slow = _slow(stated, n, rng, drift)
    machine, controller = Machine(secret, substeps), Controller(stated, gain)
    machine.start(float(asked.spin[0]))
    readings, commands = np.empty((n, len(COLUMNS))), np.empty((n, 3))
    air, pressure = secret.numbers["air_temperature"], secret.numbers["air_pressure"]
    held = (0.0, 0.0, secret.numbers["motor_constant"] * float(asked.spin[0]))
    waiting = held
    more = white + slow + hum(secret.numbers, n)
    eyes = machine.instruments
    x, y, angle, spin, _ = machine.read(held[2])
    eyes.start((x, y), angle, spin, held)

    def note() -> None:
        x, y, angle, spin, _ = machine.read(waiting[2])
        eyes.note((x, y), angle, spin, waiting)

    for k in range(n):
        if k:
            machine.advance(*waiting, None if eyes.perfect else note)
            held, waiting = waiting, tuple(commands[k - 1])
        x, y, angle, spin, current = machine.read(held[2])
        row = readings[k]
        if eyes.perfect:
            row[:] = x, y, eyes.encoder(angle), spin, *held, current, machine.coil_temperature, air, pressure
        else:
            x, y, angle, *volts, current = eyes.read(waiting)
            row[:] = x, y, angle, spin, *volts, current, machine.coil_temperature, air, pressure
        row += more[k]
        in_steps(secret.numbers, row)
        if k == 0:
            controller.start(row[0], row[1], row[3])
        commands[k] = controller.answer(
            row[0],
            row[1],
            row[3],
            asked.tilt[k],
            asked.tilt_rate[k],
            asked.spin[k],
            asked.spin_rate[k],
        )
    readings[:, 2] %= 2.0 * math.pi
    readings[:, 8] += secret.numbers["temperature_bias"]
    readings[:, 10] += secret.numbers["pressure_bias"]
    return Run(readings, commands, stamps(secret.numbers, n, rng))


def _white(stated: dict[str, float], n: int, rng: np.random.Generator | None, level: float) -> Array:
    if rng is None:
        return np.zeros((n, len(COLUMNS)))
    return rng.standard_normal((n, len(COLUMNS))) * [level * stated[name] for name in _NOISE]


def _slow(stated: dict[str, float], n: int, rng: np.random.Generator | None, level: float) -> Array:
    """Return slow drifts: white noise through a first-order lag with the stated time constant."""
    result = np.zeros((n, len(COLUMNS)))
    if rng is None:
        return result
    h = stated["sample_period"]
    count = math.ceil(n * h / _KNOT) + 2
    left = math.exp(-_KNOT / stated["drift_time"])
    for column, name in _DRIFT.items():
        knots = np.empty(count)
        knots[0] = rng.standard_normal()
        for k in range(1, count):
            knots[k] = left * knots[k - 1] + math.sqrt(1.0 - left * left) * rng.standard_normal()
        result[:, column] = (
            level * stated[name] * np.interp(np.arange(n) * h, np.arange(count) * _KNOT, knots)
        )
    return result
