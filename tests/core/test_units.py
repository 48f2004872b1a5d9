"""Units: one table for what people read, and conversion of what they write."""

from __future__ import annotations

import math

import pint
import pytest

from gyrowheel_core.errors import InputError
from gyrowheel_core.quantities import number, quantity, size, with_error
from gyrowheel_core.units import DEG, RPM, Unit, column_unit, conversion, require_unit, unit_for


@pytest.mark.parametrize("spelling", ["N*m", "N·m"])
@pytest.mark.parametrize(
    ("value", "unit"),
    [(0.0, Unit("mN·m", 1e-3)), (-5e-5, Unit("mN·m", 1e-3)), (4.9e-5, Unit("µN·m", 1e-6)), (-1e-9, Unit("µN·m", 1e-6))],
)  # fmt: skip
def test_a_torque_is_read_in_a_unit_of_its_size(spelling: str, value: float, unit: Unit) -> None:
    assert unit_for(value, spelling) == unit


def test_other_units_are_spelled_one_way() -> None:
    assert unit_for(1.0, "rad/s") == Unit("rpm", RPM)
    assert unit_for(0.001, "rad/s") == Unit("deg/h", DEG / 3600.0)
    assert unit_for(math.nan, "V") == Unit("V", 1.0)
    assert unit_for(2.0, "") == unit_for(2.0, "1") == Unit("%", 1e-2)
    assert unit_for(2.0, "1", pure=True) == Unit("", 1.0)
    assert unit_for(1.0, "kg*m^3/s") == Unit("kg·m³/s", 1.0)


def test_a_column_has_the_unit_of_its_smallest_value() -> None:
    assert column_unit([2e-6, 1.0], "N·m").label == "mN·m"
    assert column_unit([1.9e-6, 1.0], "N·m").label == "µN·m"
    assert column_unit([], "N·m").label == "mN·m"


def test_sentences_and_tables_agree_on_the_unit() -> None:
    assert (size(3.4e-5, "N·m"), quantity(3.4e-5, "N*m")) == ("34 µN·m", "34 µN·m")
    assert with_error(3.4e-6, 2.1e-7, "N*m") == "3.40 ± 0.21 µN·m"
    assert with_error(1e-6, math.inf, "N*m") == "1 µN·m"
    assert number(math.inf) == "–"


def test_values_in_another_unit_are_converted() -> None:
    assert conversion("degC", "K") == pytest.approx((273.15, 1.0))
    assert conversion("deg", "rad")[1] == pytest.approx(DEG, rel=1e-15)
    for unit, said in (("Hz", "two ways"), ("m", "cannot be converted"), ("xyzzy", "is no unit")):
        with pytest.raises(InputError, match=rf"'{unit}' .*{said}.*; allowed: units such as rad/s"):
            conversion(unit, "rad/s")


@pytest.mark.parametrize("unit", ["1", "N*m/rad^3", "1/rad^2", "kg*m^2", "K/W", "mm/s", "deg/h", "s^-1"])
def test_units_are_known(unit: str) -> None:
    require_unit(unit)


@pytest.mark.parametrize("unit", ["wheel", "furlongs/fortnite", "N*wheel"])
def test_unknown_units_are_refused(unit: str) -> None:
    with pytest.raises(pint.UndefinedUnitError):
        require_unit(unit)
