"""The verb `up`: the graph as a user starts it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gyrowheel_analysis.recording import Recording
from gyrowheel_bringup.graph import EXECUTABLES, Graph, GraphError

from ..domains import next_domain
from .helpers import SHORT_PLAN, Shell, write

#: A machine with a learned parameter and an effect that its own file declares.
MODEL = """\
schema: 1
bench: gyrowheel
overrides: {coil_constant: 0.021}
effects:
  pull:
    declaration: {torque: -k*r*z, coefficients: {k: {unit: N*m/rad}}}
    k: {value: 0.03, standard_error: 0.001}
"""
COMMAND = [sys.executable, "-c", "from gyrowheel.cli import main; main()"]

pytestmark = [pytest.mark.graph, pytest.mark.timeout(120)]


def test_up_and_simulate_give_the_same_samples(gyrowheel: Shell, tmp_path: Path):
    plan = write(tmp_path / "plan.yaml", SHORT_PLAN)
    model = write(tmp_path / "model.yaml", MODEL)
    machine = ["--plan", plan, "--effect", "aero_restoring", "--truth", model, "--machine", 3, "--seed", 8]
    shown = subprocess.run(
        [
            *COMMAND,
            "up",
            *map(str, machine),
            "--record",
            str(tmp_path / "up"),
            "--json",
            str(tmp_path / "up.json"),
        ],
        capture_output=True,
        text=True,
        env=os.environ | {"ROS_DOMAIN_ID": str(next_domain())},
    )
    assert shown.returncode == 0, shown.stderr
    assert "times real time" in shown.stdout
    assert f"recording: {tmp_path / 'up'}" in shown.stdout
    assert all(f"{name} " in shown.stderr for name in EXECUTABLES)
    result = json.loads((tmp_path / "up.json").read_text())
    assert set(result["processes"]) == set(EXECUTABLES)
    assert result["samples"] > result["simulated_seconds"] / 0.0005
    gyrowheel.good("simulate", *machine, "-o", tmp_path / "simulated")
    graph, simulated = Recording.open(tmp_path / "up"), Recording.open(tmp_path / "simulated")
    assert graph.integrity().complete
    count = len(simulated.measurement)
    assert np.array_equal(graph.measurement[:count], simulated.measurement)
    assert graph.bench_text == simulated.bench_text
    assert graph.environment == simulated.environment


def test_a_node_that_fails_is_exit_3_with_its_last_words(gyrowheel: Shell, monkeypatch: pytest.MonkeyPatch):
    def fail(graph: Graph) -> None:
        raise GraphError(
            "node_died", "plant: killed by SIGKILL", node="plant", report="plant: killed\nlast words"
        )

    monkeypatch.setattr(Graph, "__enter__", fail)
    result = gyrowheel("up", "--plan", "check")
    assert result.code == 3
    assert result.err.endswith("error: plant: killed by SIGKILL\nplant: killed\nlast words\n")
