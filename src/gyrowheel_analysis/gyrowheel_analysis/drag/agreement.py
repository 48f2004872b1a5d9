"""Agreement of measured and simulated torques of several holds, by the joint covariance of their errors.

Most of the error of a hold is that of the model's parameters, and the same in all holds; neighbouring holds share the
slow drift of the readings. Judged hold by hold, such an error hides a disagreement far above the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from gyrowheel_analysis.criteria import DRAG_CHANCE, MODEL_ABSOLUTE, MODEL_RELATIVE
from gyrowheel_analysis.drag.estimate import CONSTANTS, READINGS_OF, Estimate
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.registry import torque_scale

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Agreement:
    """Agreement of the torques of one actuator in the holds of a recording.

    Attributes
    ----------
    chi2 : float
        Chi-squared of the residuals by their joint covariance.
    p : float
        Probability that chance makes it as large.
    apart : ndarray (holds,)
        Distance of the residual of each hold from what those of all others predict [standard errors].
    shared : ndarray (holds,)
        Part of the error of each hold that it shares with others [N m, 1 sigma].
    """

    chi2: float
    p: float
    apart: Array
    shared: Array

    @property
    def agrees(self) -> bool:
        """Whether chance explains the differences, by `criteria.DRAG_CHANCE`."""
        return self.p >= DRAG_CHANCE


def agreement(estimates: Sequence[Estimate], place: int, bench: Bench | None = None) -> Agreement:
    """Return the agreement of an actuator: coil x, coil y or motor.

    Without the bench, or the sensitivities of the model's parameters, which a message lacks, the errors of the holds
    count as independent.
    """
    own = np.array([e.residual[place] for e in estimates])
    total = np.array([e.residual_std[place] for e in estimates])
    if bench is None or not all(len(e.changes) for e in estimates):
        chi2 = float(np.sum((own / total) ** 2))
        return Agreement(chi2, float(chdtrc(len(own), chi2)), own / total, np.zeros(len(own)))
    time = np.array([e.stamp_ns * 1e-9 - 0.5 * e.duration for e in estimates])
    drift = bench.value(CONSTANTS[place]) * bench.value(f"{READINGS_OF[place]}_drift")
    changes = np.array([e.changes[:, place] for e in estimates])
    common = (
        drift**2 * np.exp(-np.abs(time[:, None] - time) / bench.value("drift_time")) + changes @ changes.T
    )
    alone = np.array([e.measured_torque_std[place] ** 2 - drift**2 for e in estimates])
    simulated = np.array([e.simulated_torque[place] for e in estimates])
    floor = (torque_scale(bench) * MODEL_ABSOLUTE) ** 2 + (MODEL_RELATIVE * simulated) ** 2
    inverse = np.linalg.inv(common + np.diag(np.maximum(alone, 0.0) + floor))
    left = inverse @ own
    chi2 = float(own @ left)
    return Agreement(
        chi2,
        float(chdtrc(len(own), chi2)),
        np.asarray(left / np.sqrt(np.diag(inverse))),
        np.sqrt(np.diag(common)),
    )
