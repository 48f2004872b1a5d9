"""A recording is of the bench of the model, or it is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gyrowheel_analysis.compare import compare
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.fitting.preparation import require_one_bench
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.rate_sensor import rates
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.bench import Bench

from .machines import BENCH, hidden_machine, record

DTG = Bench.load("dtg")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("run"), "quick", hidden_machine(3, {}), "quick")


def of(recording: Recording, bench: Bench, name: str = "other") -> Recording:
    """Return the recording as one that says it is of `bench`."""
    return replace(recording, path=Path(name), bench_text=bench.describe())


def scaled(factor: float, *names: str) -> Bench:
    return replace(BENCH.with_values({n: factor * BENCH.value(n) for n in names}), name="mine")


@pytest.mark.parametrize("verb", [compare, diagnose, rates])
def test_another_bench_is_refused(recording: Recording, verb: Callable[..., Any]) -> None:
    with pytest.raises(InputError) as caught:
        verb([recording], Model.new("dtg"))
    said = str(caught.value)
    assert said.startswith(
        f"{recording.path}: is of bench gyrowheel, model of bench dtg: rotor_inertia_x is 0.00106"
    )
    assert "\n" not in said
    with pytest.raises(InputError, match=r"^other: is of bench dtg, model of bench gyrowheel: "):
        verb([of(recording, DTG)], Model.new())


def test_validation_recordings_must_be_of_the_same_bench(recording: Recording) -> None:
    with pytest.raises(InputError, match=r"^other: is of bench dtg, model of bench gyrowheel: "):
        diagnose([recording], Model.new(), validate=[of(recording, DTG)])


def test_recordings_of_different_benches_are_refused(recording: Recording) -> None:
    """Each of them may pass for the model's bench, but not both."""
    light, heavy = (scaled(factor, "rotor_inertia_z") for factor in (0.6, 1.8))
    one, two = of(recording, light, "one"), of(recording, replace(heavy, name="yours"), "two")
    require_one_bench([one], Model.new())
    require_one_bench([two], Model.new())
    with pytest.raises(
        InputError, match=r"^two: is of bench yours, one of bench mine: rotor_inertia_z is 0\.0032"
    ):
        require_one_bench([one, two], Model.new())


def test_a_user_defined_bench_of_the_same_machine_passes(recording: Recording) -> None:
    own = scaled(1.5, "rotor_inertia_x", "rotor_inertia_z", "flexure_stiffness_x", "flexure_stiffness_y")
    require_one_bench([of(recording, own)], Model.new())
    require_one_bench(
        [of(recording, scaled(4.0, "coil_constant", "motor_constant", "tilt_noise"))], Model.new()
    )


def test_a_machine_may_differ_from_the_bench_of_its_name(recording: Recording) -> None:
    own = replace(scaled(3.0, "rotor_inertia_z"), name=BENCH.name)
    require_one_bench([of(recording, own)], Model.new())


@pytest.mark.parametrize("factor", [0.4, 2.5])
def test_another_sample_period_is_another_bench(recording: Recording, factor: float) -> None:
    with pytest.raises(InputError, match="sample_period is"):
        require_one_bench([of(recording, scaled(factor, "sample_period"))], Model.new())


@pytest.mark.parametrize(
    "text",
    [
        "",
        "a bench",
        "[]",
        "5",
        json.dumps({"name": "other"}),
        json.dumps({"name": "other", "parameters": []}),
        json.dumps({"name": "other", "parameters": {"rotor_inertia_z": {"value": "much"}}}),
        json.dumps({"name": "other", "parameters": {"rotor_inertia_z": {"value": float("nan")}}}),
        json.dumps({"name": ["other"], "parameters": {"rotor_inertia_z": {"value": 1.0}}}),
        json.dumps({"name": "other", "parameters": {"rotor_inertia_z": {"value": 0}}}),
    ],
)
def test_a_recording_without_a_bench_passes(recording: Recording, text: str) -> None:
    require_one_bench([replace(recording, bench_text=text)], Model.new())
