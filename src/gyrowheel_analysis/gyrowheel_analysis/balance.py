"""The balance of torques and voltages: what the model predicts for the measured motion, against what was measured.

No controller enters. For every window the torque that the measured motion needs is computed by exact inverse
dynamics at several instants and spin angles and averaged; the averaging of the flexures, of the gimbal's inertia
and of the rectified harmonics over a revolution thus comes by itself, for every effect alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.reduction import HARMONICS, Windows
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.dynamics import Joint, Spin, generalised_forces, inverse, spin_axis
from gyrowheel_sim.effects.code import array_law
from gyrowheel_sim.effects.declaration import TARGETS, Effect
from gyrowheel_sim.effects.quantities import REFERENCES

Array = NDArray[np.float64]

CHANNELS = ("tilt_x", "tilt_y", "spin", "motor_voltage")
_INERTIAS = (
    "rotor_inertia_x",
    "rotor_inertia_y",
    "rotor_inertia_z",
    "gimbal_inertia_x",
    "gimbal_inertia_y",
    "gimbal_inertia_z",
    "shaft_inertia",
)
_PHASES = 12  # spin angles; the products of the harmonics kept reach the fifth
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)


@dataclass(frozen=True)
class ActiveEffect:
    """An effect with the values of its coefficients."""

    effect: Effect
    values: Mapping[str, float]


class Balance:
    """Predicted and measured rows of a set of windows.

    Rows are ordered by channel: tilt_x, tilt_y and spin [N m], then motor_voltage [V]; each channel has one row a
    window.

    Parameters
    ----------
    windows : Windows
        The reduced recording(s).
    bench : Bench
        The model's bench; its coil and motor constants convert voltages and currents to N m.
    """

    def __init__(self, windows: Windows, bench: Bench) -> None:
        self.windows = windows
        self.bench = bench
        self._ripple: Any = None
        self._references = {name: bench.value(parameter) for name, parameter in REFERENCES.items()}
        w = windows
        half = 0.5 * w.duration[:, None]
        theta = np.arange(_PHASES) * (2.0 * np.pi / _PHASES)
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
            """Sum of the harmonics with amplitudes `c` (n, nodes x harmonics): (n, nodes, phases)."""
            return np.einsum("nhk,hp->nkp", c * ((1j * h) ** derivative)[None, :, None], wave)

        a0, a1, a2 = (smooth(w.tilt_harmonics, d) for d in range(3))
        tau = half * _NODES
        self._order, self._wave = 1j * h, wave
        self._spin, self._spin_rate = smooth(w.spin)[:, :, None], smooth(w.spin, 1)[:, :, None]
        # readings of the tilt before any correction of the sensor, and the parts of their derivatives
        self._tilt = smooth(w.tilt)[:, :, None] + waves(a0)
        self._first = (smooth(w.tilt, 1)[:, :, None] + waves(a1), waves(a0, 1))
        self._second = (smooth(w.tilt, 2)[:, :, None] + waves(a2), 2.0 * waves(a1, 1), waves(a0, 2))
        self._current = smooth(w.current_harmonics)
        shape = (len(w), len(_NODES), _PHASES)
        self._angle = np.broadcast_to(theta, shape)
        self._weights = np.broadcast_to((_WEIGHTS / 2.0)[None, :, None] / _PHASES, shape)
        time = w.middle[:, None] + tau
        self._quantities: dict[str, Any] = {
            "T_coil": (w.coil_temperature[:, None] + w.coil_temperature_rate[:, None] * tau)[:, :, None],
            "T_air": w.air_temperature[:, None, None],
            "rho": (w.air_pressure / (bench.value("gas_constant") * w.air_temperature))[:, None, None],
            "up": w.up[:, None, None],
            "t": time[:, :, None],
            **self._references,
        }
        self.measured = np.concatenate(
            [
                bench.value("coil_constant") * w.coil_voltage.real,
                bench.value("coil_constant") * w.coil_voltage.imag,
                bench.value("motor_constant") * w.motor_current,
                w.motor_voltage,
            ]
        )

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.measured)

    def channel(self, name: str) -> slice:
        """Return the rows of a channel."""
        n, index = len(self.windows), CHANNELS.index(name)
        return slice(index * n, (index + 1) * n)

    def required(self, values: Mapping[str, float], effects: list[ActiveEffect]) -> tuple[Any, Any]:
        """Return the mean torques that coils (complex, x + i y) and motor must give [N m], arrays (n,).

        The relative changes of the coils' gain are left out here, see `predicted`.
        """
        coil, motor, _, weights = self._instantaneous(values, effects)
        return (coil * weights).sum(axis=(1, 2)), (motor * weights).sum(axis=(1, 2))

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
        ndarray (4 n,)
            What the readings should be: voltages of the coils and current of the motor converted with the
            constants of the model's bench [N m], and the motor's voltage [V].
        """
        coil, motor, gain, weights = self._instantaneous(values, effects)
        coil_row = (coil / (1.0 + gain) * weights).sum(axis=(1, 2))
        coil_row = coil_row * (self.bench.value("coil_constant") / values["coil_constant"])
        torque = (motor * weights).sum(axis=(1, 2))
        current = torque / values["motor_constant"]
        voltage = values["motor_resistance"] * current + values["motor_constant"] * self.windows.mean_spin
        return np.concatenate(
            [coil_row.real, coil_row.imag, self.bench.value("motor_constant") * current, voltage]
        )

    def _instantaneous(
        self, values: Mapping[str, float], effects: list[ActiveEffect]
    ) -> tuple[Any, Any, Any, Any]:
        """Return the torques of coils and motor, the change of the coils' gain, and the weights of a mean over time.

        All are (n, nodes, phases).

        The universal joint makes the spin rate ripple. The ripple that belongs to the measured current is far better
        known than a reading of the speed: over a revolution the motor's torque must be that of its current.
        """
        inertia = self.bench.axial_inertia
        wanted = values["motor_constant"] * self._current
        ripple = self._ripple
        if ripple is None:
            ripple = np.zeros_like(wanted)
            for _ in range(2):
                ripple = ripple + self._ripple_error(
                    self._torques(values, effects, ripple)[1], wanted, inertia
                )
            self._ripple = ripple
        first = self._torques(values, effects, ripple)
        error = self._ripple_error(first[1], wanted, inertia)
        return self._torques(values, effects, ripple + error)

    def _ripple_error(self, motor: Any, wanted: Any, inertia: float) -> Any:
        found = np.einsum("nkp,hp->nhk", motor, self._wave.conj()) / _PHASES
        return (wanted - found) / (inertia * self._order[None, :, None] * self._spin[:, None, :, 0])

    def _torques(
        self, values: Mapping[str, float], effects: list[ActiveEffect], ripple: Any
    ) -> tuple[Any, Any, Any, Any]:
        """Return the same for a given ripple of the spin rate: amplitudes (n, harmonics, nodes) [rad/s]."""
        Omega = self._spin + np.einsum("nhk,hp->nkp", ripple, self._wave).real
        acceleration = (
            self._spin_rate
            + np.einsum("nhk,hp->nkp", ripple * self._order[:, None], self._wave).real * self._spin
        )
        tilt_rate = self._first[0] + self._first[1] * Omega
        tilt_acc = (
            self._second[0]
            + self._second[1] * Omega
            + self._second[2] * Omega**2
            + self._first[1] * acceleration
        )
        q = {**self._quantities, "Omega": Omega}
        reading: Any = complex(values["tilt_bias_x"], values["tilt_bias_y"])
        # the error of the reading first: every other law sees the true tilt
        q["z"], q["z_rate"] = self._tilt, tilt_rate
        q["theta"] = q["theta_rate"] = 0.0
        for target, value in self._laws(effects, q, {"tilt_reading"}):
            assert target == "tilt_reading"
            reading = reading + value
        scale = values["tilt_scale"]
        phi = (self._tilt - reading) / scale
        phi_rate, phi_acc = tilt_rate / scale, tilt_acc / scale
        tx, ty = np.tan(phi.real), np.tan(phi.imag)
        sx2, sy2 = 1.0 + tx**2, 1.0 + ty**2
        z = tx + 1j * ty
        z_rate = sx2 * phi_rate.real + 1j * sy2 * phi_rate.imag
        z_acc = sx2 * (phi_acc.real + 2.0 * tx * phi_rate.real**2)
        z_acc = z_acc + 1j * sy2 * (phi_acc.imag + 2.0 * ty * phi_rate.imag**2)
        q["z"], q["z_rate"] = z, z_rate
        motion = Spin(z, z_rate, z_acc, self._angle, Omega, acceleration)
        joint = inverse(motion, tuple(values[name] for name in _INERTIAS))  # type: ignore[arg-type]
        n, _, _, nz = spin_axis(z, z_rate, z_acc)
        torque: Any = complex(values["fixed_torque_x"], values["fixed_torque_y"])
        axial: Any = 0.0
        shaft: Any = -values["bearing_coulomb"] * np.sign(Omega) - values["bearing_viscous"] * Omega
        flexure_x: Any = (
            -values["flexure_stiffness_x"] * joint.theta_x - values["flexure_damping_x"] * joint.theta_x_rate
        )
        flexure_y: Any = (
            -values["flexure_stiffness_y"] * joint.theta_y - values["flexure_damping_y"] * joint.theta_y_rate
        )
        gain: Any = 0.0
        across: Any = 0.0
        rest = {"rotor_torque", "axial_torque", "shaft_torque", "flexure_torque", "coil_gain"}
        for target, value in self._laws(effects, q, rest, joint):
            if target == "rotor_torque":
                across = across + value
            elif target == "axial_torque":
                axial = axial + value
            elif target == "shaft_torque":
                shaft = shaft + value
            elif target == "coil_gain":
                gain = gain + value
            else:
                flexure_x, flexure_y = flexure_x + value[0], flexure_y + value[1]
        # a torque across the spin axis has no component along it: fixes its z component
        across = torque + across
        along = (np.conj(z) * across).imag
        total = across + axial * n
        Q1, Q2, Q3 = generalised_forces(
            joint.sx, joint.cx, joint.sz, joint.cz, np.real(total), np.imag(total), along + axial * nz
        )
        need_x = joint.inertial[0] - flexure_x - Q1
        need_y = joint.inertial[1] - flexure_y - Q2
        coil = np.exp(1j * self._angle) * (need_x + 1j * need_y / joint.cx)
        motor = joint.inertial[2] - shaft - Q3
        # a spin angle that is passed quickly takes little time
        weights = self._weights * self._spin / Omega
        return coil, motor, gain, weights / weights.sum(axis=(1, 2), keepdims=True)

    @staticmethod
    def _laws(
        effects: list[ActiveEffect], q: dict[str, Any], targets: set[str], joint: Joint | None = None
    ) -> list[tuple[str, Any]]:
        results: list[tuple[str, Any]] = []
        for active in effects:
            for index, law in enumerate(active.effect.laws):
                if law.target not in targets:
                    continue
                function = array_law(active.effect, index)
                if law.target == "flexure_torque":
                    assert joint is not None
                    x = function(
                        {**q, **active.values, "theta": joint.theta_x, "theta_rate": joint.theta_x_rate}
                    )
                    y = function(
                        {**q, **active.values, "theta": joint.theta_y, "theta_rate": joint.theta_y_rate}
                    )
                    results.append((law.target, (np.real(x), np.real(y))))
                else:
                    given = q if joint is None else {**q, "theta": 0.0, "theta_rate": 0.0}
                    value = function({**given, **active.values})
                    results.append((law.target, value if TARGETS[law.target][1] else np.real(value)))
        return results
