"""Calibration in place: torque per volt of the coils and per ampere of the motor.

The reference for the coils is angular momentum: precession at a known rate takes the torque H times the rate, and H
follows from the rotor's inertia. So all torques on a rotor at rest in the case (flexures, gimbal, friction, unmodelled
air) are left free, the stated constant of the coils gets no weight, and the inertias and the scale of the tilt sensors
keep their stated uncertainty: they are the reference.

The motor's constant in V s/rad equals that in N m/A. V = R i + k Omega, averaged over whole revolutions, gives it
without any torque. It gives the resistance as well where the current varies enough, as in a speed sweep.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np
from scipy.linalg import solve_triangular

from gyrowheel_analysis.criteria import CALIBRATION_CHI2, CALIBRATION_ERROR
from gyrowheel_analysis.diagnosis.diagnose import nuisance_estimates
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.preparation import Progress, prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model, Override
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_analysis.residuals.error_table import channel_parts
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.bench import Bench

#: Calibrated constants, and the motion that a recording must contain for each.
CONSTANTS = {
    "coil_constant": "cones or other slow turns of the tilt (plan cone, plan survey)",
    "motor_constant": "several speeds (plan coast_down, plan survey)",
    "motor_resistance": "a sweep of the speed (plan coast_down)",
}
_COIL = "coil_constant"
_MOTOR = ("motor_constant", "motor_resistance")
#: Relative prior uncertainty of a constant: the stated value has practically no weight.
_OPEN = 0.3
#: Parameters that act on a rotor at rest in the case get this many times their stated uncertainty.
_FREED = 10.0
_STATIC = frozenset(
    (
        "flexure_stiffness_x",
        "flexure_stiffness_y",
        "gimbal_inertia",
        "flexure_damping_x",
        "flexure_damping_y",
        "bearing_coulomb",
        "bearing_viscous",
        "fixed_torque_x",
        "fixed_torque_y",
    )
)
_UNUSED = 1.0e4  # factor of the noise that removes a reading from the fit
_MOST_PASSES = 6
_SETTLED = 0.05  # standard errors


@dataclass(frozen=True)
class Constant:
    """A calibrated constant, SI units.

    Attributes
    ----------
    name, unit : str
        The bench parameter.
    stated : Override
        Value and standard uncertainty of the bench file.
    before : Override
        Value in the model before: an earlier estimate, or the stated value.
    after : Override
        Estimate from the recordings, with its standard error.
    limited_by : str
        The bench parameter whose uncertainty makes up most of the standard error; empty if there is no such parameter.
    """

    name: str
    unit: str
    stated: Override
    before: Override
    after: Override
    limited_by: str = ""


@dataclass(frozen=True)
class Calibration:
    """Outcome of a calibration.

    Attributes
    ----------
    constants : mapping of str to Constant
        The constants that were determined.
    undetermined : mapping of str to str
        Those that were not, and the motion that the recordings would need.
    chi2_per_n : float
        Mean square of the residuals of the tilt in units of their noise; the standard error of the coils' constant is
        widened by its root if above 1.
    calibrated : Model
        The model with the constants as overrides, and an entry in its history.
    recordings : tuple of str
        Paths of the recordings.
    """

    constants: Mapping[str, Constant]
    undetermined: Mapping[str, str]
    chi2_per_n: float
    calibrated: Model
    recordings: tuple[str, ...] = ()

    @property
    def widened(self) -> float:
        """Factor by which the standard error of the coils' constant is widened."""
        return _widened(self.chi2_per_n)

    @property
    def lacking(self) -> bool:
        """Whether the model lacks an effect that biases the calibration."""
        return self.chi2_per_n > CALIBRATION_CHI2


@one_thread()
def calibrate(
    recordings: Sequence[Recording], model: Model, *, progress: Progress | None = None
) -> Calibration:
    """Determine the constants of coils and motor.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings of one machine, with cones for the coils and a sweep of the speed for the motor.
    model : Model
        The model; its effects are taken into account, its constants of coils and motor are not.

    Raises
    ------
    InputError
        If there is too little steady motion, or nothing could be determined.
    """
    say = progress or (lambda text: None)
    stated = model.stated_bench
    # without its history: earlier calibrations get no weight either
    bare = replace(model, stated_bench=_opened(stated, {}), history=())
    prepared = prepare(recordings, bare, progress=progress)
    say("fitting the motor")
    found = dict(zip(_MOTOR, _motor([b.windows for b in prepared.problem.balances], stated), strict=True))
    say("fitting the coils")
    for _ in range(_MOST_PASSES):
        problem = prepared.problem
        fit = problem.fit(())
        coil = nuisance_estimates(problem, fit)[_COIL]
        last, found[_COIL] = found.get(_COIL), Override(float(coil.value), float(coil.standard_error))
        useless = coil.standard_error > CALIBRATION_ERROR * coil.value
        if useless or (last and abs(last.value - coil.value) <= _SETTLED * coil.standard_error):
            break
        # the rows use the bench's own constants: about the values found the fit is linear
        prepared = prepare(
            recordings, replace(bare, stated_bench=_opened(stated, found)), drift_scales=problem.noise.scales
        )
    white = problem.noise.whiten(fit.residual)
    tilt = np.concatenate(
        [part for name in ("tilt_x", "tilt_y") for part in channel_parts(problem.balances, white, name)]
    )
    chi2 = float(np.mean(tilt**2)) if len(tilt) else 1.0
    widened = _widened(chi2)
    constants, undetermined = {}, {}
    for name, needs in CONSTANTS.items():
        after = found[name]
        if name == _COIL:
            after = Override(after.value, after.standard_error * widened)
        if not after.standard_error <= CALIBRATION_ERROR * abs(after.value):
            part = min(after.standard_error / abs(after.value), _OPEN) if after.value else _OPEN
            undetermined[name] = f"known to {100.0 * part:.0f} % only; it takes {needs}"
            continue
        p = stated.parameters[name]
        limit = _limit(problem, fit) if name == _COIL else ""
        before = model.overrides.get(name, Override(p.value, p.uncertainty))
        constants[name] = Constant(name, p.unit, Override(p.value, p.uncertainty), before, after, limit)
    paths = [str(r.path) for r in recordings]
    if not constants:
        reasons = "; ".join(f"{name} {reason}" for name, reason in undetermined.items())
        raise InputError(f"{', '.join(paths)}: nothing can be calibrated: {reasons}")
    return Calibration(constants, undetermined, chi2, _changed(model, constants, paths), tuple(paths))


def _widened(chi2: float) -> float:
    return math.sqrt(max(chi2, 1.0))


#: Noise and drift of the motor's readings in the bench file.
_NOISE_OF_MOTOR = frozenset(
    f"motor_{reading}_{what}" for reading in ("voltage", "current") for what in ("noise", "drift")
)


def _opened(stated: Bench, found: Mapping[str, Override]) -> Bench:
    """Return the bench with the constants as found, no weight on the others, and all static torques left free."""
    parameters = dict(stated.parameters)
    for name, p in stated.parameters.items():
        if name in CONSTANTS:
            value, error = p.value, _OPEN * p.value
            if name in found:
                value = found[name].value
                error = found[name].standard_error if name in _MOTOR else _OPEN * value
            parameters[name] = replace(p, value=value, uncertainty=min(error, _OPEN * abs(value)))
        elif p.group in _STATIC:
            parameters[name] = replace(p, uncertainty=_FREED * p.uncertainty)
        elif name in _NOISE_OF_MOTOR:
            # the constant of the coils must follow from the tilt alone: while the speed still settles, the noise of
            # its slope biases the inertia towards zero
            parameters[name] = replace(p, value=_UNUSED * p.value)
    return replace(stated, parameters=parameters)


def _motor(recordings: Sequence[Windows], bench: Bench) -> tuple[Override, Override]:
    """Return constant and resistance of the motor by V = R i + k Omega, with wider errors where that fits badly."""
    v = bench.value
    constant = v("motor_constant")
    covariances = []
    for w in recordings:
        lag = np.exp(-np.abs(w.middle[:, None] - w.middle[None, :]) / v("drift_time"))
        volts = v("motor_voltage_noise") ** 2 + (constant * v("spin_rate_noise")) ** 2
        covariances.append(
            (
                np.diag(volts / w.samples) + v("motor_voltage_drift") ** 2 * lag,
                np.diag(v("motor_current_noise") ** 2 / w.samples) + v("motor_current_drift") ** 2 * lag,
            )
        )
    # where the current hardly changes, the resistance stays near the value of the bench file
    usual, loose = v("motor_resistance"), _OPEN * v("motor_resistance")

    def best(resistance: float) -> tuple[float, float, float]:
        """Return chi-squared for a resistance, and the corresponding constant with its standard error.

        The noise of the current enters in volts, so the weights depend on the resistance; fixed weights would bias it
        towards zero.
        """
        rows = []
        for w, (volts, amperes) in zip(recordings, covariances, strict=True):
            factor = np.linalg.cholesky(volts + resistance**2 * amperes)
            pair = np.column_stack([w.mean_spin, w.motor_voltage - resistance * w.motor_current])
            rows.append(solve_triangular(factor, pair, lower=True))
        x, y = np.concatenate(rows).T
        k = float(x @ y / (x @ x))
        return (
            float(((y - k * x) ** 2).sum()) + ((resistance - usual) / loose) ** 2,
            k,
            float((x @ x) ** -0.5),
        )

    low, high = 0.2 * usual, 3.0 * usual
    from scipy.optimize import minimize_scalar  # takes long to load

    resistance = float(minimize_scalar(lambda r: best(r)[0], bounds=(low, high), method="bounded").x)
    step = 0.01 * usual
    at, up, down = (best(resistance + change) for change in (0.0, step, -step))
    curvature = max((up[0] + down[0] - 2.0 * at[0]) / step**2, 2.0 / loose**2)
    count = sum(len(w) for w in recordings)
    widened = math.sqrt(max(at[0] / max(count - 2, 1), 1.0))
    error = widened * math.sqrt(2.0 / curvature)
    slope = (up[1] - down[1]) / (2.0 * step)
    return Override(at[1], math.hypot(widened * at[2], slope * error)), Override(resistance, error)


def _limit(problem: Problem, fit: Fit) -> str:
    """Return the parameters whose stated uncertainty causes most of the variance of the coils' constant."""
    names = [group for group, _ in problem.unknowns.nuisances]
    own = names.index(_COIL)
    variance = float(fit.covariance[own, own])
    # part of the variance that exact knowledge of a parameter would remove
    shares = {
        group: float(fit.covariance[own, k]) ** 2 / (float(fit.covariance[k, k]) * variance)
        for k, group in enumerate(names)
        if k != own and fit.covariance[k, k] > 0.0
    }
    strongest = max(shares, key=lambda group: shares[group])
    return strongest if shares[strongest] > 0.5 else ""


def _changed(model: Model, constants: dict[str, Constant], paths: list[str]) -> Model:
    entry = {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "what": f"calibrate {', '.join(constants)}",
        "fit": paths,
        "calibrated": {
            name: {"value": c.after.value, "standard_error": c.after.standard_error}
            for name, c in constants.items()
        },
    }
    return model.changed(
        entry,
        overrides={**model.overrides, **{name: c.after for name, c in constants.items()}},
        effects=model.effects,
        effect_errors=model.effect_errors,
    )
