"""Summary of a recording."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.arrays import by_blocks
from gyrowheel_recording.bags.metadata import ENTRY, METADATA_FILE, Publisher, from_text, read_metadata
from gyrowheel_recording.bags.reader import Integrity, Recording, usual_step
from gyrowheel_recording.derived import ASSUMED, assumed_rig, origins_in_words

_HOLD = 1  # Setpoint.HOLD
_PART = 1 << 16  # samples
_SAME_RATE = 0.1  # part by which a mean rate is off where a bench stood still for long


@dataclass(frozen=True)
class Hold:
    """A stretch in which the setpoints are constant."""

    segment: int  # segment of the plan
    #: Start from the start of the recording, and length [s].
    start: float
    duration: float
    #: Commanded tilt in the middle of the stretch [rad].
    tilt_x: float
    tilt_y: float
    spin_rate: float  # commanded spin rate [rad/s]


@dataclass(frozen=True)
class RecordingInfo:
    """Summary of a recording."""

    path: str  # where it is
    size: int  # of its files [bytes]
    bench: str  # name of the bench that the recording states; empty if it states none
    duration: float  # from the first to the last sample [s]
    rate: float  # samples per second, gaps not counted [1/s]; 0 for a single sample
    topics: dict[str, int]  # number of messages of every topic
    integrity: Integrity  # missing and other faulty samples
    segments: int  # segments of test plans that have a hold; 0 where no setpoints were recorded
    holds: tuple[Hold, ...]
    spin_rate: tuple[float, float]  # smallest and largest spin rate measured [rad/s]
    tilt: tuple[float, float]  # smallest and largest tilt magnitude measured [rad]
    rigs: tuple[str, ...]  # attitudes of the rig that were planned, in order
    unchecked: int = 0  # messages that no checksum covers
    machine: str = ""  # name of the machine; empty where unknown
    namespace: str = ""  # namespace in which the bench ran, such as ``/bench2``; empty for the root
    #: What no message states and no instrument measured, in words, each with what is taken instead.
    assumed: tuple[str, ...] = ()
    publishers: tuple[Publisher, ...] = ()  # who published what, where the recorder has stated it


def info(source: str | Path | Recording) -> RecordingInfo:
    """Return the summary of a recording; a path is read first.

    Raises
    ------
    InputError
        As `Recording.open` does.
    """
    recording = source if isinstance(source, Recording) else Recording.open(source)
    samples, faults = recording.measurement, recording.integrity()
    holds = _holds(recording)
    path = recording.path
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
    return RecordingInfo(
        path=str(path),
        size=sum(file.stat().st_size for file in files),
        bench=recording.carried_bench[0] if recording.carried_bench else "",
        duration=recording.duration,
        rate=_rate(recording),
        topics=recording.topics,
        integrity=faults,
        segments=len({hold.segment for hold in holds}),
        holds=holds,
        spin_rate=_extremes(len(samples), lambda part: samples["spin_rate"][part]),
        tilt=_extremes(len(samples), lambda part: np.hypot(samples["tilt_x"][part], samples["tilt_y"][part])),
        rigs=tuple(dict.fromkeys(event.rig for event in recording.environment)),
        unchecked=recording.unchecked,
        machine=recording.machine,
        namespace=recording.namespace,
        assumed=_assumed(recording),
        publishers=_publishers(path),
    )


def _assumed(recording: Recording) -> tuple[str, ...]:
    """Return what is assumed of a recording."""
    origins = recording.origins
    never = [
        f"{name} (that of the bench is taken)"
        for name in ASSUMED
        if name not in origins and not _has_values(recording.measurement[name])
    ]
    bench = () if recording.carried_bench else ("the bench (that of the model is taken)",)
    return (*assumed_rig(recording.environment), *bench, *origins_in_words(origins), *never)


def _has_values(column: NDArray[np.float64]) -> bool:
    """Whether any value is finite; the first part with one ends the search."""
    parts = (column[first : first + _PART] for first in range(0, len(column), _PART))
    return any(bool(np.isfinite(part).any()) for part in parts)


def _rate(recording: Recording) -> float:
    """Return the samples per second; 0 for a single one."""
    steps = len(recording.measurement) - 1 + recording.integrity().missing
    if not steps:
        return 0.0
    mean, usual = steps / recording.duration, 1.0 / usual_step(recording)
    return mean if abs(mean / usual - 1.0) < _SAME_RATE else usual


def _publishers(path: Path) -> tuple[Publisher, ...]:
    """Return who published what; empty for a single file, or where it is not stated."""
    file = path / METADATA_FILE
    if not file.is_file():
        return ()
    custom = read_metadata(file).custom
    return from_text(custom[ENTRY], str(file)) if ENTRY in custom else ()


def _holds(recording: Recording) -> tuple[Hold, ...]:
    rows = recording.setpoint
    if len(rows) == 0:
        return ()
    time = recording.seconds(rows["stamp_ns"])
    period = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    key = rows["segment"].astype(np.int64) * 2 + (rows["phase"] == _HOLD)
    edges = [0, *(np.flatnonzero(np.diff(key)) + 1), len(rows)]
    holds = []
    for first, last in itertools.pairwise(edges):
        if rows["phase"][first] == _HOLD:
            middle = rows[(first + last) // 2]
            asked = (float(middle[name]) for name in ("tilt_x", "tilt_y", "spin_rate"))
            length = float(time[last - 1] - time[first]) + period
            holds.append(Hold(int(middle["segment"]), float(time[first]), length, *asked))
    return tuple(holds)


def _extremes(count: int, values: Callable[[slice], NDArray[np.float64]]) -> tuple[float, float]:
    """Return the smallest and the largest finite value; both 0 without one."""

    def look(first: int, last: int) -> list[float]:
        own = values(slice(first, last))
        finite = own[np.isfinite(own)]
        return [float(finite.min()), float(finite.max())] if len(finite) else []

    found = [value for pair in by_blocks(count, look) for value in pair]
    return (min(found), max(found)) if found else (0.0, 0.0)
