"""The wheel as a rate sensor: rates of a turning case from torques, against what the table was told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gyrowheel_analysis.model import Model
from gyrowheel_analysis.rate_sensor import rates
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG
from gyrowheel_sim.plant.scenario import Scenario

from .machines import hidden_machine, record

STILL = """
schema: 1
name: still
segments:
  - {spin_rpm: 3500, tilt_deg: [[0, 0], [1, 0]], hold_s: 1.5}
"""


def test_rates_of_the_table_are_measured(tmp_path: Path) -> None:
    exact = Scenario.nominal(noise_seed=4)
    result = rates([record(tmp_path, "turns", exact, "rate_table")], Model.new())
    assert np.abs(result.reference).max() == pytest.approx(2.0 * DEG)
    assert np.abs((result.rate - result.reference) / result.standard_error).max() < 4.0
    for line in result.lines:
        assert line is not None
        assert abs(line.scale - 1.0) < 4.0 * line.scale_error < 0.01
        assert abs(line.bias) < 5.0 * line.bias_error


def test_a_wrong_constant_of_the_coils_is_a_scale_error(tmp_path: Path) -> None:
    """The torque of the rotor's momentum is known; a volt that gives three per cent more of it reads as less rate."""
    strong = Scenario(values={"coil_constant": 0.0206}, effects={}, noise_seed=4)
    result = rates([record(tmp_path, "turns", strong, "rate_table")], Model.new())
    for line in result.lines:
        assert line is not None
        assert line.scale == pytest.approx(1.0 / 1.03, abs=4.0 * line.scale_error)


def test_a_rate_fixed_in_the_room_changes_sign_with_the_rig(tmp_path: Path) -> None:
    """As the Earth's does, but ten times as fast, so that the drift of the coils does not hide it."""
    truth = {"earth_rate": {"E_x": 5.0e-4, "E_y": -3.0e-4}}
    recording = record(tmp_path, "yaw", Scenario.nominal(truth, noise_seed=2), "yaw")
    result = rates([recording], Model.new())
    assert result.lines == (None, None)
    home, yawed = result.time < 16.5, (result.time > 17.0) & (result.time < 33.0)
    found = 0.5 * (result.rate[home].mean(axis=0) - result.rate[yawed].mean(axis=0))
    np.testing.assert_allclose(found, [5.0e-4, -3.0e-4], atol=1.0e-4)


def test_rates_hardly_depend_on_controller_and_machine(tmp_path: Path) -> None:
    result = rates([record(tmp_path, "turns", hidden_machine(31, {}), "rate_table")], Model.new())
    for line in result.lines:
        assert line is not None
        assert line.scale == pytest.approx(1.0, abs=0.06)  # coils 2 %, momentum 0.5 %


def test_a_still_rig_has_rates_but_no_calibration(tmp_path: Path) -> None:
    recording = record(tmp_path, "still", Scenario.nominal(), Plan.load(STILL))
    result = rates([recording], Model.new())
    assert result.lines == (None, None)
    assert len(result.to_json()["windows"]) == len(result.time) > 0
    with pytest.raises(InputError, match="no recording"):
        rates([], Model.new())
