"""Prediction of the samples of a hold by a model: torques, readings, and their sensitivity to its uncertainties."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.balance.motion import mean
from gyrowheel_analysis.fitting.fit import Unknowns
from gyrowheel_analysis.fitting.prediction import Prediction
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.segmentation import reduce
from gyrowheel_analysis.reduction.windows import Windows, concatenate
from gyrowheel_analysis.torques import effect_parts
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

_ROWS = ("tilt_x", "tilt_y", "spin")
#: Static errors of readings that affect the laws of effects alone, and the column of the windows with these readings.
_STATIC_ERRORS = {"pressure_bias": "air_pressure", "temperature_bias": "coil_temperature"}


def believed_bench(model: Model) -> Bench:
    """Return the bench of a model with the values and standard errors learned from recordings."""
    parameters = {
        name: replace(parameter, uncertainty=model.overrides[name].standard_error)
        if name in model.overrides
        else parameter
        for name, parameter in model.bench.parameters.items()
    }
    return replace(model.bench, parameters=parameters)


@dataclass(frozen=True)
class HoldPrediction:
    """Integrals over the windows of a hold by a believed model; those of further windows add.

    `length` is that of the windows [s]. The columns of every array are coil x, coil y and motor: torque that the motion
    needs, the share of effects of the air in it, and the contribution of errors of actuators and readings [N m s]; the
    predicted voltages [V s]; and the `changes` (uncertainties, 3) of the expected torque reading if one uncertain
    quantity of the model is one standard error larger [N m s].
    """

    length: float
    torque: Array
    air: Array
    errors: Array
    voltage: Array
    changes: Array

    def __add__(self, other: HoldPrediction) -> HoldPrediction:
        """Return the integrals over the windows of both."""
        return HoldPrediction(*(getattr(self, own.name) + getattr(other, own.name) for own in fields(self)))


class Predictor:
    """Predicts holds by a model.

    Every uncertainty that the model states is propagated: of all bench parameters that affect a hold, as stated or as
    learned from recordings, of the coefficients of its effects, and of the readings of pressure and temperature that
    effects use. They count as independent: a model file has no covariances of parameters that were fitted together.
    """

    def __init__(self, model: Model) -> None:
        self._bench = believed_bench(model)
        self._unknowns = Unknowns(self._bench, model.effects, model.effect_errors, model.declared)
        self._stated = self._unknowns.stated()
        self._effects = self._unknowns.effects(self._stated)
        self._air = {active.effect.name for active in self._effects if active.effect.category == "air"}
        # without effects nothing depends on the air or on the coils' temperature
        self._static = tuple(_STATIC_ERRORS if self._effects else ())
        self._count = self._unknowns.count + len(self._static)

    def total(self, parts: Iterable[HoldPrediction | None]) -> HoldPrediction:
        """Return the sum of some predictions; None counts as that of no window."""
        none = np.zeros(3)
        result = HoldPrediction(0.0, none, none, none, none, np.zeros((self._count, 3)))
        for part in parts:
            result = result if part is None else result + part
        return result

    def windows(self, samples: Samples) -> Windows:
        """Return the windows of some samples of a hold."""
        return reduce(samples, self._bench, weighed=False)

    def of(self, parts: Sequence[Windows]) -> list[HoldPrediction]:
        """Return the prediction for each of some sets of windows; for all of them it costs little more than for one."""
        windows = concatenate(parts) if parts else Windows.of([])
        if not len(windows):
            return [self.total(()) for _ in parts]
        balance, values = self._balance(windows), self._bench.values()
        prediction = Prediction([balance], self._unknowns)
        rows = prediction.rows(self._stated)
        at = balance.instants(values, self._effects)
        coil, motor = mean(at.coil, at.weights), mean(at.motor, at.weights)
        air = np.zeros((3, len(windows)))
        for part in effect_parts(balance, values, self._effects, at, self._air):
            air += np.array([part.coil.real, part.coil.imag, part.motor])
        x, y, spin = self._torques(balance, rows)
        constant = self._bench.value("coil_constant")
        columns = [self._with_error(windows, name) - rows for name in self._static]
        if self._unknowns.count:
            columns += list(prediction.nuisance_jacobian(self._stated).T)
        changes = np.array([self._torques(balance, column) for column in columns])
        torque = np.array([coil.real, coil.imag, motor])
        errors = np.array([x - coil.real, y - coil.imag, spin - motor])
        voltage = np.array([x / constant, y / constant, rows[balance.row("motor_voltage")]])
        edges = np.cumsum([0, *map(len, parts)])
        found = []
        for own in map(slice, edges[:-1], edges[1:]):
            time = windows.duration[own]
            found.append(
                HoldPrediction(
                    length=float(time.sum()),
                    torque=torque[:, own] @ time,
                    air=air[:, own] @ time,
                    errors=errors[:, own] @ time,
                    voltage=voltage[:, own] @ time,
                    changes=changes.reshape(-1, 3, len(windows))[:, :, own] @ time,
                )
            )
        return found

    def _balance(self, windows: Windows) -> Balance:
        return Balance(windows, self._bench, clean=False, harmonics=False)

    @staticmethod
    def _torques(balance: Balance, rows: Array) -> Array:
        """Return the rows of coils and motor that are torques (3, n)."""
        return np.array([rows[balance.row(name)] for name in _ROWS])

    def _with_error(self, windows: Windows, name: str) -> Array:
        """Return the predicted rows if a reading is too high by the stated uncertainty of its static error."""
        column, error = _STATIC_ERRORS[name], self._bench.parameters[name].uncertainty
        right = replace(windows, **{column: getattr(windows, column) - error})
        return self._balance(right).predicted(self._bench.values(), self._effects)
