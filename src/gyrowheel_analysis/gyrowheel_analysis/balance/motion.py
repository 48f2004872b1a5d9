"""The measured motion at several instants and spin angles of every window, and means over them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.history import History
from gyrowheel_analysis.balance.instruments import Held, Instruments
from gyrowheel_analysis.reduction.motor_temperature import MOTOR_THERMAL
from gyrowheel_analysis.reduction.windows import HARMONICS, Windows
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.declaration import Effect
from gyrowheel_sim.effects.quantities import REFERENCES
from gyrowheel_sim.instruments import held_factor

Array = NDArray[np.float64]

#: Nodes in x, the time from the middle of a window over half its duration, and their weights.
NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)
_ENDS = np.polynomial.polynomial.polyvander([1.0, -1.0], 2) @ np.linalg.inv(
    np.polynomial.polynomial.polyvander(NODES, 2)
)
#: Difference between the ends of a window of a quantity given at the nodes.
ACROSS = _ENDS[0] - _ENDS[1]


def at_nodes(polynomial: Any, half: Any, derivative: int = 0) -> Any:
    """Return polynomials in x (n, ..., terms), or a time derivative of them, at the nodes (n, ..., nodes).

    `half` (n, 1) is half the duration of each window [s].
    """
    order = np.arange(polynomial.shape[-1])
    factor = np.ones(polynomial.shape[-1])
    for d in range(derivative):
        factor = factor * (order - d)
    powers = factor[:, None] * NODES ** np.maximum(order - derivative, 0)[:, None]
    return polynomial @ powers / (half if polynomial.ndim == 2 else half[:, :, None]) ** derivative


def summed(amplitudes: Any, wave: Any) -> Any:
    """Return the sum (n, nodes, phases) of waves (harmonics, phases) with amplitudes (n, harmonics, nodes)."""
    return np.swapaxes(amplitudes, 1, 2) @ wave


def mean(values: Any, weights: Any) -> Any:
    """Return the sum (n,) of values times individual weights, both (n, nodes, phases)."""
    return (values * weights).sum(axis=(1, 2))


def amplitude(values: Any, weights: Any) -> Any:
    """Return the sum (n,) of values, broadcast to (n, nodes, phases), times weights (nodes, phases)."""
    if np.ndim(values) == 0:
        return values * weights.sum() if values else 0.0
    if values.shape[1:] != weights.shape:
        values = np.broadcast_to(values, (len(values), *weights.shape))
    return values.reshape(len(values), weights.size) @ weights.reshape(-1)


_KEPT = 3  # cached true motions: large arrays
_PHASES = 12  # spin angles at least; the products of the harmonics reach the fifth


class Motion:
    """Readings at the nodes and spin angles of every window; arrays broadcast to `shape` (n, nodes, phases).

    Parameters
    ----------
    windows : Windows
        The windows.
    bench : Bench
        The model's bench.
    assumed : mapping of str to float
        Temperatures and pressure that were never taken, each with its part of the static error of the bench for its
        instrument. Where they were measured, that error is far too small to show in any effect.
    history : History, optional
        The whole motion of the recording; without it what lies between the windows is taken as straight.

    Attributes
    ----------
    angle, turn : ndarray
        Spin angle [rad], and exp(i angle).
    sines, cosines : ndarray (n nodes phases,)
        Of the spin angle, flat.
    orders : complex ndarray (harmonics,)
        The `HARMONICS` h times i: the derivative of a harmonic by the spin angle.
    wave : complex ndarray (harmonics, phases)
        exp(i h theta_z).
    spin, spin_rate : ndarray (n, nodes, 1)
        Mean spin rate over a revolution [rad/s] and its derivative.
    tilt : complex ndarray
        Readings of the tilt [rad].
    current : complex ndarray (n, harmonics, nodes)
        Amplitudes of the motor current [A].
    current_ripple : ndarray
        Motor current less its mean [A].
    weights : ndarray
        Weights of a mean over a window at a constant spin rate.
    order_weights : dict of int to ndarray (nodes, phases)
        Weights of the amplitude of an order of `HARMONICS`.
    ripple_weights : ndarray (nodes, phases)
        Weights of the amplitude at the order of the motor's ripple.
    instruments : Instruments
        The instruments whose errors are removed.
    quantities : dict
        Quantities of the laws besides the motion, see `effects.quantities`.
    table_rate : ndarray (n, 1, 1)
        Rate of the table about the vertical [rad/s].
    """

    def __init__(
        self,
        windows: Windows,
        bench: Bench,
        assumed: Mapping[str, float] | None = None,
        history: History | None = None,
    ) -> None:
        w = self._windows = windows
        self.history = history or History(windows, bench)
        self._bench, self._assumed = bench, dict(assumed or {})
        half = 0.5 * w.duration[:, None]
        ripple_order = self._ripple_order = bench.value("motor_ripple_order")
        # enough to distinguish the ripple from its alias
        phases = max(_PHASES, round(2.0 * ripple_order) + 4)
        theta = self._phases = np.arange(phases) * (2.0 * np.pi / phases)
        h = np.array(HARMONICS)
        self.wave = np.exp(1j * np.outer(h, theta))
        self.orders = 1j * h
        self._back = np.ascontiguousarray(self.wave.conj().T) / phases
        self.shape = (len(w), len(NODES), phases)
        self.angle = np.broadcast_to(theta, self.shape)
        self.turn = np.exp(1j * self.angle)
        self.sines, self.cosines = np.sin(self.angle).reshape(-1), np.cos(self.angle).reshape(-1)
        self.instruments = Instruments.of(bench.values(), {}).as_perfect()
        #: The last true motions, and responses of the instruments: most steps of a fit change neither.
        self._undone: OrderedDict[tuple[float, ...], Motion] = OrderedDict()
        self._shown: dict[tuple[Held, float], Any] = {}
        self._held: dict[int, Any] = {}
        self._read_motion(w)
        share = np.repeat(WEIGHTS[:, None] / (2.0 * phases), phases, axis=1)
        self.weights = np.broadcast_to(share, self.shape)
        self.order_weights = {order: np.exp(-1j * order * theta) * share for order in HARMONICS}
        self.ripple_weights = np.exp(-1j * ripple_order * theta) * share
        tau = half * NODES
        time = w.middle[:, None] + tau
        self.quantities: dict[str, Any] = {
            "theta_z": self.angle,
            "T_coil": (w.coil_temperature[:, None] + w.coil_temperature_rate[:, None] * tau)[:, :, None],
            "T_air": w.air_temperature[:, None, None],
            # the reading of a vacuum may be negative
            "rho": (np.maximum(w.air_pressure, 0.0) / (bench.value("gas_constant") * w.air_temperature))[
                :, None, None
            ],
            "up": w.up[:, None, None],
            "up_across": w.up_across[:, None, None],
            "home_x": w.home_x[:, None, None],
            "home_y": w.home_y[:, None, None],
            "t": time[:, :, None],
            **{name: bench.value(parameter) for name, parameter in REFERENCES.items()},
        }
        self._read_current(w)
        self.table_rate = w.table_rate[:, None, None]
        self._warming = w.motor_temperature_rates[:, :, None] * tau[:, None, :]

    def _read_motion(self, w: Windows) -> None:
        """Take tilt and spin rate from windows."""
        half, h = 0.5 * w.duration[:, None], np.array(HARMONICS)

        def waves(c: Any, derivative: int = 0) -> Any:
            """Sum of the harmonics with amplitudes `c` (n, harmonics, nodes), or its derivative by the angle."""
            return summed(c * ((1j * h) ** derivative)[None, :, None], self.wave)

        a0, a1, a2 = (at_nodes(w.tilt_harmonics, half, d) for d in range(3))
        self.spin = at_nodes(w.spin, half)[:, :, None]
        self.spin_rate = at_nodes(w.spin, half, 1)[:, :, None]
        self.tilt = at_nodes(w.tilt, half)[:, :, None] + waves(a0)
        # derivatives of the tilt by power of the spin rate: none, the first, the second
        self._slow_rate, self._turning_rate = at_nodes(w.tilt, half, 1)[:, :, None] + waves(a1), waves(a0, 1)
        self._slow_acceleration = at_nodes(w.tilt, half, 2)[:, :, None] + waves(a2)
        self._coriolis, self._centripetal = 2.0 * waves(a1, 1), waves(a0, 2)

    def _read_current(self, w: Windows) -> None:
        """Take the current of the motor from windows."""
        self.current = at_nodes(w.current_harmonics, 0.5 * w.duration[:, None])
        turning = summed(self.current, self.wave).real
        ripple = w.current_ripple[:, None] * np.exp(1j * self._ripple_order * self._phases)
        self.current_ripple = turning + 2.0 * ripple.real[:, None, :]
        self.quantities = {**self.quantities, "i_motor": w.motor_current[:, None, None] + turning}

    def remembered(self, effect: Effect, values: Mapping[str, float]) -> dict[str, Any]:
        """Return the states of an effect with these coefficients, by name; a pair where each flexure has its own."""
        return self.history.states(effect, values, NODES, self._phases) if effect.states else {}

    def roughly(self) -> Motion:
        """Return the same motion, along which states are integrated roughly (`History.rough`)."""
        result = copy(self)
        result.history = self.history.rough
        return result

    def undone(self, instruments: Instruments) -> Motion:
        """Return the true motion, if these are readings of some instruments.

        The non-linearity of the tilt sensors is left to `Instruments.true_tilt`.
        """
        if instruments.perfect:
            return self
        key = (*instruments.values.values(), *instruments.orders.values())
        if key in self._undone:
            self._undone.move_to_end(key)
            return self._undone[key]
        result = copy(self)
        result.instruments, result._shown = instruments, {}
        result._undone = OrderedDict()  # not shared: a cycle would keep large arrays until collection
        result._read_motion(instruments.true_motion(self._windows))
        result._read_current(instruments.true_current(self._windows))
        self._undone[key] = result
        if len(self._undone) > _KEPT:
            self._undone.popitem(last=False)
        return result

    def shown(self, reading: Held, order: float) -> Any:
        """Return the amplitude of a reading over the true one, at `order` times the spin rate."""
        if self.instruments.perfect:
            return 1.0
        if (reading, order) not in self._shown:
            self._shown[reading, order] = self.instruments.held(reading, order, self._windows.mean_spin)
        return self._shown[reading, order]

    def held_factor(self, order: int) -> Any:
        """Return the factor (n,) from the amplitude of a sampled voltage at an order to that of the held voltage."""
        if order not in self._held:
            turn = self._windows.mean_spin * self._bench.sample_period
            self._held[order] = held_factor(order, turn)
        return self._held[order]

    def current_read_by(self, instruments: Instruments) -> Motion:
        """Return the motion with the current by other instruments; tilt and spin rate stay."""
        result = copy(self)
        result.instruments, result._shown = instruments, {}
        w = self._windows
        there = np.any(w.current_harmonics) or np.any(w.current_ripple)
        if there and self.instruments.turns_current(instruments):
            result._read_current(instruments.true_current(w))
        return result

    def spin_with(self, ripple: Any) -> tuple[Any, Any]:
        """Return spin rate and acceleration for amplitudes (n, harmonics, nodes) of the rate's ripple [rad/s]."""
        rate = self.spin + summed(ripple, self.wave).real
        acceleration = self.spin_rate + summed(ripple * self.orders[:, None], self.wave).real * self.spin
        return rate, acceleration

    def tilt_derivatives(self, rate: Any, acceleration: Any) -> tuple[Any, Any]:
        """Return the first and the second derivative of the tilt readings [rad/s], [rad/s²]."""
        first = self._slow_rate + self._turning_rate * rate
        second = (
            self._slow_acceleration
            + self._coriolis * rate
            + self._centripetal * rate**2
            + self._turning_rate * acceleration
        )
        return first, second

    def quantities_at(self, rate: Any, values: Mapping[str, float]) -> dict[str, Any]:
        """Return the quantities of the laws except the tilt, at a spin rate and for other values of the bench."""
        q = {**self.quantities, "Omega": rate}
        other = np.array([values[name] - self._bench.value(name) for name in MOTOR_THERMAL])
        warm = self._windows.motor_temperatures + self._windows.temperature_sensitivity @ other
        q["T_winding"] = warm[:, 0, None, None] + self._warming[:, 0, :, None]
        q["T_motor"] = warm[:, 1, None, None] + self._warming[:, 1, :, None]
        return self._surrounded(q, values) if self._assumed else q

    def _surrounded(self, q: dict[str, Any], values: Mapping[str, float]) -> dict[str, Any]:
        """Return the quantities of the laws corrected for the errors of assumed temperatures and pressure."""
        warmer, denser = (
            values[name] - self._bench.value(name) for name in ("temperature_bias", "pressure_bias")
        )
        part = self._assumed.get
        if coils := warmer * part("coil_temperature", 0.0):
            q["T_coil"] = q["T_coil"] - coils
        if air := warmer * part("air_temperature", 0.0):
            q["rho"] = q["rho"] * (q["T_air"] / (q["T_air"] - air))
            q["T_air"] = q["T_air"] - air
        if pressure := denser * part("air_pressure", 0.0):
            # relative, so that a vacuum stays a vacuum
            q["rho"] = q["rho"] * (1.0 - pressure / self._bench.value("air_pressure"))
        return q

    def harmonics_of(self, values: Any) -> Any:
        """Return the amplitudes (n, harmonics, nodes) of the `HARMONICS` in values (n, nodes, phases)."""
        return np.swapaxes(values @ self._back, 1, 2)
