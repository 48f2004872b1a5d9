"""What an effect does to the torque balance: the analysis against the full simulation."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from gyrowheel_analysis.balance.balance import ActiveEffect, Balance
from gyrowheel_analysis.channels import ALL_ROWS
from gyrowheel_analysis.fitting.noise import Noise
from gyrowheel_analysis.reduction.quality import READING_NOISES
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.segmentation import reduce
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.readings import Readings
from gyrowheel_sim.effects import Coefficient, Effect, physical

from .helpers import BENCH, quiet_run

SPEED_STEPS = """
schema: 1
name: speed_steps
hold_s: 7
segments:
  - {spin_rpm: [1500, 3500, 1500, 3500, 2500], tilt_deg: [0, 0]}
"""
#: Plans on which an effect shows, where the quick one does not show it well.
PLANS = {"winding_heating": SPEED_STEPS, "earth_rate": "yaw"}


@functools.cache
def simulated(plan: str, name: str | None, values: tuple[tuple[str, float], ...] = ()) -> Balance:
    """Return the balance of a plan run without noise on a machine with an effect."""
    run = quiet_run(Plan.load(plan), {name: dict(values)} if name else {})
    time = np.arange(len(run.measurement), dtype=np.float64) * BENCH.sample_period
    samples = Samples(
        time, Readings(run.measurement), run.setpoints["stamp_ns"] * 1e-9, run.setpoints, run.environment
    )
    windows = reduce(samples, BENCH)
    # the readings of a simulation without noise have less of it than a recording is believed to have
    stated = np.tile([BENCH.value(noise) for noise in READING_NOISES], (len(windows), 1))
    return Balance(replace(windows, reading_noise=stated), BENCH, clean=False)


@functools.cache
def deviations(plan: str) -> np.ndarray:
    """Return the standard deviation of every row of a plan, as the analysis takes it."""
    balance = simulated(plan, None)
    return Noise.stated([balance], [balance.predicted(BENCH.values(), [])]).deviation()


@functools.cache
def met(plan: str) -> np.ndarray:
    """Return which rows the balance of a machine without any effect meets to a tenth of the noise.

    The others are those soon after a change of speed, which settles faster than a polynomial can follow, and some of
    quick cones.
    """
    rows = np.abs(residual(simulated(plan, None))) < 0.1 * deviations(plan)
    assert rows.mean() > 0.85
    return rows


def residual(balance: Balance) -> np.ndarray:
    """Return the rows measured minus predicted by a model without any effect."""
    return balance.measured - balance.predicted(BENCH.values(), [])


def cosine(a: np.ndarray, b: np.ndarray) -> float:
    return float(a @ b / math.sqrt((a @ a) * (b @ b)))


#: Channels of two components.
PAIRS = [(name, f"{name[:-1]}y") for name in ALL_ROWS if name.endswith("_x")]
COEFFICIENTS = [(effect, c) for effect in physical().values() for c in effect.coefficients]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "coefficient"),
    [
        pytest.param(
            effect,
            c,
            id=f"{effect.name}.{c.name}",
            # the other component of a pair follows by a turn of the case
            marks=[pytest.mark.study] if c.name.endswith("_y") else [],
        )
        for effect, c in COEFFICIENTS
    ],
)
def test_regressor_is_what_the_simulation_shows(effect: Effect, coefficient: Coefficient) -> None:
    """What changes in the rows when a coefficient changes, by the balance's finite difference and by full simulation.

    An amplitude goes from zero to its usual size, alone; a shape from its usual value by its uncertainty, with the
    amplitudes at their usual size.
    """
    plan = PLANS.get(effect.name, "quick")
    if coefficient.shape is None:
        start = effect.nulls()
        stop = {**start, coefficient.name: coefficient.default}
        before = simulated(plan, None)
    else:
        start = effect.defaults()
        stop = {**start, coefficient.name: coefficient.shape + coefficient.shape_uncertainty}
        before = simulated(plan, effect.name, tuple(start.items()))
    after, sigma = simulated(plan, effect.name, tuple(stop.items())), deviations(plan)
    shown = (residual(after) - residual(before)) / sigma

    def predicted(values: Mapping[str, float]) -> np.ndarray:
        return after.predicted(BENCH.values(), [ActiveEffect(effect, values)]) / sigma

    # finite difference about the start, on the recording that holds the effect, as the analysis takes it
    step = 1e-3 * (stop[coefficient.name] - start[coefficient.name])
    near = {**start, coefficient.name: start[coefficient.name] + step}
    regressor = (predicted(near) - predicted(start)) / 1e-3
    good = met(plan)
    assert cosine(shown[good], regressor[good]) >= 0.999
    # an effect of the usual size is also predicted in size: to a fifth of the noise of a window, a hundredth of itself
    difference = predicted(stop) - predicted(start)
    for x, y in (*PAIRS, ("spin", "spin"), ("motor_voltage", "motor_voltage")):
        rows = [before.row(x), before.row(y)]
        size = max(np.abs(difference[own]).max() for own in rows)
        error = max(np.abs(shown - difference)[own][good[own]].max() for own in rows)
        assert error <= 0.01 * size + 0.2, x


def test_model_without_effects_agrees_with_the_simulation():
    """What is left of the rows when nothing is missing: holds within 3.5e-6 N m, cones within 3e-5 N m."""
    balance = simulated("quick", None)
    left, moving = residual(balance), balance.windows.moving
    for name in ("tilt_x", "tilt_y"):
        rows = np.abs(left[balance.row(name)])
        assert rows[~moving].max() < 3.5e-6
        assert rows[moving].max() < 3e-5
    assert np.abs(left[balance.row("spin")]).max() < 3e-5
