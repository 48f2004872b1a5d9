"""The wheel as a two-axis rate sensor: rate of the case from the torque that holds the rotor in it.

A rotor with the angular momentum H turns with its case only if the coils precess it. The torque that the model does not
explain, times about i/H, is the rate of the case across the spin axis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import ActiveEffect, Balance
from gyrowheel_analysis.fitting.noise import Noise
from gyrowheel_analysis.fitting.preparation import require_one_bench, samples_of
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.segmentation import reduce
from gyrowheel_analysis.reduction.windows import Windows, concatenate
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.effects import registry

Array = NDArray[np.float64]

_STEP = 1.0e-4  # rad/s, of the derivatives; the torque is practically linear in the rate
_FEWEST = 4  # windows with different rates for a line


@dataclass(frozen=True)
class Line:
    """Estimated against true rate about one axis: estimate = bias + scale * reference.

    Attributes
    ----------
    scale, scale_error : float
        Slope and its standard error [1].
    bias, bias_error : float
        Estimate at rest and its standard error [rad/s].
    rms : float
        Root mean square of the residual [rad/s].
    """

    scale: float
    scale_error: float
    bias: float
    bias_error: float
    rms: float


@dataclass(frozen=True)
class Rates:
    """Rates of the case, window by window.

    Attributes
    ----------
    time : ndarray (n,)
        Middle of the window [s].
    rate, standard_error : ndarray (n, 2)
        Rate about case x and y in inertial space and its standard error from noise and drift [rad/s].
    reference : ndarray (n, 2)
        Commanded rate of the table about the same axes [rad/s].
    lines : tuple of Line or None
        Calibration of each axis against the table; None where the table hardly turned about that axis.
    """

    time: Array
    rate: Array
    standard_error: Array
    reference: Array
    lines: tuple[Line | None, Line | None]

    def to_json(self) -> dict[str, Any]:
        """Return the rates as a JSON object."""
        columns = (self.time, self.rate, self.standard_error, self.reference)
        names = ("time", "rate", "standard_error", "reference")
        windows = zip(*(column.tolist() for column in columns), strict=True)
        return {
            "schema": 1,
            "unit": "rad/s",
            "windows": [dict(zip(names, own, strict=True)) for own in windows],
            "axes": {name: line and asdict(line) for name, line in zip("xy", self.lines, strict=True)},
        }


@one_thread()
def rates(
    recordings: Sequence[Recording], model: Model, *, progress: Callable[[str], None] | None = None
) -> Rates:
    """Estimate the rate of the case across the spin axis in every steady window.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings of one machine. The commanded rate of the table serves for the calibration only.
    model : Model
        The model whose torques are subtracted: bench, overrides and effects.

    Raises
    ------
    InputError
        If there is no recording, or no steady window in any.
    """
    if not recordings:
        raise InputError("no recording given")
    require_one_bench(recordings, model)
    bench = model.bench
    values = bench.values()
    effects = [ActiveEffect(model.library[name], given) for name, given in model.effects.items()]
    turning = registry()["earth_rate"]
    parts: list[Windows] = []
    estimates: list[tuple[Array, Array]] = []
    for recording in recordings:
        if progress:
            progress(f"reducing {recording.name}")
        windows = reduce(samples_of(recording), bench)
        if not len(windows):
            continue
        parts.append(windows)
        # the case at rest, its own axes in place of the home axes
        still = replace(
            windows,
            table_rate=np.zeros(len(windows)),
            home_x=np.ones(len(windows), dtype=complex),
            home_y=np.full(len(windows), 1j),
        )
        balance = Balance(still, bench)
        predicted = balance.predicted(values, effects)
        x, y = balance.row("tilt_x"), balance.row("tilt_y")
        columns = []
        for name in ("E_x", "E_y"):
            given = {"E_x": 0.0, "E_y": 0.0, name: _STEP}
            moved = balance.predicted(values, [*effects, ActiveEffect(turning, given)])
            columns.append(np.stack([(moved - predicted)[x], (moved - predicted)[y]], axis=1) / _STEP)
        inverse = np.linalg.inv(np.stack(columns, axis=2))
        left = balance.measured - predicted
        deviation = Noise.stated([balance], [predicted]).deviation()
        torque = np.stack([left[x], left[y]], axis=1)
        noise = np.stack([deviation[x], deviation[y]], axis=1)
        estimates.append(
            (np.einsum("nij,nj->ni", inverse, torque), np.sqrt(np.einsum("nij,nj->ni", inverse**2, noise**2)))
        )
    if not parts:
        raise InputError(f"{recordings[0].path}: no steady window; the rate needs holds of about a second")
    every = concatenate(parts)
    rate = np.concatenate([r for r, _ in estimates])
    error = np.concatenate([e for _, e in estimates])
    turn = every.table_rate * every.up_across
    reference = np.stack([turn.real, turn.imag], axis=1)
    first, second = (_line(reference[:, k], rate[:, k], error[:, k]) for k in range(2))
    return Rates(every.middle, rate, error, reference, (first, second))


def _line(reference: Array, rate: Array, error: Array) -> Line | None:
    """Fit a line through estimates against references; None if the references hardly differ."""
    if len(np.unique(np.round(reference, 6))) < _FEWEST:
        return None
    design = np.stack([np.ones(len(reference)), reference], axis=1) / error[:, None]
    covariance = np.linalg.inv(design.T @ design)
    bias, scale = covariance @ (design.T @ (rate / error))
    left = rate - bias - scale * reference
    spread = max(1.0, float(np.mean((left / error) ** 2)) ** 0.5)
    deviations = spread * np.sqrt(np.diag(covariance))
    return Line(*map(float, (scale, deviations[1], bias, deviations[0], np.sqrt(np.mean(left**2)))))
