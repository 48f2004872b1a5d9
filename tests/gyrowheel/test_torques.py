"""The verb `torques` and its Python face: the parts of what coils and motor hold."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel_core.units import DEG, RPM

from .conftest import Wheel
from .helpers import Shell


def total(hold: dict[str, dict[str, dict[str, list[float]]]]) -> np.ndarray:
    return np.sum([part["coil"] for part in hold["parts"].values()], axis=0)


def test_parts_sum_to_the_simulated_torque_at_every_speed(gyrowheel: Shell) -> None:
    result = gyrowheel.good("torques", "--tilt", 3, "--speed", "1000..4000:1500", "--json", "-").json
    assert result["recordings"] == []
    holds = result["holds"]
    assert [round(hold["spin_rate"] / RPM) for hold in holds] == [1000, 2500, 4000]
    for hold in holds:
        assert math.hypot(*hold["tilt"]) == pytest.approx(3 * DEG, abs=1e-5)
        # 0.02 N m a volt, nothing but noise-free simulation
        assert total(hold) == pytest.approx(0.02 * np.array(hold["coil_voltage"]), abs=1e-6)
        assert total(hold) == pytest.approx(hold["coil_torque"], abs=1e-12)
    # published bench: the torque falls through the tuned speed
    assert [1e3 * hold["coil_torque"][0] for hold in holds] == pytest.approx([6.42, 3.20, -2.78], abs=0.02)


def test_the_air_is_a_part_and_a_vacuum_has_none(tmp_path: Path) -> None:
    model = gw.Model().details
    known = gw.Model.of(model.changed(
        {"what": "test"}, overrides={}, effects={"aero_cross": gw.effects["aero_cross"].defaults()}, effect_errors={}
    ))  # fmt: skip
    there, vacuum = (
        gw.torques(model=known, tilt=3 * DEG, spin_rate=3500 * RPM, air_density_ratio=density)
        for density in (1.0, 0.0)
    )
    cross = {part.name: part.coil[0] for part in there.parts}["aero_cross"]
    law = -1j * gw.effects["aero_cross"].defaults()["c"] * math.tan(3 * DEG)
    assert cross == pytest.approx(law, rel=0.02)
    left = {part.name: part.coil[0] for part in vacuum.parts}["aero_cross"]
    assert abs(left) < 1e-3 * abs(cross)


def test_in_orbit_air_weight_and_earth_rate_have_no_torque(gyrowheel: Shell, tmp_path: Path) -> None:
    names = ("aero_restoring", "windage", "gravity_offset", "earth_rate", "cubic_stiffness")
    effects = ""
    for name in names:
        values = (
            f"{key}: {{value: {v}, standard_error: 0}}" for key, v in gw.effects[name].defaults().items()
        )
        effects += f"  {name}: {{{', '.join(values)}}}\n"
    model = tmp_path / "wheel.yaml"
    model.write_text(f"schema: 1\nbench: gyrowheel\neffects:\n{effects}")
    hold = ["torques", "--model", model, "--tilt", 3, "--speed", 3500]
    (ground,), (orbit,) = (
        gyrowheel.good(*hold, *place, "--json", "-").json["holds"] for place in ([], ["--orbit"])
    )
    for name in names:
        here, there = (
            np.abs([*h["parts"][name]["coil"], h["parts"][name]["motor"]]).max() for h in (ground, orbit)
        )
        assert here > 1e-6
        assert there == (pytest.approx(here, rel=1e-3) if name == "cubic_stiffness" else 0.0)
    assert total(orbit) == pytest.approx(0.02 * np.array(orbit["coil_voltage"]), abs=1e-6)
    for part in ("flexure_stiffness", "gimbal_inertia", "bearing"):
        assert orbit["parts"][part]["coil"] == pytest.approx(
            ground["parts"][part]["coil"], rel=1e-3, abs=1e-7
        )
    # without the drag of the air the motor is further from its limit
    assert 0.5 < ground["margin"]["motor"] < orbit["margin"]["motor"] < 1.0
    assert orbit["margin"]["motor"] == pytest.approx(1.0 - orbit["motor_voltage"] / 28.0)
    said = gyrowheel.good(*hold, "--orbit").out
    assert "In orbit" in said
    assert "left, motor" in said


def test_a_recording_shows_the_unexplained_torque(gyrowheel: Shell, wheel: Wheel, tmp_path: Path) -> None:
    picture = tmp_path / "torques.png"
    arguments = ["torques", wheel.recording, "--model", wheel.model, "--picture", picture]
    text = gyrowheel.good(*arguments).out
    assert "beyond the model" in text
    assert max(len(line) for line in text.splitlines() if "picture" not in line) <= 80
    assert picture.read_bytes().startswith(b"\x89PNG")
    result = gw.torques(wheel.recording, gw.Model.load(wheel.model))
    assert len(result) == 8
    # windage of 1.3 mN m at 3500 rpm is in the machine and not in the model
    fast = result.spin_rate > 3400 * RPM
    assert result.remainder_motor[fast] == pytest.approx(1.3e-3, abs=0.25e-3)
    assert np.abs(result.remainder_coil).max() < 0.15e-3


def test_the_result_has_headline_page_and_columns(wheel: Wheel) -> None:
    result = gw.torques(wheel.recording, gw.Model.load(wheel.model))
    assert result.headline().startswith("8 holds; coils supply up to")
    assert "joint ripple" in result._repr_html_()
    columns = result.to_columns()
    parts = [
        name
        for name in columns
        if name.endswith("_coil_x") and name not in ("all_coil_x", "remainder_coil_x")
    ]
    assert np.sum([columns[name] for name in parts], axis=0) == pytest.approx(
        columns["all_coil_x"], abs=1e-15
    )
    assert len(result.plot().axes) == 3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--tilt", "three"], ["--tilt", "three", "0..5"]),
        (["--speed", "1000..4000:-5"], ["--speed", "1000..4000:-5"]),
        (["--tilt", "nan"], ["--tilt", "nan"]),
        (["--tilt", "9"], ["tilt", "9"]),
        (["--speed", "99999"], ["spin"]),
        (["--orbit", "--density", "0.5"], ["orbit", "density"]),
        (["--orbit", "--inverted"], ["orbit", "inverted"]),
        (["--tilt", "0..5:0.01", "--speed", "1000..4000:10"], ["holds", "500"]),
    ],
)
def test_holds_beyond_the_limits_are_refused(
    gyrowheel: Shell, arguments: list[str], words: list[str]
) -> None:
    result = gyrowheel("torques", *arguments)
    assert result.code == 2
    assert len(result.err.strip().splitlines()) == 1
    assert all(word in result.err for word in words), result.err
