"""Recordings with long pauses: a bench that slept over night, a clock that was set decades ahead."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrowheel_analysis.compare import compare
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.drag.stream import drag_estimates
from gyrowheel_analysis.fitting.preparation import prepare, samples_of
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.rate_sensor import rates
from gyrowheel_analysis.reduction.motor_temperature import interpolated, motor_temperatures
from gyrowheel_analysis.reduction.onset import onset
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_core import wire
from gyrowheel_core.readings import READINGS, Readings
from gyrowheel_recording.bags import Recording, write_run
from gyrowheel_recording.bags.info import info
from gyrowheel_recording.bags.reader import PAUSE, pauses
from gyrowheel_recording.mislabelled.blocks import Shortened
from gyrowheel_recording.mislabelled.find import wrong_setups
from gyrowheel_sim.environment import to_json

from .machines import BENCH, hidden_machine, record

DECADES = 1.7e9  # s; from 1970 to today
NIGHT = 4e4

steps = st.lists(st.sampled_from([5e-4, 0.01, 59.0, 61.0, 1e5, DECADES]), min_size=1, max_size=5000)


@given(steps)
def test_pauses_are_found_at_any_place(between: list[float]) -> None:
    time = np.concatenate([[0.0], np.cumsum(between)])
    at = np.flatnonzero(np.diff(time) > PAUSE)
    assert np.array_equal(pauses(time), np.column_stack([time[at], time[at + 1]]))


@pytest.mark.parametrize("count", [0, 1])
def test_few_samples_have_no_pauses(count: int) -> None:
    assert pauses(np.zeros(count)).shape == (0, 2)


@given(steps)
def test_shortened_time_is_whole_steps_and_can_be_inverted(between: list[float]) -> None:
    time = np.concatenate([[0.0], np.cumsum(between)])
    own = Shortened.of(time, 0.02)
    short = own.without(time)
    assert np.all(np.diff(short) >= 0.0)
    assert np.diff(short).max() <= PAUSE + 0.05
    late = (time - short) / 0.02
    assert late == pytest.approx(np.round(late), abs=1e-3)
    assert own.recorded(short) == pytest.approx(time, abs=1e-5)


def _heated(time: np.ndarray) -> Samples:
    """Return samples of a motor with a constant current."""
    columns = np.zeros((len(time), len(READINGS)))
    columns[:, Readings.columns(["motor_current"])] = 0.4
    columns[:, Readings.columns(["air_temperature"])] = 293.0
    nothing = np.zeros(0)
    return Samples(time, Readings(columns), nothing, nothing)


def test_the_motor_temperature_after_a_pause_equals_that_of_single_steps() -> None:
    before, between, after = (np.arange(*ends, 0.01) for ends in ((0, 20), (20, 85), (85, 105)))
    # of the pause five seconds are one long step; recorded, they are fifty
    short = motor_temperatures(_heated(np.concatenate([before, after])), BENCH)
    whole = motor_temperatures(_heated(np.concatenate([before, between, after])), BENCH)
    assert len(short[0]) < len(whole[0])
    # 84.9998: half a sample before the first one behind the pause, where a window asks for its start
    for when, within in ((5.03, 1e-9), (19.97, 1e-9), (84.9998, 1e-6), (85.04, 1e-9), (104.8, 1e-9)):
        for column in (1, 2):
            own, wanted = (interpolated(heat[0], heat[column], when) for heat in (short, whole))
            assert own == pytest.approx(wanted, rel=within, abs=1e-12)


def test_the_motor_temperature_is_real_where_eigenvalues_have_a_complex_type(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As NumPy 2.5 gives them, whatever their values."""
    samples, eig = _heated(np.arange(0.0, 20.0, 0.01)), np.linalg.eig
    usual = motor_temperatures(samples, BENCH)[1]
    monkeypatch.setattr(np.linalg, "eig", lambda rates: tuple(own.astype(complex) for own in eig(rates)))
    warm = motor_temperatures(samples, BENCH)[1]
    assert warm.dtype == np.float64
    assert np.array_equal(warm, usual)


def test_the_motor_temperature_is_steady_after_decades() -> None:
    time = np.arange(0.0, 20.0, 0.01)
    time, warm, _ = motor_temperatures(_heated(np.concatenate([time, DECADES + time])), BENCH)
    assert len(time) < 2000
    heat = BENCH.value("motor_resistance") * 0.4**2
    outer, inner = (BENCH.value(name) for name in ("motor_thermal_resistance", "winding_thermal_resistance"))
    steady = 293.0 + heat * np.array([outer + inner, outer])
    assert interpolated(time, warm, DECADES + 15.0) == pytest.approx(steady, rel=1e-6)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    machine = hidden_machine(3, {"aero_cross": {"c": 0.006, "n": 1.98}})
    return record(tmp_path_factory.mktemp("run"), "run", machine, "quick")


def paused(recording: Recording, directory: Path, pause: float, share: float) -> Recording:
    """Write a recording again whose clock is set ahead somewhere, and read it."""

    def late(stamps: np.ndarray) -> Any:
        after = stamps - recording.start_ns > share * recording.duration * wire.SECOND
        return stamps + after * round(pause * wire.SECOND)

    setpoints = recording.setpoint.copy()
    setpoints["stamp_ns"] = late(setpoints["stamp_ns"])
    write_run(
        directory,
        recording.readings.array,
        np.column_stack([recording.command[name] for name in wire.COMMAND.fields]),
        setpoints,
        to_json(recording.environment),
        recording.bench_text,
        sample_period=BENCH.sample_period,
        stamps=late(recording.measurement["stamp_ns"]),
    )
    return Recording.open(directory)


@pytest.mark.parametrize("pause", [pytest.param(NIGHT, marks=pytest.mark.study), DECADES])
@pytest.mark.parametrize("share", [0.31, pytest.param(0.5, marks=pytest.mark.study)])
@pytest.mark.slow
def test_the_analysis_uses_both_sides_of_a_pause(
    recording: Recording, tmp_path: Path, pause: float, share: float
) -> None:
    late, model = paused(recording, tmp_path / "run", pause, share), Model.new()
    assert info(late).rate == pytest.approx(1.0 / BENCH.sample_period, rel=1e-3)
    ((at, length),) = late.integrity().stalls
    assert (at, length) == pytest.approx((share * recording.duration, pause), abs=0.01)
    found = diagnose([late], model)
    assert set(found.ties) == {"aero_cross"}
    (effect,) = found.effects
    assert abs(effect.coefficients["c"].value - 0.006) < 4.0 * effect.coefficients["c"].standard_error
    own, whole = (compare([each], model) for each in (late, recording))
    assert own.coverage.used == pytest.approx(whole.coverage.used, abs=2.0)
    for name, channel in whole.channels.items():
        assert own.channels[name].rms == pytest.approx(channel.rms, rel=0.2)
    settled, all_settled = (
        sum(
            1
            for _ in drag_estimates(
                each.measurement["stamp_ns"], each.readings, each.setpoint, model, settled=True
            )
        )
        for each in (late, recording)
    )
    assert settled == all_settled
    assert len(rates([late], model).time) == pytest.approx(len(rates([recording], model).time), abs=3)


@pytest.mark.parametrize("quantity", ["torque_x", "spin_torque", "motor_voltage"])
def test_the_instant_of_a_change_is_not_sought_in_a_pause(
    recording: Recording, tmp_path: Path, quantity: str
) -> None:
    """The instants between two windows are tried one by one; a pause of years had more of them than any memory."""
    late = samples_of(paused(recording, tmp_path / "run", DECADES, 0.31), incomplete=True)
    at = 0.31 * recording.duration
    assert onset(late, BENCH, (quantity,), at - 1.0, at + DECADES + 1.0) is None


@pytest.mark.parametrize("share", [0.003, 0.31, 0.999])
def test_no_law_with_a_memory_is_sought_across_a_pause(
    recording: Recording, tmp_path: Path, share: float
) -> None:
    """A pause before the first window had its motion followed for years, in more than 2 GB."""
    assert prepare([recording], Model.new()).problem.memory_terms
    late = paused(recording, tmp_path / "run", DECADES, share)
    problem = prepare([late], Model.new()).problem
    assert problem.measured.size
    assert not problem.memory_terms


def test_a_wrong_setup_shows_on_both_sides_of_a_pause(recording: Recording, tmp_path: Path) -> None:
    late = paused(recording, tmp_path / "run", DECADES, 0.31)
    assert not wrong_setups([late], BENCH)
    turned = late.measurement.copy()
    turned["tilt_y"] *= -1.0
    (wrong,) = wrong_setups([replace(late, measurement=turned)], BENCH)
    assert (wrong.kind, wrong.columns) == ("sign", ("tilt_y",))
