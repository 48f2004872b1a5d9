"""User-defined nodes instead of those of the bench: the code of the pages."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel_bringup.graph import Graph
from gyrowheel_control.plans.plan import HOLD, Plan
from gyrowheel_recording.bags import Recording

from ..domains import next_domain
from .helpers import SHORT_PLAN, write
from .test_up import COMMAND

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.mark.graph
@pytest.mark.parametrize("plan", ["short", pytest.param("check", marks=pytest.mark.study)])
def test_the_controller_of_the_page_holds_the_bench_through_a_plan(plan: str, tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (DOCS / "your_controller.md").read_text(), re.DOTALL)
    assert len(code.splitlines()) <= 40
    (tmp_path / "mine.py").write_text(code)
    domain = str(next_domain())
    mine = subprocess.Popen(
        [sys.executable, tmp_path / "mine.py"], env=os.environ | {"ROS_DOMAIN_ID": domain}
    )
    try:
        file = write(tmp_path / "plan.yaml", SHORT_PLAN)
        options = [
            "--plan",
            file if plan == "short" else plan,
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
        ended = mine.wait(240.0)
    assert done.returncode == 0, done.stderr
    assert ended == 0
    assert "none missing" in done.stdout
    # it is the law of the bench, so the samples are those of the bench
    walked = SHORT_PLAN if plan == "short" else plan
    simulated = gw.simulate(Plan.load(walked), folder=tmp_path / "simulated")
    recorded = gw.Recording(tmp_path / "run").measurement  # the graph ends with the next tick of its clock
    assert np.array_equal(recorded[: len(simulated.measurement)], simulated.measurement)


@pytest.mark.study  # a computer with other work is late
@pytest.mark.graph
def test_the_controller_of_the_page_holds_the_bench_in_real_time(tmp_path: Path) -> None:
    """There samples come before the first setpoint, and none of them is waited for."""
    (code,) = re.findall(r"```python\n(.*?)```", (DOCS / "your_controller.md").read_text(), re.DOTALL)
    (tmp_path / "mine.py").write_text(code)
    domain = next_domain()
    mine = subprocess.Popen(
        [sys.executable, tmp_path / "mine.py"], env=os.environ | {"ROS_DOMAIN_ID": str(domain)}
    )
    try:
        with Graph(
            SHORT_PLAN,
            record=tmp_path / "run",
            domain_id=domain,
            realtime=True,
            without=["controller"],
            parameters={"plant": {"watchdog": 20.0, "oldest_command": 5.0}},
        ) as graph:
            graph.run()
    finally:
        mine.terminate()
        ended = mine.wait(240.0)
    assert ended == 0
    run = Recording.open(tmp_path / "run")
    # it was commanded all along, and went where the plan has it
    answered = run.command["measurement_sequence"]
    assert len(np.unique(answered)) > 0.8 * (answered[-1] - answered[0])
    assert answered[-1] - answered[0] > 0.8 * Plan.load(SHORT_PLAN).duration / 0.0005
    # at the end of each hold, and at that of all
    setpoint, samples = run.setpoint, run.measurement
    row = np.searchsorted(setpoint["stamp_ns"], samples["stamp_ns"], side="right") - 1
    held = (row >= 0) & (setpoint["phase"][row] == HOLD)
    ends = np.flatnonzero(held & ~np.append(held[1:], False))
    had, asked = samples[ends], setpoint[row[ends]]
    assert len(ends) == len(Plan.load(SHORT_PLAN).segments)
    assert np.abs(had["spin_rate"] - asked["spin_rate"]).max() < 5.0
    off = np.hypot(had["tilt_x"] - asked["tilt_x"], had["tilt_y"] - asked["tilt_y"])
    assert np.degrees(off).max() < 0.2
