"""What recordings may be given to the verbs that fit and validate, and what is said of those that may not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel_core import wire
from gyrowheel_recording.bags import Recording, write_run
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import to_json

from .conftest import Wheel
from .helpers import Shell


@pytest.mark.parametrize("verb", ["diagnose", "add"])
def test_a_recording_that_is_fitted_cannot_validate(gyrowheel: Shell, wheel: Wheel, verb: str) -> None:
    again = wheel.recording.parent / "." / wheel.recording.name
    arguments = {
        "diagnose": ["diagnose", wheel.recording],
        "add": ["model", "add", "windage", "--fit", wheel.recording],
    }[verb]
    before = wheel.model.read_bytes()
    result = gyrowheel(*arguments, "--model", wheel.model, "--validate", again)
    assert result.code == 2
    assert f"validate: {again}: a recording that is fitted cannot validate the fit" in result.err
    assert len(result.err.strip().splitlines()) == 1
    assert wheel.model.read_bytes() == before


def test_a_recording_of_another_bench_is_refused(gyrowheel: Shell, wheel: Wheel, tmp_path: Path) -> None:
    gyrowheel.good("model", "new", "--bench", "dtg", "--model", tmp_path / "gyro.yaml")
    for verb in ("compare", "diagnose"):
        result = gyrowheel(verb, wheel.recording, "--model", tmp_path / "gyro.yaml")
        assert result.code == 2
        assert "is of bench gyrowheel, " in result.err
        assert "gyro.yaml of bench dtg: " in result.err


@pytest.mark.slow
def test_nan_readings_do_not_stop_the_analysis(gyrowheel: Shell, wheel: Wheel, tmp_path: Path) -> None:
    """Once it ended in a traceback, and with 1, which also means that something was found."""
    whole = Recording.open(wheel.recording)
    commands = np.column_stack([whole.command[name] for name in wire.COMMAND.fields if "voltage" in name])
    for name, rows, code in (("tilt_x", slice(5000, 5001), 0), ("tilt_y", slice(None), 2)):
        readings = whole.readings.copy()
        readings[name][rows] = float("nan")
        write_run(
            tmp_path / name,
            readings.array,
            commands,
            whole.setpoint,
            to_json(whole.environment),
            whole.bench_text,
            sample_period=Bench.load().sample_period,
        )
        result = gyrowheel("compare", tmp_path / name, "--model", wheel.model)
        assert result.code == code, result.err
        assert "Warning" not in result.err
    assert f"{tmp_path / name}: {name}: no reading is a number; " in result.err


@pytest.mark.study  # test_event_laws.py has laws in place of events
@pytest.mark.slow
def test_a_large_unknown_law_in_the_validation_is_reported_as_such_and_not_as_events() -> None:
    """Steps and bursts describe a part of it, and leave far more than noise."""
    law = gw.own_effect("k*tanh(20*abs(z))*cos(3*r)*cos(40*re(z))", target="axial_torque", name="odd")
    fitted, unused = gw.simulate("quick", machine=3), gw.simulate("check", effects=[law], machine=3, seed=4)
    found = gw.diagnose(fitted, gw.Model(), validate=unused, mixed=True).to_dict()
    assert found["events"] == []
    assert found["verdict"] == "unknown"
    assert found["proof"]["proven"] is False
