"""Instruments that are not as stated: named as what they are, or tied; nothing physical is invented for them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter

from gyrowheel.show.sentences.diagnosis import verdict_sentence
from gyrowheel_analysis.add import add_effect
from gyrowheel_analysis.channels import in_groups
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.diagnosis.result import Diagnosis
from gyrowheel_analysis.fitting.preparation import prepare
from gyrowheel_analysis.model import Model
from gyrowheel_core.arrays import one_thread
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.effects import EffectValues, get, physical
from gyrowheel_sim.effects.targets import TARGETS

from .machines import BENCH, hidden_machine, record

COILS = ("coil_voltage_x", "coil_voltage_y")
TILTS = ("tilt_x", "tilt_y")
#: What is hidden in the plant, and what else may be named for it.
WRONG: dict[str, tuple[EffectValues, tuple[str, ...]]] = {
    "tilt_late": ({"tilt_delay": {"d": 2.0e-4}}, ("tilt_filter",)),
    "tilt_early": ({"tilt_delay": {"d": -2.0e-4}}, ()),
    "coil_early": ({"coil_voltage_delay": {"d": -4.5e-4}}, ()),
    "coil_late": ({"coil_voltage_delay": {"d": 3.0e-4}}, ("coil_voltage_filter",)),
    "angle_late": ({"spin_angle_delay": {"d": 3.0e-4}}, ("encoder_zero",)),
    "tilt_filter": ({"tilt_filter": {"t_f": 4.0e-4}}, ("tilt_delay",)),
    "coil_filter": ({"coil_voltage_filter": {"t_f": 4.0e-4}}, ("coil_voltage_delay",)),
    "zero": ({"encoder_zero": {"E_0": 0.05}}, ("spin_angle_delay",)),
    "once": ({"encoder_once": {"E_x": 2.0e-3, "E_y": -1.0e-3}}, ()),
    "twice": ({"encoder_twice": {"E_x": 2.0e-3, "E_y": -1.0e-3}}, ()),
    "cubic": ({"tilt_nonlinearity": {"q": 2.5}}, ()),
    "cross_talk": ({"tilt_cross_talk": {"c": 0.015}}, ()),
}


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Return a recording of a machine with nothing hidden in it."""
    return record(tmp_path_factory.mktemp("run"), "run", hidden_machine(11, {}), "quick")


def changed(recording: Recording, names: tuple[str, ...], by: Any) -> Recording:
    """Return a recording in which what was read of some quantities is different; its ends are left out."""
    measurement = recording.measurement.copy()
    for name in names:
        measurement[name] = by(measurement[name])
    return replace(recording, measurement=measurement[400:-400])


def through(response: Any) -> Any:
    """Return what a response by the complex frequency makes of a reading."""

    def applied(x: Any) -> Any:
        # mirrored at its end, so that it does not jump
        both = np.concatenate([x, x[::-1]])
        s = 2j * np.pi * np.fft.rfftfreq(len(both), BENCH.sample_period)
        return np.fft.irfft(np.fft.rfft(both) * response(s), len(both))[: len(x)]

    return applied


def nothing_invented(found: Diagnosis, channel: str) -> None:
    """Check that instruments of one channel are named, and nothing else."""
    assert found.instruments, verdict_sentence(found)
    assert {f.channel for f in found.instruments} == {channel}, verdict_sentence(found)
    assert not found.effects, verdict_sentence(found)
    assert not found.free_form, verdict_sentence(found)


#: The others are a study.
EVERY_TIME = ("tilt_late",)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in EVERY_TIME else [pytest.mark.study]) for name in WRONG]
)
def test_an_instrument_that_is_not_as_stated_is_named(name: str, tmp_path: Path) -> None:
    truth, others = WRONG[name]
    ((own, values),) = truth.items()
    machine = hidden_machine(seed=60 + list(WRONG).index(name), effects=truth)
    fit = record(tmp_path, "fit", machine, "quick")
    found = diagnose([fit], Model.new())
    assert not found.effects, verdict_sentence(found)
    assert not found.free_form
    (named,) = found.ties
    tied = {tie.name for tie in found.ties[named]}
    assert named == own or (named in others and own in tied), verdict_sentence(found)
    if named == own:
        parameters = [entry.of for law in get(own).laws for entry in TARGETS[law.target].enters]
        for finding, value, parameter in zip(found.instruments, values.values(), parameters, strict=True):
            # the machine has instruments of its own, within what is stated; the effect adds to that
            stated = BENCH.value(parameter)
            own_error = machine.values.get(parameter, stated) - stated
            assert abs(finding.deviation - value - own_error) < 4.0 * finding.standard_error


@pytest.mark.slow
@pytest.mark.parametrize(("channel", "order"), [("tilt", 3), ("coil_voltage", 2)])
@pytest.mark.study
def test_filter_of_another_shape_gives_no_physical_finding(
    plain: Recording, channel: str, order: int
) -> None:
    b, a = butter(order, 2.0 * np.pi * 400.0, analog=True)
    names = TILTS if channel == "tilt" else COILS
    read = changed(plain, names, through(lambda s: np.polyval(b, s) / np.polyval(a, s)))
    nothing_invented(diagnose([read], Model.new()), channel)


@pytest.mark.slow
def test_early_voltage_readings_are_found_as_a_delay_not_an_inductance(plain: Recording) -> None:
    found = diagnose([changed(plain, (*COILS, "motor_voltage"), lambda v: np.roll(v, -1))], Model.new())
    nothing_invented(found, "coil_voltage")
    (delay,) = found.instruments
    assert delay.quantity == "delay"
    assert abs(delay.value + BENCH.sample_period) < 4.0 * delay.standard_error


@pytest.mark.study  # each is found alone above
@pytest.mark.slow
def test_an_effect_and_an_instrument_are_both_found(tmp_path: Path) -> None:
    truth = {"aero_cross": physical()["aero_cross"].defaults(), "tilt_delay": {"d": -2.5e-4}}
    found = diagnose([record(tmp_path, "fit", hidden_machine(72, truth), "quick")], Model.new())
    assert set(found.ties) == set(truth), verdict_sentence(found)


@pytest.mark.slow
def test_an_instrument_that_was_found_goes_into_the_model(plain: Recording) -> None:
    early = changed(plain, (*COILS, "motor_voltage"), lambda v: np.roll(v, -1))  # that above, which is known
    added = add_effect(Model.new(), ["coil_voltage_delay"], [early])
    assert abs(added.model.effects["coil_voltage_delay"]["d"] + BENCH.sample_period) < 5.0e-5
    again = diagnose([early], added.model)
    assert again.verdict == "nothing_missing", verdict_sentence(again)


@pytest.mark.slow
def test_what_a_filter_takes_from_a_reading_is_put_back_with_its_noise(tmp_path: Path) -> None:
    filters = {"tilt_filter_time": 3e-3, "motor_voltage_filter_time": 3e-3, "motor_current_filter_time": 1e-3}
    bench = BENCH.with_values(filters)
    machine = replace(hidden_machine(11, {}), values=bench.values())
    recording = record(tmp_path, "run", machine, "quick", bench=bench)
    with one_thread():
        problem = prepare([recording], replace(Model.new(), stated_bench=bench)).problem
        residual = problem.measured - problem.predict(problem.fit(()).point)
    (balance,), deviations = problem.balances, problem.noise.deviation()
    for channel in in_groups("revolution", "ripple"):
        parts = [(residual / deviations)[balance.row(name)] for name in channel.rows]
        assert 0.75 < np.sqrt(np.mean(np.square(parts))) < 1.25, channel.rows
