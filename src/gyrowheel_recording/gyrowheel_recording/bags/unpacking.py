"""Compressed files, unpacked into memory as far as the limit allows; nothing is written to the disk."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import zstandard

from gyrowheel_core.errors import InputError
from gyrowheel_core.limits import largest, require_room
from gyrowheel_recording.bags.mcap.records import MOST_COMPRESSED

_BLOCK = 1 << 20  # bytes


@contextlib.contextmanager
def file_in_memory(name: str) -> Iterator[tuple[BinaryIO, Path]]:
    """Yield an empty file that has no place on the disk, and a path by which this process can open it."""
    number = os.memfd_create(name[:200], os.MFD_CLOEXEC)
    with os.fdopen(number, "w+b", buffering=0) as file:
        yield file, Path(f"/proc/self/fd/{number}")


def unpack(source: BinaryIO, target: BinaryIO, name: Path) -> None:
    """Write what a file compressed by zstd holds.

    Parameters
    ----------
    source : file
        The compressed file.
    target : file
        Takes the content; after an error it has what could be unpacked before.
    name : Path
        What the file is called, for the error.

    Raises
    ------
    InputError
        If it unpacks to more than `limits.largest`, or to more than any recording can.
    zstandard.ZstdError
        If it is damaged.
    """
    limit, written = largest(), 0
    with zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True, closefd=False) as plain:
        while block := plain.read(_BLOCK):
            written += len(block)
            if written > limit:
                require_room(float("inf"), f"{name}: unpacked it")
            if written > MOST_COMPRESSED * max(source.tell(), _BLOCK):
                raise InputError(
                    f"{name}: unpacks to more than {MOST_COMPRESSED} times its size, as no recording does"
                )
            target.write(block)
