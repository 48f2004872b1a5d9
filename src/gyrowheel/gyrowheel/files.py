"""Files that are whole or as they were, as the command line writes and checks them."""

from __future__ import annotations

from pathlib import Path

from gyrowheel_core.files import disk_errors, json_text, require_new, require_writable, write_text
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
    """Return whether a file is plainly a table of `gyrowheel.write_table`; OSError if it cannot be read."""
    from gyrowheel_analysis.exchange import is_exported_table

    return is_exported_table(file)


def is_exported_map(file: Path) -> bool:
    """Return whether a file is plainly a map of `gyrowheel.write_table`; OSError if it cannot be read."""
    from gyrowheel_analysis.exchange import is_exported_map

    return is_exported_map(file)


def new_folder(parent: Path, name: str, first: int) -> Path:
    """Return ``parent/name-first``, or the next number of which there is no folder yet."""
    number = first
    while (folder := parent / f"{name}-{number}").exists():
        number += 1
    return folder
