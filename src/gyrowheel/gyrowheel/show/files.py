"""Files that are whole or as they were, as the command line writes and checks them."""

from __future__ import annotations

from pathlib import Path

from gyrowheel_core.files import disk_errors, json_text, require_new, require_writable, write_text
from gyrowheel_core.locks import changing

#: First lines of a report: in HTML, and in Markdown.
REPORT_MARKS = ('<meta name="generator" content="gyrowheel">', "<!-- report of gyrowheel -->")

#: Title of a report as PDF.
REPORT_TITLE = "gyrowheel report"

__all__ = [
    "REPORT_MARKS",
    "REPORT_TITLE",
    "changing",
    "disk_errors",
    "is_exported_map",
    "is_exported_table",
    "is_report",
    "is_suggested_map",
    "json_text",
    "new_folder",
    "require_new",
    "require_writable",
    "write_text",
]


def is_exported_table(file: Path) -> bool:
    """Return whether a file is plainly a table of `gyrowheel.write_table`; OSError if it cannot be read."""
    from gyrowheel_recording.mapping import is_exported_table

    return is_exported_table(file)


def is_exported_map(file: Path) -> bool:
    """Return whether a file is plainly a map of `gyrowheel.write_table`; OSError if it cannot be read."""
    from gyrowheel_recording.mapping import is_exported_map

    return is_exported_map(file)


def is_suggested_map(file: Path) -> bool:
    """Return whether a file is plainly a map of `gyrowheel.TableMap`; OSError if it cannot be read."""
    with file.open(encoding="utf-8", errors="replace") as stream:
        return stream.readline(1000).startswith("# Suggested for ")


def is_report(head: str) -> bool:
    """Return whether a file that begins like this is plainly a report of `gyrowheel.Report`."""
    return any(mark in head for mark in REPORT_MARKS) or (
        head.startswith("%PDF") and f"({REPORT_TITLE})" in head
    )


def new_folder(parent: Path, name: str, first: int) -> Path:
    """Return ``parent/name-first``, or with the next number that is free."""
    number = first
    while (folder := parent / f"{name}-{number}").exists():
        number += 1
    return folder
