"""The yardstick of verdicts: its noise is what its page states, and a count goes on where it ended."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import welch

from benchmarks import verdicts
from gyrowheel_core.errors import InputError
from gyrowheel_sim.instruments import Reading

PERIOD = 5e-4  # s


def of_readings(kind: verdicts.Noise, seed: int, seconds: float) -> tuple[verdicts.RoughNoise, np.ndarray]:
    count, readings = int(seconds / PERIOD), len(Reading)
    noise = verdicts.RoughNoise(kind, seed, PERIOD)
    normal = np.random.default_rng(seed).standard_normal((count, readings + 1))
    last = normal[:, -1].copy()
    made = noise.applied(normal)
    assert np.array_equal(made[:, -1], last)  # the noise of the motion is not one of the readings
    return noise, made[:, :-1]


def test_student_noise_has_the_stated_variance_and_heavy_tails() -> None:
    _, made = of_readings("student", 1, 60.0)
    assert np.median(np.abs(made)) == pytest.approx(0.765 / np.sqrt(3.0), rel=0.02)  # of t with 3 degrees
    assert np.mean(np.abs(made) > 5.0) > 1e-3


@pytest.mark.slow
def test_flicker_noise_equals_the_white_one_at_its_corner_and_falls_as_one_over_f() -> None:
    noise, made = of_readings("flicker", 2, 300.0)
    frequency, power = welch(made, 1.0 / PERIOD, nperseg=2**17, axis=0)
    of_all = power.mean(axis=1) / (2.0 * PERIOD)  # over that of white noise

    def near(wanted: float) -> float:
        return float(of_all[(frequency > wanted / 1.5) & (frequency < wanted * 1.5)].mean())

    assert near(30.0 * noise.corner) == pytest.approx(1.0, abs=0.15)
    assert near(noise.corner) == pytest.approx(2.0, rel=0.3)
    assert near(noise.corner / 8.0) == pytest.approx(9.0, rel=0.4)


def test_bursts_have_the_stated_rate_and_leave_the_rest_as_it_was() -> None:
    noise, made = of_readings("bursts", 3, 200.0)
    plain = np.random.default_rng(3).standard_normal((len(made), made.shape[1] + 1))[:, :-1]
    changed = made != plain
    begun = np.sum(np.diff(changed.astype(int), axis=0, prepend=0) == 1)
    assert begun == pytest.approx(noise.rate * 200.0 * made.shape[1], rel=0.5)
    assert np.all(np.abs(made[changed]) >= 5.0 * np.abs(plain[changed]))


def test_a_count_goes_on_where_it_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def answered(kind: str, case: Any, folder: Path) -> dict[str, Any] | None:
        asked.append(case.index)
        if case.index == 1:
            return None  # no case of the kind
        if case.index == 2:
            raise InputError("refused")
        return {"consistent": True}

    monkeypatch.setattr(verdicts, "answered", answered)
    file = tmp_path / "count.jsonl"
    for count in (1, 3):
        verdicts.run("right", 7, count, file)
    rows = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    assert asked == [row["case"] for row in rows] == [0, 1, 2, 3]
    assert [("none" in row, row.get("error")) for row in rows] == [
        (False, None),
        (True, None),
        (False, "refused"),
        (False, None),
    ]
