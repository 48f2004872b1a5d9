"""Limits to what a file may grow to as it is read: a small file can claim, or unpack to, more than the memory holds."""

from __future__ import annotations

import math
import os

from gyrowheel_core.errors import InputError

#: Environment variable with the limit [GB].
VARIABLE = "GYROWHEEL_LARGEST_GB"
_USUAL = 4.0  # GB: five hours of the bench's samples
_GIGABYTE = 10**9


def largest() -> int:
    """Return how many bytes one file may have once it is unpacked.

    Raises
    ------
    InputError
        If the environment variable is no number above zero.
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
    """Refuse what is larger than `largest`.

    Parameters
    ----------
    size : float
        Bytes that are needed.
    what : str
        What needs them, with the file's name, as the beginning of the message.

    Raises
    ------
    InputError
        If they are too many; the message names the limit and the variable that raises it.
    """
    limit = largest()
    if size > limit:
        needed = (
            f"{size / _GIGABYTE:.3g} GB" if math.isfinite(size) else f"more than {limit / _GIGABYTE:.3g} GB"
        )
        raise InputError(
            f"{what} needs {needed} of memory; allowed: {limit / _GIGABYTE:g} GB ({VARIABLE} raises the limit)"
        )
