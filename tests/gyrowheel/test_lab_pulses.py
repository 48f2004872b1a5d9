"""A lab's table with pulses of a Hall sensor or an index mark where others have an angle."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gyrowheel as gw

from . import lab_tables as lab
from .helpers import Shell

pytestmark = pytest.mark.slow

HIDDEN = "commutation_ripple"
TURN = 2.0 * np.pi


@pytest.fixture(scope="module")
def original() -> gw.Recording:
    return gw.simulate("check", effects={HIDDEN: {}}, machine=6)


@pytest.fixture(scope="module")
def measurement(original: gw.Recording) -> Any:
    return original.data.measurement


def pulsed(
    measurement: Any, name: str, pulses: int, *, every: int = 1, rows: int | None = None
) -> tuple[lab.Columns, dict[str, str]]:
    """Return the columns of a lab whose angle is a signal of pulses, or a count of them."""
    columns, units = lab.lab_columns(measurement[:rows], every=every, without=["spin_angle"])
    turned = np.unwrap(measurement["spin_angle"][:rows])[::every] * pulses / TURN
    if "count" in name:
        columns[name], units[name] = np.floor(turned), "-"
    else:
        columns[name], units[name] = np.where(np.mod(turned, 1.0) < 0.3, 4.9, 0.1), "V"
    return columns, units


@pytest.mark.parametrize(("name", "pulses"), [("Index", 1), ("Hall A", 3), ("AI7", 1), ("Hall count", 6)])
def test_pulses_are_recognised_and_counted(measurement: Any, tmp_path: Path, name: str, pulses: int) -> None:
    columns, units = pulsed(measurement, name, pulses, every=2, rows=12000)
    suggested = gw.suggest_map(lab.write_text(tmp_path / "lab.csv", columns, units))
    assert suggested.settled, suggested.questions
    source = suggested.content["columns"]["spin_angle"]
    assert (source["column"], source["pulses"]) == (f"{name} [{units[name]}]", pulses)
    recording = gw.read_table(tmp_path / "lab.csv", suggested)
    found, step = recording.data.measurement["spin_angle"], TURN / pulses
    off = np.remainder(found - measurement["spin_angle"][:12000:2] + 0.5 * step, step) - 0.5 * step
    origin = recording.data.origins["spin_angle"]
    assert origin.pulses == pulses
    assert float(np.sqrt(np.mean(off**2))) < 3.0 * origin.uncertainty < 0.3


def test_pulses_without_a_speed_are_asked_for(measurement: Any, tmp_path: Path) -> None:
    columns, units = pulsed(measurement, "Hall", 3, every=2, rows=12000)
    del columns["Speed"]
    suggested = gw.suggest_map(lab.write_text(tmp_path / "lab.csv", columns, units))
    assert any("Set `pulses:`" in question for question in suggested.questions)
    content = copy.deepcopy(dict(suggested.content))
    content["columns"]["spin_angle"]["pulses"] = 3
    found = gw.read_table(tmp_path / "lab.csv", content).data
    assert np.isnan(found.measurement["spin_rate"]).all()
    assert np.isfinite(found.measurement["spin_angle"]).all()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            {"pulses": 2},
            r"column 'Hall \[V\]': by 2 pulses a turn the speed reads .*; allowed: 2% between them",
        ),
        ({"level": 40.0}, r"column 'Hall \[V\]': 0 rising edges; allowed: 8 or more"),
        ({"pulses": 0}, r"columns\.spin_angle.*unit: missing"),
        ({"pulses": -1}, r"columns\.spin_angle\.pulses: -1"),
    ],
)
def test_pulses_that_cannot_be_are_refused(
    measurement: Any, tmp_path: Path, change: dict[str, float], told: str
) -> None:
    columns, units = pulsed(measurement, "Hall", 1, every=2, rows=6000)
    file = lab.write_text(tmp_path / "lab.csv", columns, units)
    content = copy.deepcopy(dict(gw.suggest_map(file).content))
    content["columns"]["spin_angle"] |= change
    with pytest.raises(gw.InputError, match=told):
        gw.read_table(file, content)


def test_two_files_of_two_loggers_are_one_recording(
    measurement: Any, tmp_path: Path, gyrowheel: Shell
) -> None:
    """The motor is logged at half the rate, by a clock that is 0.25 s ahead."""
    columns, units = lab.lab_columns(measurement)
    motor = {name: columns[name][::2] for name in ("Time", "Motor voltage", "Motor current")}
    motor["Time"] = motor["Time"] + 0.25
    rest = {name: values for name, values in columns.items() if "Motor" not in name}
    files = [
        lab.write_text(tmp_path / "wheel.csv", rest, units),
        lab.write_text(tmp_path / "drive.csv", motor, units),
    ]
    names, made = [str(file) for file in files], tmp_path / "loggers.yaml"
    assert gyrowheel.good("import", *names, "--suggest", "-o", str(made))
    suggested = gw.suggest_map(files)
    assert suggested.settled, suggested.questions
    (offset,) = suggested.content["clocks"].values()
    assert offset == pytest.approx(-0.25, abs=0.005)
    assert suggested.content["columns"]["motor_current"]["clock"] == "drive/Time [s]"
    rows = gw.read_table(files, suggested).data.measurement
    assert np.isfinite(rows["motor_current"]).all()
    assert len(measurement) - len(rows) < 600
    assert gyrowheel.good("import", *names, "--map", str(made), "-o", str(tmp_path / "run"))
    assert (gw.Recording.open(tmp_path / "run").data.measurement == rows).all()


@pytest.mark.study
@pytest.mark.parametrize(("every", "pulses"), [(1, 1), (2, 1), (2, 3)])
def test_synchronous_effects_are_found_by_pulses(
    original: gw.Recording, measurement: Any, tmp_path: Path, every: int, pulses: int
) -> None:
    columns, units = pulsed(measurement, "Hall", pulses, every=every)
    recording = gw.read_table(lab.write_text(tmp_path / "lab.csv", columns, units))
    found = [gw.diagnose(own, gw.Model("gyrowheel")) for own in (recording, original)]
    by_pulses, by_angle = (own.to_dict()["effects"] for own in found)
    assert [own["name"] for own in by_pulses] == [HIDDEN]
    for name, own in by_pulses[0]["coefficients"].items():
        other = by_angle[0]["coefficients"][name]
        error = np.hypot(own["standard_error"], other["standard_error"])
        assert abs(own["value"] - other["value"]) < 4.0 * error, name
    assert found[0].error is not None
    assert max(row.chi2_per_n for row in found[0].error.after.channels.values()) < 2.2
    # without an angle nothing of it shows
    del columns["Hall"]
    bare = gw.read_table(lab.write_text(tmp_path / "bare.csv", columns, units))
    assert gw.diagnose(bare, gw.Model("gyrowheel")).verdict != "effect"


def test_two_loggers_of_which_one_counts_from_1970_are_asked_about(measurement: Any, tmp_path: Path) -> None:
    """No offset between their clocks shows, and nothing as long as their distance is made."""
    columns, units = lab.lab_columns(measurement)
    motor = {name: columns[name][::2] for name in ("Time", "Motor voltage", "Motor current")}
    motor["Time"] = motor["Time"] + 1.7e9
    rest = {name: values for name, values in columns.items() if "Motor" not in name}
    files = [
        lab.write_text(tmp_path / "wheel.csv", rest, units),
        lab.write_text(tmp_path / "drive.csv", motor, units),
    ]
    suggested = gw.suggest_map(files)
    assert not suggested.settled
    assert any("drive/Time [s]" in question for question in suggested.questions)
