"""What the analysis makes of readings that were not taken: single ones, stretches of them, and whole columns."""

from __future__ import annotations

import warnings
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gyrowheel_analysis.compare import compare
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.drag.estimate import DragEstimator
from gyrowheel_analysis.fitting.preparation import samples_of
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.rate_sensor import rates
from gyrowheel_analysis.reduction.quality import NEEDED, SLOW, reading_noise
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.segmentation import reduce, reduce_and_account
from gyrowheel_analysis.reduction.windows import Coverage, Windows
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_core.readings import READINGS, Readings
from gyrowheel_recording.bags import Recording

from .machines import BENCH, assert_same_means, hidden_machine, record

UNREAD = "with readings missing"
THIN = """\
schema: 1
name: thin
hold_s: 1.0
segments:
  - {spin_rpm: 2000, tilt_deg: [[2, 0]]}
  - {spin_rpm: 2000, air_density_ratio: 0.3, tilt_deg: [[0, 0], [2, 0]]}
"""
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("run"), "run", hidden_machine(3, {}), "check")


@pytest.fixture(scope="module")
def samples(recording: Recording) -> Samples:
    return samples_of(recording)


@pytest.fixture(scope="module")
def windows(samples: Samples) -> Windows:
    return reduce(samples, BENCH)


def without(recording: Recording, name: str, rows: Any = slice(None), value: float = np.nan) -> Recording:
    measurement = recording.measurement.copy()
    measurement[name][rows] = value
    return replace(recording, measurement=measurement)


def some(samples: Samples, rows: np.ndarray) -> Samples:
    """Return some of the samples, each with all that belongs to it."""
    assert samples.sequence is not None
    assert samples.commanded is not None
    return replace(
        samples,
        time=samples.time[rows],
        readings=samples.readings[rows].copy(),
        sequence=samples.sequence[rows],
        commanded=samples.commanded[rows],
    )


def same(one: Windows, other: Windows) -> bool:
    return all(np.array_equal(getattr(one, f.name), getattr(other, f.name)) for f in fields(Windows))


@pytest.mark.slow
@settings(max_examples=5, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    name=st.sampled_from(NEEDED),
    row=st.floats(0.0, 1.0),
    value=st.sampled_from([np.nan, np.inf, -np.inf]),
)
def test_a_sample_without_a_reading_counts_as_lost(
    samples: Samples, name: str, row: float, value: float
) -> None:
    hurt = some(samples, np.flatnonzero(samples.time < 8.0))
    k = round(row * (len(hurt.time) - 1))
    hurt.readings[name][k] = value
    found = reduce(hurt, BENCH)
    assert len(found) > 3
    assert same(found, reduce(some(hurt, np.delete(np.arange(len(hurt.time)), k)), BENCH))


@pytest.mark.slow
@pytest.mark.parametrize("name", READINGS)
def test_scattered_missing_readings_hardly_move_a_window(
    samples: Samples, windows: Windows, name: str
) -> None:
    rng = np.random.default_rng(4)
    readings = samples.readings.copy()
    readings[name][rng.random(len(readings)) < 0.01] = np.nan
    data = replace(samples, readings=readings)
    found, coverage = reduce_and_account(data, BENCH)
    assert coverage.complete
    assert_same_means(found, windows)
    assert np.abs(found.coil_temperature - windows.coil_temperature).max() < 0.01
    assert np.abs(found.air_pressure - windows.air_pressure).max() < 2.0


def test_noise_is_estimated_from_the_present_readings(samples: Samples) -> None:
    rng = np.random.default_rng(5)
    readings = samples.readings.copy()
    readings.tilt_x[rng.random(len(readings)) < 0.003] = np.nan
    found = reduce(replace(samples, readings=readings), BENCH).reading_noise[0]
    assert found == pytest.approx(reading_noise(samples, BENCH), rel=0.1)


@pytest.mark.slow
def test_a_stretch_without_readings_is_left_out_and_accounted_for(samples: Samples, windows: Windows) -> None:
    gone = windows.select(np.flatnonzero(windows.duration > 0.9)[2:3])
    readings = samples.readings.copy()
    start, length = float(gone.start[0]), float(gone.duration[0])
    rows = (samples.time > start) & (samples.time < start + length)
    readings.motor_current[rows] = np.nan
    found, coverage = reduce_and_account(replace(samples, readings=readings), BENCH)
    assert len(found) == len(windows) - 1
    assert coverage.left_out[UNREAD] == pytest.approx(length, rel=0.1)
    assert f"s {UNREAD}" in coverage.sentence()
    _, whole = reduce_and_account(samples, BENCH)
    assert coverage.steady == pytest.approx(whole.steady)
    assert coverage.recorded == whole.recorded


@pytest.mark.slow
def test_a_gap_within_a_window_does_not_count_as_used(samples: Samples, windows: Windows) -> None:
    own = windows.select(np.flatnonzero(windows.duration > 0.9)[2:3])
    end = float(own.start[0] + own.duration[0])
    turn = 2.0 * np.pi / float(own.mean_spin[0])  # what follows the last whole revolution counts as well
    for start, stop, length in ((end - 0.3, end + 0.1, 0.3 + 0.5 * turn), (end - 0.5, end - 0.495, 0.005)):
        readings = samples.readings.copy()
        readings.tilt_x[(samples.time > start) & (samples.time < stop)] = np.nan
        found, coverage = reduce_and_account(replace(samples, readings=readings), BENCH)
        _, whole = reduce_and_account(samples, BENCH)
        assert len(found) == len(windows)
        assert coverage.left_out[UNREAD] == pytest.approx(length, abs=0.5 * turn if stop > end else 0.001)
        assert coverage.used == pytest.approx(whole.used - coverage.left_out[UNREAD])


def test_lost_samples_are_not_missing_readings(samples: Samples) -> None:
    thin = some(samples, np.arange(0, len(samples.time), 4))
    thin.readings.tilt_x[5] = np.nan
    _, coverage = reduce_and_account(thin, BENCH)
    assert UNREAD not in coverage.left_out
    assert coverage.left_out["with too few samples or revolutions"] > 0.0


def test_a_recording_with_hardly_any_readings_has_no_windows(samples: Samples) -> None:
    readings = samples.readings.copy()
    readings.motor_current[10:] = np.nan
    nothing = Readings(np.full_like(readings.array, np.nan))
    for data in (replace(samples, readings=readings), replace(samples, readings=nothing)):
        for own in (data, replace(data, setpoint_time=data.setpoint_time[:0], setpoint=data.setpoint[:0])):
            found, coverage = reduce_and_account(own, BENCH)
            assert len(found) == 0
            assert coverage.used == 0.0


@pytest.mark.slow
def test_the_finding_is_the_same_with_a_reading_missing(recording: Recording) -> None:
    """The whole way, by both verbs; a missing reading once ended it with a traceback."""
    hurt = without(without(recording, "tilt_x", 20000), "motor_current", 30000)
    before, after = (compare([r], Model.new()) for r in (recording, hurt))
    for channel, metrics in before.channels.items():
        # the noise of the readings is estimated from other stretches, its square to within a few per cent
        assert after.channels[channel].chi2_per_n == pytest.approx(metrics.chi2_per_n, rel=0.1)
    assert diagnose([hurt], Model.new()).verdict == "nothing_missing"


#: Channels that need a reading.
COMPARES = {
    "spin_angle": {"tilt_1n", "tilt_2n", "angle_1n", "angle_2n", "spin_ripple", "voltage_ripple"},
    "spin_rate": {"spin_ripple", "voltage_ripple"},
    "coil_voltage_x": {"tilt_x", "tilt_1n", "tilt_2n"},
    "coil_voltage_y": {"tilt_y", "tilt_1n", "tilt_2n"},
    "motor_voltage": {"motor_voltage", "voltage_ripple"},
    "motor_current": {"spin", "spin_ripple", "voltage_ripple"},
}


@pytest.mark.parametrize("name", NEEDED)
def test_channels_that_need_no_missing_reading_are_compared(recording: Recording, name: str) -> None:
    hurt = without(recording, name)
    with pytest.raises(InputError, match=rf"^{recording.path}: {name}: no reading is a number; [^\n]+$"):
        rates([hurt], Model.new())
    if name not in COMPARES:
        with pytest.raises(InputError, match=rf"^{recording.path}: {name}: no reading is a number; [^\n]+$"):
            compare([hurt], Model.new())
        return
    whole, found = (compare([r], Model.new()) for r in (recording, hurt))
    assert whole.channels.keys() - found.channels.keys() == COMPARES[name]
    assert f"not measured: {name} (" in found.coverage.sentence()
    for channel, metrics in found.channels.items():
        assert metrics.rms < 2.0 * whole.channels[channel].rms, channel
        assert metrics.chi2_per_n < 2.0, channel


@pytest.mark.slow
def test_dispensable_readings_are_assumed_and_reported(recording: Recording, windows: Windows) -> None:
    hurt = recording
    for name in SLOW:
        hurt = without(hurt, name)
    found, coverage = reduce_and_account(samples_of(hurt), BENCH)
    assert len(found) == len(windows)
    assert found.coil_temperature == pytest.approx(BENCH.value("air_temperature"))
    assert found.air_temperature == pytest.approx(BENCH.value("air_temperature"))
    assert found.air_pressure == pytest.approx(windows.air_pressure, abs=300.0)
    assert not coverage.complete
    assert len(coverage.assumed) == 3
    said = compare([hurt], Model.new()).coverage.sentence()
    assert "; not measured: air_temperature (that of the bench is taken, ± 3 K)" in said
    assert "air_pressure (that of the bench is taken, ± 3000 Pa)" in said
    assert "coil_temperature (that of the air is taken, ± 3 K)" in said
    both = Coverage.of([coverage, coverage, reduce_and_account(samples_of(recording), BENCH)[1]])
    assert both.assumed == coverage.assumed


def test_the_commanded_pressure_replaces_one_that_was_not_measured(tmp_path: Path) -> None:
    thin = record(tmp_path, "run", hidden_machine(3, {}), Plan.load(THIN))
    measured = reduce(samples_of(thin), BENCH).air_pressure
    taken = reduce(samples_of(without(thin, "air_pressure")), BENCH).air_pressure
    assert measured.min() < 0.7 * measured.max()
    assert np.median(np.abs(taken / measured - 1.0)) < 0.01


@pytest.mark.slow
def test_complete_readings_are_neither_copied_nor_reported(samples: Samples, windows: Windows) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found, coverage = reduce_and_account(samples, BENCH)
    assert same(found, windows)
    assert coverage.assumed == ()


@pytest.mark.slow
def test_the_drag_estimate_skips_a_sample_with_a_reading_missing(recording: Recording) -> None:
    def estimates(readings: Readings) -> list[Any]:
        estimator = DragEstimator(Model.new())
        for row in recording.setpoint:
            motion = [row[n] for n in ("tilt_x", "tilt_y", "tilt_rate_x", "tilt_rate_y")]
            speed = [row["spin_rate"], row["spin_acceleration"]]
            estimator.setpoint(row["stamp_ns"], row["segment"], row["phase"], [*motion, *speed])
        return estimator.add_block(recording.measurement["stamp_ns"], readings) + estimator.finish()

    whole = recording.readings.copy()
    holed = whole.copy()
    holed.coil_voltage_x[5000] = np.nan
    holed.tilt_y[20000:20003] = np.nan
    own, plain = estimates(holed), estimates(whole)
    assert len(own) == len(plain) > 5
    for a, b in zip(own, plain, strict=True):
        assert np.all(np.isfinite(a.dc_voltage))
        assert np.all(np.abs(a.dc_voltage - b.dc_voltage) < b.dc_voltage_std)
