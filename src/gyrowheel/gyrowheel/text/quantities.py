"""Numbers with units as people in the laboratory say them: mN·m, degrees, rpm, per cent. JSON stays in SI."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import NamedTuple

from gyrowheel_core.units import DEG, RPM


class Edge(NamedTuple):
    """A unit for people: its name, and its size in the SI unit."""

    label: str
    size: float


#: By SI unit. What is not listed is shown as it is.
_EDGE: dict[str, Edge] = {
    "N*m": Edge("mN·m", 1e-3),
    "N*m/rad": Edge("mN·m/rad", 1e-3),
    "N*m*s/rad": Edge("µN·m·s/rad", 1e-6),
    "N*m/rad^3": Edge("N·m/rad³", 1.0),
    "N*m/V": Edge("mN·m/V", 1e-3),
    "N*m/A": Edge("mN·m/A", 1e-3),
    "kg*m^2": Edge("mg·m²", 1e-6),
    "rad": Edge("deg", DEG),
    "rad/s": Edge("rpm", RPM),
    "1/K": Edge("%/K", 1e-2),
    "1": Edge("%", 1e-2),
    "s": Edge("s", 1.0),
    "ohm": Edge("Ω", 1.0),
}
#: For values below a hundredth of the SI unit.
_SLOW: dict[str, Edge] = {"rad/s": Edge("deg/h", DEG / 3600.0), "s": Edge("ms", 1e-3)}
_SMALL = 2e-6  # noise of a torque below which milli is too coarse [N m]
_PRETTY = str.maketrans({"*": "·"})


def edge(unit: str, *, pure: bool = False, value: float = 1.0) -> Edge:
    """Return the unit in which people read values of an SI unit.

    Parameters
    ----------
    unit : str
        SI unit, with ``*`` or ``·`` between its factors.
    pure : bool
        Whether a number without unit is a pure number (an exponent), not a fraction shown in per cent.
    value : float
        A value that is to be shown; a very small one may get another unit.
    """
    plain = unit.replace("·", "*").replace("²", "^2").replace("³", "^3")
    if plain in ("1", "") and pure:
        return Edge("", 1.0)
    if plain in _SLOW and abs(value) < 0.01:
        return _SLOW[plain]
    if plain in _EDGE:
        return _EDGE[plain or "1"]
    return Edge(plain.replace("^2", "²").replace("^3", "³").translate(_PRETTY), 1.0)


def torque_edge(noise: Iterable[float]) -> Edge:
    """Return the unit in which people read torques with noise of these sizes [N m]: a smaller one on a small bench."""
    return Edge("µN·m", 1e-6) if min(noise, default=1.0) < _SMALL else _EDGE["N*m"]


def is_pure(effect: str, coefficient: str) -> bool:
    """Whether a coefficient without unit shapes the law of an effect (an exponent)."""
    from gyrowheel_sim.effects import registry

    known = registry().get(effect)
    return known is not None and any(c.name == coefficient for c in known.shapes)


def with_error(value: float, error: float, unit: str, *, pure: bool = False) -> str:
    """Return ``22.31 ± 0.27 mN·m/rad``: the error to two digits, the value as far as the error reaches."""
    shown = edge(unit, pure=pure, value=max(abs(value), abs(error)))
    return f"{pair(value / shown.size, error / shown.size)}{_tail(shown)}"


def pair(value: float, error: float) -> str:
    """Return ``22.31 ± 0.27`` of two bare numbers."""
    if not math.isfinite(error) or error <= 0.0:
        return short(value)
    # two digits of the error; rounding 0.0996 up must not show a third
    digits = 1 - math.floor(math.log10(float(f"{error:.1e}")))
    if -3 <= digits <= 6:
        places = max(digits, 0)
        return f"{_minus(f'{round(value, digits) + 0.0:.{places}f}')} ± {round(error, digits):.{places}f}"
    return f"{short(value)} ± {error:.1e}"


def quantity(value: float, unit: str, *, pure: bool = False, digits: int = 3) -> str:
    """Return ``0.213 mN·m``: a value to some digits with its unit."""
    shown = edge(unit, pure=pure, value=value)
    return f"{short(value / shown.size, digits)}{_tail(shown)}"


def span(low: float, high: float, unit: str, *, pure: bool = False) -> str:
    """Return ``0.8 .. 1.3 mN·m``."""
    shown = edge(unit, pure=pure, value=max(abs(low), abs(high)))
    return f"{short(low / shown.size)} .. {short(high / shown.size)}{_tail(shown)}"


def short(value: float, digits: int = 3) -> str:
    """Return a number to some significant digits, without an exponent where that stays readable."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    size = abs(value)
    if 1e-4 <= size < 1e5:
        places = max(digits - 1 - math.floor(math.log10(size)), 0)
        text = f"{value:.{places}f}"
        return _minus(text.rstrip("0").rstrip(".") if "." in text else text)
    return _minus(f"{value:.{digits - 1}e}")


def fixed(value: float, digits: int = 3) -> str:
    """Return a number to some significant digits with the zeros kept, for columns of numbers."""
    if not math.isfinite(value):
        return "–"
    value += 0.0  # no sign before a zero
    size = abs(float(f"{value:.{digits - 1}e}"))
    if size >= 10 ** (digits - 1):
        return _minus(f"{value:.0f}") if size < 1e6 else _minus(f"{value:.{digits - 1}e}")
    places = digits - 1 - (math.floor(math.log10(size)) if size > 0.0 else 0)
    return _minus(f"{value:.{places}f}") if places <= 6 else _minus(f"{value:.{digits - 1}e}")


def decimal(value: float, places: int, *, sign: bool = False) -> str:
    """Return a number with some digits behind the point, with its sign if asked for; a zero is never negative."""
    if not math.isfinite(value):
        return "–"
    return _minus(f"{round(value, places) + 0.0:{'+' if sign else ''}.{places}f}")


def minus(text: str) -> str:
    """Return a text with the minus sign of tables before its negative numbers."""
    return re.sub(r"(?<![\w.)-])-(?=\.?\d)", "−", text)


def seconds(value: float) -> str:
    """Return a time in words: ``42 s``, ``3 min 20 s``."""
    if value < 60.0:
        return f"{value:.1f} s" if value < 10.0 else f"{value:.0f} s"
    minutes, rest = divmod(round(value), 60)
    return f"{minutes} min {rest} s" if rest else f"{minutes} min"


def _tail(shown: Edge) -> str:
    if shown.label.startswith("%"):
        return f" {shown.label}"
    return f" {shown.label}" if shown.label else ""


def _minus(text: str) -> str:
    return text.replace("-", "−", 1) if text.startswith("-") else text
