"""Windows in the user's cache: a second look at the same samples needs no reduction, anything else does."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrowheel_analysis.fitting import kept_windows
from gyrowheel_analysis.fitting.preparation import Prepared, prepare
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction import segmentation
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import cache
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mislabelled import find
from gyrowheel_sim.bench import Bench

from .machines import BENCH, hidden_machine, record
from .test_problem import SHORT


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("kept"), "run", hidden_machine(3, {}), Plan.load(SHORT))


@pytest.fixture
def reductions(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the numbers of samples of all recordings that are reduced from now on."""
    found: list[int] = []
    reduce = segmentation.reduce_and_account

    def counted(samples: Samples, bench: Bench) -> object:
        found.append(len(samples.time))
        return reduce(samples, bench)

    monkeypatch.setattr(kept_windows, "reduce_and_account", counted)
    return found


def rows(prepared: Prepared) -> bytes:
    """Return all that a fit takes from the windows, and what the samples show of the instruments."""
    problem = prepared.problem
    parts = [problem.measured, problem.base, problem.noise.deviation()]
    return b"".join(part.tobytes() for part in parts) + repr((prepared.coverage, prepared.shown)).encode()


def test_the_same_samples_are_reduced_once(
    recording: Recording, cache_folder: Path, reductions: list[int]
) -> None:
    first = rows(prepare([recording], Model(BENCH)))
    copy = replace(recording, measurement=recording.measurement.copy(), path=Path("elsewhere"))
    assert rows(prepare([copy], Model(BENCH))) == first
    assert len(reductions) == 1


def test_other_samples_parts_and_benches_are_reduced_again(
    recording: Recording, cache_folder: Path, reductions: list[int]
) -> None:
    prepare([recording], Model(BENCH))
    samples = recording.measurement.copy()
    samples["tilt_x"][1000] += 1e-9
    others = [
        replace(recording, measurement=samples),
        replace(recording, part=(0.5, np.inf)),
        replace(recording, command=recording.command[:-1]),
    ]
    for count, other in enumerate(others, 2):
        prepare([other], Model(BENCH))
        assert len(reductions) == count
    stiffer = BENCH.with_values({"flexure_stiffness_x": 1.001 * BENCH.value("flexure_stiffness_x")})
    prepare([recording], Model(stiffer))
    assert len(reductions) == len(others) + 2


def test_damaged_entries_are_made_again(
    recording: Recording, cache_folder: Path, reductions: list[int]
) -> None:
    first = rows(prepare([recording], Model(BENCH)))
    (entry,) = (place for place in cache_folder.iterdir() if place.name.startswith("windows_"))
    whole = entry.read_bytes()
    for damaged in (b"", whole[:-1], whole[:40] + bytes([whole[40] ^ 1]) + whole[41:]):
        entry.write_bytes(damaged)
        assert rows(prepare([recording], Model(BENCH))) == first
        assert entry.read_bytes() == whole
    cache.write(entry.name, b"whole, but no pickle")
    assert rows(prepare([recording], Model(BENCH))) == first
    assert len(reductions) == 5


def test_the_latest_entries_are_kept(cache_folder: Path) -> None:
    for k in range(5):
        cache.write(f"windows_{k}", b"")
        (cache_folder / f"windows_{k}").touch()
        os.utime(cache_folder / f"windows_{k}", (k, k))
    cache.write("other_0", b"")
    cache.keep_latest("windows_", 2)
    assert sorted(place.name for place in cache_folder.iterdir()) == ["other_0", "windows_3", "windows_4"]


def test_a_right_setup_is_checked_once_and_a_wrong_one_always(
    recording: Recording, cache_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged: list[Path] = []
    judge = find._judged

    def counted(own: Recording, bench: object) -> object:
        judged.append(own.path)
        return judge(own, bench)  # type: ignore[arg-type]

    monkeypatch.setattr(find, "_judged", counted)
    samples = recording.measurement.copy()
    samples["motor_voltage"] *= -1.0
    wrong = replace(recording, measurement=samples)
    for own, times in ((recording, 1), (wrong, 3)):
        judged.clear()
        results = [find.wrong_setups([own], BENCH) for _ in range(3)]
        assert len(judged) == times
        assert results[0] == results[1] == results[2]
        assert bool(results[0]) == (own is wrong)
