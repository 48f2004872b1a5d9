"""Structured arrays as the bytes that they are: elements at any byte of a memory, and rows with what pads them."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def everywhere(
    memory: memoryview | npt.NDArray[np.uint8], dtype: np.dtype[Any], *, writeable: bool = False
) -> npt.NDArray[Any]:
    """Return one element at every byte of a memory where a whole one begins; they overlap.

    Memory that may be written to is shown to be read only like any other: a compiled loop is compiled once for both.
    """
    result: npt.NDArray[Any] = np.ndarray(
        (len(memory) - dtype.itemsize + 1,), dtype=dtype, buffer=memory, strides=(1,)
    )
    result.flags.writeable = writeable
    return result


def gathered(memory: memoryview, places: npt.NDArray[np.int64], dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """Return a copy of what is at `places` of a memory, one element each."""
    if len(places) == 0:
        return np.empty(0, dtype)
    # as plain bytes, which numpy copies at once
    return everywhere(memory, np.dtype(f"V{dtype.itemsize}"))[places].view(dtype)


def picked(rows: npt.NDArray[Any], which: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return some rows of a structured array with the bytes that pad them, which numpy's indexing leaves undefined."""
    return rows.view(f"V{rows.dtype.itemsize}")[which].view(rows.dtype)
