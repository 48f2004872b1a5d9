"""Functions on files that verbs use, which may not import the packages below."""

from __future__ import annotations

from pathlib import Path

from gyrowheel_core.files import disk_errors, json_text, new_folder, require_new, require_writable, write_text
from gyrowheel_core.locks import changing

__all__ = [
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


def is_exported_table(file: Path) -> bool:
    """Return whether a file is a table of `gyrowheel.write_table`; OSError if it cannot be read."""
    from gyrowheel_recording.mapping import is_exported_table

    return is_exported_table(file)


def is_exported_map(file: Path) -> bool:
    """Return whether a file is a map of `gyrowheel.write_table`; OSError if it cannot be read."""
    from gyrowheel_recording.mapping import is_exported_map

    return is_exported_map(file)
