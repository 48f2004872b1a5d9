"""The command line, and recordings and a model that tests share."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

import gyrowheel as gw
from gyrowheel.simulation.api import record_simulation
from gyrowheel.simulation.scenario import scenario
from gyrowheel.workbench.library import Library
from gyrowheel.workbench.session import Session
from gyrowheel_analysis.model import Model
from gyrowheel_control.plans.plan import Plan
from gyrowheel_sim.bench import Bench

from ..shared import made_once
from .helpers import DRAG_PLAN, OTHER_PLAN, Shell


@pytest.fixture
def gyrowheel(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Shell:
    monkeypatch.setenv("COLUMNS", "80")
    return Shell(capsys)


@dataclass(frozen=True)
class Wheel:
    """Two recordings of one machine with windage, and the model without."""

    recording: Path
    other: Path
    model: Path


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Wheel:
    def made(folder: Path) -> Path:
        bench = Bench.load()
        for text in (DRAG_PLAN, OTHER_PLAN):
            plan = Plan.load(text)
            machine = scenario(bench, plan.name, effects=["windage:w=0.0013"], seed=4)
            record_simulation(folder / plan.name, bench, machine, plan)
        Model.new().save(folder / "model.yaml")
        return folder

    # one folder per worker, because some tests save models in it
    folder = tmp_path_factory.mktemp("wheel")
    shutil.copytree(made_once(tmp_path_factory, "wheel", made), folder, dirs_exist_ok=True)
    return Wheel(folder / "drag", folder / "other", folder / "model.yaml")


@pytest.fixture(scope="module")
def compared(wheel: Wheel) -> Iterator[Session]:
    """Return a session with a recording compared and its holds predicted, and nothing diagnosed."""
    session = Session(Library([wheel.recording.parent]), gw.Model.load(wheel.model), wheel.model)
    session.open("0/drag", "fitted")
    session.wait(240.0)
    session.compare()
    session.wait(240.0)
    assert session.trouble is None
    yield session
    session.shut()
