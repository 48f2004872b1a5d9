"""Arrays larger than the memory, processing in cache-sized blocks, and structured arrays as plain bytes."""

from __future__ import annotations

import contextlib
import mmap
import os
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from gyrowheel_core import cache

_T = TypeVar("_T")

#: Rows of a block: some megabytes of columns.
ROWS = 1 << 15
_MOST_THREADS = 4
#: Size above which an array is mapped to a file [bytes]: about three hours of the bench's samples.
IN_MEMORY = 2 << 30


def zeros(count: int, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """Return zeros, shape (n,).

    An array larger than `IN_MEMORY` is mapped to an unnamed file in the user's cache folder, if the disk has room. The
    kernel can write its pages back under memory pressure, so that hours of samples leave room for their analysis.
    """
    size = count * dtype.itemsize
    if size > IN_MEMORY:
        with contextlib.suppress(OSError), tempfile.TemporaryFile(dir=cache.folder()) as file:
            # without reserved blocks a full disk would end the process (SIGBUS) when a page is written
            os.posix_fallocate(file.fileno(), 0, size)
            return np.ndarray((count,), dtype, buffer=mmap.mmap(file.fileno(), size))
    return np.zeros(count, dtype)


def by_blocks(count: int, work: Callable[[int, int], _T], rows: int = ROWS) -> list[_T]:
    """Process the rows of an array in blocks.

    Parameters
    ----------
    count : int
        Number of rows.
    work : callable
        Called with the first row of a block and the row after its last one, in several threads.
    rows : int
        Rows of a block; the last one may have fewer.

    Returns
    -------
    list
        Results of the calls, in the order of the rows.
    """
    firsts = range(0, count, rows)
    lasts = [min(first + rows, count) for first in firsts]
    threads = min(_MOST_THREADS, len(os.sched_getaffinity(0)), max(len(firsts), 1))
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, firsts, lasts))


def block_extremes(columns: npt.NDArray[np.float64], span: int) -> npt.NDArray[np.float64]:
    """Return smallest and largest of every `span` values of columns (n, k), the last ones fewer: (n, 2, m).

    They are NaN where a value is NaN.
    """
    whole = columns.shape[1] - columns.shape[1] % span
    parts = [columns[:, :whole].reshape(len(columns), -1, span)]
    if whole < columns.shape[1]:
        parts.append(columns[:, None, whole:])
    ends = [np.stack([part.min(axis=2), part.max(axis=2)], axis=1) for part in parts]
    return np.concatenate(ends, axis=2)


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Keep linear algebra on one thread: the matrices are small, and threads would only wait for each other."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


def everywhere(
    memory: memoryview | npt.NDArray[np.uint8], dtype: np.dtype[Any], *, writeable: bool = False
) -> npt.NDArray[Any]:
    """Return overlapping elements of a memory, one at every byte where a whole one fits.

    The result is read-only by default, also for writable memory: a compiled loop is then compiled once for both.
    """
    result: npt.NDArray[Any] = np.ndarray(
        (len(memory) - dtype.itemsize + 1,), dtype=dtype, buffer=memory, strides=(1,)
    )
    result.flags.writeable = writeable
    return result


def gathered(memory: memoryview, places: npt.NDArray[np.int64], dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """Return a copy of the elements at `places` of a memory."""
    if len(places) == 0:
        return np.empty(0, dtype)
    # as plain bytes, which numpy copies at once
    return everywhere(memory, np.dtype(f"V{dtype.itemsize}"))[places].view(dtype)


def running_mean(
    values: npt.NDArray[np.float64], size: int, beyond: Literal["edge", "symmetric"]
) -> npt.NDArray[np.float64]:
    """Return the mean of `size` values (n,) around each; beyond an end the last is repeated, or all are mirrored."""
    before = size // 2
    total = np.pad(values, (before + 1, size - before - 1), beyond)
    total[0] = 0.0
    np.cumsum(total, out=total)
    return np.asarray((total[size:] - total[:-size]) / size)


def picked(rows: npt.NDArray[Any], which: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return some rows of a structured array, padding bytes included, which numpy's indexing leaves undefined."""
    return rows.view(f"V{rows.dtype.itemsize}")[which].view(rows.dtype)
