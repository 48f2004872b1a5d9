"""Measured and predicted rows of every channel: the physics of each `channels.Quantity`, once each way."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.motion import ACROSS, WEIGHTS, amplitude, mean
from gyrowheel_analysis.balance.torques import Instants, coil_voltages
from gyrowheel_analysis.channels import Channel, Quantity
from gyrowheel_analysis.reduction.windows import FORWARD, HARMONICS, Windows
from gyrowheel_sim.bench import Bench, axial_inertia, precession_inertia
from gyrowheel_sim.effects.targets import added, changed

Array = NDArray[np.float64]


def measured_rows(windows: Windows, bench: Bench, channels: Sequence[Channel], kept: Set[str]) -> Array:
    """Return the measured rows `kept` of channels, converted with the constants of a bench."""
    return _joined(channels, kept, lambda c: _MEASURED[c.quantity](windows, bench, c))


def _joined(channels: Sequence[Channel], kept: Set[str], rows: Callable[[Channel], list[Array]]) -> Array:
    return np.concatenate(
        [row for c in channels for name, row in zip(c.rows, rows(c), strict=True) if name in kept]
    )


def predicted_rows(
    at: Instants,
    values: Mapping[str, float],
    windows: Windows,
    bench: Bench,
    channels: Sequence[Channel],
    kept: Set[str],
) -> Array:
    """Return the predicted rows `kept` of channels, for the required torques `at` and bench parameters `values` [SI].

    `windows` are the measured motion; the constants of `bench`, the model's, convert readings to torques.
    """
    state = _Predicted(at, values, windows, bench)
    return _joined(channels, kept, lambda c: _PREDICTED[c.quantity](state, c))


def _coil_measured(w: Windows, bench: Bench, channel: Channel) -> list[Array]:
    coil = bench.value("coil_constant")
    if channel.group == "average":
        return [coil * w.coil_voltage.real, coil * w.coil_voltage.imag]
    return _components((coil * w.coil_harmonics)[:, FORWARD.index(channel.order)])


def _shaft_measured(w: Windows, bench: Bench, channel: Channel) -> list[Array]:
    return _components(
        1j * bench.axial_inertia * bench.value("motor_ripple_order") * w.mean_spin * w.spin_ripple
    )


def _winding_measured(w: Windows, bench: Bench, channel: Channel) -> list[Array]:
    return _components(bench.value("motor_resistance") * w.current_ripple)


def _angle_measured(w: Windows, bench: Bench, channel: Channel) -> list[Array]:
    return _components(w.angle_harmonics[:, FORWARD.index(channel.order)])


class _Predicted:
    """A state of the balance with quantities that several rows share."""

    def __init__(self, at: Instants, values: Mapping[str, float], windows: Windows, bench: Bench) -> None:
        self.at, self.values, self.windows, self.bench = at, values, windows, bench
        self.motion, self.instruments = at.motion, at.motion.instruments
        self.perfect = self.instruments.perfect
        self._amplitudes: dict[int, Any] = {}

    @cached_property
    def coil(self) -> Any:
        """Voltages of the coils, times the constant of the model's bench [N m]."""
        return self.bench.value("coil_constant") * coil_voltages(self.at.coil, self.at.laws, self.values)

    @cached_property
    def coil_error(self) -> Any:
        """Contribution of the laws to the readings of these voltages, times the same constant [N m]."""
        return self.bench.value("coil_constant") * self.error("coil_voltage_x", "coil_voltage_y")

    @cached_property
    def lag(self) -> Any:
        """Mean time constant of the coils in every window [s]."""
        lag = np.asarray(added(self.at.laws, self.values, "coil_lag"))
        return np.broadcast_to(lag, self.at.weights.shape).mean(axis=(1, 2)) if lag.ndim else lag

    @cached_property
    def constant(self) -> Any:
        """Constant of the motor [N m/A]."""
        return changed(self.at.laws, self.values, "motor_constant")

    @cached_property
    def resistance(self) -> Any:
        """Resistance of the motor's winding [ohm]."""
        return changed(self.at.laws, self.values, "motor_resistance")

    def error(self, *readings: str) -> Any:
        """Return the contribution of the laws to a reading, or to two as x + i y [V, A]."""
        if not self.at.laws:
            return 0.0
        parts = [added(self.at.laws, self.values, "reading", reading) for reading in readings]
        return parts[0] if len(parts) == 1 else parts[0] + 1j * parts[1]

    @cached_property
    def inertia(self) -> float:
        """Moment of inertia about the spin axis [kg m²]."""
        return axial_inertia(self.values.__getitem__)

    @cached_property
    def coil_swing(self) -> Any:
        """Part of the coils' mean torque that is missing, as the mean tilt rate is that of the bench file [N m].

        The swings of tilt and voltages are part of that rate, by the stiffness and the coil constant (`mean_rates`).
        """
        v, bench, w = self.values, self.bench, self.windows
        stated = bench.flexure_stiffness * w.tilt_swing - bench.value("coil_constant") * w.volt_swing
        own = 0.5 * (v["flexure_stiffness_x"] + v["flexure_stiffness_y"]) * w.tilt_swing
        own = own - v["coil_constant"] * w.volt_swing
        return own - precession_inertia(v.__getitem__) / bench.precession_inertia * stated

    @cached_property
    def motor_swing(self) -> Any:
        """Part of the motor's mean torque that is missing, as the mean acceleration is that of the bench file [N m]."""
        stated = self.bench.value("motor_constant") * self.inertia / self.bench.axial_inertia
        return (stated - self.values["motor_constant"]) * self.windows.current_swing

    @cached_property
    def mean_current(self) -> Any:
        """Mean current of the motor [A]."""
        constant, weights = self.constant, self.at.weights
        torque = mean(self.at.motor, weights) + self.motor_swing
        if not np.ndim(constant):
            return torque / constant
        # a constant that ripples rectifies the ripple of the current
        middle = mean(constant, weights)
        torque = torque - mean((constant - middle[:, None, None]) * self.motion.current_ripple, weights)
        return torque / middle

    @cached_property
    def constant_ripple(self) -> Any:
        """Amplitude of the change of the motor's constant at the order of its ripple [N m/A]."""
        return amplitude(self.constant - self.values["motor_constant"], self.motion.ripple_weights)

    def mean_of(self, error: Any) -> Any:
        """Return the mean of the error of a reading; without laws it is a number."""
        return mean(error, self.at.weights) if np.ndim(error) else error

    def ripple_of(self, reading: str) -> Any:
        """Return the amplitude of the error of a reading at the order of the motor's ripple."""
        return amplitude(self.error(reading), self.motion.ripple_weights)

    def coil_torque(self, channel: Channel) -> list[Array]:
        """Return the torque of the coils by their voltages, averaged or at an order of the spin rate."""
        if channel.group == "average":
            average = mean(self.coil, self.at.weights)
            # the gain of the torque from the beginning to the end is missing in the mean of a delayed quantity
            late = self.lag - self.instruments.lateness("coil_voltage")
            average = average + late * (self.coil.mean(axis=2) @ ACROSS) / self.windows.duration
            average = (
                average + self.bench.value("coil_constant") / self.values["coil_constant"] * self.coil_swing
            )
            return _components(average + self.mean_of(self.coil_error))
        mixing = self.instruments.mixing
        if mixing is None:
            return _components(self.coil_amplitude(channel.order))
        # the readings are mixed, before they stand for the voltages that act between two of them
        held = self.motion.held_factor
        parts = zip(mixing[HARMONICS.index(channel.order)], HARMONICS, strict=True)
        read = sum(part * self.coil_amplitude(order) / held(order) for part, order in parts)
        return _components(read * held(channel.order))

    def coil_amplitude(self, order: int) -> Any:
        """Return the amplitude of the coils' torque, as their voltages are read, at an order of the true angle."""
        if order not in self._amplitudes:
            lagging = 1.0 + 1j * order * self.windows.mean_spin * self.lag
            weights = self.motion.order_weights[order]
            torque = amplitude(self.coil, weights) * lagging + amplitude(self.coil_error, weights)
            self._amplitudes[order] = torque * self.motion.shown("coil_voltage", order)
        return self._amplitudes[order]

    def motor_torque(self, channel: Channel) -> list[Array]:
        """Return the torque of the motor by its current."""
        read = self.mean_current + self.mean_of(self.error("motor_current"))
        if late := self.instruments.lateness("motor_current"):
            current = self.at.motor.mean(axis=2) / self.values["motor_constant"]
            read = read - late * (current @ ACROSS) / self.windows.duration
        return [self.bench.value("motor_constant") * read]

    def motor_voltage(self, channel: Channel) -> list[Array]:
        """Return the voltage of the motor."""
        weights = self.at.weights
        current = self.at.motor / self.constant
        current = current + (self.mean_current - mean(current, weights))[:, None, None]
        volts = self.resistance * current + self.constant * self.at.rate
        voltage = mean(volts, weights)
        if late := self.instruments.lateness("motor_voltage"):
            voltage = voltage - late * (volts.mean(axis=2) @ ACROSS) / self.windows.duration
        return [voltage + self.mean_of(self.error("motor_voltage"))]

    def shaft_torque(self, channel: Channel) -> list[Array]:
        """Return the torque that accelerates the shaft: the ripple of the speed follows from that of the torque."""
        values = self.values
        shaft = (
            values["motor_constant"] * (self.current_ripple - self.ripple_of("motor_current"))
            + self.constant_ripple * self.mean_current
        )
        shaft = shaft - amplitude(self.at.motor, self.motion.ripple_weights)
        if not self.perfect:
            shaft = shaft * self.instruments.angle(self.order, self.windows.mean_spin)
        return _components(shaft * (self.bench.axial_inertia / self.inertia))

    @property
    def order(self) -> float:
        """Periods a turn of the motor's ripple."""
        return self.bench.value("motor_ripple_order")

    @property
    def current_ripple(self) -> Any:
        """Amplitude of the true current at that order, by the true angle [A]."""
        return self.windows.current_ripple / self.motion.shown("motor_current", self.order)

    def winding_voltage(self, channel: Channel) -> list[Array]:
        """Return the voltage across the winding: the ripple of the current follows from that of the back-EMF."""
        w, values = self.windows, self.values
        voltage, speed = w.voltage_ripple, w.spin_ripple
        if not self.perfect:
            voltage = voltage / self.motion.shown("motor_voltage", self.order)
            speed = speed / self.instruments.angle(self.order, w.mean_spin)
        volts = voltage - values["motor_constant"] * speed - self.constant_ripple * w.mean_spin
        volts = volts - amplitude(self.resistance, self.motion.ripple_weights) * self.mean_current
        volts = volts - self.ripple_of("motor_voltage")
        own = self.bench.value("motor_resistance")
        current = volts * (own / values["motor_resistance"]) + own * self.ripple_of("motor_current")
        return _components(current * self.motion.shown("motor_current", self.order))

    @cached_property
    def turned(self) -> Any:
        """Amplitudes (n, harmonics) of the angle less its steady growth [rad], by a reading with a wrong zero alone."""
        turn = self.windows.mean_spin[:, None] * self.motion.orders
        ripple = self.at.ripple @ (0.5 * WEIGHTS) / turn
        # The torque is integrated twice as if its amplitude were constant; in a cone it turns with the tilt.
        ripple = ripple - 2.0 * (self.at.ripple @ ACROSS) / (turn**2 * self.windows.duration[:, None])
        # the reading delays the ripple as it delays the angle itself: only its zero changes the phase
        return ripple * np.exp(-self.motion.orders * self.instruments.values["encoder_zero"])

    def encoder_angle(self, channel: Channel) -> list[Array]:
        """Return the angle's reading less its steady growth: the ripple of the speed, and the encoder's error."""
        mixing, place = self.instruments.mixing, HARMONICS.index(channel.order)
        own = self.turned[:, place] if mixing is None else self.turned @ mixing[place]
        return _components(own + self.instruments.encoder(channel.order))


_MEASURED: dict[Quantity, Callable[[Windows, Bench, Channel], list[Array]]] = {
    "coil_torque": _coil_measured,
    "motor_torque": lambda w, bench, _: [bench.value("motor_constant") * w.motor_current],
    "motor_voltage": lambda w, bench, _: [w.motor_voltage],
    "shaft_torque": _shaft_measured,
    "winding_voltage": _winding_measured,
    "encoder_angle": _angle_measured,
}
_PREDICTED: dict[Quantity, Callable[[_Predicted, Channel], list[Array]]] = {
    "coil_torque": _Predicted.coil_torque,
    "motor_torque": _Predicted.motor_torque,
    "motor_voltage": _Predicted.motor_voltage,
    "shaft_torque": _Predicted.shaft_torque,
    "winding_voltage": _Predicted.winding_voltage,
    "encoder_angle": _Predicted.encoder_angle,
}


def _components(row: Any) -> list[Array]:
    """Return real and imaginary part."""
    return [np.real(row), np.imag(row)]
