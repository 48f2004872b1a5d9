"""Functions on files that verbs use, which may not import the packages below."""

from __future__ import annotations

from pathlib import Path

from gyrowheel_core.files import disk_errors, json_text, new_folder, require_new, require_writable, write_text
from gyrowheel_core.locks import changing

__all__ = [
    "bag_head",
    "changing",
    "disk_errors",
    "is_exported_map",
    "is_exported_table",
    "json_text",
    "new_folder",
    "require_new",
    "require_writable",
    "write_text",
]

_METADATA = "metadata.yaml"
_HEAD = 4096  # characters of it that are looked at
_MARK = "rosbag2_bagfile_information"


def bag_head(folder: Path) -> str | None:
    """Return the beginning of the metadata of a recording; None for any other folder."""
    file = folder / _METADATA
    try:
        if not file.is_file():  # opening a pipe, which any user may put into a shared folder, would block
            return None
        with file.open(encoding="utf-8", errors="replace") as stream:
            head = stream.read(_HEAD)
    except OSError:
        return None
    return head if _MARK in head else None


def is_exported_table(file: Path) -> bool:
    """Return whether a file is a table of `gyrowheel.write_table`; OSError if it cannot be read."""
    from gyrowheel_recording.mapping import is_exported_table

    return is_exported_table(file)


def is_exported_map(file: Path) -> bool:
    """Return whether a file is a map of `gyrowheel.write_table`; OSError if it cannot be read."""
    from gyrowheel_recording.mapping import is_exported_map

    return is_exported_map(file)
