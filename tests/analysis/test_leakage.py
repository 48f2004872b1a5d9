"""Noise of torques within a revolution: motion at other frequencies leaks into windows of few revolutions."""

from __future__ import annotations

import numpy as np

import gyrowheel as gw
from gyrowheel_analysis.channels import LISTED
from gyrowheel_analysis.fitting.preparation import prepare
from gyrowheel_analysis.residuals.error_table import channel_values

#: Fast cones at a slow speed: windows of four revolutions.
PLAN = """\
schema: 1
name: short_windows
hold_s: 1.5
tilt_limit_deg: 3.6
segments:
  - {label: hold, spin_rpm: 1500, tilt_deg: [[0, 0], [3, 0], [0, 3]]}
  - {label: cones, cone_radius_deg: 3.6, cone_period_s: 2.0, cone_turns: 6}
"""


def test_short_windows_have_the_noise_that_the_leakage_adds() -> None:
    recording = gw.simulate(PLAN, machine=11, seed=11)
    prepared = prepare([recording.data], gw.Model().details)
    problem = prepared.problem
    fit = problem.fit(())
    white = problem.noise.whiten(fit.residual)
    windows = problem.balances[0].windows
    short = windows.duration * windows.mean_spin < 2.0 * np.pi * 5.0
    assert short.sum() > 40
    for name in ("tilt_1n", "tilt_2n"):
        own = np.concatenate(
            [channel_values(problem.balances, white, row)[short] for row in LISTED[name].rows]
        )
        # without the leakage 2.0 and 1.35 on average
        assert 0.55 < float(np.mean(own**2)) < 1.3
    leak = windows.leakage_variance
    assert np.all(leak[short] > 4.0 * leak[~short].max(axis=0))
