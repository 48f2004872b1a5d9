"""Recordings that lack what a logger did not have, or hold what no bench can read: every verb answers, or refuses."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel.workbench import pictures
from gyrowheel.workbench.library import Library
from gyrowheel.workbench.session import Session
from gyrowheel_core import wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import json_text
from gyrowheel_recording.bags import write_run
from gyrowheel_recording.mislabelled.find import wrong_setups
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import to_json

from ..fuzz.recordings import machine_recording

COILS = ("coil_voltage_x", "coil_voltage_y")
PERIOD = 5e-4  # s
MOTOR = ("motor_voltage", "motor_current")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> gw.Recording:
    return gw.Recording.open(machine_recording(tmp_path_factory.mktemp("runs") / "run", lacking=True).path)


def changed(run: gw.Recording, **values: Any) -> gw.Recording:
    """Return the recording with some readings in place of its own, in all samples or from some sample on."""
    measurement = run.data.measurement.copy()
    for name, value in values.items():
        measurement[name] = value
    return gw.Recording(Path("run"), replace(run.data, measurement=measurement))


def asked(run: gw.Recording) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield everything that can be asked of a recording."""
    model = gw.Model("gyrowheel")
    verbs: tuple[Callable[..., Any], ...] = (
        gw.compare,
        gw.diagnose,
        gw.rate,
        gw.torques,
        gw.drag,
        gw.calibrate,
    )
    for verb in verbs:
        yield verb.__name__, functools.partial(verb, run, model)
    yield "add", lambda: model.add("aero_cross", fit=run)


@pytest.mark.slow
@pytest.mark.parametrize(
    "absent",
    [
        COILS,
        *(
            pytest.param(own, marks=pytest.mark.study)
            for own in (MOTOR, COILS[:1], (*COILS, "motor_current"))
        ),
    ],
    ids="+".join,
)
def test_every_verb_answers_or_refuses_where_columns_are_missing(
    run: gw.Recording, absent: tuple[str, ...]
) -> None:
    less = changed(run, **dict.fromkeys(absent, np.nan))
    answered = []
    for name, ask in asked(less):
        try:
            found = ask()
        except InputError:  # anything else fails
            continue
        answered.append(name)
        assert json_text(found.to_dict())
        assert str(found)
        if name == "compare":
            assert found.plot().axes
    assert {"compare", "diagnose", "add"} <= set(answered)


def test_no_coil_torque_without_coil_voltages(run: gw.Recording) -> None:
    model = gw.Model("gyrowheel")
    found = gw.compare(changed(run, **dict.fromkeys(COILS, np.nan)), model).to_dict()
    assert set(found["error"]["raw"]["rms"]) == {"spin"}
    assert not any(name.startswith("tilt") for name in found["channels"])
    calibrated = gw.calibrate(changed(run, **dict.fromkeys(COILS, np.nan)), model)
    assert "coil_constant" in calibrated.undetermined


def written(
    run: gw.Recording, folder: Path, readings: np.ndarray, commands: np.ndarray | None = None
) -> Path:
    """Write the recording with other readings and commands."""
    data = run.data
    own = np.column_stack([data.command[name] for name in wire.COMMAND.fields])
    return write_run(
        folder,
        readings,
        own if commands is None else commands,
        data.setpoint,
        to_json(data.environment),
        data.bench_text,
        sample_period=PERIOD,
        stamps=data.measurement["stamp_ns"],
    )


def place(name: str) -> int:
    return wire.MEASUREMENT.fields.index(name)


@pytest.mark.study  # NaN counts as missing above
@pytest.mark.slow
def test_an_impossible_reading_counts_as_missing(run: gw.Recording, tmp_path: Path) -> None:
    """A logger writes 1e30, or zero kelvin, where a sensor gives nothing."""
    readings = run.data.readings.array.copy()
    readings[2000:2100, place("tilt_x")] = 1e30
    readings[9000:12000, place("air_temperature")] = 0.0
    commands = np.column_stack([run.data.command[name] for name in wire.COMMAND.fields])
    commands[500:600] = -3e38
    odd = gw.Recording.open(written(run, tmp_path / "odd", readings, commands))
    assert odd.info.integrity.not_finite == 100
    assert np.isnan(odd.data.measurement["tilt_x"][2000:2100]).all()
    assert np.isnan(odd.data.command["coil_voltage_x"][500:600]).all()
    assert np.array_equal(odd.data.measurement["air_temperature"], readings[:, place("air_temperature")])
    model = gw.Model("gyrowheel")
    own, whole = (gw.compare(each, model).to_dict()["channels"] for each in (odd, run))
    for name, channel in whole.items():
        assert own[name]["rms"] == pytest.approx(channel["rms"], rel=0.3)
    assert {effect.name for effect in gw.diagnose(odd, model).effects} == {"aero_cross"}


def test_a_workbench_shows_a_recording_without_the_voltages_of_the_coils(
    run: gw.Recording, tmp_path: Path
) -> None:
    readings = run.data.readings.array.copy()
    readings[:, [place(name) for name in COILS]] = np.nan
    written(run, tmp_path / "less", readings)
    session = Session(Library([tmp_path]), gw.Model())
    try:
        session.open("0/less", "fitted")
        session.wait(240.0)
        session.compare()
        session.wait(240.0)
        assert session.trouble is None
        found = pictures.found(session)
        assert found["windows"]["of_coils"] is False
        assert "spin" in found["windows"]["chi2"]
        assert "tilt" not in found["windows"]["chi2"]
        assert json_text(found)
    finally:
        session.shut()


def test_a_recording_of_a_few_samples_a_second_is_refused(run: gw.Recording) -> None:
    slow = changed(run, stamp_ns=run.data.measurement["stamp_ns"] * 200)
    for verb in (gw.compare, gw.diagnose, gw.rate):
        with pytest.raises(InputError, match=r"a sample every 100 ms; allowed: 0\.005 \.\. 50 ms"):
            verb(slow, gw.Model("gyrowheel"))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(("name", "factor"), [("motor_voltage", 1e6), ("motor_current", 1e4)])
def test_absurd_readings_cause_no_traceback(run: gw.Recording, name: str, factor: float) -> None:
    """Where numbers overflow in the fit, it stays where it is, or says so."""
    odd = changed(run, **{name: run.data.measurement[name] * factor})
    try:
        found = gw.compare(odd, gw.Model("gyrowheel")).to_dict()
    except InputError:
        return
    assert json_text(found)


def test_negative_gauge_pressure_and_celsius_are_readings(run: gw.Recording, tmp_path: Path) -> None:
    """The bias of a gauge shows in a vacuum, and a cold room in degrees Celsius is still told by its unit."""
    readings = run.data.readings.array.copy()
    readings[:, place("air_pressure")] = -30.0
    readings[:, place("air_temperature")] = -8.0
    cold = gw.Recording.open(written(run, tmp_path / "cold", readings)).data
    assert cold.integrity().complete
    assert np.all(cold.readings.air_pressure == -30.0)
    (wrong,) = wrong_setups([cold], Bench.load())
    assert (wrong.kind, wrong.columns, wrong.unit) == ("unit", ("air_temperature",), "deg C")
