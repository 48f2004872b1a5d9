"""Bench parameters stated as exact: they have no error, neither as a candidate nor as an addition."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gyrowheel_analysis.add import add_effect
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.fitting.fit import candidate_terms
from gyrowheel_analysis.model import Model
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.plant.scenario import Scenario

from .machines import BENCH, record

EXACT = ("coil_constant", "flexure_stiffness_x")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder: Path = tmp_path_factory.mktemp("exact")
    machine = replace(Scenario.nominal(noise_seed=5), effects={"aero_cross": {"c": 0.0054, "n": 1.9}})
    return record(folder, "quick", machine, "quick")


@pytest.fixture(scope="module")
def model() -> Model:
    exact = {name: replace(BENCH.parameters[name], uncertainty=0.0) for name in EXACT}
    return replace(Model.new(), stated_bench=replace(BENCH, parameters={**BENCH.parameters, **exact}))


@pytest.mark.slow
def test_errors_of_exact_parameters_are_no_candidates(recording: Recording, model: Model) -> None:
    found = diagnose([recording], model)
    assert [effect.name for effect in found.effects] == ["aero_cross"]
    candidates = {term.name for term in candidate_terms(model.reference_bench)}
    assert candidates ^ {term.name for term in candidate_terms(BENCH)} == {
        "coil_gain_error",
        "stiffness_error",
    }


def test_errors_of_exact_parameters_cannot_be_added(recording: Recording, model: Model) -> None:
    with pytest.raises(InputError, match=r"coil_gain_error: the bench states coil_constant as exact"):
        add_effect(model, ["coil_gain_error"], [recording])
    with pytest.raises(InputError, match=r"states flexure_stiffness_x as exact"):
        add_effect(model, ["stiffness_error"], [recording])
