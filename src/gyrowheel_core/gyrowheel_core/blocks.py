"""Long arrays block by block: what is read stays in the cache of the processor, and numpy works in several threads."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

_T = TypeVar("_T")

#: Rows of a block: some megabytes of columns.
ROWS = 1 << 15
_MOST_THREADS = 4


def by_blocks(count: int, work: Callable[[int, int], _T], rows: int = ROWS) -> list[_T]:
    """Work on the rows of an array by blocks.

    Parameters
    ----------
    count : int
        Number of rows.
    work : callable
        Given the first row of a block and that behind its last one; called in several threads.
    rows : int
        Rows of a block; the last one may have fewer.

    Returns
    -------
    list
        What the calls returned, in the order of the rows.
    """
    firsts = range(0, count, rows)
    lasts = [min(first + rows, count) for first in firsts]
    threads = min(_MOST_THREADS, len(os.sched_getaffinity(0)), max(len(firsts), 1))
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, firsts, lasts))
