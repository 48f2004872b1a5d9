"""An investigation on the real graph: two look-alikes, the test that separates them, the answer."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from gyrowheel_analysis.model import Model
from gyrowheel_analysis.recording import Recording

from .helpers import next_domain

COMMAND = [sys.executable, "-c", "from gyrowheel_bringup.cli import main; main()"]


@pytest.mark.graph
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_papers_tilt_sweep_is_ambiguous_and_the_graph_settles_it(tmp_path: Path):
    Model.new().save(tmp_path / "model.yaml")
    arguments = ["investigate", "--model", "model.yaml", "--plan", "paper_tilt", "--budget", "6", "-o", "run"]
    arguments += ["--effect", "aero_restoring:k=0.04", "--machine", "5", "--json", "out.json"]
    done = subprocess.run(
        [*COMMAND, *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env=os.environ | {"ROS_DOMAIN_ID": str(next_domain())},
    )
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "out.json").read_text())
    first, *others = result["steps"]
    # at one speed a restoring torque of the air acts as a stiffness does, and as an offset of the centre of gravity
    (open_,) = first["effects"]
    assert first["verdict"] == "ambiguous"
    assert {open_["name"], *open_["ties"]} >= {"aero_restoring", "stiffness_error", "gravity_offset"}
    assert others
    assert result["settled"] is True
    assert result["named"] == ["aero_restoring"]
    assert result["minutes"] <= 6.0
    assert "ruled out" in done.stdout
    for step in result["steps"]:
        for path in step["recordings"]:
            assert Recording.open(tmp_path / path).integrity().complete
