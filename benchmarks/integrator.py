"""The false torque of the integrator: a constant tilt, at the default step and at a much finer one."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.ours import bench, sampled_loop
from benchmarks.results import Bar, Figure, Report
from gyrowheel_core.units import DEG, RPM

TILT, SPIN = 5.0 * DEG, 3500.0 * RPM
SECONDS = 3.0
FINE = 16
#: At 3500 rpm seven revolutions are 240 samples: the ripple cancels in their mean.
MEAN_OVER = 4 * 240


def mean_torque(substeps: int) -> complex:
    """Return the torque with which the closed loop holds the tilt, averaged over whole revolutions [N m].

    The integral action of the loop keeps the mean reading exactly at the reference, so a false torque of the integrator
    appears with the opposite sign in the mean coil torque.

    Parameters
    ----------
    substeps : int
        Steps of the plant per sample.
    """
    mean = sampled_loop(TILT, SPIN, SECONDS, substeps)[-MEAN_OVER:].mean(axis=0)
    return bench().value("coil_constant") * complex(mean[0], mean[1])


def measure(progress: Callable[[float], None]) -> list[Report]:
    """Measure the false torque of the default step."""
    false = {}
    truth = mean_torque(FINE)
    for part, substeps in enumerate((1, 2), 1):
        false[substeps] = abs(mean_torque(substeps) - truth)
        progress(part / 2.0)
    return [
        Report(
            "Integrator",
            [Figure("false torque", false[1], "N·m", bar=Bar("<", 1e-6))],
            notes=[
                f"One step a sample, held at {TILT / DEG:g}° and {SPIN / RPM:.0f} rpm in the closed loop, whose coils "
                f"then give {abs(truth) * 1e3:.3f} mN·m on average; against {FINE} steps a sample. Two steps a sample: "
                f"{false[2]:.1e} N·m.",
            ],
        )
    ]
