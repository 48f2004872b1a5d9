"""How sizes and lists are said in sentences: units by the size, few digits."""

from __future__ import annotations

import math
from collections.abc import Sequence

#: Units by the SI unit, largest first: name, size, and the smallest value that is said in it.
_UNITS: dict[str, tuple[tuple[str, float, float], ...]] = {
    "N·m": (("mN·m", 1e-3, 5e-5), ("µN·m", 1e-6, 0.0)),
    "V": (("V", 1.0, 0.5), ("mV", 1e-3, 5e-5), ("µV", 1e-6, 0.0)),
}


def unit_for(size: float, unit: str) -> tuple[str, float]:
    """Return the name and the SI size of the unit in which values of about this size are said."""
    for name, scale, least in _UNITS.get(unit, ()):
        if abs(size) >= least:
            return name, scale
    return unit, 1.0


def number(value: float, digits: int = 2, *, sign: bool = False) -> str:
    """Return a number to some significant digits, never with an exponent: 0.013, 5.6, 320."""
    if value == 0.0 or not math.isfinite(value):
        return "0" if value == 0.0 else "–"
    places = max(digits - 1 - math.floor(math.log10(float(f"{abs(value):.{digits - 1}e}"))), 0)
    text = f"{float(f'{value:.{digits - 1}e}'):{'+' if sign else ''}.{places}f}"
    return text.replace("-", "−", 1)


def size(value: float, unit: str, *, sign: bool = False) -> str:
    """Return a value with its unit: ``0.25 mN·m``, ``34 µN·m``."""
    name, scale = unit_for(value, unit)
    return f"{number(value / scale, sign=sign)} {name}"


def listed(names: Sequence[str], last: str) -> str:
    """Return names as a list in a sentence, with a word before the last one: ``a, b and c``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}"


def size_and_noise(value: float, noise: float, unit: str, word: str = "") -> str:
    """Return a value and the noise beside it, both in one unit: ``0.25 mN·m rms, noise 0.021``."""
    name, scale = unit_for(max(value, noise), unit)
    return f"{number(value / scale)} {name}{word}, noise {number(noise / scale)}"
