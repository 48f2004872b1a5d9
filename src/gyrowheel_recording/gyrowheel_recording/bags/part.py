"""A part of a recording, named behind its path: ``runs/monday@from=20,until=110``."""

from __future__ import annotations

import math
from pathlib import Path

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import read_errors

#: What separates a path from the part, and its two limits from each other.
MARK, BETWEEN = "@", ","
LIMITS = ("from", "until")
WHOLE = (-math.inf, math.inf)


def parted(path: str | Path) -> tuple[Path, tuple[float, float]]:
    """Return the path of a recording and the part of it that is meant [s from its start].

    A path that exists is taken as it is, whatever its name contains.

    Raises
    ------
    InputError
        If what follows the mark is no part.
    """
    place, mark, text = str(path).rpartition(MARK)
    if not mark or "=" not in text or _exists(Path(path)):
        return Path(path), WHOLE
    limits: dict[str, float] = {}
    for item in text.split(BETWEEN):
        name, _, value = (part.strip() for part in item.partition("="))
        if name not in LIMITS:
            raise InputError(f"{path}: {name!r} is no limit of a part; allowed: {', '.join(LIMITS)}")
        if name in limits:
            raise InputError(f"{path}: {name} is given twice")
        try:
            limits[name] = float(value)
        except ValueError:
            limits[name] = math.nan
        if not math.isfinite(limits[name]):
            raise InputError(f"{path}: {name}: {value!r} is out of range; allowed: seconds from the start")
    begin, end = limits.get("from", WHOLE[0]), limits.get("until", WHOLE[1])
    if not begin < end:
        raise InputError(f"{path}: until: {end:g} s is out of range; allowed: more than {begin:g} s")
    return Path(place), (begin, end)


def _exists(path: Path) -> bool:
    with read_errors(path):
        return path.exists()
