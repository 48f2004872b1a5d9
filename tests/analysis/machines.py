"""Recordings of simulated machines for the tests of the analysis: made by the simulation, handed over as files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import gyrowheel as gw
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_control.loops.closed_loop import simulate
from gyrowheel_control.loops.controller import Gains
from gyrowheel_control.plans.plan import Plan
from gyrowheel_recording.bags import Recording, write_run
from gyrowheel_sim import blind
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import EffectValues
from gyrowheel_sim.environment import to_json
from gyrowheel_sim.plant.scenario import Scenario

BENCH = Bench.load()


def hidden_machine(seed: int, effects: EffectValues) -> Scenario:
    """Return a machine whose parameters are drawn within the stated uncertainties, with the given effects."""
    drawn = blind.draw(BENCH, seed, kinds=("none",))
    return Scenario(values=drawn.values, effects=effects, noise_seed=seed)


def record(
    folder: Path,
    name: str,
    scenario: Scenario,
    plan: str | Plan,
    *,
    noise_seed: int | None = None,
    gains: Gains | None = None,
    bench: Bench = BENCH,
) -> Recording:
    """Run a plan on a machine and return the recording as read from disk."""
    plan = Plan.load(plan) if isinstance(plan, str) else plan
    seed = scenario.noise_seed if noise_seed is None else noise_seed
    run = simulate(bench, replace(scenario, noise_seed=seed), plan, gains=gains)
    write_run(
        folder / name,
        run.measurement,
        run.command,
        run.setpoints,
        to_json(run.environment),
        bench.describe(),
        sample_period=bench.sample_period,
    )
    return Recording.open(folder / name)


def assert_same_means(own: Windows, other: Windows) -> None:
    """Check that two reductions of one motion have the same windows, and means that agree within their noise."""
    assert len(own) == len(other)
    n = np.sqrt(other.samples)
    for name, noise in (
        ("mean_tilt", "tilt_noise"),
        ("motor_current", "motor_current_noise"),
        ("motor_voltage", "motor_voltage_noise"),
    ):
        assert np.all(np.abs(getattr(own, name) - getattr(other, name)) < other.noise(noise) / n)


def hidden_law(formula: str, plan: str, folder: Path) -> tuple[Path, Path]:
    """Return two recordings of a machine with a user-defined law, by a plan and by plan check."""
    law = gw.own_effect(formula, name="hidden")
    for name, seed in ((plan, 31), ("check", 32)):
        gw.simulate(name, effects=[law], machine=31, seed=seed, folder=folder / name)
    return folder / plan, folder / "check"


def found_in(formula: str, plan: str, folder: Path) -> gw.Diagnosis:
    """Return the diagnosis of a recording of a machine with a user-defined law, with the other one to validate."""
    fit, check = hidden_law(formula, plan, folder)
    return gw.diagnose(fit, gw.Model(), validate=check)
