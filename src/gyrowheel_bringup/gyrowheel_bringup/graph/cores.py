"""Placement of the nodes on processor cores."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping

#: Nodes that wait for each other's messages: only one of them runs at a time.
_LOOP = ("plant", "controller")


def share_core(pids: Mapping[str, int], number: int) -> None:
    """Place the nodes of the loop on one core, and all others on the rest.

    To wake a process on another core takes longer than on the same core, on virtual machines much longer, and two cores
    of which one waits for the other gain nothing. With a single core, or without such control, nothing changes.

    Parameters
    ----------
    pids : mapping of str to int
        Process id of each node.
    number : int
        Number of the graph, which chooses the core, counted cyclically from the first allowed one: other graphs
        should have other numbers.
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
            with contextlib.suppress(OSError):  # the process has just ended, or the system does not allow it
                os.sched_setaffinity(thread, own)


def _threads(pid: int) -> list[int]:
    try:
        return [int(name) for name in os.listdir(f"/proc/{pid}/task")]
    except OSError:  # the node has just ended
        return []
