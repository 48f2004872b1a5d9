"""The spin loop as a phase-locked loop: it settles, keeps its phase, and lets nothing of 2N through."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrowheel_control.loops.closed_loop import Run, simulate
from gyrowheel_control.loops.controller import Controller, Gains
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import RPM
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.instruments import Reading
from gyrowheel_sim.parameter import default_text
from gyrowheel_sim.plant.scenario import Scenario

PI = Bench.load()
PLL = replace(PI, spin_loop="pll")
QUIET = {name: 0.0 for name in PI.values() if name.endswith(("_noise", "_drift"))}
PERIOD = PI.sample_period


def run(
    bench: Bench, plan: Plan, *, values: dict[str, float] | None = None, gains: Gains | None = None
) -> Run:
    return simulate(bench, Scenario(values={**QUIET, **(values or {})}), plan, gains=gains)


def steps(hold_s: float = 3.0) -> Plan:
    return Plan.load(
        f"schema: 1\nname: steps\nhold_s: {hold_s}\nsegments:\n"
        "  - {spin_rpm: [1000, 2500, 4000, 1500], tilt_deg: [[2, 0]]}\n"
    )


@pytest.mark.parametrize("bench", [PI, PLL], ids=["pi", "pll"])
def test_the_spin_loop_settles_at_every_speed_with_a_wrong_bearing(bench: Bench) -> None:
    """Friction 40 % off, which the feed-forward does not know."""
    plan = steps()
    rate = run(bench, plan, values={"bearing_coulomb": 7e-4, "bearing_viscous": 1.4e-6}).measurement[
        :, Reading.spin_rate
    ]
    for segment in plan.segments:
        last = rate[round((segment.end - 0.5) / PERIOD) : round(segment.end / PERIOD)]
        assert np.mean(last) == pytest.approx(segment.spin, abs=0.5 * RPM)


def test_the_phase_is_kept_over_all_turns() -> None:
    """From one hold to the next the shaft turns by the integral of the wanted speed: no turn is lost."""
    plan = steps()
    angle = np.unwrap(run(PLL, plan).measurement[:, Reading.spin_angle])
    setpoints = plan.setpoints()
    spacing = np.diff(setpoints["stamp_ns"], append=round(plan.duration * 1e9)) * 1e-9
    steps_ = (setpoints["spin_rate"] + 0.5 * setpoints["spin_acceleration"] * spacing) * spacing
    wanted = np.concatenate([[0.0], np.cumsum(steps_)])
    # ends of the first and the third hold; sample k is at k periods
    for number in (2, 3):
        first, last = plan.segments[0].end, plan.segments[number].end
        turned = angle[round(last / PERIOD) - 1] - angle[round(first / PERIOD) - 1]
        asked = np.interp(
            [first - PERIOD, last - PERIOD], np.append(setpoints["stamp_ns"] * 1e-9, plan.duration), wanted
        )
        assert turned == pytest.approx(asked[1] - asked[0], abs=0.1)


def test_2n_does_not_pass_the_spin_loop() -> None:
    """At 5 deg the shaft ripples at 2N; the voltages of both loops show no more of it than of their neighbourhood."""
    plan = Plan.load(
        "schema: 1\nname: h\nhold_s: 4\nsegments:\n  - {spin_rpm: 3500, tilt_deg: [[0, 0], [5, 0]]}\n"
    )
    found = {}
    for name, bench, gains in (
        ("pi", PI, None),
        ("pll", PLL, None),
        ("open", PLL, Gains(spin_lowpass=1000.0)),
    ):
        made = run(bench, plan, gains=gains)
        last = slice(-round(2.0 / PERIOD), None)
        angle = made.measurement[last, Reading.spin_angle]
        volts = made.command[last, 2]
        window = np.hanning(len(volts))
        ripple = 2.0 * abs(np.sum((volts - volts.mean()) * window * np.exp(-2j * angle))) / window.sum()
        coil = PI.value("coil_constant") * made.measurement[last, Reading.coil_voltage_y].mean()
        found[name] = (ripple, coil)
    assert found["pll"][0] < 2.0 * found["pi"][0]
    assert found["pll"][0] < 0.02 * found["open"][0]
    # hence no false torque across the tilt, which with 2N let through is larger than the air's
    assert found["pll"][1] == pytest.approx(found["pi"][1], abs=5e-6)
    assert abs(found["open"][1] - found["pi"][1]) > 50e-6


def test_a_controller_that_misses_samples_keeps_the_lock() -> None:
    """Every third sample answered, as in real time on a busy computer: the reference goes on meanwhile."""
    every, missing = Controller(PLL), Controller(PLL)
    rate, answers = 3000.0 * RPM, {}
    for name, controller, stride in (("every", every, 1), ("missing", missing, 3)):
        for k in range(0, 6001, stride):
            sample = [0.0] * 11
            sample[Reading.spin_angle] = (rate * k * PERIOD) % (2.0 * np.pi)
            sample[Reading.spin_rate] = rate
            answers[name] = controller.update(sample, (0.0, 0.0, 0.0, 0.0, rate, 0.0), 0.0)[2]
    assert answers["missing"] == pytest.approx(answers["every"], abs=1e-6)


def test_a_bench_file_names_its_loop() -> None:
    text = default_text()
    assert Bench.from_text(text, origin="b").spin_loop == "pi"
    assert Bench.from_text(text.replace("spin_loop: pi", "spin_loop: pll"), origin="b").spin_loop == "pll"
    without = "\n".join(line for line in text.splitlines() if not line.startswith("controller:"))
    assert Bench.from_text(without, origin="b").spin_loop == "pi"
    with pytest.raises(InputError, match=r"b: controller\.spin_loop: 'fll' is not known; allowed: pi, pll"):
        Bench.from_text(text.replace("spin_loop: pi", "spin_loop: fll"), origin="b")
