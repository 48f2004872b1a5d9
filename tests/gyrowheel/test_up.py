"""The verb `up`: the graph as a user starts it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gyrowheel_bringup.graph import EXECUTABLES, Graph, GraphError
from gyrowheel_recording.bags import Recording

from ..domains import next_domain
from .helpers import Shell, slow_bench, write
from .test_drag import assert_same, recorded

#: A machine with a learned parameter.
MODEL = """\
schema: 1
bench: gyrowheel
overrides: {coil_constant: 0.021}
"""
#: With an effect of the user's own, which is compiled for the plant and for the whole loop.
OWN = f"""\
{MODEL}effects:
  pull:
    declaration: {{torque: -k*r*z, coefficients: {{k: {{unit: N*m/rad}}}}}}
    k: {{value: 0.03, standard_error: 0.001}}
"""
#: Two holds more than a diagnosis needs, at speeds that are soon reached.
STEADY_PLAN = """\
schema: 1
name: drag
hold_s: 1.3
segments:
  - {spin_rpm: 3500, tilt_deg: [[0, 0], [1, 0], [0, 1], [1, 1]]}
  - {spin_rpm: 3200, tilt_deg: [[1, 1], [0, 1], [1, 0], [0, 0]]}
"""
COMMAND = [sys.executable, "-c", "from gyrowheel.cli.app import main; main()"]

pytestmark = pytest.mark.graph


@pytest.mark.slow
@pytest.mark.parametrize(
    "truth", [pytest.param(MODEL, id="known"), pytest.param(OWN, id="own", marks=pytest.mark.study)]
)
def test_a_bench_that_runs_gives_the_samples_of_simulate_is_diagnosed_and_may_end_early(
    truth: str, gyrowheel: Shell, tmp_path: Path
):
    plan = write(tmp_path / "plan.yaml", STEADY_PLAN)
    bench = slow_bench(tmp_path)
    model = write(tmp_path / "model.yaml", truth.replace("bench: gyrowheel", f"bench: {bench}"))
    machine = ["--plan", plan, "--bench", bench, "--effect", "windage", "--truth", model]
    machine += ["--machine", 3, "--seed", 8]
    options = [
        "--record",
        "run",
        "--diagnose",
        "--model",
        "model.yaml",
        "--until",
        "settled",
        "--json",
        "up.json",
    ]
    done = subprocess.run(
        [*COMMAND, "up", *map(str, machine), *options],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"ROS_DOMAIN_ID": str(next_domain()), "COLUMNS": "80"},
    )
    assert done.returncode == 0, done.stderr
    assert "times real time" in done.stdout
    assert f"recording: {tmp_path / 'run'}" in done.stdout
    assert all(f"{name} " in done.stderr for name in EXECUTABLES)
    result = json.loads((tmp_path / "up.json").read_text())
    assert set(result["processes"]) == set(EXECUTABLES)
    assert result["samples"] > result["simulated_seconds"] / 0.001
    looks = [line for line in done.stderr.splitlines() if " windows " in line]
    assert looks
    assert "windage" in looks[-1]
    assert "gyrowheel" in done.stdout.rpartition("Next")[2]  # the page of the last look
    graph = Recording.open(tmp_path / "run")
    assert graph.integrity().complete
    if early := "plan drag: ended at" in done.stderr:
        last = graph.setpoint["stamp_ns"][-1]  # there it was ended
    else:  # before it was settled, the bench had run the whole plan
        assert "whole" in looks[-1]
    gyrowheel.good("simulate", *machine, "-o", tmp_path / "simulated")
    simulated = Recording.open(tmp_path / "simulated")
    count = int((graph.measurement["stamp_ns"] < last).sum()) if early else len(simulated.measurement)
    assert np.array_equal(graph.measurement[:count], simulated.measurement[:count])
    assert graph.bench_text == simulated.bench_text
    assert graph.environment == simulated.environment


@pytest.mark.study  # tests/bringup/test_replay.py and test_drag.py compare them
def test_up_drag_and_replay_report_the_same_holds(gyrowheel: Shell, tmp_path: Path):
    plan = write(
        tmp_path / "plan.yaml",
        "schema: 1\nname: holds\nhold_s: 1.4\nsegments: [{spin_rpm: 3500, tilt_deg: [[0, 0], [2, 0]]}]\n",
    )
    model = write(tmp_path / "model.yaml", OWN.replace("0.021", "{value: 0.021, standard_error: 0.0002}"))

    def run(*arguments: object) -> str:
        done = subprocess.run(
            [*COMMAND, *map(str, arguments)],
            capture_output=True,
            text=True,
            env=os.environ | {"ROS_DOMAIN_ID": str(next_domain()), "COLUMNS": "80"},
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    recording = tmp_path / "run"
    options = ["--plan", plan, "--model", model, "--effect", "windage:w=0.0013", "--record", recording]
    shown = run("up", *options, "--json", tmp_path / "up.json")
    table = run("drag", recording, "--model", model)
    # the same tables, in the same lines
    assert table.strip() in shown
    assert max(map(len, table.splitlines())) <= 80
    for place in ("coil x", "coil y", "motor"):
        assert f"Drag estimates, {place}" in shown
    said = gyrowheel.good("drag", recording, "--model", model, "--json", "-").json["recordings"][0]["holds"]
    assert_same(recorded(recording), said)
    assert [row["segment"] for row in said] == [0, 1]
    # 1.3 mN m of windage that the believed model lacks
    for row in said:
        error = np.hypot(row["measured_torque_std"][2], row["constants_std"][2])
        assert abs(row["residual"][2] - 1.3e-3) < 3.0 * error
    shown_live = [
        row for row in json.loads((tmp_path / "up.json").read_text())["drag_estimates"] if row["settled"]
    ]
    assert_same(recorded(recording), shown_live)
    # and again on replay, to the bit
    run("replay", recording, "--fast", "--estimate", "--model", model, "--json", tmp_path / "replay.json")
    again = json.loads((tmp_path / "replay.json").read_text())["drag_estimates"]
    assert again == json.loads((tmp_path / "up.json").read_text())["drag_estimates"]


def test_a_failed_node_is_exit_3_with_its_last_output(gyrowheel: Shell, monkeypatch: pytest.MonkeyPatch):
    def fail(graph: Graph) -> None:
        raise GraphError(
            "node_died", "plant: killed by SIGKILL", node="plant", report="plant: killed\nlast words"
        )

    monkeypatch.setattr(Graph, "__enter__", fail)
    result = gyrowheel("up", "--plan", "check")
    assert result.code == 3
    assert result.err.endswith("error: plant: killed by SIGKILL\nplant: killed\nlast words\n")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--diagnose"], "--diagnose: needs --record and --model"),
        (["--diagnose", "--record", "run"], "--diagnose: needs --record and --model"),
        (["--until", "settled"], "--until: needs --diagnose"),
        (
            ["--diagnose", "--record", "run", "--model", "m.yaml", "--until", "settled"],
            "--until: needs --plan",
        ),
    ],
)
def test_options_of_a_diagnosis_that_do_not_go_together_are_refused(
    options: list[str], words: str, gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    refused = gyrowheel("up", *options)
    assert refused.code == 2
    assert words in refused.err
    assert not list(tmp_path.iterdir())
