"""Bench files in other units than SI, or in wrong ones; and the names of groups."""

from __future__ import annotations

import json
import math
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
import yaml

from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench

DEFAULT = Bench.load()


def edited(name: str, **fields: Any) -> str:
    """Return the text of the default bench file with fields of one parameter replaced; None removes one."""
    text = resources.files("gyrowheel_sim").joinpath("config/bench.yaml").read_text(encoding="utf-8")
    content = yaml.safe_load(text)
    entry = {**content["parameters"][name], **fields}
    content["parameters"][name] = {key: value for key, value in entry.items() if value is not None}
    return yaml.safe_dump(content)


@pytest.mark.parametrize(
    ("name", "unit", "value", "uncertainty", "expected", "deviation"),
    [
        ("tilt_limit", "deg", 5, 0.18, math.radians(5.0), math.radians(0.18)),
        ("spin_rate_maximum", "rpm", 4000, 30, 4000 * math.pi / 30, math.pi),
        ("spin_rate_maximum", "turn/s", 50, 0, 100 * math.pi, 0.0),
        ("rotor_inertia_z", "mg*m^2", 1779, 8.9, 1.779e-3, 8.9e-6),
        ("rotor_inertia_z", "mg*m^2", 1779, "0.5 %", 1.779e-3, 8.895e-6),
        ("flexure_stiffness_x", "mN*m/deg", 2.0, 0.02, 0.36 / math.pi, 3.6e-3 / math.pi),
        ("air_temperature", "degC", -10.0, 0.2, 263.15, 0.2),
        ("air_pressure", "mbar", 1000, "1 %", 1.0e5, 1.0e3),
        ("sample_period", "ms", 0.5, 0, 5.0e-4, 0.0),
        ("bearing_coulomb", "mJ", 0.5, 0.1, 5.0e-4, 1.0e-4),
    ],
)
def test_a_unit_of_the_same_kind_is_converted(
    name: str, unit: str, value: float, uncertainty: float | str, expected: float, deviation: float
) -> None:
    text = edited(name, unit=unit, value=value, uncertainty=uncertainty)
    parameter = Bench.from_text(text, origin="own.yaml").parameters[name]
    assert parameter.value == pytest.approx(expected, rel=1e-12)
    assert parameter.uncertainty == pytest.approx(deviation, rel=1e-12)
    assert parameter.unit == DEFAULT.parameters[name].unit


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("rotor_inertia_z", "kg*m"),
        ("tilt_limit", "m"),
        ("spin_rate_maximum", "m/s"),
        ("sample_period", "rad/s"),
        # would be taken for radians per second
        ("spin_rate_maximum", "Hz"),
        ("spin_rate_maximum", "kHz"),
        ("coil_constant", "N*m/A"),
    ],
)
def test_a_unit_of_another_kind_is_refused(name: str, unit: str, tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(edited(name, unit=unit))
    needed = DEFAULT.parameters[name].unit
    with pytest.raises(InputError) as caught:
        Bench.load(file)
    reason = "can be meant in two ways" if unit.endswith("Hz") else "cannot be converted"
    hint = ", rpm, turn/s" if unit.endswith("Hz") else ""
    assert str(caught.value) == (
        f"{file}: parameters.{name}.unit: {unit!r} {reason}; allowed: units such as {needed}{hint}"
    )


def test_invalid_unit_is_refused_naming_the_required_one() -> None:
    with pytest.raises(
        InputError,
        match=r"^own.yaml: parameters.tilt_limit.unit: 'xyzzy' is no unit .*; allowed: units such as rad$",
    ):
        Bench.from_text(edited("tilt_limit", unit="xyzzy"), origin="own.yaml")


def test_a_range_is_that_of_the_converted_value() -> None:
    with pytest.raises(
        InputError, match=r"own.yaml: parameters.air_temperature: -6.85 is out of range; allowed: > 0"
    ):
        Bench.from_text(edited("air_temperature", unit="degC", value=-280.0), origin="own.yaml")
    with pytest.raises(InputError, match=r"own.yaml: parameters.tilt_limit.value: 'five' is not a number"):
        Bench.from_text(edited("tilt_limit", unit="deg", value="five"), origin="own.yaml")


@pytest.mark.parametrize("name", Bench.shipped())
def test_a_shipped_bench_uses_the_required_units(name: str) -> None:
    """Nothing is converted in them: values, uncertainties and what recordings carry are as the files say."""
    file = {"gyrowheel": "bench.yaml", "dtg": "dtg.yaml"}[name]
    text = resources.files("gyrowheel_sim").joinpath(f"config/{file}").read_text(encoding="utf-8")
    stated = yaml.safe_load(text)["parameters"]
    carried = json.loads(Bench.load(name).describe())["parameters"]
    for key, entry in stated.items():
        assert carried[key]["value"] == float(entry["value"])
        assert carried[key]["unit"] == str(entry["unit"])


def test_a_misspelt_group_is_refused_with_the_right_name() -> None:
    said = r"^own.yaml: parameters.gimbal_inertia_x.group: 'gimbal_inertai' is not its group; allowed: gimbal_inertia$"
    with pytest.raises(InputError, match=said):
        Bench.from_text(edited("gimbal_inertia_x", group="gimbal_inertai"), origin="own.yaml")
    with pytest.raises(
        InputError, match=r"coil_constant.group: 'constants' is not its group; allowed: no group$"
    ):
        Bench.from_text(edited("coil_constant", group="constants"), origin="own.yaml")


def test_a_group_that_is_not_given_is_the_one_the_analysis_knows() -> None:
    bench = Bench.from_text(edited("gimbal_inertia_x", group=None), origin="own.yaml")
    assert bench.groups().keys() == DEFAULT.groups().keys()
    assert len(bench.groups()["gimbal_inertia"]) == 3
