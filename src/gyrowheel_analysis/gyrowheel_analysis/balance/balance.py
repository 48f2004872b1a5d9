"""The balance of torques and voltages: what the model predicts for the measured motion, against what was measured.

No controller enters. For every window the torque that the measured motion needs is computed by exact inverse
dynamics at several instants and spin angles and averaged; the averaging of the flexures, of the gimbal's inertia
and of the rectified harmonics over a revolution thus comes by itself, for every effect alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.channels import ALL_ROWS, AVERAGE_ROWS
from gyrowheel_analysis.reduction import FORWARD, HARMONICS, MOTOR_THERMAL, Windows, without_noise
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.compiled import compile_kernels
from gyrowheel_sim.effects.code import array_law
from gyrowheel_sim.effects.declaration import Effect
from gyrowheel_sim.effects.quantities import REFERENCES, Omega, T_motor, T_winding, t, theta_z, z, z_rate
from gyrowheel_sim.effects.targets import TARGETS
from gyrowheel_sim.mechanics.dynamics import Joint, generalised_forces
from gyrowheel_sim.mechanics.inverse import N_POINT

Array = NDArray[np.float64]

_INERTIAS = (
    "rotor_inertia_x",
    "rotor_inertia_y",
    "rotor_inertia_z",
    "gimbal_inertia_x",
    "gimbal_inertia_y",
    "gimbal_inertia_z",
    "shaft_inertia",
)
_PHASES = 12  # spin angles at least; the products of the harmonics kept reach the fifth
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
#: Difference between the ends of a window of what is known at the nodes.
_ENDS = np.polynomial.polynomial.polyvander([1.0, -1.0], 2) @ np.linalg.inv(
    np.polynomial.polynomial.polyvander(_NODES, 2)
)
_ACROSS = _ENDS[0] - _ENDS[1]
#: An error of the ripple up to this is made good to first order [rad/s]. How the coils answer a ripple depends on the
#: inertia, which is known to a part in a hundred at worst: what is left is some nN m.
_RIPPLE_ACCURACY = 3.0e-5
_REPETITIONS = 4
#: Step of the derivatives of a reading's error [rad of the spin angle], and the five-point formulas for them.
_STENCIL = 0.05
_FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
_SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0


@dataclass(frozen=True)
class ActiveEffect:
    """An effect with the values of its coefficients."""

    effect: Effect
    values: Mapping[str, float]


@dataclass
class _Laws:
    """What the effects do at every instant, summed; the targets of `TARGETS`."""

    rotor_torque: Any = 0.0
    axial_torque: Any = 0.0
    shaft_torque: Any = 0.0
    flexure_torque: Any = (0.0, 0.0)
    inertia_difference: Any = 0.0
    case_rate: Any = 0.0
    coil_gain: Any = 0.0
    coil_anisotropy: Any = 0.0
    coil_lag: Any = 0.0
    motor_gain: Any = 0.0
    winding_resistance: Any = 0.0
    supply_drop: Any = 0.0


@dataclass(frozen=True)
class Instants:
    """What the measured motion needs at every instant of every window, for a state of the model.

    Arrays are (n, nodes, phases): torques of coils (complex) and motor [N m], spin rate [rad/s], weights of a mean over
    time; the rest is what the laws of the effects are evaluated with. `ripple` are the amplitudes (n, harmonics, nodes)
    of the ripple of the spin rate [rad/s].
    """

    ripple: Any
    coil: Any
    motor: Any
    rate: Any
    weights: Any
    laws: _Laws
    quantities: dict[str, Any]
    joint: Joint
    axis: tuple[Any, Any]


class Balance:
    """Predicted and measured rows of a set of windows.

    Rows are ordered as `channels.ALL_ROWS`, each for every window: the averages tilt_x, tilt_y and spin [N m]
    and motor_voltage [V]; the torque of the coils once and twice a revolution [N m]; at the order of the motor's
    ripple, the torque that accelerates the shaft [N m] and the voltage across the winding's resistance [V].

    Parameters
    ----------
    windows : Windows
        The reduced recording(s).
    bench : Bench
        The model's bench; its coil and motor constants convert voltages and currents to N m.
    clean : bool
        Whether to predict from the motion without the harmonics and accelerations that are noise
        (`reduction.without_noise`); what those need on the bench as stated is then taken from the measured rows.
    harmonics : bool
        Whether there are rows of what happens within a revolution, or of the averages alone.
    """

    def __init__(self, windows: Windows, bench: Bench, *, clean: bool = True, harmonics: bool = True) -> None:
        self._unclean = windows if clean else None
        #: Names of the channels, in the order of the rows.
        self.channels = ALL_ROWS if harmonics else AVERAGE_ROWS
        windows = without_noise(windows) if clean else windows
        self.windows = windows
        self.bench = bench
        self._ripple: Any = None
        # by what the ripple's parts move what coils and motor must give, and how to undo an error of the motor
        self._answers: list[tuple[Any, Any]] = []
        self._steps: Any = None
        self._references = {name: bench.value(parameter) for name, parameter in REFERENCES.items()}
        w = windows
        half = 0.5 * w.duration[:, None]
        self._ripple_order = bench.value("motor_ripple_order")
        # enough of them that the ripple is told from its mirror image
        self._phases = max(_PHASES, round(2.0 * self._ripple_order) + 4)
        theta = np.arange(self._phases) * (2.0 * np.pi / self._phases)
        h = np.array(HARMONICS)
        wave = np.exp(1j * np.outer(h, theta))  # (harmonics, phases)

        def smooth(c: Any, derivative: int = 0) -> Any:
            """Polynomial in x over the last axis of `c`, or a time derivative of it, at the nodes: (n, ..., nodes)."""
            order = np.arange(c.shape[-1])
            factor = np.ones(c.shape[-1])
            for d in range(derivative):
                factor = factor * (order - d)
            powers = factor[:, None] * _NODES ** np.maximum(order - derivative, 0)[:, None]
            return c @ powers / (half if c.ndim == 2 else half[:, :, None]) ** derivative

        def waves(c: Any, derivative: int = 0) -> Any:
            """Sum of the harmonics with amplitudes `c` (n, harmonics, nodes): (n, nodes, phases)."""
            return _summed(c * ((1j * h) ** derivative)[None, :, None], wave)

        a0, a1, a2 = (smooth(w.tilt_harmonics, d) for d in range(3))
        tau = half * _NODES
        self._order, self._wave = 1j * h, wave
        self._back = np.ascontiguousarray(wave.conj().T) / self._phases
        self._spin, self._spin_rate = smooth(w.spin)[:, :, None], smooth(w.spin, 1)[:, :, None]
        # readings of the tilt before any correction of the sensor, and the parts of their derivatives
        self._tilt = smooth(w.tilt)[:, :, None] + waves(a0)
        self._first = (smooth(w.tilt, 1)[:, :, None] + waves(a1), waves(a0, 1))
        self._second = (smooth(w.tilt, 2)[:, :, None] + waves(a2), 2.0 * waves(a1, 1), waves(a0, 2))
        self._current = smooth(w.current_harmonics)
        shape = (len(w), len(_NODES), self._phases)
        self._angle = np.broadcast_to(theta, shape)
        self._sines, self._cosines = np.sin(self._angle).reshape(-1), np.cos(self._angle).reshape(-1)
        self._turn = np.exp(1j * self._angle)
        # weights of a mean, and of the amplitudes of what is compared within a revolution: (nodes, phases)
        mean = np.repeat(_WEIGHTS[:, None] / (2.0 * self._phases), self._phases, axis=1)
        self._weights = np.broadcast_to(mean, shape)
        self._turning = [np.exp(-1j * order * theta) * mean for order in FORWARD]
        self._rippling = np.exp(-1j * self._ripple_order * theta) * mean
        time = w.middle[:, None] + tau
        self._quantities: dict[str, Any] = {
            "theta_z": self._angle,
            "i_motor": w.motor_current[:, None, None] + _summed(self._current, wave).real,
            "T_coil": (w.coil_temperature[:, None] + w.coil_temperature_rate[:, None] * tau)[:, :, None],
            "T_air": w.air_temperature[:, None, None],
            "rho": (w.air_pressure / (bench.value("gas_constant") * w.air_temperature))[:, None, None],
            "up": w.up[:, None, None],
            "up_across": w.up_across[:, None, None],
            "home_x": w.home_x[:, None, None],
            "home_y": w.home_y[:, None, None],
            "t": time[:, :, None],
            **self._references,
        }
        self._table = w.table_rate[:, None, None]
        self._warming = w.motor_temperature_rates[:, :, None] * tau[:, None, :]
        ripple = w.current_ripple[:, None] * np.exp(1j * self._ripple_order * theta)
        self._current_ripple = _summed(self._current, wave).real + 2.0 * ripple.real[:, None, :]
        coil, motor, order = bench.value("coil_constant"), bench.value("motor_constant"), self._ripple_order
        turning = coil * w.coil_harmonics
        shaft = 1j * bench.axial_inertia * order * w.mean_spin * w.spin_ripple
        volts = bench.value("motor_resistance") * w.current_ripple
        self.measured = np.concatenate(
            [
                coil * w.coil_voltage.real,
                coil * w.coil_voltage.imag,
                motor * w.motor_current,
                w.motor_voltage,
                *_components(turning.T),
                *_components([shaft, volts]),
            ][: len(self.channels)]
        )
        if clean:
            self.measured = self._without_noise(bench.values(), [])

    def cleared(self, values: Mapping[str, float], effects: list[ActiveEffect]) -> Balance:
        """Return the balance with measured rows without what noise in the motion needs, on a machine as given.

        The prediction is without those harmonics and accelerations, see `clean`. On the bench as stated, what is taken
        is wrong where a harmonic is real though no clearer than noise and the machine differs from its bench.

        Parameters
        ----------
        values : mapping
            Bench parameters by name [SI].
        effects : list of ActiveEffect
            Effects with their coefficients.
        """
        result = copy(self)
        result.measured = self._without_noise(values, effects)
        return result

    def _without_noise(self, values: Mapping[str, float], effects: list[ActiveEffect]) -> Array:
        if self._unclean is None or not len(self.windows):
            return self.measured
        raw = Balance(self._unclean, self.bench, clean=False, harmonics=self.channels != AVERAGE_ROWS)
        return raw.measured - raw.predicted(values, effects) + self.predicted(values, effects)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.measured)

    def channel(self, name: str) -> slice:
        """Return the rows of a channel."""
        n, index = len(self.windows), self.channels.index(name)
        return slice(index * n, (index + 1) * n)

    def required(self, values: Mapping[str, float], effects: list[ActiveEffect]) -> tuple[Any, Any]:
        """Return the mean torques that coils (complex, x + i y) and motor must give [N m], arrays (n,).

        The changes of the coils' gain are left out here, see `predicted`.
        """
        at = self.instants(values, effects)
        return (at.coil * at.weights).sum(axis=(1, 2)), (at.motor * at.weights).sum(axis=(1, 2))

    def predicted(self, values: Mapping[str, float], effects: list[ActiveEffect]) -> Array:
        """Return the predicted rows.

        Parameters
        ----------
        values : mapping
            Bench parameters by name [SI].
        effects : list of ActiveEffect
            Effects with their coefficients.

        Returns
        -------
        ndarray (12 n,)
            What the readings should be: voltages of the coils and current of the motor converted with the
            constants of the model's bench [N m], and the motor's voltage [V]; then the rows of the harmonics.
        """
        return self.rows(self.instants(values, effects), values)

    def rows(self, at: Instants, values: Mapping[str, float]) -> Array:
        """Return the predicted rows of a state (see `predicted`)."""
        laws, weights, spin = at.laws, at.weights, self.windows.mean_spin
        # voltages of the coils, times the constant of the model's bench
        gain = 1.0 + laws.coil_gain - laws.supply_drop / values["supply_voltage"]
        coil = at.coil / gain * (self.bench.value("coil_constant") / values["coil_constant"])
        mirror = laws.coil_anisotropy
        if np.any(mirror):
            coil = (coil - mirror * np.conj(coil)) / (1.0 - np.abs(mirror) ** 2)
        lag = np.asarray(laws.coil_lag)
        lag = np.broadcast_to(lag, at.weights.shape).mean(axis=(1, 2)) if lag.ndim else lag
        average = (coil * weights).sum(axis=(1, 2))
        # what the torque gains from the beginning to the end is missing in the mean of what follows with a lag
        average = average + lag * (coil.mean(axis=2) @ _ACROSS) / self.windows.duration
        turning = []
        for order, wave in zip(FORWARD, self._turning, strict=True):
            turning.append(_weighted(coil, wave) * (1.0 + 1j * order * spin * lag))
        constant = values["motor_constant"] * (1.0 + laws.motor_gain)
        resistance = values["motor_resistance"] * (1.0 + laws.winding_resistance)
        torque = (at.motor * weights).sum(axis=(1, 2))
        if np.ndim(constant):
            # a constant that ripples rectifies the ripple of the current
            middle = (constant * weights).sum(axis=(1, 2))
            torque = torque - ((constant - middle[:, None, None]) * self._current_ripple * weights).sum(
                axis=(1, 2)
            )
            mean_current = torque / middle
        else:
            mean_current = torque / constant
        current = at.motor / constant
        current = current + (mean_current - (current * weights).sum(axis=(1, 2)))[:, None, None]
        voltage = ((resistance * current + constant * at.rate) * weights).sum(axis=(1, 2))
        # the ripple of the current follows from that of the back-EMF, the ripple of the speed from that of the torque
        w = self.windows
        wave = self._rippling
        change = _weighted(constant - values["motor_constant"], wave)
        volts = w.voltage_ripple - values["motor_constant"] * w.spin_ripple - change * spin
        volts = volts - _weighted(resistance, wave) * mean_current
        volts = volts * (self.bench.value("motor_resistance") / values["motor_resistance"])
        shaft = values["motor_constant"] * w.current_ripple + change * mean_current
        shaft = shaft - _weighted(at.motor, wave)
        inertia = values["rotor_inertia_z"] + values["gimbal_inertia_z"] + values["shaft_inertia"]
        shaft = shaft * (self.bench.axial_inertia / inertia)
        return np.concatenate(
            [
                average.real,
                average.imag,
                self.bench.value("motor_constant") * mean_current,
                voltage,
                *_components(turning),
                *_components([shaft, volts]),
            ][: len(self.channels)]
        )

    def instants(
        self, values: Mapping[str, float], effects: list[ActiveEffect], near: Instants | None = None
    ) -> Instants:
        """Return the state of the balance for bench parameters and effects (see `predicted`).

        The universal joint makes the spin rate ripple. The ripple that belongs to the measured current is far better
        known than a reading of the speed: over a revolution the motor's torque must be that of its current.

        Parameters
        ----------
        values : mapping
            Bench parameters by name [SI].
        effects : list of ActiveEffect
            Effects with their coefficients.
        near : Instants, optional
            A state from which this one is but the step of a derivative away: its ripple is then enough to begin with.
            Without it the search begins at the ripple of the state that was asked for first, whatever came in between.
        """
        wanted = values["motor_constant"] * self._current
        if self._ripple is None:
            self._solve_ripple(values, effects, wanted)
        ripple = self._ripple if near is None else near.ripple
        for _ in range(_REPETITIONS):
            at = self._torques(values, effects, ripple)
            parts = self._ripple_parts(at.motor, wanted)
            if near is not None or np.abs(parts).max(initial=0.0) < _RIPPLE_ACCURACY:
                break
            ripple = ripple + _amplitudes(parts)
        return self._settled(at, wanted)

    def _solve_ripple(self, values: Mapping[str, float], effects: list[ActiveEffect], wanted: Any) -> None:
        """Find the ripple, and how coils and motor answer a small change of it."""
        ripple = np.zeros_like(wanted)
        for _ in range(3):
            ripple = ripple + self._ripple_error(self._torques(values, effects, ripple).motor, wanted)
        self._ripple = ripple
        at = self._torques(values, effects, ripple)
        step = 1e-3
        for part in range(len(_PARTS)):
            moved = self._torques(
                values, effects, ripple + step * _amplitudes(np.eye(len(_PARTS))[part : part + 1])
            )
            self._answers.append(((moved.coil - at.coil) / step, (moved.motor - at.motor) / step))
        nothing = np.zeros_like(wanted)
        slopes = [_real_parts(-self._ripple_error(motor, nothing)) for _, motor in self._answers]
        self._steps = np.linalg.inv(np.stack(slopes, axis=-1))

    def _ripple_parts(self, motor: Any, wanted: Any) -> Any:
        """Return by how much the ripple must change, to first order, in the parts of `_real_parts`."""
        error = _real_parts(self._ripple_error(motor, wanted))
        return (self._steps @ error[..., None])[..., 0]

    def _settled(self, at: Instants, wanted: Any) -> Instants:
        """Return a state with the ripple at which the motor's torque is that of its current, to first order."""
        parts = self._ripple_parts(at.motor, wanted)
        coil, motor = at.coil, at.motor
        for index, (coil_answer, motor_answer) in enumerate(self._answers):
            part = parts[:, :, index, None]
            coil = coil + coil_answer * part
            motor = motor + motor_answer * part
        change = _amplitudes(parts)
        rate = at.rate + _summed(change, self._wave).real
        # a spin angle that is passed quickly takes little time
        weights = at.weights * at.rate / rate
        weights = weights / weights.sum(axis=(1, 2), keepdims=True)
        return replace(at, ripple=at.ripple + change, coil=coil, motor=motor, rate=rate, weights=weights)

    def changed(
        self,
        at: Instants,
        values: Mapping[str, float],
        effect: Effect,
        before: Mapping[str, float] | None,
        after: Mapping[str, float],
    ) -> Array | None:
        """Return the predicted rows of a state in which one effect has other coefficients.

        Parameters
        ----------
        at : Instants
            The state, with the effect as in `before`.
        values : mapping
            The bench parameters of that state.
        effect : Effect
            The effect.
        before, after : mapping
            Its coefficients; `before` is None where the state is without it.

        Returns
        -------
        ndarray or None
            None if the effect changes the motion itself, so that the state must be computed anew.
        """
        targets = {law.target for law in effect.laws}
        if targets & _BEFORE_THE_JOINT:
            return None
        new = self._laws([ActiveEffect(effect, after)], at.quantities, _ON_THE_JOINT, at.joint)
        old = _Laws()
        if before is not None:
            old = self._laws([ActiveEffect(effect, before)], at.quantities, _ON_THE_JOINT, at.joint)
        laws = replace(at.laws)
        for target in targets - {"flexure_torque"}:
            setattr(laws, target, getattr(laws, target) + getattr(new, target) - getattr(old, target))
        state = replace(at, laws=laws)
        if targets & _TORQUES:
            state = self._pushed(
                state,
                new.rotor_torque - old.rotor_torque,
                new.axial_torque - old.axial_torque,
                new.shaft_torque - old.shaft_torque,
                tuple(a - b for a, b in zip(new.flexure_torque, old.flexure_torque, strict=True)),
            )
        return self.rows(state, values)

    def moved(
        self,
        at: Instants,
        before: Mapping[str, float],
        after: Mapping[str, float],
        effects: list[ActiveEffect],
    ) -> Array | None:
        """Return the predicted rows of a state with other bench parameters.

        Parameters
        ----------
        at : Instants
            The state, with the bench parameters `before`.
        before, after : mapping
            All bench parameters by name [SI].
        effects : list of ActiveEffect
            The effects in it.

        Returns
        -------
        ndarray or None
            None if the parameters change the motion itself, so that the state must be computed anew.
        """
        by = {name: after[name] - value for name, value in before.items() if after[name] != value}
        if not by.keys() <= _QUICK:
            return None
        if by.keys() & set(MOTOR_THERMAL) and any(
            law.expression.free_symbols & _WARM for active in effects for law in active.effect.laws
        ):
            return None
        if by.keys() & _PUSHING:
            # they act in proportion, so that their changes act like them
            changes = {name: by.get(name, 0.0) for name in _PUSHING}
            across, shaft, flexures = _bench_torques(changes, at.quantities["Omega"], at.joint)
            at = self._pushed(at, across, 0.0, shaft, flexures)
        return self.rows(at, after)

    def _pushed(
        self, at: Instants, across: Any, axial: Any, shaft: Any, flexures: tuple[Any, Any]
    ) -> Instants:
        """Return a state in which further torques act on rotor, shaft and flexures."""
        Q1, Q2, Q3 = self._forces(at.joint, at.axis, at.quantities["z"], across, axial)
        coil = at.coil - self._turn * (Q1 + flexures[0] + 1j * (Q2 + flexures[1]) / at.joint.cx)
        # the state's motor torque is settled: only what has changed needs another ripple
        return self._settled(replace(at, coil=coil, motor=at.motor - shaft - Q3), self._harmonics(at.motor))

    @staticmethod
    def _forces(
        joint: Joint, axis: tuple[Any, Any], tilt: Any, across: Any, axial: Any
    ) -> tuple[Any, Any, Any]:
        """Return the generalised forces of torques across and along the spin axis."""
        n, nz = axis
        # a torque across the spin axis has no component along it: fixes its z component
        along = (np.conj(tilt) * across).imag
        total = across + axial * n
        return generalised_forces(
            joint.sx, joint.cx, joint.sz, joint.cz, np.real(total), np.imag(total), along + axial * nz
        )

    def _harmonics(self, motor: Any) -> Any:
        return np.swapaxes(motor @ self._back, 1, 2)

    def _ripple_error(self, motor: Any, wanted: Any) -> Any:
        left = wanted - self._harmonics(motor)
        return left / (self.bench.axial_inertia * self._order[None, :, None] * self._spin[:, None, :, 0])

    def _torques(self, values: Mapping[str, float], effects: list[ActiveEffect], ripple: Any) -> Instants:
        """Return the state for a given ripple of the spin rate: amplitudes (n, harmonics, nodes) [rad/s]."""
        rate = self._spin + _summed(ripple, self._wave).real
        acceleration = self._spin_rate + _summed(ripple * self._order[:, None], self._wave).real * self._spin
        tilt_rate = self._first[0] + self._first[1] * rate
        tilt_acc = (
            self._second[0]
            + self._second[1] * rate
            + self._second[2] * rate**2
            + self._first[1] * acceleration
        )
        q = {**self._quantities, "Omega": rate}
        other = np.array([values[name] - self.bench.value(name) for name in MOTOR_THERMAL])
        warm = self.windows.motor_temperatures + self.windows.temperature_sensitivity @ other
        q["T_winding"] = warm[:, 0, None, None] + self._warming[:, 0, :, None]
        q["T_motor"] = warm[:, 1, None, None] + self._warming[:, 1, :, None]
        # the error of the reading first: every other law sees the true tilt
        error, error_rate, error_acc = self._reading_error(
            effects, q, values, tilt_rate, tilt_acc, acceleration
        )
        bias = complex(values["tilt_bias_x"], values["tilt_bias_y"])
        scale = values["tilt_scale"]
        phi = (self._tilt - bias - error) / scale
        phi_rate, phi_acc = (tilt_rate - error_rate) / scale, (tilt_acc - error_acc) / scale
        # rate of the case and inertia do not depend on the motion
        ahead = self._laws(effects, q | _AT_REST, {"inertia_difference", "case_rate"})
        turn = ahead.case_rate + self._table * self._quantities["up_across"]
        tilt, z_dot, axis, joint = self._motion(
            (phi, phi_rate, phi_acc),
            rate,
            acceleration,
            values,
            float(np.mean(ahead.inertia_difference)),
            turn,
        )
        q["z"], q["z_rate"] = tilt, z_dot
        laws = self._laws(effects, q, _ON_THE_JOINT, joint)
        laws.inertia_difference, laws.case_rate = ahead.inertia_difference, ahead.case_rate
        fixed, bearing, flexures = _bench_torques(values, rate, joint)
        across, shaft = fixed + laws.rotor_torque, bearing + laws.shaft_torque
        flexure_x, flexure_y = (own + law for own, law in zip(flexures, laws.flexure_torque, strict=True))
        Q1, Q2, Q3 = self._forces(joint, axis, tilt, across, laws.axial_torque)
        need_x = joint.inertial[0] - flexure_x - Q1
        need_y = joint.inertial[1] - flexure_y - Q2
        coil = self._turn * (need_x + 1j * need_y / joint.cx)
        motor = joint.inertial[2] - shaft - Q3
        # a spin angle that is passed quickly takes little time
        weights = self._weights * self._spin / rate
        weights = weights / weights.sum(axis=(1, 2), keepdims=True)
        return Instants(ripple, coil, motor, rate, weights, laws, q, joint, axis)

    def _motion(
        self,
        phi: tuple[Any, Any, Any],
        rate: Any,
        acceleration: Any,
        values: Mapping[str, float],
        difference: float,
        turn: Any,
    ) -> tuple[Any, Any, tuple[Any, Any], Joint]:
        """Return complex tilt, its rate, the spin axis (n_x + i n_y, n_z) and the joint (see `dynamics.inverse`)."""
        shape = self._angle.shape

        def flat(array: Any) -> Any:
            return np.ascontiguousarray(np.broadcast_to(array, shape)).reshape(-1)

        turning = bool(np.any(turn))
        nothing = np.zeros(0)
        case = (
            (flat(turn.real), flat(turn.imag), flat(self._table * self._quantities["up"]))
            if turning
            else (nothing, nothing, nothing)
        )
        inertias = [values[name] for name in _INERTIAS]
        inertias[0] += difference
        inertias[1] -= difference
        out = np.empty((N_POINT, self._angle.size))
        compile_kernels(*_KERNELS).inverse_points(
            *(flat(part.astype(complex)) for part in phi), self._sines, self._cosines, flat(rate), flat(acceleration),
            *case, turning, *inertias, out,
        )  # fmt: skip
        r = out.reshape(N_POINT, *shape)
        joint = Joint(
            sx=r[7], cx=r[8], sz=self._sines.reshape(shape), cz=self._cosines.reshape(shape),
            theta_x=r[9], theta_y=r[10], theta_x_rate=r[11], theta_y_rate=r[12], inertial=(r[15], r[16], r[17]),
        )  # fmt: skip
        return r[0] + 1j * r[1], r[2] + 1j * r[3], (r[4] + 1j * r[5], r[6]), joint

    def _reading_error(
        self,
        effects: list[ActiveEffect],
        q: Mapping[str, Any],
        values: Mapping[str, float],
        tilt_rate: Any,
        tilt_acc: Any,
        acceleration: Any,
    ) -> tuple[Any, Any, Any]:
        """Return what the effects add to the tilt readings, and its first and second derivative.

        The laws see the true tilt, which is the reading less what they add: found by repetition. The derivatives are
        taken along the motion, with what changes slowly held.
        """
        error: Any = 0.0j
        first: Any = 0.0j
        second: Any = 0.0j
        for active in effects:
            for index, law in enumerate(active.effect.laws):
                if law.target != "tilt_reading":
                    continue
                function = array_law(active.effect, index)
                fixed = {**q, **active.values, **_NO_JOINT}
                moving = law.expression.free_symbols & _MOVING
                if not moving:
                    error = error + function({**fixed, "z": 0.0j, "z_rate": 0.0j})
                    continue
                step = _STENCIL / q["Omega"]
                phi = (self._tilt - complex(values["tilt_bias_x"], values["tilt_bias_y"])) / values[
                    "tilt_scale"
                ]
                own: Any = 0.0j
                rate: Any = 0.0j
                acc: Any = 0.0j
                for _ in range(3 if {z, z_rate} & moving else 1):
                    samples = []
                    for k in (-2, -1, 0, 1, 2):
                        h = k * step
                        at = phi - own + h * (tilt_rate - rate) + 0.5 * h**2 * (tilt_acc - acc)
                        there = {
                            **fixed,
                            "z": np.tan(at.real) + 1j * np.tan(at.imag),
                            "z_rate": tilt_rate - rate + h * (tilt_acc - acc),
                            "theta_z": self._angle + k * _STENCIL + 0.5 * h**2 * acceleration,
                            "t": fixed["t"] + h,
                        }
                        samples.append(np.broadcast_to(function(there), self._angle.shape))
                    stack = np.array(samples)
                    own = stack[2]
                    rate = np.tensordot(_FIRST, stack, 1) / step
                    acc = np.tensordot(_SECOND, stack, 1) / step**2
                error, first, second = error + own, first + rate, second + acc
        return error, first, second

    @staticmethod
    def _laws(
        effects: list[ActiveEffect],
        q: dict[str, Any],
        targets: frozenset[str] | set[str],
        joint: Joint | None = None,
    ) -> _Laws:
        result = _Laws()
        for active in effects:
            for index, law in enumerate(active.effect.laws):
                if law.target not in targets:
                    continue
                function = array_law(active.effect, index)
                if law.target == "flexure_torque":
                    assert joint is not None
                    sides = []
                    for axis, angle, rate, so_far in (
                        (1.0, joint.theta_x, joint.theta_x_rate, result.flexure_torque[0]),
                        (-1.0, joint.theta_y, joint.theta_y_rate, result.flexure_torque[1]),
                    ):
                        own = {**q, **active.values, "theta": angle, "theta_rate": rate, "axis": axis}
                        sides.append(so_far + np.real(function(own)))
                    result.flexure_torque = tuple(sides)
                    continue
                value = function({**q, **active.values, **_NO_JOINT})
                value = value if TARGETS[law.target].complex else np.real(value)
                setattr(result, law.target, getattr(result, law.target) + value)
        return result


#: Bench parameters that act as a torque.
_PUSHING = frozenset(
    (
        "flexure_stiffness_x",
        "flexure_stiffness_y",
        "flexure_damping_x",
        "flexure_damping_y",
        "bearing_coulomb",
        "bearing_viscous",
        "fixed_torque_x",
        "fixed_torque_y",
    )
)
#: Those that leave the motion as it is: also what turns torques into readings, and the motor's heat, which acts
#: through effects that know its warmth (`_WARM`), if at all.
_QUICK = _PUSHING | {"coil_constant", "motor_resistance", *MOTOR_THERMAL}
#: Angles of a flexure where there is none.
_NO_JOINT = {"theta": 0.0, "theta_rate": 0.0, "axis": 1.0}
#: What stands for the motion in laws that must not depend on it.
_AT_REST = {"z": 0.0j, "z_rate": 0.0j}
_KERNELS = (("gyrowheel_sim", "mechanics/dynamics.py"), ("gyrowheel_sim", "mechanics/inverse.py"))
_BEFORE_THE_JOINT = frozenset(("inertia_difference", "case_rate", "tilt_reading"))
_ON_THE_JOINT = frozenset(TARGETS) - _BEFORE_THE_JOINT
_TORQUES = frozenset(("rotor_torque", "axial_torque", "shaft_torque", "flexure_torque"))
#: Quantities that change within a revolution.
_MOVING = frozenset((z, z_rate, theta_z, Omega, t))
_WARM = frozenset((T_winding, T_motor))


def _bench_torques(
    values: Mapping[str, float], rate: Any, joint: Joint
) -> tuple[complex, Any, tuple[Any, Any]]:
    """Return the torques of the bench's own parameters `_PUSHING` [N m]: across the spin axis, on shaft, on flexures.

    They are proportional to the parameters.
    """
    flexures = (
        -values["flexure_stiffness_x"] * joint.theta_x - values["flexure_damping_x"] * joint.theta_x_rate,
        -values["flexure_stiffness_y"] * joint.theta_y - values["flexure_damping_y"] * joint.theta_y_rate,
    )
    shaft = -values["bearing_coulomb"] * np.sign(rate) - values["bearing_viscous"] * rate
    return complex(values["fixed_torque_x"], values["fixed_torque_y"]), shaft, flexures


#: Places of the amplitudes of a ripple, a real quantity: each harmonic and its conjugate; see `HARMONICS`.
_PAIRS = tuple((HARMONICS.index(-order), HARMONICS.index(order)) for order in FORWARD)
_PARTS = tuple((place, unit) for _, place in _PAIRS for unit in (1.0, 1j))


def _real_parts(amplitudes: Any) -> Any:
    """Return real and imaginary parts of the amplitudes (n, harmonics, nodes) of a ripple: (n, nodes, parts)."""
    return np.stack(
        [amplitudes[:, place].real if unit == 1.0 else amplitudes[:, place].imag for place, unit in _PARTS],
        axis=-1,
    )


def _amplitudes(parts: Any) -> Any:
    """Return the amplitudes (..., harmonics, nodes) of a ripple that has these parts (..., nodes, parts)."""
    result = np.zeros((*parts.shape[:-2], len(HARMONICS), *parts.shape[-2:-1]), dtype=complex)
    for number, (mirror, place) in enumerate(_PAIRS):
        value = parts[..., 2 * number] + 1j * parts[..., 2 * number + 1]
        result[..., place, :], result[..., mirror, :] = value, np.conj(value)
    return result


def _summed(amplitudes: Any, wave: Any) -> Any:
    """Sum of waves (harmonics, phases) with amplitudes (n, harmonics, nodes): (n, nodes, phases)."""
    return np.swapaxes(amplitudes, 1, 2) @ wave


def _weighted(values: Any, weights: Any) -> Any:
    """Sum of values (n, nodes, phases), or what broadcasts to it, times weights (nodes, phases): (n,)."""
    if np.ndim(values) == 0:
        return values * weights.sum()
    nodes, phases = weights.shape
    values = np.broadcast_to(values, (len(values), nodes, phases))
    return values.reshape(len(values), nodes * phases) @ weights.reshape(-1)


def _components(rows: Any) -> list[Array]:
    """Return real and imaginary parts, one after the other."""
    return [part for row in rows for part in (np.real(row), np.imag(row))]
