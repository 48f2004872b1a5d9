"""Recordings of a bench that ran in a namespace of ROS."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypeVar

from gyrowheel_core import namespaces, topics
from gyrowheel_core.errors import InputError

_V = TypeVar("_V")


class AnyNamespace(Mapping[str, _V]):
    """Values by the names of topics, found by these names in any namespace.

    Parameters
    ----------
    values : mapping
        Values by the name of a topic where no namespace is given.
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

    Parameters
    ----------
    counts : mapping
        Number of messages of each topic, by its full name.
    where : str
        The recording, for an error.

    Raises
    ------
    InputError
        If it holds the samples of several benches.
    """
    benches = namespaces.found([name for name, count in counts.items() if count])
    if len(benches) > 1:
        names = ", ".join(bench or "/" for bench in benches)
        raise InputError(
            f"{where}: {topics.MEASUREMENT.name} of several benches, in the namespaces {names}; allowed: one bench in "
            "a recording, as the recorder of each writes it"
        )
    return benches[0] if benches else ""
