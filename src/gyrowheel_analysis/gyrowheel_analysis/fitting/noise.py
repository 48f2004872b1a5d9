"""Covariance of the rows of a balance: white noise, slow drift, accuracy of the model; and how large the drift is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular
from scipy.optimize import minimize

from gyrowheel_analysis.balance.balance import CHANNELS, RIPPLE_CHANNELS, TURNING_CHANNELS, Balance
from gyrowheel_analysis.fitting.drift import DriftCovariance, MarginalCost
from gyrowheel_analysis.reduction import FORWARD
from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.sizes import torque_scale

Array = NDArray[np.float64]

#: Drifts that are scaled together: the coils are alike.
SOURCES = {
    "tilt_x": "coil_voltage",
    "tilt_y": "coil_voltage",
    "spin": "motor_current",
    "motor_voltage": "motor_voltage",
}
#: Accuracy of the balance itself, measured against the full simulation on every shipped plan: part of the torque of
#: the row, and a constant part on the default bench [N m], which goes with the torques of a bench.
MODEL_RELATIVE = 5.0e-4
MODEL_ABSOLUTE = 4.0e-6
#: The same for the ripple of the speed while the tilt moves [N m].
MODEL_RIPPLE = 1.0e-4
#: A drift below the stated one is not believed: few windows show little of a slow drift by chance.
_SCALE_BOUNDS = (1.0, 8.0)
_SCALE_SPREAD = 0.7  # of the logarithm of a drift's scale before the recording is seen
_OTHER = 0.25  # change of the logarithm of a standard deviation that makes a noise another one


class Noise:
    """Noise of several recordings: one covariance a channel and recording.

    Parameters
    ----------
    balances : sequence of Balance
        One a recording; their drifts are independent.
    predicted : sequence of ndarray
        Predicted rows of each, for the accuracy of the model.
    """

    def __init__(self, balances: Sequence[Balance], predicted: Sequence[Array]) -> None:
        self.channels = [
            {name: _channel(balance, rows, name) for name in CHANNELS}
            for balance, rows in zip(balances, predicted, strict=True)
        ]
        self._white = _turning(balances, predicted, [balance.bench for balance in balances])
        self.scales = dict.fromkeys(SOURCES.values(), 1.0)

    def weigh(
        self, balances: Sequence[Balance], predicted: Sequence[Array], values: Mapping[str, float]
    ) -> bool:
        """Take the noise of the harmonics as it is on a bench of other values; return whether it is another one.

        Of a torque twice a revolution the noise comes mostly from the readings of the tilt, times what the rotor
        resists there. That almost vanishes on a disc, and does not on a rotor with a very different inertia.

        Parameters
        ----------
        balances, predicted
            As given before, the rows as predicted with those values.
        values : mapping
            All bench parameters [SI].
        """
        try:
            benches = [balance.bench.with_values(values) for balance in balances]
        except InputError:  # a fit that went astray
            return False
        white = _turning(balances, predicted, benches)
        other = any(np.any(np.abs(np.log(b / a)) > _OTHER) for a, b in zip(self._white, white, strict=True))
        if other:
            self._white = white
        return other

    def whiten(self, rows: Array) -> Array:
        """Return rows (N, ...) divided by the square root of their covariance, recording after recording."""
        parts, at = [], 0
        for c, white in zip(self.channels, self._white, strict=True):
            for name in CHANNELS:
                n = len(c[name])
                parts.append(c[name].whiten(rows[at : at + n], self.scales[SOURCES[name]]))
                at += n
            # the harmonics carry no drift
            own = rows[at : at + len(white)]
            parts.append(own / (white if own.ndim == 1 else white[:, None]))
            at += len(white)
        return np.concatenate(parts) if parts else np.zeros_like(rows)

    def deviation(self) -> Array:
        """Return the standard deviation of every row [unit of the row]."""
        parts = []
        for c, white in zip(self.channels, self._white, strict=True):
            parts += [np.sqrt(c[name].variance(self.scales[SOURCES[name]])) for name in CHANNELS]
            parts.append(white)
        return np.concatenate(parts)

    def estimate_scales(self, residual: Array, regressors: Array) -> None:
        """Estimate how large the drifts are and keep the scales (see `best_scales`)."""
        self.use_scales(self.best_scales(residual, regressors)[0])

    def use_scales(self, scales: dict[str, float]) -> None:
        """Take the scales of the drifts from elsewhere."""
        self.scales = dict(scales)

    def best_scales(self, residual: Array, regressors: Array) -> tuple[dict[str, float], float]:
        """Return the most likely scales of the drifts and minus twice the log of their marginal likelihood.

        Parameters
        ----------
        residual : ndarray (N,)
            Rows measured minus predicted by the model as it stands.
        regressors : ndarray (N, p)
            Everything that may explain them, each column scaled to one prior standard deviation: what they can
            explain is not taken for drift.
        """
        names = list(dict.fromkeys(SOURCES.values()))
        blocks: list[tuple[DriftCovariance, str]] = []
        kept: list[Any] = []
        start = 0
        for c, white in zip(self.channels, self._white, strict=True):
            for name in CHANNELS:
                n = len(c[name])
                blocks.append((c[name], SOURCES[name]))
                kept.append(np.arange(start, start + n))
                start += n
            start += len(white)
        # the drift shows in the averages alone; the harmonics narrow what the regressors may explain there
        averages = np.concatenate(kept) if kept else np.zeros(0, dtype=int)
        turning = np.setdiff1d(np.arange(start), averages)
        residual, regressors, turning_cost = _narrowed(residual, regressors, averages, turning, self._white)
        marginal = MarginalCost(blocks, residual, regressors)

        def cost(log_scale: Array) -> float:
            scale = dict(zip(names, np.exp(log_scale), strict=True))
            return marginal(scale) + float((log_scale**2).sum()) / _SCALE_SPREAD**2

        bounds = [(float(np.log(_SCALE_BOUNDS[0])), float(np.log(_SCALE_BOUNDS[1])))] * len(names)
        best = minimize(
            cost, np.full(len(names), 0.05), bounds=bounds, method="L-BFGS-B", options={"maxiter": 30}
        )
        return {name: float(np.exp(value)) for name, value in zip(names, best.x, strict=True)}, float(
            best.fun + turning_cost
        )


def _narrowed(
    residual: Array, regressors: Array, averages: Any, turning: Any, white: Sequence[Array]
) -> tuple[Array, Array, float]:
    """Return the averages' residual and regressors once the rows of the harmonics have been taken into account.

    The regressors stand for coefficients of unit prior deviation. The harmonics, whose noise is known, turn that
    prior into another; its mean is taken from the residual, and its deviation scales the regressors. The number is
    minus twice the log of the likelihood of the harmonics themselves, but for a constant.
    """
    if not len(turning):
        return residual[averages], regressors[averages], 0.0
    sigma = np.concatenate(list(white))
    design, rows = regressors[turning] / sigma[:, None], residual[turning] / sigma
    precision = np.eye(design.shape[1]) + design.T @ design
    root = np.linalg.cholesky(precision)
    mean = cho_solve((root, True), design.T @ rows)
    cost = float(rows @ rows - (design.T @ rows) @ mean + 2.0 * np.log(np.diag(root)).sum())
    spread = solve_triangular(root, np.eye(len(root)), lower=True).T
    return residual[averages] - regressors[averages] @ mean, regressors[averages] @ spread, cost


def _turning(
    balances: Sequence[Balance], predicted: Sequence[Array], benches: Sequence[Bench]
) -> list[Array]:
    """Return the standard deviations of the harmonics of every recording."""
    return [
        np.sqrt(
            np.concatenate(
                [np.zeros(0)]
                + [_harmonic(balance, bench, rows, name) for name in balance.channels[len(CHANNELS) :]]
            )
        )
        for balance, rows, bench in zip(balances, predicted, benches, strict=True)
    ]


def _harmonic(balance: Balance, bench: Bench, predicted: Array, name: str) -> Array:
    """Return the variance of one channel of the harmonics on a bench of other values than that of the balance."""
    v, w = bench.value, balance.windows
    spin, scale = w.mean_spin, torque_scale(balance.bench)
    if name in TURNING_CHANNELS:
        order = FORWARD[TURNING_CHANNELS.index(name) // 2]
        # torque that a reading of the tilt once or twice a revolution stands for
        inertia = v("rotor_inertia_x") + 0.5 * v("gimbal_inertia_x")
        stiffness = 0.5 * (v("flexure_stiffness_x") + v("flexure_stiffness_y"))
        stiff = np.abs(stiffness + (order * bench.precession_inertia - order**2 * inertia) * spin**2)
        white = (v("coil_constant") * w.noise("coil_voltage_noise")) ** 2 + (
            stiff * w.noise("tilt_noise")
        ) ** 2
        white = white * w.harmonic_variance[:, FORWARD.index(order)] / w.samples
        x = TURNING_CHANNELS[2 * (order - 1)], TURNING_CHANNELS[2 * (order - 1) + 1]
        size = np.hypot(*(predicted[balance.channel(own)] for own in x))
        return np.asarray(white + (scale * MODEL_ABSOLUTE) ** 2 + (MODEL_RELATIVE * size) ** 2)
    half = 2.0 * w.samples
    speed = w.noise("spin_rate_noise") ** 2 / half
    current = w.noise("motor_current_noise") ** 2 / half
    if name in RIPPLE_CHANNELS[:2]:
        swing = bench.axial_inertia * v("motor_ripple_order") * spin
        floor = scale * np.where(w.moving, MODEL_RIPPLE, MODEL_ABSOLUTE)
        return np.asarray(swing**2 * speed + v("motor_constant") ** 2 * current + floor**2)
    voltage = w.noise("motor_voltage_noise") ** 2 / half
    return np.asarray(
        voltage + v("motor_resistance") ** 2 * current + v("motor_constant") ** 2 * speed + 1e-14
    )


def _channel(balance: Balance, predicted: Array, name: str) -> DriftCovariance:
    v, w = balance.bench.value, balance.windows
    rows = np.abs(predicted[balance.channel(name)])
    absolute = torque_scale(balance.bench) * MODEL_ABSOLUTE
    if name in ("tilt_x", "tilt_y"):
        momentum = balance.bench.precession_inertia * w.mean_spin
        slew = momentum * np.abs(w.mean_tilt_rate)
        white = (
            v("coil_constant") * w.noise("coil_voltage_noise")
        ) ** 2 / w.samples + momentum**2 * w.tilt_rate_variance
        size, level = np.maximum(rows, slew), v("coil_constant") * v("coil_voltage_drift")
        floor = absolute**2 + (MODEL_RELATIVE * size) ** 2
    else:
        inertia = balance.bench.axial_inertia
        torque = inertia**2 * w.spin_acceleration_variance
        floor = absolute**2 + (4.0 * MODEL_RELATIVE * inertia * np.abs(w.mean_spin_acceleration)) ** 2
        if name == "spin":
            white = (v("motor_constant") * w.noise("motor_current_noise")) ** 2 / w.samples + torque
            level = v("motor_constant") * v("motor_current_drift")
        else:
            per_torque = v("motor_resistance") / v("motor_constant")
            white = w.noise("motor_voltage_noise") ** 2 / w.samples + per_torque**2 * torque
            white = white + (v("motor_constant") * w.noise("spin_rate_noise")) ** 2 / w.samples
            level, floor = v("motor_voltage_drift"), floor * per_torque**2
    return DriftCovariance(w.middle, white + floor, level, v("drift_time"))
