"""Units of formulas: every law has that of what it acts on."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from gyrowheel_core.errors import InputError
from gyrowheel_sim.effects import (
    Effect,
)
from gyrowheel_sim.effects.dimensions import Unit, check_effect, check_unit
from gyrowheel_sim.effects.formula import read

from .every_effect import EACH


@EACH
def test_every_law_has_the_unit_of_its_target(effect: Effect) -> None:
    check_effect(effect)
    # and the check can fail: with another unit of its first coefficient no law that has it passes
    first = effect.coefficients[0]
    other = dataclasses.replace(first, unit=f"{first.unit}*K")
    wrong = dataclasses.replace(effect, coefficients=(other, *effect.coefficients[1:]))
    with pytest.raises(InputError, match=f"{effect.name}."):
        check_effect(wrong)


@pytest.mark.parametrize(
    ("text", "unit", "message"),
    [
        ("k*z", "N*m", None),  # radians count as dimensionless
        ("k*z", "N*m/rad", None),
        ("k*z*z_rate/Omega", "N*m/rad^2", None),
        ("k*Omega^(3/2)*Omega^0.5", "N*m*s^2", None),
        ("k*sqrt(Omega)*sqrt(Omega)", "N*m*s", None),
        ("k*max(abs(z), 0)", "N*m/rad", None),
        ("k*exp(-z*conj(z)/z_ref^2)", "N*m", None),
        ("k*(1 + abs(z))", "N*m", None),
        ("k*z", "N", "column 1: 'k*z' has the unit N*rad; N*m is needed"),
        (
            "k*z + Omega",
            "N*m",
            "column 7: 'k*z' [N*m*rad] and 'Omega' [rad/s] cannot be added: their units differ",
        ),
        ("k*(z + Omega)", "N*m", "column 8: 'z' [rad] and 'Omega' [rad/s] cannot be added"),
        (
            "k*exp(Omega)",
            "N*m",
            "column 7: 'Omega' has the unit rad/s; the argument of exp must be a pure number",
        ),
        ("k*r^t", "N*m", "column 5: 't' has the unit s; an exponent must be a pure number"),
        ("k*Omega^n", "N*m", "column 3: 'Omega' has the unit rad/s; with the exponent 'n' it must be"),
        ("k*max(t, abs(z))", "N*m", "column 10: 't' [s] and 'abs(z)' [rad] cannot be compared"),
        ("k*(T_coil - 20)", "N*m/K", "column 13: 'T_coil' [K] and '20' [1] cannot be added"),
    ],
)
def test_units_are_checked(text: str, unit: str, message: str | None) -> None:
    formula = read(text, ("a", "b", "k", "n", "p"))
    units = {"k": unit, "n": "1"}
    if message is None:
        check_unit(formula, units, "N*m")
        return
    with pytest.raises(InputError) as caught:
        check_unit(formula, units, "N*m")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["N*m/rad", "kg/m^3", "1", "1/K", "N*m*s/rad", "ohm", "rad/s"])
def test_units_are_printed_so_that_they_are_read_back(text: str) -> None:
    unit = Unit.of(text)
    assert Unit.of(str(unit)) == unit


@pytest.mark.parametrize(
    "text",
    ["mN*m", "rpm", "deg", "degC", "N m", "furlong", "", "9**9**9", "N^99", "N*(m)", "/s", "__class__", None],
)
def test_units_beyond_plain_si_are_refused(text: Any) -> None:
    with pytest.raises(InputError, match=r"is no (SI )?unit"):
        Unit.of(text)
