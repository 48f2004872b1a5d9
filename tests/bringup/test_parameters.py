"""Declarations of node parameters, without any node."""

from __future__ import annotations

import math
from typing import Any

import pytest

from gyrowheel_core.errors import InputError
from gyrowheel_core.node import Param, parameter_help
from gyrowheel_sim.plant.node import PlantNode

NUMBER = Param("n", 1.0, "A number", low=0.5, high=2.0)
COUNT = Param("c", 3, "A count", low=1)
WORD = Param("w", "tick", "A word", choices=("tick", "tock"))
SWITCH = Param("s", True, "A switch")


@pytest.mark.parametrize(
    ("param", "given", "value"),
    [
        (NUMBER, 0.5, 0.5),
        (NUMBER, 2, 2.0),
        (COUNT, 10**6, 10**6),
        (WORD, "tock", "tock"),
        (SWITCH, False, False),
    ],
)
def test_allowed_values_are_taken_in_the_declared_type(param: Param, given: Any, value: Any):
    taken = param.check(given)
    assert taken == value
    assert type(taken) is type(param.default)


@pytest.mark.parametrize(
    ("param", "given", "allowed"),
    [
        (NUMBER, 2.1, "a number 0.5 .. 2"),
        (NUMBER, math.nan, "a number 0.5 .. 2"),
        (NUMBER, math.inf, "a number 0.5 .. 2"),
        (NUMBER, True, "a number 0.5 .. 2"),
        (NUMBER, "1", "a number 0.5 .. 2"),
        (COUNT, 0, "a whole number >= 1"),
        (COUNT, 2.0, "a whole number >= 1"),
        (WORD, "tack", "tick, tock"),
        (SWITCH, 1, "true or false"),
        (Param("x", 1.0, "", high=2.0), 3.0, "a number <= 2"),
    ],
)
def test_other_values_are_refused_with_what_is_allowed(param: Param, given: Any, allowed: str):
    with pytest.raises(InputError) as caught:
        param.check(given)
    assert str(caught.value) == f"parameter {param.name}: {given!r} is not allowed; allowed: {allowed}"


def test_help_lists_every_parameter_with_its_description():
    text = parameter_help(PlantNode)
    for param in PlantNode.PARAMETERS:
        assert param.name in text
        assert param.description in text
    assert "autostart" in text
