"""An investigation on the real graph: two look-alikes, the test that separates them, the answer."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from gyrowheel_analysis.model import Model
from gyrowheel_recording.bags import Recording

from ..domains import next_domain
from ..gyrowheel.helpers import DRAG_PLAN

COMMAND = [sys.executable, "-c", "from gyrowheel.cli.app import main; main()"]


def investigated(folder: Path, *arguments: str) -> tuple[dict[str, Any], str]:
    """Return what `investigate` found on the graph of nodes, and what it told."""
    Model.new().save(folder / "model.yaml")
    done = subprocess.run(
        [*COMMAND, "investigate", "--model", "model.yaml", "-o", "run", "--json", "out.json", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        env=os.environ | {"ROS_DOMAIN_ID": str(next_domain())},
    )
    assert done.returncode == 0, done.stderr
    result = json.loads((folder / "out.json").read_text())
    for step in result["steps"]:
        for path in step["recordings"]:
            assert Recording.open(folder / path).integrity().complete
    return result, done.stdout


@pytest.mark.study  # tests/gyrowheel/test_investigate.py goes the same way without nodes
@pytest.mark.graph
def test_an_investigation_records_with_the_nodes_and_names_what_is_hidden(tmp_path: Path):
    """The loop that the simulation goes, too; the recordings are those of the running bench."""
    (tmp_path / "plan.yaml").write_text(DRAG_PLAN, encoding="utf-8")
    hidden = ["--effect", "windage:w=0.0013", "--machine", "4"]
    result, told = investigated(tmp_path, "--plan", "plan.yaml", "--budget", "1", *hidden)
    assert result["named"] == ["windage"]
    assert result["settled"] is True
    assert "windage" in told


@pytest.mark.graph
@pytest.mark.study
def test_the_papers_own_plans_are_ambiguous_and_the_graph_settles_it(tmp_path: Path):
    """As the paper analysed it, by averages: torque of the air and inertia of the gimbal are the same."""
    gimbal = {"gimbal_inertia_x": 8e-6, "gimbal_inertia_y": 8e-6, "gimbal_inertia_z": 1.4e-5}
    key = {"values": {name: 0.35 * value for name, value in gimbal.items()}, "effects": {}}
    (tmp_path / "key.json").write_text(json.dumps(key), encoding="utf-8")
    # holds of 0.8 s in place of the paper's two: they show the same, with more noise
    plans = [
        "--plan",
        "paper_tilt@hold_s=0.8",
        "--plan",
        "paper_speed@hold_s=0.8",
        "--averages",
        "--budget",
        "6",
    ]
    result, told = investigated(tmp_path, *plans, "--blind", "key.json")
    first, second, *_ = result["steps"]
    (open_,) = first["effects"]
    assert first["verdict"] == "ambiguous"
    assert {open_["name"], *open_["ties"]} >= {"aero_restoring", "gimbal_inertia_error"}
    assert second["plans"] == ["check@air_density_ratio=0.3"]  # air_density takes three times as long
    assert "aero_restoring" in second["separated"]
    assert result["settled"] is True
    assert result["named"] == ["gimbal_inertia_error"]
    assert result["minutes"] <= 6.0
    assert "verdict: ambiguous → effect" in told
