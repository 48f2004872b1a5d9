"""The whole loop on another bench: a machine of other sizes, speeds, gas and sample period, by the same commands."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from gyrowheel.diagnosis.page import following
from gyrowheel_control.plans.plan import Plan
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import registry
from gyrowheel_sim.effects.registry import for_bench

from ..domains import next_domain
from .findings import AMBIGUOUS
from .helpers import Shell, write
from .test_up import COMMAND

MACHINE = ["--bench", "dtg", "--machine", 12]
#: Torques of this bench are a tenth of those of the default one, and so is its noise.
FLOOR = 1.2e-6


@pytest.mark.study  # test_your_bench.py walks the same way
@pytest.mark.slow
def test_a_hidden_effect_is_named_added_and_proven(gyrowheel: Shell, tmp_path: Path):
    for plan in ("dtg_quick", "dtg_check"):
        gyrowheel.good("simulate", "--plan", plan, "-o", tmp_path / plan, *MACHINE, "--effect", "aero_cross")
    fit, unused, model = tmp_path / "dtg_quick", tmp_path / "dtg_check", tmp_path / "wheel.yaml"
    gyrowheel.good("model", "new", "--model", model, "--bench", "dtg")
    assert "dtg" in model.read_text()
    shown = gyrowheel.good("compare", fit, "--model", model).out
    assert "µN·m" in shown
    assert "…" not in shown, "a column is cut off"
    worst = gyrowheel.good("compare", fit, "--model", model, "--json", "-").json["channels"]
    assert worst["tilt_x"]["chi2_per_n"] > 10.0
    found = gyrowheel.good("diagnose", fit, "--model", model, "--json", "-").json
    assert found["verdict"] == "effect"
    (effect,) = found["effects"]
    assert effect["name"] == "aero_cross"
    truth = for_bench(registry()["aero_cross"], Bench.load("dtg")).defaults()
    for name, estimate in effect["coefficients"].items():
        assert abs(estimate["value"] - truth[name]) < 4.0 * estimate["standard_error"]
    options = ["--model", model, "--fit", fit, "--validate", unused, "--json", "-"]
    error = gyrowheel.good("model", "add", "aero_cross", *options).json["error"]
    assert error["validation_before"]["chi2_per_n"] > 10.0
    assert error["validation_after"]["chi2_per_n"] < 1.7
    # the floor is that of this bench: four of its own noise, not the accuracy claimed for the other
    assert error["noise_floor"]["rms"]["tilt_x"] < FLOOR
    assert error["validation_after"]["rms"]["tilt_x"] < FLOOR
    again = gyrowheel.good("diagnose", fit, "--model", model, "--json", "-").json
    assert again["verdict"] == "nothing_missing"
    # and the machine of the model is on its own bench, without being told
    gyrowheel.good("simulate", "--plan", "dtg_check", "-o", tmp_path / "again", "--truth", model)
    assert Recording.open(tmp_path / "again").bench_text == Recording.open(unused).bench_text


@pytest.mark.parametrize("machine", [21, pytest.param(22, marks=pytest.mark.study)])
@pytest.mark.slow
def test_nothing_is_missing_without_a_hidden_effect(gyrowheel: Shell, tmp_path: Path, machine: int):
    model, run = tmp_path / "wheel.yaml", tmp_path / "run"
    gyrowheel.good("model", "new", "--model", model, "--bench", "dtg")
    options = ["--bench", "dtg", "--machine", machine, "--seed", machine]
    gyrowheel.good("simulate", "--plan", "dtg_quick", "-o", run, *options)
    found = gyrowheel.good("diagnose", run, "--model", model, "--json", "-").json
    assert found["verdict"] == "nothing_missing"
    assert 0.5 < found["error"]["before"]["chi2_per_n"] < 1.6
    # limits are told for the sizes of this bench
    usual = {limit["effect"] for limit in found["detection_limits"] if limit["visible"]}
    assert {"aero_cross", "windage", "flexure_damping", "bearing_coulomb"} <= usual


@pytest.mark.slow
def test_the_next_test_is_one_that_the_bench_can_run(gyrowheel: Shell, tmp_path: Path):
    """Gravity cannot be told from stiffness until the rig is turned over: by the bench's own plan."""
    plan = write(
        tmp_path / "plan.yaml",
        "schema: 1\nname: few\nhold_s: 1.5\nsegments:\n"
        "  - {spin_rpm: [6000, 4000, 2500], tilt_deg: [[0, 0], [1.5, 0], [0, 1.5], [-1.5, 0]]}\n",
    )
    run, model = tmp_path / "run", tmp_path / "wheel.yaml"
    gyrowheel.good("simulate", "--plan", plan, "-o", run, *MACHINE)
    gyrowheel.good("model", "new", "--model", model, "--bench", "dtg")
    found = gyrowheel.good("diagnose", run, "--model", model, "--json", "-").json
    assert found["next_test"]["plan"].startswith("dtg_")
    assert found["next_test"]["plan"] in Plan.shipped()
    command = following(AMBIGUOUS, [run], [], model, "dtg")
    assert command is not None
    assert "--bench dtg" in command


def test_a_plan_name_selects_the_plan_of_the_bench(gyrowheel: Shell):
    own = gyrowheel.good("plans", "quick", "--bench", "dtg", "--json", "-").json
    assert own == gyrowheel.good("plans", "dtg_quick", "--json", "-").json
    listed = gyrowheel.good("plans", "--bench", "dtg", "--json", "-").json["plans"]
    assert {"dtg_quick", "survey", "yaw"} <= {plan["name"] for plan in listed}
    assert all(s["spin_rate"] > 200.0 for plan in listed for s in plan["segments"])


def test_a_bench_other_than_that_of_the_model_is_refused(gyrowheel: Shell, tmp_path: Path):
    model = tmp_path / "wheel.yaml"
    gyrowheel.good("model", "new", "--model", model, "--bench", "dtg")
    options = ["--plan", "quick", "-o", tmp_path / "run", "--model", model, "--bench", "gyrowheel"]
    result = gyrowheel("simulate", *options)
    assert result.code == 2
    assert "bench: gyrowheel is not the bench of" in result.err


def test_effects_are_shown_in_the_sizes_of_a_bench(gyrowheel: Shell):
    here, there = (
        gyrowheel.good("effects", "windage", "--bench", bench, "--json", "-").json["coefficients"]["w"][
            "usual"
        ]
        for bench in Bench.shipped()
    )
    assert here == [0.0008, 0.0013]
    assert there[1] < 0.2 * here[0]
    assert "dtg" in gyrowheel("bench", "--bench", "nosuch").err
    assert gyrowheel.good("bench", "--bench", "dtg").out.startswith("dtg  dry tuned gyroscope")


@pytest.mark.study  # the other bench has no code of its own in the graph
@pytest.mark.graph
def test_the_graph_runs_it_and_gives_the_same_samples(gyrowheel: Shell, tmp_path: Path):
    plan = write(
        tmp_path / "plan.yaml",
        "schema: 1\nname: short\nhold_s: 0.3\nsegments:\n  - {spin_rpm: 5000, tilt_deg: [[0, 0], [0.5, 0]]}\n",
    )
    options = ["--plan", plan, "--effect", "windage", *MACHINE, "--seed", 5]
    done = subprocess.run(
        [*COMMAND, "up", *map(str, options), "--record", str(tmp_path / "up")],
        capture_output=True,
        text=True,
        env=os.environ | {"ROS_DOMAIN_ID": str(next_domain())},
    )
    assert done.returncode == 0, done.stderr
    gyrowheel.good("simulate", *options, "-o", tmp_path / "simulated")
    graphed, simulated = Recording.open(tmp_path / "up"), Recording.open(tmp_path / "simulated")
    assert graphed.integrity().complete
    count = len(simulated.measurement)
    assert np.array_equal(graphed.measurement[:count], simulated.measurement)
    assert json.loads(graphed.bench_text)["name"] == "dtg"
