"""HDF5 files, and those of MATLAB from version 7.3 on, by h5py."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gyrowheel_analysis.tables.grid import Column, Grid, require_table, split
from gyrowheel_core.errors import InputError, one_line

_UNITS = ("unit", "units", "Unit", "Units", "UNIT")


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read data sets that are vectors, matrices or records (see `formats.read_grid`)."""
    import h5py  # takes a while, as the other readers' libraries do

    columns: list[Column] = []
    size = 0.0
    try:
        with h5py.File(path, "r") as file:
            joint = "." if _is_matlab(path) else "/"

            def take(name: str, node: Any) -> None:
                nonlocal size
                if (
                    not isinstance(node, h5py.Dataset)
                    or name.startswith("#")
                    or node.ndim > 2
                    or node.size is None
                ):
                    return
                kind = node.attrs.get("MATLAB_class", b"")
                if (
                    node.size < 2
                    or kind in (b"char", b"cell")
                    or (node.dtype.names is None and node.dtype.kind not in "biuf")
                ):
                    return
                own = name.replace("/", joint)
                if names is not None and not any(
                    wanted == own or wanted.startswith(own + joint) for wanted in names
                ):
                    return
                size += float(node.size) * max(len(node.dtype.names or ()), 1)
                require_table(size, str(path))
                columns.extend(split(own, node[()], unit=_unit(node), joint=joint))

            file.visititems(take)
    except InputError:
        raise
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        raise InputError(f"{path}: cannot be read: {one_line(error)}") from None
    return Grid.of(str(path), [own for own in columns if names is None or own.name in names])


def _is_matlab(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(6) == b"MATLAB"


def _unit(node: Any) -> str:
    for name in _UNITS:
        if name in node.attrs:
            value = np.asarray(node.attrs[name]).ravel()
            if len(value):
                return value[0].decode("utf-8", "replace") if isinstance(value[0], bytes) else str(value[0])
    return ""
