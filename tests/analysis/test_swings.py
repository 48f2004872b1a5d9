"""Disturbances that swing to and fro: named with period and size, in every recording, and taken for no law."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrowheel.show.sentences.findings import shape_sentences
from gyrowheel_analysis.diagnosis.dated_changes import DriftShape
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.mean_rates import Acts, share_of_swing

from .machines import found_in, hidden_machine, record

_SIZES = {"spin_torque": "on the spin", "torque_x": "about case x", "coil_gain": "torque per volt"}


@pytest.mark.slow
@pytest.mark.parametrize("plan", [pytest.param("survey", marks=pytest.mark.study), "quick"])
@pytest.mark.parametrize(
    ("target", "channel", "size", "period"),
    [
        pytest.param("shaft_torque", "spin_torque", "4e-4 [N*m]", 4.0, id="spin"),
        pytest.param("torque", "torque_x", "4e-4 [N*m]", 2.6, id="tilt", marks=pytest.mark.study),
        pytest.param("coil_gain", "coil_gain", "0.004 [1]", 7.0, id="gain", marks=pytest.mark.study),
    ],
)
def test_what_swings_faster_than_a_hold_is_long_is_named_with_period_and_size(
    target: str, channel: str, size: str, period: float, plan: str, tmp_path: Path
) -> None:
    found = found_in(
        f"{target} = a*sin(w*t); a = {size}; w = {2.0 * math.pi / period} +- 0.001 [1/s]", plan, tmp_path
    )
    (shape,) = found.drift_shapes
    assert (shape.kind, shape.channel, shape.also_in) == ("swing", channel, ("check",))
    assert abs(shape.time - period) < 0.01 * period
    assert abs(shape.size) == pytest.approx(float(size.split()[0]), rel=0.05)
    assert not [*found.laws, *found.events, *found.effects, *found.free_form]
    assert found.proof is not None
    assert found.proof.proven
    assert found.proof.otherwise > 2.0 * found.proof.allowed
    assert _SIZES[channel] in found.sentence
    assert "also in check" in found.sentence


@pytest.mark.slow
def test_what_swings_in_one_recording_alone_is_not_taken_from_another(tmp_path: Path) -> None:
    machine = hidden_machine(31, {})
    check = record(tmp_path, "check", machine, "check", noise_seed=32)
    fit = record(tmp_path, "fit", machine, "quick")
    measurement = fit.measurement.copy()
    measurement["coil_voltage_x"] += 0.03 * np.sin(1.2 * fit.time)
    found = diagnose([replace(fit, measurement=measurement)], Model.new(), validate=[check], quick=True)
    (shape,) = found.drift_shapes
    assert shape.also_in == ()
    assert found.proof is not None
    assert found.proof.proven
    assert found.proof.swinging == ()


@pytest.mark.study
def test_a_torque_that_swings_is_no_map(tmp_path: Path) -> None:
    law = "torque = a*(sin(t/b) + i*cos(0.86*t/b)); a = 0.0003 [N*m]; b = 7 +- 0.1 [s]"
    found = found_in(law, "survey", tmp_path)
    assert found.map is None
    assert {shape.kind for shape in found.drift_shapes} == {"swing"}


@pytest.mark.parametrize("acts", ["reading", "tilt", "spin"])
def test_a_window_shows_all_of_a_slow_swing_and_less_of_a_fast_one(acts: Acts) -> None:
    slow, fast = share_of_swing(np.array([1.0e-4, 2.0]), acts)
    assert slow == pytest.approx(1.0, abs=1e-7)
    assert fast < 0.9


def test_the_mean_of_a_reading_that_swings_falls_as_that_of_a_sine_does() -> None:
    angle = np.linspace(0.1, 2.7, 9)
    assert share_of_swing(angle, "reading") == pytest.approx(np.sin(angle) / angle, rel=1e-9)


def test_both_axes_of_a_swing_share_a_sentence() -> None:
    along_x = DriftShape("fit", "swing", "torque_x", 4.0e-4, 1.0e-5, "N*m", 5.0, 0.01, 0.0, 90.0, ("check",))
    along_y = replace(along_x, channel="torque_y", time=5.005)
    slower = replace(along_x, time=9.0)
    one, other = shape_sentences([along_x, along_y, slower])
    assert one.count("mN·m") == 2
    assert "swing to and fro with a period of 5.00(1) s, also in check." in one
    assert "swings to and fro with a period of 9.00(1) s" in other
