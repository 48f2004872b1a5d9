"""Explanations in the user's cache: a second verb on the same recordings searches for nothing."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from gyrowheel_analysis.add import add_effect
from gyrowheel_analysis.channels import DRIFTS
from gyrowheel_analysis.compare import compare
from gyrowheel_analysis.diagnosis import diagnose as diagnose_module
from gyrowheel_analysis.diagnosis import explanation, kept_explanation
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.diagnosis.explanation import Explanation, SearchEnded, unexplained
from gyrowheel_analysis.diagnosis.kept_explanation import explanation_of
from gyrowheel_analysis.diagnosis.result import Diagnosis
from gyrowheel_analysis.fitting.preparation import Prepared, prepare
from gyrowheel_analysis.model import Model
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import cache
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.effects import EffectValues
from gyrowheel_sim.effects.user_defined_line import typed_effect
from gyrowheel_sim.plant.scenario import Scenario

from .machines import BENCH, hidden_machine, record
from .test_problem import SHORT

CROSS: EffectValues = {"aero_cross": {"c": 0.0055, "n": 1.98}}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("kept"), "run", hidden_machine(6, CROSS), Plan.load(SHORT))


@pytest.fixture(scope="module")
def unused(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(
        tmp_path_factory.mktemp("kept"), "run", hidden_machine(6, CROSS), Plan.load(SHORT), noise_seed=9
    )


@pytest.fixture(autouse=True)
def _kept(cache_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep every explanation, also what is found quickly, as in a short recording, and no diagnosis."""
    monkeypatch.setattr(kept_explanation, "_WORTH", 0.0)
    monkeypatch.setattr(diagnose_module, "_key", _no_key)


def _no_key(*_: Any) -> str:
    raise LookupError


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the numbers of recordings of all searches from now on."""
    found: list[int] = []
    search = explanation.explained

    def counted(first: Any, recordings: Sequence[Recording], progress: Any) -> Any:
        found.append(len(recordings))
        return search(first, recordings, progress)

    monkeypatch.setattr(kept_explanation, "explained", counted)
    return found


def facts(found: Diagnosis) -> str:
    """Return all of a diagnosis but the time that it took."""
    with np.printoptions(threshold=10**9, floatmode="unique"):
        return repr(replace(found, seconds=0.0))


def _ends_at(step: str) -> Callable[[str], None]:
    def progress(text: str) -> None:
        if text.startswith(step):
            raise SearchEnded

    return progress


@pytest.mark.slow
def test_comparison_diagnosis_and_addition_share_one_search_and_none_that_ended_early(
    recording: Recording, unused: Recording, searches: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    early = diagnose([recording], Model(BENCH), progress=_ends_at("comparing with forms"))
    assert early.ended
    assert len(searches) == 1
    first = compare([recording], Model(BENCH))
    found = diagnose([recording], Model(BENCH))
    with_unused = diagnose([recording], Model(BENCH), validate=[unused])
    add_effect(Model(BENCH), ["aero_cross"], [recording], validate=[unused])
    assert compare([recording], Model(BENCH)).error_before == first.error_before
    assert len(searches) == 2
    assert not found.ended
    assert [f.name for f in early.effects] == [f.name for f in found.effects] == ["aero_cross"]
    assert with_unused.error is not None
    assert with_unused.error.validation_after is not None
    # without a cache
    monkeypatch.setattr(cache, "read", lambda name: None)
    assert facts(diagnose([recording], Model(BENCH), validate=[unused])) == facts(with_unused)
    assert len(searches) == 3


def test_a_search_that_ends_before_anything_is_selected_is_interrupted(recording: Recording) -> None:
    with pytest.raises(KeyboardInterrupt):
        diagnose([recording], Model(BENCH), progress=_ends_at("aero_cross"))


def _with_event(recording: Recording) -> Recording:
    """Return a recording in which a reading jumps half way."""
    samples = recording.measurement.copy()
    samples["coil_voltage_x"][len(samples) // 2 :] += 0.05
    return replace(recording, measurement=samples)


def _of(effects: EffectValues, plan: str, line: str = "") -> Callable[[Recording, Path], Recording]:
    def made(_: Recording, folder: Path) -> Recording:
        machine = hidden_machine(8, effects)
        if line:
            law = typed_effect(line)
            machine = Scenario(machine.values, {law.name: law.defaults()}, 8, {law.name: law})
        return record(folder, "made", machine, plan)

    return made


@pytest.mark.slow
@pytest.mark.parametrize(
    "made",
    [
        # above, in both orders
        pytest.param(lambda own, _: own, id="an effect", marks=pytest.mark.study),
        pytest.param(lambda own, _: _with_event(own), id="an event"),
        pytest.param(_of({"stiffness_memory": {"k": 0.02}}, "check"), id="a law with a memory"),
        pytest.param(_of({}, "check", "pulled: -k*conj(z)^2*r; k = 0.04 [N*m]"), id="an unknown law"),
        pytest.param(_of({}, "check"), id="nothing"),
    ],
)
def test_a_kept_explanation_gives_the_same_diagnosis_to_the_last_digit(
    made: Callable[[Recording, Path], Recording], recording: Recording, tmp_path: Path, searches: list[int]
) -> None:
    own = made(recording, tmp_path)
    first = diagnose([own], Model(BENCH))
    assert facts(diagnose([own], Model(BENCH))) == facts(first)
    assert len(searches) == 1


@pytest.fixture
def unsearched(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the numbers of recordings of all searches, which find nothing and take no time."""
    found: list[int] = []

    def nothing(first: Prepared, recordings: Sequence[Recording], progress: Any) -> Explanation:
        found.append(len(recordings))
        return unexplained(first)

    monkeypatch.setattr(kept_explanation, "explained", nothing)
    return found


@pytest.mark.slow
def test_another_question_is_searched_again(
    recording: Recording, unused: Recording, unsearched: list[int]
) -> None:
    samples = recording.measurement.copy()
    samples["tilt_x"][1000] += 1e-9
    law, other = (typed_effect(f"pulled: -k*conj(z)^2*{r}; k = 0.04 [N*m]") for r in ("r", "r^2"))
    known: EffectValues = {"pulled": {"k": 1e-5}}
    stiffer = BENCH.with_values({"flexure_stiffness_x": 1.001 * BENCH.value("flexure_stiffness_x")})
    plain = Model(BENCH)
    questions: list[tuple[list[Recording], Model, dict[str, Any]]] = [
        ([recording], plain, {}),
        ([replace(recording, measurement=samples)], plain, {}),
        ([recording, unused], plain, {}),
        ([unused, recording], plain, {}),
        ([recording], plain, {"harmonics": False}),
        ([recording], plain, {"drift_scales": dict.fromkeys(DRIFTS, 2.0)}),
        ([recording], Model(BENCH, effects={"gravity_offset": {"G": 1e-3}}), {}),
        ([recording], Model(BENCH, effects={"gravity_offset": {"G": 2e-3}}), {}),
        ([recording], Model(BENCH, effects=known, declared={"pulled": law}), {}),
        ([recording], Model(BENCH, effects=known, declared={"pulled": other}), {}),
        ([recording], Model(stiffer), {}),
    ]
    for _ in range(2):
        for own, model, options in questions:
            explanation_of(prepare(own, model, **options), own)
    assert len(unsearched) == len(questions)


def test_damaged_entries_are_searched_again(
    recording: Recording, cache_folder: Path, unsearched: list[int]
) -> None:
    prepared = prepare([recording], Model(BENCH))
    explanation_of(prepared, [recording])
    (entry,) = (place for place in cache_folder.iterdir() if place.name.startswith("explanation_"))
    whole = entry.read_bytes()
    for damaged in (b"", whole[:-1], whole[:40] + bytes([whole[40] ^ 1]) + whole[41:]):
        entry.write_bytes(damaged)
        explanation_of(prepared, [recording])
    cache.write(entry.name, b"whole, but no pickle")
    explanation_of(prepared, [recording])
    assert len(unsearched) == 5
    found = explanation_of(prepared, [recording])
    assert len(unsearched) == 5
    assert found.problem is prepared.problem


def test_a_model_with_an_effect_that_cannot_be_written_is_searched_each_time(
    recording: Recording, unsearched: list[int]
) -> None:
    """An effect of another package may have parts that pickle refuses."""
    law = replace(typed_effect("pulled: -k*conj(z)^2*r; k = 0.04 [N*m]"), look_alikes=MappingProxyType({}))
    model = Model(BENCH, effects={"pulled": {"k": 1e-5}}, declared={"pulled": law})
    for count in (1, 2):
        explanation_of(prepare([recording], model), [recording])
        assert len(unsearched) == count


def test_entries_are_kept_up_to_a_size_in_all(cache_folder: Path) -> None:
    for k in range(5):
        cache.write(f"explanation_{k}", bytes(1000))
        os.utime(cache_folder / f"explanation_{k}", (k, k))
    cache.keep_latest("explanation_", 4, 3000)
    assert sorted(place.name for place in cache_folder.iterdir()) == ["explanation_3", "explanation_4"]
