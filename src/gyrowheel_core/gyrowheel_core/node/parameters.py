"""Declarations of node parameters: type, range, description, and whether they may change while a node works."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from gyrowheel_core.errors import InputError

_KINDS: dict[type, str] = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


@dataclass(frozen=True)
class Param:
    """The declaration of one node parameter."""

    name: str
    #: Value where none is given; its type is the type of the parameter. A whole number given for a float is
    #: taken as one.
    default: bool | int | float | str
    description: str  # one line, with the unit
    #: Smallest and largest value of a number.
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()  # the allowed values of a text; empty: any text
    #: Whether it may be changed at any time; the others are fixed once the node is configured.
    live: bool = False

    @property
    def allowed(self) -> str:
        """Allowed values in words."""
        if self.choices:
            return ", ".join(self.choices)
        kind = _KINDS[type(self.default)]
        if self.low is None and self.high is None:
            return kind
        if self.high is None:
            return f"{kind} >= {self.low:g}"
        if self.low is None:
            return f"{kind} <= {self.high:g}"
        return f"{kind} {self.low:g} .. {self.high:g}"

    def check(self, value: Any) -> Any:
        """Return `value` in the type of the parameter.

        Raises
        ------
        InputError
            If it is of another type or out of range.
        """
        kind = type(self.default)
        if kind is float and type(value) is int:
            value = float(value)
        good = type(value) is kind
        if good and kind in (int, float):
            above = self.low is None or value >= self.low
            below = self.high is None or value <= self.high
            good = math.isfinite(value) and above and below
        if good and self.choices:
            good = value in self.choices
        if not good:
            raise InputError(f"parameter {self.name}: {value!r} is not allowed; allowed: {self.allowed}")
        return value

    def descriptor(self) -> ParameterDescriptor:
        """Return the ROS descriptor (description, range)."""
        constraints = [f"one of: {self.allowed}"] if self.choices else []
        constraints.append("may change at any time" if self.live else "fixed once the node is configured")
        descriptor = ParameterDescriptor(
            description=self.description, additional_constraints="; ".join(constraints)
        )
        if self.low is not None or self.high is not None:
            if isinstance(self.default, float):
                descriptor.floating_point_range = [
                    FloatingPointRange(
                        from_value=-sys.float_info.max if self.low is None else float(self.low),
                        to_value=sys.float_info.max if self.high is None else float(self.high),
                    )
                ]
            else:
                descriptor.integer_range = [
                    IntegerRange(
                        from_value=-(2**63) if self.low is None else int(self.low),
                        to_value=2**63 - 1 if self.high is None else int(self.high),
                    )
                ]
        return descriptor


AUTOSTART = Param("autostart", True, "Configure and activate itself at start, without a lifecycle manager")
