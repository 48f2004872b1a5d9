"""MATLAB files up to version 7, by SciPy; those of version 7.3 are HDF5 files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gyrowheel_analysis.tables.grid import Column, Grid, require_table, split
from gyrowheel_core.errors import InputError, one_line


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read variables that are vectors, matrices or structures of them (see `formats.read_grid`)."""
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatReadError

    try:
        with path.open("rb") as file:
            # shapes alone: a compressed file may unpack to far more than it has
            require_table(sum(float(np.prod(shape)) for _, shape, _ in whosmat(file)), str(path))
            file.seek(0)
            content = loadmat(file, squeeze_me=True, struct_as_record=False)
    except InputError:
        raise
    except (MatReadError, OSError, ValueError, TypeError, NotImplementedError, KeyError, IndexError) as error:
        raise InputError(f"{path}: cannot be read: {one_line(error)}") from None
    columns = [
        column
        for name, value in content.items()
        if not name.startswith("__")
        for column in _columns(name, value)
        if names is None or column.name in names
    ]
    return Grid.of(str(path), columns)


def _columns(name: str, value: Any) -> Iterator[Column]:
    if hasattr(value, "_fieldnames"):  # a structure
        for field in value._fieldnames:
            yield from _columns(f"{name}.{field}", getattr(value, field))
        return
    array = np.asarray(value)
    if array.dtype == object:
        for k, own in enumerate(array.ravel()[:64]):
            if hasattr(own, "_fieldnames"):
                yield from _columns(f"{name}.{k + 1}", own)
        return
    yield from split(name, array)
