"""What samples show of their instruments: hum, steps of converters, jitter and rate of the clock."""

from __future__ import annotations

import re
from copy import copy
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel_analysis.fitting.preparation import samples_of
from gyrowheel_analysis.reduction.clock import read_stamps
from gyrowheel_analysis.reduction.instrument_readings import (
    ReadingFinding,
    Shown,
    look,
    reading_findings,
    steps,
)
from gyrowheel_analysis.reduction.segmentation import reduce
from gyrowheel_core.readings import READINGS, Readings
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.bench import Bench

BENCH = Bench.load()
#: What is wrong with the instruments; the bench file that the analyst has says nothing of it.
WRONG = {
    "tilt_hum": 1.2e-5,
    "coil_voltage_hum": 1.0e-3,
    "motor_voltage_hum": 2.0e-3,
    "motor_current_hum": 1.5e-3,
    "tilt_resolution": 1.3e-5,
    "coil_voltage_resolution": 1.221e-3,
    "spin_angle_resolution": 4.0e-4,
    "clock_jitter": 4.0e-6,
    "clock_rate_error": -4.0e-5,
}
#: Two speeds of which no multiple is at 50 Hz, and one that is.
SPEEDS = """\
schema: 1
name: speeds
hold_s: 1.8
segments:
  - {spin_rpm: 2700, tilt_deg: [[0, 0], [2, 0], [0, 2]]}
  - {spin_rpm: 3000, tilt_deg: [[1, 1], [0, -2], [-1, 0], [0, 1]]}
  - {spin_rpm: 3800, tilt_deg: [[0, 0], [-2, 0], [0, -2]]}
"""


def bench_file(folder: Path, values: dict[str, float]) -> Path:
    text = (resources.files("gyrowheel_sim") / "config/bench.yaml").read_text()
    for name, value in values.items():
        text, count = re.subn(rf"(  {name}: {{value: )[^,]*", rf"\g<1>{value:.6e}", text)
        assert count == 1
    path = folder / "instruments.yaml"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "speeds.yaml"
    path.write_text(SPEEDS)
    return path


@pytest.fixture(scope="module")
def imperfect(plan: Path) -> Recording:
    return gw.simulate(plan, bench=bench_file(plan.parent, WRONG), machine=5, seed=21).data


@pytest.fixture(scope="module")
def right(plan: Path) -> Recording:
    return gw.simulate(plan, machine=5, seed=21).data


def shown(recording: Recording, bench: Bench = BENCH) -> Shown:
    samples = samples_of(recording)
    return look(samples, reduce(samples, bench), bench)


def found(recording: Recording, bench: Bench = BENCH) -> dict[str, ReadingFinding]:
    return {f.name: f for f in reading_findings([shown(recording, bench)], ["it"], bench).found}


def test_every_wrong_reading_is_reported_with_its_size_and_nothing_else(imperfect: Recording) -> None:
    told = found(imperfect)
    assert set(told) == set(WRONG)
    for name, item in told.items():
        error = max(item.standard_error, 1e-6 * WRONG[name] if item.quantity == "resolution" else 0.0)
        assert abs(item.value - WRONG[name]) < max(4.0 * error, 1e-3 * abs(WRONG[name])), name
        assert item.standard_error < 0.2 * abs(item.value)
        if item.quantity == "hum":
            assert item.frequency == pytest.approx(50.0, abs=0.1)
    assert told["clock_jitter"].remark == "stamped"
    assert told["clock_rate_error"].remark == "stamps_off"


def test_stated_or_absent_deviations_are_not_reported(imperfect: Recording, right: Recording) -> None:
    assert not found(right)
    assert not found(imperfect, BENCH.with_values(WRONG))


@pytest.mark.parametrize("kind", ["heavy_tails", "bursts"])
def test_noise_that_is_not_gaussian_is_reported_and_is_no_effect(right: Recording, kind: str) -> None:
    random = np.random.default_rng(8)
    rough = copy(right)
    measured = right.measurement.copy()
    for name, noise in (("tilt_x", 2e-5), ("tilt_y", 2e-5), ("motor_current", 5e-3)):
        if kind == "heavy_tails":
            measured[name] += noise * random.standard_t(3, len(measured))
        else:
            for start in random.integers(0, len(measured) - 40, 12):
                measured[name][start : start + 40] += 20.0 * noise * random.standard_normal(40)
    vars(rough).pop("readings", None)  # cached
    vars(rough).update(measurement=measured)
    reported = found(rough)
    assert set(reported) == {"tilt_noise", "motor_current_noise"}
    for item in reported.values():
        assert (item.quantity, item.remark) == ("outliers", kind)
        assert 2e-4 < item.value < 0.03


def test_stated_but_absent_deviations_are_reported(right: Recording) -> None:
    told = found(right, BENCH.with_values(WRONG))
    assert {name for name in WRONG if name not in told} <= {"clock_jitter"}
    assert told["tilt_resolution"].value == 0.0
    assert told["motor_voltage_hum"].value < 0.2 * WRONG["motor_voltage_hum"]


def test_hum_at_the_rotor_frequency_follows_from_other_speeds(
    imperfect: Recording,
) -> None:
    samples = samples_of(imperfect)
    windows = reduce(samples, BENCH)
    weighed = look(samples, windows, BENCH).weighed(windows)
    once = weighed.hum_variance[:, 0, 0]
    at = np.abs(windows.mean_spin - 3000 * np.pi / 30) < 1.0
    assert at.any()
    assert not at.all()
    # half of the amplitude forward on each axis, and no better known in all windows of that speed than in one
    assert once[at].mean() == pytest.approx(at.sum() * 0.5 * WRONG["tilt_hum"] ** 2, rel=0.2)
    assert once[~at].max() < 0.01 * once[at].min()
    alone = windows.select(at)
    assert look(samples, alone, BENCH).hum_unknown == "rotor"
    assert not look(samples, alone, BENCH).lines


def test_hum_of_the_tilt_is_separated_from_the_response_of_the_loop(plan: Path) -> None:
    recording = gw.simulate(
        plan, bench=bench_file(plan.parent, {"tilt_hum": 1.2e-5, "mains_frequency": 60.3}), machine=5, seed=22
    ).data
    told = found(recording)
    assert set(told) == {"tilt_hum"}
    assert told["tilt_hum"].value == pytest.approx(1.2e-5, rel=0.1)
    assert told["tilt_hum"].frequency == pytest.approx(60.3, abs=0.05)


@pytest.mark.parametrize("part", [0.02, 0.5, 3.0])
def test_steps_are_found_for_any_zero(right: Recording, part: float) -> None:
    noise = {
        "tilt_x": 2e-5,
        "spin_angle": 1e-3,
        "spin_rate": 0.05,
        "motor_current": 5e-3,
        "air_pressure": 5.0,
    }
    values = right.readings.array.copy()
    for name, own in noise.items():
        step, column = 1.0234 * part * own, values[:, READINGS.index(name)]
        column[:] = np.floor(column / step) * step + 0.3 * step
    seen = steps(Readings(values))
    assert set(seen) <= set(noise)
    for name, own in noise.items():
        if name in seen or part > 0.1:
            assert seen[name] == pytest.approx(1.0234 * part * own, rel=1e-6)
    assert len(seen) >= 4
    assert not steps(Readings(right.readings.array.astype(np.float32).astype(np.float64)))


def test_jitter_of_samples_and_of_stamps_are_distinguished(right: Recording) -> None:
    late = 3.0e-6 * np.random.default_rng(4).standard_normal(len(right.time))
    values = right.readings.array.copy()
    angle = READINGS.index("spin_angle")
    values[:, angle] = np.mod(values[:, angle] + values[:, READINGS.index("spin_rate")] * late, 2.0 * np.pi)
    samples = replace(samples_of(right), readings=Readings(values))
    assert samples.sequence is not None
    with_stamps = read_stamps(replace(samples, time=samples.time + late), samples.sequence, 5e-4)
    assert with_stamps is not None
    assert with_stamps.sampled == pytest.approx(1.0, abs=0.05)
    without = read_stamps(samples, samples.sequence, 5e-4)
    assert without is not None
    assert without.jitter == 0.0
    assert abs(without.hidden - 3.0e-6) < 5.0 * without.hidden_error < 3.0e-6
