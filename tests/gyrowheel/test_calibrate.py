"""The verb `calibrate`."""

from __future__ import annotations

from pathlib import Path

import pytest

from gyrowheel.simulation.api import record_simulation
from gyrowheel_analysis.model import Model
from gyrowheel_control.plans.plan import Plan
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.plant.scenario import Scenario

from .helpers import SHORT_PLAN, Shell


@pytest.fixture(scope="module")
def cone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a machine whose coils give a tenth more than stated."""
    folder = tmp_path_factory.mktemp("calibrate")
    machine = Scenario({"coil_constant": 0.022}, noise_seed=3)
    record_simulation(folder / "cone", Bench.load(), machine, Plan.load("cone"))
    return folder / "cone"


@pytest.mark.slow
def test_constants_are_shown_and_written_only_on_request(gyrowheel: Shell, cone: Path, tmp_path: Path):
    model = tmp_path / "model.yaml"
    gyrowheel.good("model", "new", "--model", model)
    before = model.read_bytes()
    shown = gyrowheel.good("calibrate", cone, "--model", model)
    assert all(len(line) <= 80 for line in shown.out.splitlines() if "gyrowheel calibrate" not in line)
    assert "coil_constant" in shown.out
    assert f"gyrowheel calibrate {cone} --model {model} --write" in shown.out
    assert model.read_bytes() == before
    result = gyrowheel.good("calibrate", cone, "--model", model, "--write", "--json", "-").json
    coil = result["constants"]["coil_constant"]
    assert result["written"] is True
    assert coil["after"]["value"] == pytest.approx(0.022, abs=4.0 * coil["after"]["standard_error"])
    assert coil["stated"] == {"value": 0.02, "uncertainty": 0.0004}
    assert Model.load(model).overrides["coil_constant"].value == pytest.approx(coil["after"]["value"])
    assert "calibrate" in gyrowheel.good("model", "show", "--model", model).out
    gyrowheel.good("model", "undo", "--model", model)
    assert model.read_bytes() == before


def test_undetermined_constants_are_reported(gyrowheel: Shell, cone: Path, tmp_path: Path):
    model = tmp_path / "model.yaml"
    gyrowheel.good("model", "new", "--model", model)
    record_simulation(tmp_path / "short", Bench.load(), Scenario.nominal(), Plan.load(SHORT_PLAN))
    before = model.read_bytes()
    result = gyrowheel("calibrate", tmp_path / "short", "--model", model, "--write")
    assert result.code == 2
    assert "steady windows; at least" in result.err
    assert gyrowheel("calibrate", cone, cone, "--model", model).code == 2
    assert model.read_bytes() == before
