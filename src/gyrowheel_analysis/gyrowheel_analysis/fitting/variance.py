"""How noisy the rows of a balance are: noise of the readings, slow drift, and accuracy of the balance itself."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.channels import Channel
from gyrowheel_analysis.criteria import (
    ANGLE_FLOOR,
    FILTER_SHAPE,
    MODEL_ABSOLUTE,
    MODEL_ANGLE,
    MODEL_RELATIVE,
    MODEL_RIPPLE,
    VOLTAGE_FLOOR,
)
from gyrowheel_analysis.fitting.drift import DriftCovariance
from gyrowheel_analysis.reduction import FORWARD, HARMONICS
from gyrowheel_analysis.reduction.windows import MEAN, MODULATION
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.registry import torque_scale

Array = NDArray[np.float64]


def average_covariance(balance: Balance, predicted: Array, channel: Channel, row: str) -> DriftCovariance:
    """Return the covariance of one row of the averages, given the predicted rows.

    Raises
    ------
    KeyError
        If the channel's quantity has no average.
    """
    return _AVERAGES[channel.quantity](balance, np.abs(predicted[balance.row(row)]))


def amplitude_variance(
    balance: Balance,
    bench: Bench,
    predicted: Array,
    channel: Channel,
    lateness: Mapping[str, float] | None = None,
) -> Array:
    """Return the variance of each part of an amplitude in every window.

    Parameters
    ----------
    balance : Balance
        The balance.
    bench : Bench
        The bench on which the noise arises; its values may be others than those of the balance's bench.
    predicted : ndarray (N,)
        The predicted rows.
    channel : Channel
        A channel of the group ``revolution`` or ``ripple``.
    lateness : dict of str to float, optional
        By how much readings are late without being stated so [s], by channel. The filter that makes them late has an
        unknown shape.
    """
    size = np.hypot(*(predicted[balance.row(row)] for row in channel.rows))
    variance = np.asarray(_AMPLITUDES[channel.quantity](balance, bench, size, channel.order))
    if balance.phase_error:
        turns = channel.order or bench.value("motor_ripple_order")
        variance = variance + (turns * balance.phase_error * size) ** 2
    if not lateness or channel.quantity != "coil_torque":
        return variance
    w, order = balance.windows, channel.order
    turn = order * w.mean_spin
    wobble = np.abs(w.tilt_harmonics[:, HARMONICS.index(order)] @ MEAN[:MODULATION])
    for reading, torque in (("coil_voltage", size), ("tilt", _resistance(balance, bench, order) * wobble)):
        variance = variance + (FILTER_SHAPE * np.abs(turn * lateness.get(reading, 0.0)) ** 3 * torque) ** 2
    return variance


def _coil_average(balance: Balance, rows: Array) -> DriftCovariance:
    v, w = balance.bench.value, balance.windows
    momentum = balance.bench.precession_inertia * w.mean_spin
    slew = momentum * np.abs(w.mean_tilt_rate)
    white = (
        v("coil_constant") * w.noise("coil_voltage_noise")
    ) ** 2 / w.samples + momentum**2 * w.tilt_rate_variance
    size, level = np.maximum(rows, slew), v("coil_constant") * v("coil_voltage_drift")
    floor = _absolute(balance) ** 2 + (MODEL_RELATIVE * size) ** 2
    return DriftCovariance(w.middle, white + floor, level, v("drift_time"))


def _motor_torque(balance: Balance, rows: Array) -> DriftCovariance:
    v, w = balance.bench.value, balance.windows
    torque, floor = _spin_acceleration(balance)
    white = (v("motor_constant") * w.noise("motor_current_noise")) ** 2 / w.samples + torque
    level = v("motor_constant") * v("motor_current_drift")
    return DriftCovariance(w.middle, white + floor, level, v("drift_time"))


def _motor_voltage(balance: Balance, rows: Array) -> DriftCovariance:
    v, w = balance.bench.value, balance.windows
    torque, floor = _spin_acceleration(balance)
    per_torque = v("motor_resistance") / v("motor_constant")
    white = w.noise("motor_voltage_noise") ** 2 / w.samples + per_torque**2 * torque
    white = white + (v("motor_constant") * w.noise("spin_rate_noise")) ** 2 / w.samples
    return DriftCovariance(w.middle, white + floor * per_torque**2, v("motor_voltage_drift"), v("drift_time"))


def _spin_acceleration(balance: Balance) -> tuple[Array, Array]:
    """Return the variances of the motor's torque from the noise of the acceleration, and of the balance itself."""
    w, inertia = balance.windows, balance.bench.axial_inertia
    floor = _absolute(balance) ** 2 + (4.0 * MODEL_RELATIVE * inertia * np.abs(w.mean_spin_acceleration)) ** 2
    return inertia**2 * w.spin_acceleration_variance, floor


def _coil_amplitude(balance: Balance, bench: Bench, size: Array, order: int) -> Array:
    v, w = bench.value, balance.windows
    stiff = _resistance(balance, bench, order)
    white = (v("coil_constant") * w.noise("coil_voltage_noise")) ** 2 + (stiff * w.noise("tilt_noise")) ** 2
    white = white * w.harmonic_variance[:, FORWARD.index(order)] / w.samples
    hum = w.hum_variance[:, :, FORWARD.index(order)]
    white = white + stiff**2 * hum[:, 0] + v("coil_constant") ** 2 * hum[:, 1]
    return np.asarray(white + _absolute(balance) ** 2 + (MODEL_RELATIVE * size) ** 2)


def _resistance(balance: Balance, bench: Bench, order: int) -> Array:
    """Return the torque that a tilt once or twice a revolution takes, over the tilt [N m/rad]."""
    v = bench.value
    inertia = v("rotor_inertia_x") + 0.5 * v("gimbal_inertia_x")
    stiffness = 0.5 * (v("flexure_stiffness_x") + v("flexure_stiffness_y"))
    spin = balance.windows.mean_spin
    return np.abs(stiffness + (order * bench.precession_inertia - order**2 * inertia) * spin**2)


def _angle_amplitude(balance: Balance, bench: Bench, size: Array, order: int) -> Array:
    w = balance.windows
    # the two signs of a harmonic of a real reading share its noise
    white = 0.5 * w.noise("spin_angle_noise") ** 2 * w.harmonic_variance[:, FORWARD.index(order)] / w.samples
    return np.asarray(white + ANGLE_FLOOR**2 + (MODEL_ANGLE * size) ** 2)


def _shaft_amplitude(balance: Balance, bench: Bench, size: Array, order: int) -> Array:
    v, w = bench.value, balance.windows
    speed, current = _ripple_readings(balance)
    swing = bench.axial_inertia * v("motor_ripple_order") * w.mean_spin
    floor = torque_scale(balance.bench) * np.where(w.moving, MODEL_RIPPLE, MODEL_ABSOLUTE)
    return np.asarray(swing**2 * speed + v("motor_constant") ** 2 * current + floor**2)


def _winding_amplitude(balance: Balance, bench: Bench, size: Array, order: int) -> Array:
    v, w = bench.value, balance.windows
    speed, current = _ripple_readings(balance)
    voltage = w.noise("motor_voltage_noise") ** 2 / (2.0 * w.samples)
    return np.asarray(
        voltage + v("motor_resistance") ** 2 * current + v("motor_constant") ** 2 * speed + VOLTAGE_FLOOR
    )


def _ripple_readings(balance: Balance) -> tuple[Array, Array]:
    """Return the variances of the amplitudes of spin rate [(rad/s)²] and motor current [A²]."""
    w = balance.windows
    half = 2.0 * w.samples
    return w.noise("spin_rate_noise") ** 2 / half, w.noise("motor_current_noise") ** 2 / half


def _absolute(balance: Balance) -> float:
    return torque_scale(balance.bench) * MODEL_ABSOLUTE


#: By the channel's quantity.
_AVERAGES = {
    "coil_torque": _coil_average,
    "motor_torque": _motor_torque,
    "motor_voltage": _motor_voltage,
}
_AMPLITUDES = {
    "coil_torque": _coil_amplitude,
    "shaft_torque": _shaft_amplitude,
    "winding_voltage": _winding_amplitude,
    "encoder_angle": _angle_amplitude,
}
