"""Declarations of node parameters, without any node."""

from __future__ import annotations

import math
from typing import Any

import pytest

from gyrowheel_core.errors import InputError
from gyrowheel_core.node import AUTOSTART, BenchNode, Param, parameter_help

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


class TickNode(BenchNode):
    """Says tick.

    No more than that.
    """

    NODE_NAME = "tick"
    PARAMETERS = (NUMBER, COUNT, WORD, SWITCH)


def test_help_lists_every_parameter_with_its_description():
    text = parameter_help(TickNode)
    assert text.startswith("Says tick.\n\nnode tick; ")
    for param in (AUTOSTART, *TickNode.PARAMETERS):
        assert (
            f"\n  {param.name} (default {param.default!r}; {param.allowed})\n      {param.description}"
            in text
        )


def test_the_descriptor_gives_ros_the_range():
    number, count, word = (param.descriptor() for param in (NUMBER, COUNT, WORD))
    (floats,), (integers,) = number.floating_point_range, count.integer_range
    assert (floats.from_value, floats.to_value) == (0.5, 2.0)
    assert (integers.from_value, integers.to_value) == (1, 2**63 - 1)
    assert word.additional_constraints == "one of: tick, tock; fixed once the node is configured"
    assert not word.floating_point_range
    assert not word.integer_range
    live = Param("r", 1.0, "A rate", high=3.0, live=True).descriptor()
    assert live.floating_point_range[0].from_value < -1e300
    assert live.additional_constraints == "may change at any time"
