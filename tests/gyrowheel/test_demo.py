"""The demonstration, with the simulation in place of the graph."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import gyrowheel as gw
from gyrowheel.demonstration import api as demo
from gyrowheel.simulation.api import record_simulation
from gyrowheel_analysis.model import Model
from gyrowheel_control.plans.plan import Plan
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.plant.scenario import Scenario

from .helpers import Shell
from .pages import Page, check_numbers


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the simulation make the recordings: it gives the same samples as the graph."""

    def record(plan: str, scenario: Scenario, recording: Path, model: Path, tour: Any) -> None:
        record_simulation(recording, Bench.load(), scenario, Plan.load(plan), model=Model.load(model))

    monkeypatch.setattr(demo, "_run_graph", record)


@pytest.fixture
def locked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the key exist only while a machine is built from it and when it is opened at the end."""
    kept: dict[Path, str] = {}
    machine, open_key = demo._machine, demo._open_key

    def build(seed: int, plan: str, key: Path) -> Scenario:
        if key in kept:
            key.write_text(kept[key])
        scenario = machine(seed, plan, key)
        kept[key] = key.read_text()
        key.unlink()
        return scenario

    def at_the_end(found: Any, files: demo.Files, tour: Any) -> Any:
        files.key.write_text(kept[files.key])
        return open_key(found, files, tour)

    monkeypatch.setattr(demo, "_machine", build)
    monkeypatch.setattr(demo, "_open_key", at_the_end)


@pytest.mark.slow
@pytest.mark.usefixtures("simulated", "locked")
def test_the_tour_finds_what_is_hidden_without_the_key(gyrowheel: Shell, tmp_path: Path):
    folder = tmp_path / "results"
    result = gyrowheel("demo", "--seed", 5, "-o", folder, "--json", "-")
    assert result.code == 0, result.err
    outcome = result.json
    assert outcome["right"]
    assert outcome["named"] == list(outcome["hidden"])
    paths = {name: Path(path) for name, path in outcome["paths"].items()}
    assert all(path.exists() for path in paths.values())
    assert set(paths) == {"recording", "validation_recording", "model", "report", "report_picture", "key"}
    assert (
        outcome["error"]["validation_after"]["chi2_per_n"]
        < outcome["error"]["validation_before"]["chi2_per_n"]
    )
    report = Page(paths["report"].read_text(encoding="utf-8"))
    assert check_numbers(report) > 100
    assert report.content["addition"]["error"] == outcome["error"]
    model = Model.load(paths["model"])
    assert list(model.effects) == outcome["named"]
    assert len(model.history) == 1
    assert model.history[0]["validate"]
    for number in range(1, 9):
        assert f"\n {number} " in result.err
    assert all(len(line) <= 80 for line in result.err.splitlines())


@pytest.mark.study
@pytest.mark.usefixtures("simulated")
def test_a_wrong_verdict_ends_with_exit_code_1(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    key = SimpleNamespace(hidden=SimpleNamespace(effects={"coil_heating": {"a": 0.004}}))
    monkeypatch.setattr(gw, "open_key", lambda _: key)
    result = gyrowheel("demo", "--seed", 5, "-o", tmp_path / "results")
    assert result.code == 1
    assert "WRONG" in result.out


def test_new_folder_when_the_default_one_exists(tmp_path: Path):
    assert demo.folder_for(3, tmp_path).name == "demo-3"
    (tmp_path / "demo-3").mkdir()
    (tmp_path / "demo-3-2").mkdir()
    assert demo.folder_for(3, tmp_path).name == "demo-3-3"
