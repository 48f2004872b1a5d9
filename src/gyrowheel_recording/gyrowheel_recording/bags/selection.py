"""What of a recording is meant: a part, ``runs/monday@from=20,until=110``, and the bench of a namespace."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TypeVar

from gyrowheel_core import namespaces, topics
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


def part_of(path: Path, part: tuple[float, float]) -> Path:
    """Return the path that means a part of a recording, as `parted` reads it."""
    limits = [
        f"{name}={limit!r}".removesuffix(".0")
        for name, limit in zip(LIMITS, part, strict=True)
        if math.isfinite(limit)
    ]
    return Path(f"{path}{MARK}{BETWEEN.join(limits)}") if limits else path


def _exists(path: Path) -> bool:
    with read_errors(path):
        return path.exists()


_V = TypeVar("_V")


class AnyNamespace(Mapping[str, _V]):
    """Values by the names of topics, found by these names in any namespace.

    `values`: values by the name of a topic where no namespace is given.
    """

    def __init__(self, values: Mapping[str, _V]) -> None:
        self._values = values

    def __getitem__(self, name: str) -> _V:
        for own, value in self._values.items():
            if name.endswith(own):
                return value
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)


def bench_in(counts: Mapping[str, int], where: str) -> str:
    """Return the namespace in which the bench of a recording ran: empty for the root, else such as ``/bench2``.

    `counts` is the number of messages by the full name of each topic.

    Raises
    ------
    InputError
        If it has the samples of several benches; it names `where`.
    """
    benches = namespaces.found([name for name, count in counts.items() if count])
    if len(benches) > 1:
        names = ", ".join(bench or "/" for bench in benches)
        raise InputError(
            f"{where}: {topics.MEASUREMENT.name} of several benches, in the namespaces {names}; allowed: one bench in "
            "a recording, as the recorder of each writes it"
        )
    return benches[0] if benches else ""
