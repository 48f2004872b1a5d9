"""Formatted numbers with units, for sentences and tables. JSON stays in SI, with all digits."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

from gyrowheel_core.units import Unit, unit_for

NOT_KNOWN = "–"  #: shown for a number that is not finite

# --- numbers


def number(value: float, digits: int = 2, *, sign: bool = False) -> str:
    """Return a number to some significant digits, zeros kept, never with an exponent: 0.013, 5.6, 320."""
    if not math.isfinite(value):
        return NOT_KNOWN
    if value == 0.0:
        return "0"
    rounded = float(f"{value:.{digits - 1}e}")
    places = max(digits - 1 - math.floor(math.log10(abs(rounded))), 0)
    return _minus(f"{rounded:{'+' if sign else ''}.{places}f}")


def short(value: float, digits: int = 3) -> str:
    """Return a number to some significant digits without zeros at its end, with an exponent where it is unwieldy."""
    if not math.isfinite(value):
        return NOT_KNOWN
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
        return NOT_KNOWN
    value += 0.0  # no sign before a zero
    size = abs(float(f"{value:.{digits - 1}e}"))
    if size >= 10 ** (digits - 1):
        return _minus(f"{value:.0f}") if size < 1e6 else _minus(f"{value:.{digits - 1}e}")
    places = digits - 1 - (math.floor(math.log10(size)) if size > 0.0 else 0)
    return _minus(f"{value:.{places}f}") if places <= 6 else _minus(f"{value:.{digits - 1}e}")


def decimal(value: float, places: int, *, sign: bool = False) -> str:
    """Return a number with a fixed number of decimals, optionally with its sign; a zero is never negative."""
    if not math.isfinite(value):
        return NOT_KNOWN
    return _minus(f"{round(value, places) + 0.0:{'+' if sign else ''}.{places}f}")


def pair(value: float, error: float) -> str:
    """Return ``22.31 ± 0.27``: the error to two digits, the value as far as the error reaches."""
    if not math.isfinite(error) or error <= 0.0:
        return short(value)
    # two digits of the error; rounding 0.0996 up must not show a third
    digits = 1 - math.floor(math.log10(float(f"{error:.1e}")))
    if -3 <= digits <= 6:
        places = max(digits, 0)
        return f"{_minus(f'{round(value, digits) + 0.0:.{places}f}')} ± {round(error, digits):.{places}f}"
    return f"{short(value)} ± {error:.1e}"


def minus(text: str) -> str:
    """Return a text with the minus sign of tables before its negative numbers."""
    return re.sub(r"(?<![\w.)-])-(?=\.?\d)", "−", text)


def _minus(text: str) -> str:
    return text.replace("-", "−", 1) if text.startswith("-") else text


# --- numbers with units


def quantity(value: float, unit: str, *, pure: bool = False, digits: int = 3) -> str:
    """Return ``0.213 mN·m``: a value [SI] with the unit in which people read it (`unit_for` explains `pure`)."""
    shown = unit_for(value, unit, pure=pure)
    return _with(short(value / shown.size, digits), shown)


def with_error(value: float, error: float, unit: str, *, pure: bool = False) -> str:
    """Return ``22.31 ± 0.27 mN·m/rad`` of a value and its standard error [SI]."""
    shown = unit_for(_largest(value, error), unit, pure=pure)
    return _with(pair(value / shown.size, error / shown.size), shown)


def span(low: float, high: float, unit: str, *, pure: bool = False) -> str:
    """Return ``0.8 .. 1.3 mN·m`` of a range [SI]."""
    shown = unit_for(_largest(low, high), unit, pure=pure)
    return _with(f"{short(low / shown.size)} .. {short(high / shown.size)}", shown)


def interval(low: float, high: float, parts: Mapping[str, float], unit: str, *, pure: bool = False) -> str:
    """Return ``0.83 .. 1.20 mN·m (noise 0.024, bench 0.048)``: an interval and standard deviations within it [SI]."""
    shown = unit_for(_largest(low, high), unit, pure=pure)
    error = 0.5 * (high - low) / shown.size
    ends = (pair(end / shown.size, error).split(" ± ")[0] for end in (low, high))
    own = ", ".join(f"{name} {short(part / shown.size, 2)}" for name, part in parts.items())
    return f"{_with(' .. '.join(ends), shown)} ({own})"


def size(value: float, unit: str, *, sign: bool = False) -> str:
    """Return a value [SI] for a sentence: ``0.25 mN·m``, ``34 µN·m``."""
    shown = unit_for(value, unit)
    return _with(number(value / shown.size, sign=sign), shown)


def size_and_noise(value: float, noise: float, unit: str, word: str = "") -> str:
    """Return a value [SI] and its noise in one unit: ``0.25 mN·m rms, noise 0.021``."""
    shown = unit_for(max(value, noise), unit)
    return f"{number(value / shown.size)} {shown.label}{word}, noise {number(noise / shown.size)}"


def seconds(value: float) -> str:
    """Return a time in words: ``42 s``, ``3 min 20 s``."""
    if value < 60.0:
        return f"{value:.1f} s" if value < 10.0 else f"{value:.0f} s"
    minutes, rest = divmod(round(value), 60)
    return f"{minutes} min {rest} s" if rest else f"{minutes} min"


def _largest(a: float, b: float) -> float:
    return max((abs(v) for v in (a, b) if math.isfinite(v)), default=0.0)


def _with(text: str, unit: Unit) -> str:
    return f"{text} {unit.label}" if unit.label else text


# --- lists


def listed(names: Sequence[str], last: str) -> str:
    """Return names as a list in a sentence, with a word before the last one: ``a, b and c``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}"
