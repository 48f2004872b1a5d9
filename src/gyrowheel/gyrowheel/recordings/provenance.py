"""How a simulated machine was asked for: noted beside its recordings, so that the next test is run on the same one.

The note is a file of the machine's name in the folder ``.machines`` beside the recording. A recording itself holds
nothing of what its machine is, and no analysis reads the note: it is for the command to type next. Of a hidden machine
it has the name of the key file, never what is in it.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from gyrowheel.recordings.api import Recording
from gyrowheel_core.files import write_text

FOLDER = ".machines"
_LONGEST = 4096


def note_machine(recording: Recording, options: Sequence[str]) -> None:
    """Note beside a recording the options of the command line that its machine was asked for with.

    Raises
    ------
    InputError
        If the disk refuses it.
    """
    place = _place(recording) if options else None
    if place is not None:
        place.parent.mkdir(exist_ok=True)
        write_text(place, shlex.join(options) + "\n")


def noted_machine(recordings: Sequence[Recording]) -> str:
    """Return the options with which the machine of some recordings was asked for; empty where none are noted."""
    for recording in recordings:
        place = _place(recording)
        try:
            note = "" if place is None else place.read_text(encoding="utf-8")[:_LONGEST].strip()
            if note and note.isprintable():
                return shlex.join(shlex.split(note))  # whatever stands there is words, and no other command
        except (OSError, ValueError):
            continue
    return ""


def machine_options(
    *,
    effect: Sequence[str] | None = None,
    truth: Path | None = None,
    blind: Path | None = None,
    machine: int | None = None,
    seed: int = 0,
    bench: str | None = None,
) -> list[str]:
    """Return the options of the command line for a machine, as the user gave them."""
    words = [word for item in effect or () for word in ("--effect", item)]
    for name, value in (("truth", truth), ("blind", blind), ("machine", machine), ("bench", bench)):
        words += [] if value is None else [f"--{name}", str(value)]
    return [*words, "--seed", str(seed)] if seed else words


def _place(recording: Recording) -> Path | None:
    """Return the file of the note; None for a recording without the name of a machine."""
    name = recording.data.machine
    return recording.path.absolute().parent / FOLDER / name if name.isalnum() else None
