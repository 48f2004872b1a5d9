"""The acquisition node of the page, as it stands there, before a machine that hides an effect."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import gyrowheel as gw

from ..domains import next_domain
from .test_namespaces import BRIEF, GYROWHEEL, PAIR

PAGE = Path(__file__).resolve().parents[2] / "docs" / "your_hardware.md"
#: The driver of a card before a simulated machine with something that nobody knows. Its own drive keeps the machine at
#: its speed until somebody commands it; from then on it waits for each command, so that no computer is too slow for it.
CARD = """\
import time
from gyrowheel.simulation.scenario import scenario
from gyrowheel_control.plans.plan import Plan
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import from_json
from gyrowheel_sim.plant.machine import Plant

bench, plan = Bench.load(), Plan.load("plan.yaml")
plant = Plant(bench, scenario(bench, plan.name, effects=["aero_cross"]), initial_spin_rate=plan.initial_spin_rate)
readings = plant.measure()
drive = float(plant.machine.held[2])
commanded, since = False, 0.0


def read():
    global since
    since = time.monotonic()
    return plant.stamp_ns, readings.tolist()


def write(*voltages):
    global readings, commanded
    if commanded and not any(voltages):
        open("off", "w").close()
    commanded = commanded or any(voltages)
    readings = plant.step(*(voltages if commanded else (0.0, 0.0, drive)))


def is_due():
    return time.monotonic() > since + (3.0 if commanded else 0.002)


def arrange(text):
    plant.schedule(from_json(text))
"""


@pytest.mark.graph
@pytest.mark.study  # test_own_nodes.py runs the controller of another page
@pytest.mark.parametrize("text", [BRIEF, PAIR], ids=("brief", "pair"))
def test_a_machine_behind_the_node_of_the_page_is_recorded_and_diagnosed(text: str, tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(code.splitlines()) <= 42
    (tmp_path / "acquisition.py").write_text(code, encoding="utf-8")
    (tmp_path / "card.py").write_text(CARD, encoding="utf-8")
    (tmp_path / "plan.yaml").write_text(text, encoding="utf-8")
    domain = str(next_domain())
    node = subprocess.Popen(
        [sys.executable, "acquisition.py"], env=os.environ | {"ROS_DOMAIN_ID": domain}, cwd=tmp_path
    )
    options = [
        "--plan",
        "plan.yaml",
        "--record",
        "run",
        "--without",
        "plant",
        "--realtime",
        "--domain",
        domain,
    ]
    try:
        done = subprocess.run(
            [*GYROWHEEL, "up", *options], capture_output=True, text=True, check=False, cwd=tmp_path
        )
        assert node.poll() is None
        node.terminate()
        assert node.wait(240.0) == 0
    finally:
        node.kill()
        node.wait()
    assert (tmp_path / "off").exists()  # the last thing that it did with its card
    assert done.returncode == 0, done.stderr
    assert "none missing" in done.stdout
    run = gw.Recording.open(tmp_path / "run")
    assert run.duration > 2.0
    if text == BRIEF:
        return
    found = gw.diagnose(run, gw.Model("gyrowheel"))
    named = [effect.name for effect in found.effects]
    # where the computer is busy, answers come late: motion that has not settled is left out, and what is left may not
    # tell it from a look-alike any more, or not show it
    coverage = found.to_dict()["coverage"]
    if coverage["used"] > 0.7 * coverage["steady"]:
        assert named == ["aero_cross"]
        assert found.verdict in ("effect", "ambiguous")
    else:
        assert named in ([], ["aero_cross"])
