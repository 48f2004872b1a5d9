"""Archives of NumPy (``.npz``), and arrays of records (``.npy``)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from gyrowheel_recording.tables.grid import Column, Grid, split
from gyrowheel_recording.tables.readers import library_errors

_ARRAY: Final = b"\x93NUMPY"
_RECORDS: Final = b"'descr': ["  # of an array: its cells have fields
_ZIP: Final = b"PK\x03\x04"
_NAME: Final = 30  # place of the name of the first file of an archive; its length stands four bytes before


def begins(head: bytes) -> bool:
    """Whether a file that begins with some bytes is one of NumPy whose columns have names."""
    if head.startswith(_ARRAY):
        return _RECORDS in head[:128]
    name = head[_NAME : _NAME + int.from_bytes(head[_NAME - 4 : _NAME - 2], "little")]
    return head.startswith(_ZIP) and name.endswith(b".npy")


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read arrays that are vectors, matrices or records (see `formats.read_grid`)."""
    columns: list[Column] = []
    remarks: list[str] = []
    with library_errors(path):
        content = np.load(path)
        if isinstance(content, np.ndarray):
            columns += split("", content, joint="")
        else:
            with content:
                for name in content.files:
                    try:
                        columns += split(name, content[name])
                    except ValueError as error:
                        if "allow_pickle" not in str(error):
                            raise
                        remarks.append(f"{name} is left out: its cells are objects of Python")
    wanted = [own for own in columns if names is None or own.name in names]
    return Grid.of(str(path), wanted, remarks if names is None else ())
