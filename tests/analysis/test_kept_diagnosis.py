"""Diagnoses in the user's cache: the same question again is not searched again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gyrowheel_analysis.diagnosis import diagnose as diagnose_module
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.diagnosis.explanation import SearchEnded
from gyrowheel_analysis.model import Model
from gyrowheel_control.plans.plan import Plan
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.effects import EffectValues
from gyrowheel_sim.effects.user_defined_line import typed_effect

from .machines import BENCH, hidden_machine, record
from .test_kept_explanation import CROSS, facts
from .test_problem import SHORT

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("kept"), "run", hidden_machine(6, CROSS), Plan.load(SHORT))


@pytest.fixture
def searches(cache_folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the numbers of recordings of all searches from now on."""
    found: list[int] = []
    search = diagnose_module._diagnosed

    def counted(recordings: Any, *others: Any, **options: Any) -> Any:
        found.append(len(recordings))
        return search(recordings, *others, **options)

    monkeypatch.setattr(diagnose_module, "_diagnosed", counted)
    return found


def test_the_same_diagnosis_is_searched_once(recording: Recording, searches: list[int]) -> None:
    model = Model(BENCH)
    first = diagnose([recording], model)
    again = diagnose([recording], replace(model, origin="other.yaml"))
    assert len(searches) == 1
    assert facts(again) == facts(replace(first, model="other.yaml"))
    assert again.seconds < first.seconds


@pytest.mark.parametrize("effects", [{}, CROSS], ids=["nothing missing", "an effect"])
def test_a_quick_diagnosis_is_the_same_without_limits_and_next_test(
    effects: EffectValues, recording: Recording, cache_folder: Path
) -> None:
    """Where nothing was found, what could hide is part of the verdict."""
    model = replace(Model(BENCH), effects=effects)
    whole, quick = (diagnose([recording], model, quick=own) for own in (False, True))
    assert whole.verdict == ("nothing_missing" if effects else "effect")
    assert whole.next_test is not None
    limits = whole.limits if effects else ()
    assert facts(quick) == facts(replace(whole, next_test=None, limits=limits))


def _declared(model: Model, law: str) -> Model:
    effect = typed_effect(f"pull: {law}; k = 1e-3 [N*m/rad]")
    return replace(model, declared={"pull": effect}, effects={"pull": {"k": 0.001}})


@pytest.mark.parametrize(
    "other",
    [
        lambda model: replace(model, effects={"windage": {"w": 0.001, "n": 1.8}}),
        lambda model: replace(model, stated_bench=BENCH.with_values({"coil_constant": 0.021})),
        lambda model: _declared(model, "-k*z"),
    ],
    ids=["effect", "bench", "declaration"],
)
def test_another_model_is_diagnosed_again(
    other: Callable[[Model], Model], recording: Recording, searches: list[int]
) -> None:
    model = Model(BENCH)
    for asked in (model, other(model), model, other(model)):
        diagnose([recording], asked)
    assert len(searches) == 2


def test_another_declaration_of_the_same_name_is_diagnosed_again(
    recording: Recording, searches: list[int]
) -> None:
    for law in ("-k*z", "-k*conj(z)", "-k*z"):
        diagnose([recording], _declared(Model(BENCH), law))
    assert len(searches) == 2


def test_other_options_or_another_place_are_diagnosed_again(
    recording: Recording, searches: list[int], tmp_path: Path
) -> None:
    moved = replace(recording, path=tmp_path / "moved")
    diagnose([recording], Model(BENCH))
    diagnose([recording], Model(BENCH), averages=True)
    diagnose([recording], Model(BENCH), quick=True)
    diagnose([recording], Model(BENCH), validate=[moved])
    found = diagnose([moved], Model(BENCH))
    assert len(searches) == 5
    assert found.recordings == (str(moved.path),)


def test_a_search_that_ended_early_is_not_kept(recording: Recording, searches: list[int]) -> None:
    def ended(text: str) -> None:
        if text.startswith("comparing with forms"):
            raise SearchEnded

    assert diagnose([recording], Model(BENCH), progress=ended).ended
    assert not diagnose([recording], Model(BENCH)).ended
    assert len(searches) == 2


def test_a_damaged_entry_is_searched_again(
    recording: Recording, searches: list[int], cache_folder: Path
) -> None:
    first = diagnose([recording], Model(BENCH))
    (entry,) = cache_folder.glob("diagnosis_*")
    entry.write_bytes(entry.read_bytes()[:-9])
    assert facts(diagnose([recording], Model(BENCH))) == facts(first)
    assert len(searches) == 2
