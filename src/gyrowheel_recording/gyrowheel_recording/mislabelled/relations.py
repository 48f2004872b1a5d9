"""Physical relations between the columns: angle and speed, balance of voltages, precession, energy.

Each relation is fitted with constants that may be wrong by more than any effect or tolerance makes them, and returns
what part of the readings it leaves unexplained. Nothing here is an estimate: that is what the diagnosis is for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.units import DEG
from gyrowheel_recording.mislabelled.blocks import COIL, Averages
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

#: A constant of the bench may be wrong by these factors before a setup is to blame: campaigns hide errors of 50 %.
_CONSTANT = (0.4, 1.8)
#: The same for the ratio of angular momentum to the constant of the coils: both may be wrong at once.
_RATIO = (0.3, 2.9)
_MOST_FRICTION = 40.0  # times the stated friction
_STIFFEST = 6.0  # times the stated stiffness
_DAMPED = (
    0.6  # of the precession torque: the most that a rotation of the sensors or a damping may add across it
)
#: Slewing torque over holding torque from which on the law of precession can be judged.
_SLEWS = 1.0
_MOVED = 0.5 * DEG  # least change of the tilt
_RAMPS = 0.3  # least part of the motor's torque that accelerates the rotor
_OVERLAP = 16.0  # averages that share their blocks


@dataclass(frozen=True)
class Spin:
    """What the relations of the spin leave unexplained, as parts of the readings: 0 perfect, 1 nothing explained."""

    kinematic: float  # speed against the rate at which the angle turns
    electrical: float  # V = R i + Ke Omega
    energy: float  # kt i = J dOmega/dt + friction, which may not drive

    @property
    def worst(self) -> float:
        """The worst of them over what is gross for each (`GROSS_SPIN`)."""
        return max(
            value / limit
            for value, limit in zip((self.kinematic, self.electrical, self.energy), GROSS_SPIN, strict=True)
        )


#: From these parts on a relation of the spin fails grossly: kinematic, electrical, energy.
GROSS_SPIN = (0.05, 0.15, 0.6)


def spin(a: Averages, bench: Bench) -> Spin:
    """Return how well speed, angle, motor voltage and motor current fit each other."""
    finite = np.isfinite(a.turning + a.rate + a.voltage + a.current)
    turning, rate, voltage, current = (x[finite] for x in (a.turning, a.rate, a.voltage, a.current))
    if not len(rate):
        return Spin(0.0, 0.0, 0.0)
    kinematic = _size(turning - rate) / max(_size(rate), _size(turning), 1e-30)
    if a.absent >= {"spin_angle", "spin_rate"}:
        return Spin(0.0, 0.0, 0.0)
    v = bench.value
    electrical = energy = 0.0
    inertial = bench.axial_inertia * a.acceleration[finite]
    if a.measured("motor_voltage"):
        drop, drops = current * v("motor_resistance"), (0.2, 5.0)
        if not a.measured("motor_current"):  # the current that accelerates is the larger part of it
            drop, drops = inertial * (v("motor_resistance") / v("motor_constant")), (0.1, 10.0)
        design = np.column_stack([rate * v("motor_constant"), drop])
        electrical = _left(design, voltage, [_CONSTANT, drops], _size(voltage))
    if not a.measured("motor_current"):
        return Spin(kinematic, electrical, energy)
    torque, turn = v("motor_constant") * current, np.sign(rate)
    friction = v("bearing_coulomb"), v("bearing_viscous")
    reference = v("spin_rate_reference")
    usual = friction[0] + friction[1] * reference
    speed = np.abs(rate) / reference
    design = np.column_stack([inertial, *(usual * turn * speed**power for power in (0, 1, 2))])
    # a drift of the current reading is no torque
    floor = v("motor_constant") * 4.0 * (v("motor_current_drift") + v("motor_current_noise"))
    size = max(_size(torque), 0.5 * usual, floor)
    energy = _left(design, torque, [_CONSTANT, *[(0.0, _MOST_FRICTION)] * 3], size)
    return Spin(kinematic, electrical, energy)


def slews(a: Averages, bench: Bench) -> bool:
    """Whether the tilt moves enough for the law of precession to be judged."""
    finite = np.isfinite(a.tilt + a.rate)
    tilt, omega = a.tilt[finite], a.rate[finite]
    if not len(tilt) or np.abs(tilt - np.median(tilt.real) - 1j * np.median(tilt.imag)).max() < _MOVED:
        return False
    detuned = 0.5 * (bench.tuning_inertia * omega**2) - bench.value("flexure_stiffness_x")
    slewing = bench.precession_inertia * omega * a.tilt_rate[finite]
    return _size(slewing) > _SLEWS * _size(detuned * tilt)


def precession(a: Averages, bench: Bench) -> float:
    """Return what part of the coil torque the law of precession leaves unexplained.

    T = g (-i H dz/dt) + (k0 - k2 Omega^2) z + damping + inertia, with g between `_RATIO` and a stiffness that is none
    below zero.
    """
    finite = np.isfinite(a.tilt + a.coil + a.rate)
    z, rate, bend, omega = a.tilt[finite], a.tilt_rate[finite], a.tilt_acceleration[finite], a.rate[finite]
    torque = bench.value("coil_constant") * a.coil[finite]
    if not len(z):
        return 0.0
    v = bench.value
    stiffness = bench.flexure_stiffness
    slewing = -1j * bench.precession_inertia * omega * rate
    r = omega / v("spin_rate_reference")
    own = v("rotor_inertia_x") + v("gimbal_inertia_x")
    columns = [
        (slewing, _RATIO),
        (1j * slewing, (-_DAMPED, _DAMPED)),
        (stiffness * z, (0.0, _STIFFEST)),
        (-stiffness * r**2 * z, (-_STIFFEST, _STIFFEST)),
        (-1j * stiffness * r * z, (-2.0, 2.0)),
        (own * bend, (0.0, 5.0)),
        (np.full_like(z, stiffness * v("tilt_limit")), (-1.0, 1.0)),
        (np.full_like(z, 1j * stiffness * v("tilt_limit")), (-1.0, 1.0)),
    ]
    design = np.column_stack([_parts(column, a) for column, _ in columns])
    return _left(design, _parts(torque, a), [bounds for _, bounds in columns], _size(_parts(torque, a)))


@dataclass(frozen=True)
class Ratio:
    """An inertia as a recording shows it, over the stated one, and its standard error; NaN where it shows none."""

    value: float
    error: float


def precession_ratio(a: Averages, bench: Bench) -> Ratio:
    """Return the torque of precession that the coils give over the one that the motion takes by the stated inertia."""
    finite = np.isfinite(a.tilt + a.coil + a.rate)
    if not slews(a, bench) or a.absent >= set(COIL):
        return Ratio(math.nan, math.nan)
    z, rate, omega = a.tilt[finite], a.tilt_rate[finite], a.rate[finite]
    slewing = -1j * bench.precession_inertia * omega * rate
    columns = [slewing, 1j * slewing, z, omega**2 * z, 1j * omega * z, np.ones_like(z), 1j * np.ones_like(z)]
    columns.append(a.tilt_acceleration[finite])
    design = np.column_stack([_parts(column, a) for column in columns])
    return _first(design, _parts(bench.value("coil_constant") * a.coil[finite], a))


def spin_up_ratio(a: Averages, bench: Bench) -> Ratio:
    """Return the torque of the motor that accelerates the rotor over the one that the stated inertia takes."""
    finite = np.isfinite(a.acceleration + a.rate + a.current)
    acceleration, rate = a.acceleration[finite], a.rate[finite]
    torque = bench.value("motor_constant") * a.current[finite]
    inertial = bench.axial_inertia * acceleration
    if not a.measured("motor_current"):
        return Ratio(math.nan, math.nan)
    if not len(rate) or _size(inertial) < _RAMPS * _size(torque) or not np.any(inertial):
        return Ratio(math.nan, math.nan)
    design = np.column_stack([inertial, np.ones_like(rate), rate, rate**2])
    return _first(design, torque)


def _first(design: Array, values: Array) -> Ratio:
    """Return the first coefficient of a fit; neighbouring averages overlap, so its error is widened."""
    scale = np.linalg.norm(design, axis=0)
    if not np.all(scale > 0.0):
        return Ratio(math.nan, math.nan)
    design = design / scale
    fit, *_ = np.linalg.lstsq(design, values, rcond=None)
    left = float(np.var(values - design @ fit))
    inverse = np.linalg.pinv(design.T @ design)
    return Ratio(
        float(fit[0] / scale[0]), math.sqrt(_OVERLAP * left * float(inverse[0, 0])) / float(scale[0])
    )


def _left(design: Array, values: Array, bounds: list[tuple[float, float]], size: float) -> float:
    """Return the size of what a bounded fit leaves, over `size`."""
    if not size > 0.0:
        return 0.0
    scale = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    # a fit of few unknowns: the triangle stands for all rows
    rows = np.column_stack([design / scale, values])
    triangle: Array = np.asarray(np.linalg.qr(rows, mode="r"))
    low, high = (np.array([b[k] for b in bounds]) * scale for k in (0, 1))
    from scipy.optimize import lsq_linear  # takes long to load

    fit = lsq_linear(triangle[:, :-1], triangle[:, -1], (low, high), method="bvls")
    return float(math.sqrt(2.0 * fit.cost / len(values)) / size)


def _parts(values: NDArray[np.complex128], a: Averages) -> Array:
    """Return the parts x and y of torques, those of the coils that were measured."""
    parts = [part for part, name in ((values.real, COIL[0]), (values.imag, COIL[1])) if a.measured(name)]
    return np.concatenate(parts) if parts else np.zeros(0)


def _size(values: NDArray[np.inexact]) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2))) if len(values) else 0.0
