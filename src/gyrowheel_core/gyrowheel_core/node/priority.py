"""Priority of a process before the usual ones, for nodes that keep pace with the clock on the wall."""

from __future__ import annotations

import os
from pathlib import Path

from gyrowheel_core.node.parameters import Param

#: For nodes that have to keep pace with the clock on the wall.
PRIORITY = Param(
    "priority",
    0,
    "Priority before all usual processes (SCHED_FIFO), where the system allows it; 0: as they are",
    low=0,
    high=99,
)


def raise_priority(level: int) -> bool:
    """Put this process before all usual ones (``SCHED_FIFO``); return whether the system allows it.

    Parameters
    ----------
    level : int
        1 .. 99; 0 leaves everything as it is.
    """
    if level == 0:
        return True
    try:
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(level))
    except OSError:
        return False
    return True
