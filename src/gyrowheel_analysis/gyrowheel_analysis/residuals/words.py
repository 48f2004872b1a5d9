"""How a law that a residual follows is said: what is beyond the model, how it stands to the motion, how large it is."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gyrowheel_analysis.residuals.fits import Change
from gyrowheel_analysis.residuals.windows import Kind
from gyrowheel_core.quantities import number, size, unit_for

_PATTERNS = {
    "tilt": "turns with the tilt",
    "mirror": "is in proportion to the tilt, mirrored",
    "square": "grows with the tilt squared",
    "cube": "grows with the cube of the tilt",
    "rate": "goes with the rate of the tilt",
    "load": "is in proportion to what they have to give",
    "acceleration": "goes with the acceleration of the spin",
    "table": "goes with the rate of the table",
    "room": "stands in the room while the rig is turned",
    "still": "is the same at every tilt",
}
_PER = {
    "tilt": "/rad", "mirror": "/rad", "square": "/rad²", "cube": "/rad³", "rate": " per rad/s",
    "acceleration": " per rad/s²", "table": " per rad/s",
}  # fmt: skip
_VARIABLES = {
    "coils": "as the coils warm from {low} to {high} °C",
    "motor": "as the motor's winding warms from {low} to {high} °C",
    "magnets": "as the motor's magnets warm from {low} to {high} °C",
    "air": "as the pressure of the air goes from {low} to {high} kPa",
    "up": "as the rig is turned from upside down to upright",
    "time": "from {low} to {high} s in the recording",
}


def amounts(values: Sequence[float], kind: Kind, pattern: str) -> tuple[list[str], str]:
    """Return amplitudes of a pattern as numbers, and the unit of them all."""
    name, scale = ("%", 1e-2) if pattern == "load" else unit_for(max(abs(v) for v in values), kind.unit)
    signed = min(values) < 0.0
    return [number(v / scale, sign=signed) for v in values], f"{name}{_PER.get(pattern, '')}"


def beyond(kind: Kind, pattern: str, mean: complex, *, alone: bool = False) -> str:
    """Return what is beyond the model, how it stands to the motion, and its size; `alone` if that is all it has."""
    per = _PER.get(pattern, "")
    if len(kind.rows) == 1:
        side = "more" if mean.real > 0 else "less"
        text = f"the {kind.subject} is {size(abs(mean), kind.unit)}{per} {side} than the model asks for"
        return text if pattern == "still" else f"{text}, which {_PATTERNS[pattern]}"
    text = _who(kind, pattern, mean)
    if pattern == "still" and kind.rows[0] == "tilt_x":
        return text + constant_axes(mean, kind)
    (amount,), unit = amounts([abs(mean)], kind, pattern)
    sign = "−" if pattern == "load" and mean.real < 0.0 else ""
    return f"{text}, {sign}{amount} {unit}{'' if alone else ' on average'}"


def beyond_changing(kind: Kind, change: Change) -> str:
    """Return what is beyond the model, and between which sizes it changes."""
    comma = " and goes" if len(kind.rows) == 2 or change.pattern != "still" else " goes"
    return f"{_who(kind, change.pattern, change.direction)}{comma} {ends(kind, change)}"


def ends(kind: Kind, change: Change) -> str:
    """Return the sizes at both ends of a change, and what changes between them."""
    (a, b), unit = amounts([change.at_low, change.at_high], kind, change.pattern)
    low, high = (_value(change.variable, v) for v in (change.low, change.high))
    return f"from {a} to {b} {unit} {_VARIABLES[change.variable].format(low=low, high=high)}"


def power(value: float, error: float) -> str:
    """Return a power of the speed with its error: ``Ω^1.9±0.2``."""
    digits = 1 if error >= 0.1 else 2
    return f"Ω^{value:.{digits}f}±{max(error, 0.01):.{digits}f}".replace("-", "−")


def phase(slope: complex) -> str:
    """Return how a torque in proportion to the tilt stands to it."""
    angle = math.degrees(math.atan2(slope.imag, slope.real))
    if abs(angle) < 20.0:
        return "in phase with it"
    if abs(abs(angle) - 180.0) < 20.0:
        return "against it"
    side = "ahead of" if angle > 0 else "behind"
    return f"{abs(angle):.0f}° {side} it"


def constant_axes(value: complex, kind: Kind) -> str:
    """Return the components of a constant, where its axes mean something to people."""
    if kind.rows[0] != "tilt_x":
        return " in the rotor" if kind.rows[0].startswith("tilt") else ""
    name, scale = unit_for(abs(value), kind.unit)
    x, y = (number(v / scale, sign=True) for v in (value.real, value.imag))
    return f", {x} {name} about x and {y} about y"


def _who(kind: Kind, pattern: str, direction: complex) -> str:
    """Return what is beyond the model, and how it stands to the motion."""
    words = _PATTERNS[pattern]
    if len(kind.rows) == 1:
        return f"the {kind.subject} beyond the model's" + ("" if pattern == "still" else f" {words}")
    if pattern == "mirror" and kind.rows[0] == "tilt_2n_x":
        words = "is in proportion to the tilt"
    tilt = kind.rows[0] == "tilt_x"
    text = f"{'the coils give a torque' if tilt else f'there is a {kind.subject}'} beyond the model's that {words}"
    return f"{text}, {phase(direction)}" if tilt and pattern in ("tilt", "cube", "rate") else text


def _value(variable: str, value: float) -> str:
    if variable in ("coils", "motor", "magnets"):
        return f"{value - 273.15:.0f}"
    return f"{value * 101.325:.0f}" if variable == "air" else f"{value:.0f}"
