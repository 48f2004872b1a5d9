"""The benchmark of the diagnosis: recordings as long as they are called, stages as there are."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import diagnosis
from gyrowheel_control.plans.plan import Plan


@pytest.mark.parametrize(("name", "seconds"), [("4 minutes", 240.0), ("1 hour", 3600.0)])
def test_plans_are_as_long_as_they_are_called(name: str, seconds: float) -> None:
    assert Plan.load(diagnosis.plan(name)).duration == pytest.approx(seconds, rel=0.01)


@pytest.mark.slow
@pytest.mark.study
def test_a_diagnosis_is_taken_apart_into_its_stages(tmp_path: Path) -> None:
    samples = diagnosis.record(tmp_path / "recording", "check", lambda _: None)
    found = diagnosis.diagnosed(tmp_path / "recording")
    assert samples == pytest.approx(Plan.load("check").duration / 5e-4, abs=2)
    stages = found["stages"]
    assert list(stages) == [
        "reading", "reduction", "balance", "noise and drift", "selection", "events", "free forms", "error table",
        "ties, limits, next test", "report",
    ]  # fmt: skip
    assert min(stages.values()) > 0.0
    assert found["memory"] > 0.05
    assert found["named"] == ["aero_cross"]
