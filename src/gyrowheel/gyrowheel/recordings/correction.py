"""Recordings with wrong setups: what is wrong, and corrected copies."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gyrowheel.recordings.api import Recording
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from gyrowheel_analysis.model import Model
    from gyrowheel_recording.mislabelled.fixes import WrongSetup


def correct(
    recording: Recording | str | Path,
    *,
    exchange: Sequence[tuple[str, str]] = (),
    scale: Mapping[str, float] | None = None,
    offset: Mapping[str, float] | None = None,
    shift: Mapping[str, float] | None = None,
    folder: str | Path | None = None,
) -> Recording:
    """Return a copy of a recording with corrected readings.

    Parameters
    ----------
    recording : Recording or path
        The recording, which stays as it is.
    exchange : sequence of (str, str)
        Pairs of readings to exchange, before all else.
    scale, offset : mapping, optional
        Readings to multiply, then to increase [SI].
    shift : mapping, optional
        Readings to move to later times [s]; samples for which nothing is left are dropped.
    folder : str or Path, optional
        New directory to keep it in; a temporary one that is removed with the recording if not given.

    Raises
    ------
    InputError
        If there is no such reading, a value is not allowed, nothing is to be done, or the folder cannot be written.
    """
    from gyrowheel_core.files import new_directory, require_new
    from gyrowheel_recording.mislabelled.fixes import Fix
    from gyrowheel_recording.mislabelled.fixes import correct as write

    if folder is not None:
        require_new(Path(folder))
    given = recording if isinstance(recording, Recording) else Recording.open(recording)
    cure = Fix(tuple(exchange), dict(scale or {}), dict(offset or {}), dict(shift or {}))
    if folder is not None:
        with new_directory(Path(folder)) as place:
            write(given.data, cure, place)
        return Recording.made(Path(folder))
    scratch = tempfile.TemporaryDirectory(prefix="gyrowheel-")
    place = Path(scratch.name) / f"{given.name}-corrected"
    write(given.data, cure, place)
    return Recording.made(place, scratch)


def wrong_setups(recordings: Sequence[Recording], model: Model, *, mixed: bool = False) -> list[WrongSetup]:
    """Return the wrong setups of recordings: columns that cannot be what they are called."""
    from gyrowheel_recording.mislabelled.find import wrong_setups as find

    return find([recording.data for recording in recordings], model.reference_bench, mixed=mixed)


@contextlib.contextmanager
def explained_by(wrong: Sequence[WrongSetup]) -> Iterator[None]:
    """Report a wrong setup instead of an error that it causes."""
    try:
        yield
    except InputError as error:
        if not wrong:
            raise
        from gyrowheel.show.sentences.setup import setup_line

        raise InputError(setup_line(wrong)) from error
