"""Arguments of the API: recordings and callbacks."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias

from gyrowheel.recordings.api import Recording
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording as Data
from gyrowheel_recording.bags import parted

#: One recording, or several of one machine; a path is opened.
Recordings: TypeAlias = "Recording | str | os.PathLike[str] | Sequence[Recording | str | os.PathLike[str]]"
#: Called now and then with a line about the current step.
Say: TypeAlias = Callable[[str], None]
#: Called now and then with the fraction that is done, 0 .. 1.
Fraction: TypeAlias = Callable[[float], None]


def opened(given: Recordings) -> list[Recording]:
    """Return recordings, those given as paths opened; InputError if one is missing, damaged or given twice."""
    items = _items(given)
    _refuse_twice(items)
    return [item if isinstance(item, Recording) else Recording.open(Path(item)) for item in items]


def require_one_machine(recordings: Sequence[Data], *, mixed: bool = False) -> None:
    """Refuse recordings that state different machines, unless a mix is asked for; those that state no machine pass.

    The InputError names two recordings and their machines.
    """
    named = [recording for recording in recordings if recording.machine]
    for recording in named[1:] if not mixed else ():
        if recording.machine != named[0].machine:
            raise InputError(
                f"{recording.path}: is of machine {recording.machine}, {named[0].path} of machine "
                f"{named[0].machine}; allowed: recordings of one machine, unless a mix is asked for (--mixed)"
            )


def of_one_machine(given: Recordings, *, mixed: bool) -> list[Recording]:
    """Return recordings as `opened` does, of one machine unless a mix is asked for."""
    recordings = opened(given)
    require_one_machine(data(recordings), mixed=mixed)
    return recordings


def opened_apart(fitted: Recordings, unused: Recordings) -> tuple[list[Recording], list[Recording]]:
    """Return recordings to fit and those to validate the fit on; InputError also if one is given as both."""
    places = [_place(item) for item in _items(fitted)]
    for item in _items(unused):
        if any(_overlap(_place(item), place) for place in places):
            name = item.path if isinstance(item, Recording) else item
            raise InputError(f"validate: {name}: a recording that is fitted cannot validate the fit")
    return opened(fitted), opened(unused)


def data(recordings: Sequence[Recording]) -> list[Data]:
    """Return recordings as the packages below have them."""
    return [recording.data for recording in recordings]


def _items(given: Recordings) -> list[Recording | str | os.PathLike[str]]:
    return [given] if isinstance(given, Recording | str | os.PathLike) else list(given)


#: Where a recording is, and which part of it is meant.
_Place: TypeAlias = tuple[Path, tuple[float, float]]


def _place(item: Recording | str | os.PathLike[str]) -> _Place:
    path, part = parted(item.path if isinstance(item, Recording) else Path(item))
    return path.resolve(), part


def _overlap(left: _Place, right: _Place) -> bool:
    """Whether two parts have something in common."""
    return left[0] == right[0] and max(left[1][0], right[1][0]) < min(left[1][1], right[1][1])


def _refuse_twice(items: Sequence[Recording | str | os.PathLike[str]]) -> None:
    places = [_place(item) for item in items]
    for index, place in enumerate(places):
        if any(_overlap(place, other) for other in places[:index]):
            item = items[index]
            raise InputError(f"{item.path if isinstance(item, Recording) else item}: is given twice")
