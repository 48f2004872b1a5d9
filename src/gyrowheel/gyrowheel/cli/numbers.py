"""Lists of numbers as they are typed: ``3``, ``1,2,3``, ``0..5`` or ``0..5:0.5``."""

from __future__ import annotations

import math

from gyrowheel_core.errors import InputError

_STEPS = 6  # between the ends of a range without a step
_MOST = 1000  # steps of a range


def numbers(text: str, option: str) -> list[float]:
    """Return the numbers of ``3``, ``1,2,3``, ``0..5`` or ``0..5:0.5``.

    Parameters
    ----------
    text : str
        What was typed.
    option : str
        The option that it was typed for.

    Raises
    ------
    InputError
        If it is no list of numbers.
    """
    wanted = f"{option}: '{text}' is no list of numbers; allowed: 3, or 1,2,3, or 0..5, or 0..5:0.5"
    try:
        ends, _, step = text.partition(":")
        first, dots, last = ends.partition("..")
        if not dots:
            values = [float(part) for part in text.split(",")]
        else:
            low, high = float(first), float(last)
            by = float(step) if step else (high - low) / _STEPS
            if not by * (high - low) > 0.0 or (high - low) / by > _MOST:
                raise InputError(wanted)
            values = [low + k * by for k in range(math.floor((high - low) / by + 1e-9) + 1)]
    except ValueError:
        raise InputError(wanted) from None
    if not all(math.isfinite(value) for value in values):
        raise InputError(wanted)
    return values
