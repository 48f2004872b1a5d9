"""The diagnosis of a recording in progress, renewed as it grows."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from gyrowheel.diagnosis.api import Diagnosis, diagnose
from gyrowheel.models.api import Model
from gyrowheel.recordings.api import Recording
from gyrowheel.recordings.inputs import Recordings, Say, opened
from gyrowheel_analysis.criteria import FEWEST_WINDOWS
from gyrowheel_analysis.diagnosis.looks import Settlement
from gyrowheel_analysis.fitting.kept_windows import reduced
from gyrowheel_analysis.fitting.preparation import samples_of
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import being_written, salvage

_POLL = 0.25  # s


@dataclass(frozen=True)
class Look:
    """One look at a recording in progress.

    Attributes
    ----------
    number : int
        Its number, from 1 on.
    recording : Recording
        The recording as far as it was written.
    diagnosis : Diagnosis
        The diagnosis of that.
    settled : bool
        Whether an effect is named with certainty, although looking often finds more by chance; see
        `gyrowheel_analysis.diagnosis.looks`.
    complete : bool
        Whether the recording had ended.
    """

    number: int
    recording: Recording
    diagnosis: Diagnosis
    settled: bool
    complete: bool

    @property
    def state(self) -> Literal["settled", "whole", "so far"]:
        """Its state in a word or two."""
        return "settled" if self.settled else "whole" if self.complete else "so far"


def follow(
    directory: str | Path,
    model: Model,
    *,
    validate: Recordings = (),
    averages: bool = False,
    progress: Say | None = None,
) -> Iterator[Look]:
    """Diagnose a recording while it is written, again whenever it has new steady motion, until it ends.

    Parameters
    ----------
    directory : str or Path
        Directory of the recording. One that is complete is looked at once.
    model : Model
        The model.
    validate : Recording, path or list, optional
        Recordings of the machine for validation.
    averages : bool
        As `gyrowheel.diagnose` takes it.
    progress : callable, optional
        Called with a line of text now and then.

    Yields
    ------
    Look
        The latest look; the last one is of the whole recording. No look takes more than half of the time.

    Raises
    ------
    InputError
        If there is no such recording, or it broke off.
    """
    place, unused = Path(directory), opened(validate)
    settlement, windows, size = Settlement(), 0, -1
    while True:
        began = time.monotonic()
        complete = not being_written(place)
        if complete:
            recording: Recording | None = Recording.open(place)
        else:
            size, before = _size(place), size
            recording = _so_far(place) if size != before else None
        if recording is not None:
            now = 0 if complete else _windows(recording, model)
            if complete or now > max(windows, FEWEST_WINDOWS - 1):
                windows = now
                found = diagnose([recording], model, validate=unused, averages=averages, progress=progress)
                settlement = settlement.after(found)
                yield Look(settlement.looks, recording, found, settlement.settled, complete)
        if complete:
            return
        time.sleep(max(_POLL, time.monotonic() - began))


def _so_far(place: Path) -> Recording | None:
    """Return what is written of a recording in progress; None if it has no sample yet."""
    with tempfile.TemporaryDirectory(prefix="gyrowheel-") as scratch:
        copy = Path(scratch) / place.absolute().name
        try:
            salvage(place, copy, unfinished=True)
            data = Recording.open(copy).data
        except InputError:  # at its end it is read as a whole, with the reason
            return None
        return Recording(place, replace(data, path=place))


def _windows(recording: Recording, model: Model) -> int:
    """Return the number of steady windows; 0 while there are too few samples."""
    try:
        samples = samples_of(recording.data, incomplete=True)
        return len(reduced(recording.data, samples, model.details.reference_bench).windows)
    except InputError:
        return 0


def _size(place: Path) -> int:
    """Return the size of the files of a recording [bytes]."""
    total = 0
    for entry in os.scandir(place) if place.is_dir() else ():
        try:
            total += entry.stat().st_size
        except OSError:  # removed meanwhile
            continue
    return total
