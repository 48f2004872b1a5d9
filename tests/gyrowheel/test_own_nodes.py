"""Nodes of one's own in the place of those of the bench: the code of the pages, as it stands there."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel_control.plans.plan import Plan

from ..domains import next_domain
from .helpers import SHORT_PLAN, write
from .test_up import COMMAND

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.mark.graph
def test_the_controller_of_the_page_holds_the_bench_through_a_plan(tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (DOCS / "your_controller.md").read_text(), re.DOTALL)
    assert len(code.splitlines()) <= 40
    (tmp_path / "mine.py").write_text(code)
    domain = str(next_domain())
    mine = subprocess.Popen(
        [sys.executable, tmp_path / "mine.py"], env=os.environ | {"ROS_DOMAIN_ID": domain}
    )
    try:
        plan = write(tmp_path / "plan.yaml", SHORT_PLAN)
        options = [
            "--plan",
            plan,
            "--record",
            tmp_path / "run",
            "--without",
            "controller",
            "--domain",
            domain,
        ]
        done = subprocess.run(
            [*COMMAND, "up", *map(str, options)], capture_output=True, text=True, check=False
        )
    finally:
        mine.terminate()
        mine.wait(240.0)
    assert done.returncode == 0, done.stderr
    assert "none missing" in done.stdout
    # it is the law of the bench, so the samples are those of the bench
    simulated = gw.simulate(Plan.load(SHORT_PLAN), folder=tmp_path / "simulated")
    recorded = gw.Recording(tmp_path / "run").measurement  # the graph ends with the next tick of its clock
    assert np.array_equal(recorded[: len(simulated.measurement)], simulated.measurement)
