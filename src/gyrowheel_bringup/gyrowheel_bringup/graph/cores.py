"""Which cores of the processor the nodes run on."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping

#: Nodes that wait for each other's messages: only one of them works at a time.
_LOOP = ("plant", "controller")


def share_core(pids: Mapping[str, int], number: int) -> None:
    """Let the nodes of the loop share one core, and all others have the rest.

    A message that wakes a process on another core takes longer than one on the same core, on virtual machines much
    longer, and nothing is gained by two cores of which one waits for the other. Where there is one core only, or the
    system has no such control, everything is left as it is.

    Parameters
    ----------
    pids : mapping of str to int
        Process id of each node.
    number : int
        Which core it is, counted from the first allowed one and round again: graphs of other numbers are to take
        other cores.
    """
    if not hasattr(os, "sched_setaffinity"):
        return
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) < 2 or not all(name in pids for name in _LOOP):
        return
    shared = cores[number % len(cores)]
    for name, pid in pids.items():
        own = {shared} if name in _LOOP else set(cores) - {shared}
        for thread in _threads(pid):
            with contextlib.suppress(OSError):  # one that has just ended, or a system that does not allow it
                os.sched_setaffinity(thread, own)


def _threads(pid: int) -> list[int]:
    try:
        return [int(name) for name in os.listdir(f"/proc/{pid}/task")]
    except OSError:  # a node that has just ended
        return []
