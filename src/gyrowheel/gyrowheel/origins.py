"""How a simulated machine was asked for: noted with its recording, so that the next test can be run on the same one.

The note stands in rosbag2's ``custom_data`` of ``metadata.yaml``. Nothing that analyses a recording reads it: it is for
the command to type next. Of a hidden machine it has the name of the key file, never what is in it.
"""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from gyrowheel_analysis.recording.metadata import METADATA_FILE, metadata_text
from gyrowheel_core.files import write_text

_HEADING, _NOTE = "rosbag2_bagfile_information", "gyrowheel_machine"


def note_machine(folder: Path, options: Sequence[str]) -> None:
    """Note with a recording the options of the command line that its machine was asked for with.

    Raises
    ------
    InputError
        If the disk refuses it.
    """
    content = _content(folder)
    if not options or content is None:
        return
    known = content[_HEADING].get("custom_data")
    content[_HEADING]["custom_data"] = {
        **(known if isinstance(known, dict) else {}),
        _NOTE: shlex.join(options),
    }
    write_text(folder / METADATA_FILE, metadata_text(content))


def noted_machine(folders: Sequence[Path]) -> str:
    """Return the options with which the machine of some recordings was asked for; empty where none is noted."""
    for folder in folders:
        content = _content(folder)
        known = None if content is None else content[_HEADING].get("custom_data")
        note = known.get(_NOTE) if isinstance(known, dict) else None
        if isinstance(note, str) and note.isprintable():
            with contextlib.suppress(ValueError):
                return shlex.join(shlex.split(note))  # whatever stands there is words, and no other command
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


def _content(folder: Path) -> dict[str, Any] | None:
    """Return what stands in the metadata of a recording; None where there is none that can be read."""
    try:
        content = yaml.safe_load((folder / METADATA_FILE).read_text(encoding="utf-8"))
        return content if isinstance(content[_HEADING], dict) else None
    except (OSError, ValueError, TypeError, KeyError, RecursionError, yaml.YAMLError):
        return None
