"""Limit of the size of unpacked files: a small file can claim, or unpack to, more than the memory."""

from __future__ import annotations

import math
import os

from gyrowheel_core.errors import InputError

#: Environment variable with the limit [GB].
VARIABLE = "GYROWHEEL_LARGEST_GB"
_USUAL = 4.0  # GB: five hours of the bench's samples
_GIGABYTE = 10**9


def largest() -> int:
    """Return the largest size of an unpacked file [bytes].

    Raises
    ------
    InputError
        If the environment variable is not a number above zero.
    """
    given = os.environ.get(VARIABLE, "")
    try:
        limit = float(given) if given else _USUAL
    except ValueError:
        limit = math.nan
    if not 0.0 < limit < math.inf:
        raise InputError(f"{VARIABLE}: '{given}' is not allowed; allowed: a number of gigabytes above 0")
    return int(limit * _GIGABYTE)


def require_room(size: float, what: str) -> None:
    """Refuse a size above `largest`.

    Parameters
    ----------
    size : float
        Needed memory [bytes].
    what : str
        Beginning of the message, with the file's name.

    Raises
    ------
    InputError
        If it is too large; the message names the limit and the variable that raises it.
    """
    limit = largest()
    if size > limit:
        needed = (
            f"{size / _GIGABYTE:.3g} GB" if math.isfinite(size) else f"more than {limit / _GIGABYTE:.3g} GB"
        )
        raise InputError(
            f"{what} needs {needed} of memory; allowed: {limit / _GIGABYTE:g} GB ({VARIABLE} raises the limit)"
        )
